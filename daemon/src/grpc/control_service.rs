//! `ControlService`: what users ask of the running server.

use posed_proto::v1::{
    CalibrateRequest, CalibrateResponse, GetControlStateRequest, GetControlStateResponse,
    MoveObjectRequest, MoveObjectResponse, ResetRequest, ResetResponse, SetHeightRequest,
    SetHeightResponse, SetTrackerRequest, SetTrackerResponse, StartRecordingRequest,
    StartRecordingResponse, StopRecordingRequest, StopRecordingResponse,
    control_service_server::ControlService,
};
use tokio::task;
use tonic::{Request, Response, Status};

use super::{Services, convert};
use crate::{control::Refusal, output::record::RecordError, pipeline::tracking};

/// The service.
#[derive(Debug)]
pub(super) struct Controls {
    pub(super) services: Services,
}

#[tonic::async_trait]
impl ControlService for Controls {
    async fn get_control_state(
        &self,
        _: Request<GetControlStateRequest>,
    ) -> Result<Response<GetControlStateResponse>, Status> {
        let control = &self.services.control;
        Ok(Response::new(convert::control_state(
            &control.heights(),
            control.tracker(),
            control.trackers(),
            self.services.recorder.recording().as_ref(),
        )))
    }

    async fn reset(&self, _: Request<ResetRequest>) -> Result<Response<ResetResponse>, Status> {
        self.request(tracking::Request::Reset)?;
        Ok(Response::new(ResetResponse {}))
    }

    async fn set_height(
        &self,
        request: Request<SetHeightRequest>,
    ) -> Result<Response<SetHeightResponse>, Status> {
        let wish = request.into_inner();
        self.request(tracking::Request::Height {
            metres: wish.height_m,
            avatar: convert::to_avatar(wish.avatar_height_m),
        })?;
        Ok(Response::new(SetHeightResponse {}))
    }

    async fn move_object(
        &self,
        request: Request<MoveObjectRequest>,
    ) -> Result<Response<MoveObjectResponse>, Status> {
        let to = convert::to_object_move(&request.into_inner());
        let missing = || Status::invalid_argument("the position is missing");
        self.request(tracking::Request::Move(to.ok_or_else(missing)?))?;
        Ok(Response::new(MoveObjectResponse {}))
    }

    async fn set_tracker(
        &self,
        request: Request<SetTrackerRequest>,
    ) -> Result<Response<SetTrackerResponse>, Status> {
        let wire = request.into_inner().tracker();
        let unknown = || refused(&self.services.control.no_tracker(wire.as_str_name()));
        let kind = convert::to_tracker(wire).map_err(|_| unknown())?;
        self.request(tracking::Request::Tracker(kind))?;
        Ok(Response::new(SetTrackerResponse {}))
    }

    async fn calibrate(
        &self,
        request: Request<CalibrateRequest>,
    ) -> Result<Response<CalibrateResponse>, Status> {
        let stance = convert::to_stance(request.into_inner().stance());
        let unknown = || Status::invalid_argument("the stance is not one of those known");
        self.request(tracking::Request::Calibrate(stance.ok_or_else(unknown)?))?;
        Ok(Response::new(CalibrateResponse {}))
    }

    async fn start_recording(
        &self,
        request: Request<StartRecordingRequest>,
    ) -> Result<Response<StartRecordingResponse>, Status> {
        let wish = convert::to_wish(request.into_inner());
        let unknown = || Status::invalid_argument("the format or the names are not known");
        let (wish, recorder) = (wish.ok_or_else(unknown)?, self.services.recorder.clone());
        let begun = blocking(move || recorder.start(&wish)).await?;
        Ok(Response::new(StartRecordingResponse {
            recording: Some(convert::recording(&begun)),
        }))
    }

    async fn stop_recording(
        &self,
        _: Request<StopRecordingRequest>,
    ) -> Result<Response<StopRecordingResponse>, Status> {
        let recorder = self.services.recorder.clone();
        let ended = blocking(move || recorder.stop()).await?;
        Ok(Response::new(StopRecordingResponse {
            recording: Some(convert::recording(&ended)),
        }))
    }
}

impl Controls {
    fn request(&self, request: tracking::Request) -> Result<(), Status> {
        let answer = self.services.control.request(request);
        answer.map_err(|refusal| refused(&refusal))
    }
}

/// Disks may keep one waiting; other clients must not.
async fn blocking<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, RecordError> + Send + 'static,
) -> Result<T, Status> {
    let done = task::spawn_blocking(work).await;
    done.map_err(|error| Status::internal(error.to_string()))?
        .map_err(|error| record_status(&error))
}

fn refused(refusal: &Refusal) -> Status {
    let text = refusal.to_string();
    match refusal {
        Refusal::Busy => Status::resource_exhausted(text),
        Refusal::Height(_) | Refusal::Tracker { .. } | Refusal::Object { .. } => {
            Status::invalid_argument(text)
        }
    }
}

fn record_status(error: &RecordError) -> Status {
    let text = error.to_string();
    match error {
        RecordError::Busy(_) | RecordError::Idle | RecordError::NoFolder => {
            Status::failed_precondition(text)
        }
        RecordError::Name(_) => Status::invalid_argument(text),
        RecordError::Exists(_) => Status::already_exists(text),
        RecordError::File { .. } => Status::internal(text),
    }
}
