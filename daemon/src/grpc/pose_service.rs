//! `PoseService`: poses against credits, every pose, one pose; skeleton and clock.

use std::pin::Pin;

use futures_util::{Stream, stream};
use posed_proto::v1::{
    FollowPosesRequest, FollowPosesResponse, GetClockRequest, GetClockResponse, GetPoseRequest,
    GetPoseResponse, GetSkeletonRequest, GetSkeletonResponse, StreamPosesRequest,
    StreamPosesResponse, pose_service_server::PoseService,
};
use posed_signal::HostTime;
use tokio::sync::watch;
use tonic::{Request, Response, Status, Streaming};

use super::{
    Services, convert,
    hub::Hub,
    stopping,
    window::{Behind, POSES_MAX},
};
use crate::published::PublishedPose;

/// Half the window: a client further behind may as well begin with the newest.
const CATCH_UP_MAX: u32 = POSES_MAX as u32 / 2;
/// Credits that a client can have at a time.
const CREDIT_MAX: u32 = 1024;

type BoxStream<T> = Pin<Box<dyn Stream<Item = Result<T, Status>> + Send>>;

/// The service.
#[derive(Debug)]
pub(super) struct Poses {
    pub(super) services: Services,
    /// Closes when the server stops.
    pub(super) stop: watch::Receiver<()>,
}

#[tonic::async_trait]
impl PoseService for Poses {
    type FollowPosesStream = BoxStream<FollowPosesResponse>;
    type StreamPosesStream = BoxStream<StreamPosesResponse>;

    async fn follow_poses(
        &self,
        request: Request<Streaming<FollowPosesRequest>>,
    ) -> Result<Response<Self::FollowPosesStream>, Status> {
        let follower = Follower {
            cursor: self.cursor(None),
            requests: Some(request.into_inner()),
            credit: 0,
            catch_up: 0,
        };
        let poses = stream::unfold(follower, |mut follower| async {
            let sent = follower.next().await?;
            Some((sent, follower))
        });
        Ok(Response::new(Box::pin(poses)))
    }

    async fn stream_poses(
        &self,
        _: Request<StreamPosesRequest>,
    ) -> Result<Response<Self::StreamPosesStream>, Status> {
        // Sequence numbers begin at 1: before the first pose, the cursor stands before it.
        let from = self.services.hub.newest().unwrap_or(0);
        let poses = stream::unfold(self.cursor(Some(from)), |mut cursor| async {
            let next = cursor.wait(Behind::InOrder).await?;
            let message = |(pose, lost)| StreamPosesResponse {
                pose: Some(convert::pose(&pose)),
                lost,
            };
            Some((next.map(message), cursor))
        });
        Ok(Response::new(Box::pin(poses)))
    }

    async fn get_pose(
        &self,
        request: Request<GetPoseRequest>,
    ) -> Result<Response<GetPoseResponse>, Status> {
        let hub = &self.services.hub;
        let found = match request.into_inner().target_time_ns {
            None => hub
                .latest()
                .map_or(posed_signal::Lookup::Empty, posed_signal::Lookup::Exact),
            Some(target) => {
                let skeleton = self.services.wearer.borrow().skeleton;
                let too_old = || Status::out_of_range("the target time is before the oldest pose");
                hub.at(HostTime(target), &skeleton).ok_or_else(too_old)?
            }
        };
        let nothing = || Status::unavailable("there is no pose yet");
        convert::pose_at(&found)
            .map(Response::new)
            .ok_or_else(nothing)
    }

    async fn get_skeleton(
        &self,
        _: Request<GetSkeletonRequest>,
    ) -> Result<Response<GetSkeletonResponse>, Status> {
        let skeleton = convert::skeleton(&self.services.wearer.borrow());
        Ok(Response::new(GetSkeletonResponse {
            skeleton: Some(skeleton),
        }))
    }

