//! What users ask for reaches the tracker and the disk, or is refused with a reason.

use posed_proto::v1::{
    CalibrateRequest, GetControlStateRequest, RecordingFormat, ResetRequest, SetHeightRequest,
    SetTrackerRequest, Stance, StartRecordingRequest, StopRecordingRequest, Tracker,
    control_service_client::ControlServiceClient,
};
use tonic::Code;

use super::fixture::Fixture;
use crate::pipeline::tracking::Request;

#[tokio::test]
async fn requests_reach_the_tracker_and_nonsense_does_not() {
    let mut fixture = Fixture::start();
    let mut client = ControlServiceClient::new(fixture.channel().await);
    client.reset(ResetRequest {}).await.unwrap();
    let stance = Stance::Straight.into();
    client.calibrate(CalibrateRequest { stance }).await.unwrap();
    let busy = client.reset(ResetRequest {}).await.unwrap_err();
    assert_eq!(busy.code(), Code::ResourceExhausted, "two are waiting");
    assert_eq!(fixture.requests.pop(), Some(Request::Reset));
    let calibrate = Request::Calibrate(posed_tracker::Stance::Straight);
    assert_eq!(fixture.requests.pop(), Some(calibrate));

    let height_m = 1.65;
    client
        .set_height(SetHeightRequest { height_m })
        .await
        .unwrap();
    let tracker = Tracker::Pip.into();
    client
        .set_tracker(SetTrackerRequest { tracker })
        .await
        .unwrap();
    let state = client.get_control_state(GetControlStateRequest {}).await;
    let state = state.unwrap().into_inner();
    assert_eq!((state.height_m, state.tracker()), (1.65, Tracker::Pip));
    assert_eq!(state.trackers, [Tracker::Ik as i32, Tracker::Pip as i32]);
    assert_eq!(state.recording, None);
    assert_eq!(fixture.requests.pop(), Some(Request::Height(1.65)));
    assert!(fixture.requests.pop().is_some());

    for height_m in [0.9, 2.6, f32::NAN] {
        let refused = client.set_height(SetHeightRequest { height_m }).await;
        assert_eq!(refused.unwrap_err().code(), Code::InvalidArgument);
    }
    for tracker in [0, Tracker::Questsim as i32, 99] {
        let refused = client.set_tracker(SetTrackerRequest { tracker }).await;
        let refused = refused.unwrap_err();
        assert_eq!(refused.code(), Code::InvalidArgument);
        assert!(refused.message().contains("there are ik, pip"), "{refused}");
    }
    let refused = client.calibrate(CalibrateRequest::default()).await;
    assert_eq!(refused.unwrap_err().code(), Code::InvalidArgument);
    assert_eq!(fixture.requests.pop(), None);
    fixture.stop().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn poses_are_recorded_between_start_and_stop() {
    let mut fixture = Fixture::start();
    let mut client = ControlServiceClient::new(fixture.channel().await);
    let idle = client.stop_recording(StopRecordingRequest {}).await;
    assert_eq!(idle.unwrap_err().code(), Code::FailedPrecondition);
    let wish = |name: &str| StartRecordingRequest {
        format: RecordingFormat::Bvh.into(),
        name: name.into(),
        names: 0,
    };
    let refused = client.start_recording(wish("../walk")).await;
    assert_eq!(refused.unwrap_err().code(), Code::InvalidArgument);
    let refused = client
        .start_recording(StartRecordingRequest::default())
        .await;
    assert_eq!(refused.unwrap_err().code(), Code::InvalidArgument);

    let begun = client
        .start_recording(wish("walk"))
        .await
        .unwrap()
        .into_inner();
    let begun = begun.recording.unwrap();
    let busy = client.start_recording(wish("run")).await.unwrap_err();
    assert_eq!(busy.code(), Code::FailedPrecondition);
    assert!(busy.message().contains(&begun.path), "{busy}");
    for sequence in 1..=40 {
        fixture.publish(sequence).await;
    }
    let state = client.get_control_state(GetControlStateRequest {}).await;
    assert_eq!(
        state.unwrap().into_inner().recording.unwrap().path,
        begun.path
    );
    let ended = client
        .stop_recording(StopRecordingRequest {})
        .await
        .unwrap();
    let ended = ended.into_inner().recording.unwrap();
    assert_eq!((ended.poses, ended.lost, ended.error.as_str()), (40, 0, ""));
    assert_eq!(ended.path, begun.path);
    let text = std::fs::read_to_string(&ended.path).unwrap();
    assert!(
        text.contains("MOTION") && text.contains("LeftUpLeg"),
        "{text}"
    );
    let again = client.start_recording(wish("walk")).await.unwrap_err();
    assert_eq!(again.code(), Code::AlreadyExists);
    fixture.stop().await;
}