    async fn get_clock(
        &self,
        _: Request<GetClockRequest>,
    ) -> Result<Response<GetClockResponse>, Status> {
        Ok(Response::new(GetClockResponse {
            time_ns: self.services.clock.now().0,
        }))
    }
}

impl Poses {
    fn cursor(&self, after: Option<u64>) -> Cursor {
        Cursor {
            hub: self.services.hub.clone(),
            changes: self.services.hub.changes(),
            stop: self.stop.clone(),
            after,
            ended: false,
        }
    }
}

/// How far one client has read.
struct Cursor {
    hub: Hub,
    changes: watch::Receiver<()>,
    stop: watch::Receiver<()>,
    after: Option<u64>,
    /// No pose will be published any more; some may still be unread.
    ended: bool,
}

impl Cursor {
    /// The next pose for this client, if there is one already, and those it missed.
    fn take(&mut self, behind: Behind) -> Option<(PublishedPose, u64)> {
        // Marked as seen before reading: whatever comes during it wakes `changed`.
        self.changes.mark_unchanged();
        let (pose, gap) = self.hub.next(self.after, behind)?;
        self.after = Some(pose.sequence);
        Some((pose, gap))
    }

    /// Whether there is nothing to read, now or later.
    fn is_done(&self) -> bool {
        self.ended
            && self
                .hub
                .newest()
                .is_none_or(|newest| self.after == Some(newest))
    }

    /// Waits for poses that [`Cursor::take`] has not looked at, or for their end.
    async fn changed(&mut self) -> Result<(), Status> {
        tokio::select! {
            changed = self.changes.changed(), if !self.ended => self.ended = changed.is_err(),
            _ = self.stop.changed() => return Err(stopping()),
        }
        Ok(())
    }

    /// The next pose for this client; `None` when there will be none.
    async fn wait(&mut self, behind: Behind) -> Option<Result<(PublishedPose, u64), Status>> {
        loop {
            if let Some(found) = self.take(behind) {
                return Some(Ok(found));
            }
            if self.ended {
                return None;
            }
            if let Err(status) = self.changed().await {
                return Some(Err(status));
            }
        }
    }
}

/// One client of `FollowPoses`.
struct Follower {
    cursor: Cursor,
    /// `None` once the client has said that it will ask for no more.
    requests: Option<Streaming<FollowPosesRequest>>,
    credit: u32,
    catch_up: u32,
}

/// What a follower waited for.
enum Woken {
    Request(Result<Option<FollowPosesRequest>, Status>),
    Poses(Result<(), Status>),
}

impl Follower {
    /// The next message; `None` ends the stream.
    async fn next(&mut self) -> Option<Result<FollowPosesResponse, Status>> {
        loop {
            let behind = Behind::CatchUp(self.catch_up as usize);
            if self.credit > 0
                && let Some((pose, gap)) = self.cursor.take(behind)
            {
                self.credit -= 1;
                let pose = Some(convert::pose(&pose));
                return Some(Ok(FollowPosesResponse { pose, gap }));
            }
            if self.cursor.is_done() || (self.requests.is_none() && self.credit == 0) {
                return None;
            }
            match self.woken().await {
                Woken::Request(Ok(Some(request))) => self.grant(request),
                Woken::Request(Ok(None)) => self.requests = None,
                // The client is gone.
                Woken::Request(Err(_)) => return None,
                Woken::Poses(Ok(())) => {}
                Woken::Poses(Err(status)) => return Some(Err(status)),
            }
        }
    }

    async fn woken(&mut self) -> Woken {
        let requests = &mut self.requests;
        let request = async {
            match requests {
                Some(requests) => requests.message().await,
                None => std::future::pending().await,
            }
        };
        tokio::select! {
            biased;
            request = request => Woken::Request(request),
            changed = self.cursor.changed() => Woken::Poses(changed),
        }
    }

    fn grant(&mut self, request: FollowPosesRequest) {
        self.credit = self.credit.saturating_add(request.credit).min(CREDIT_MAX);
        self.catch_up = request.catch_up.min(CATCH_UP_MAX);
    }
}
