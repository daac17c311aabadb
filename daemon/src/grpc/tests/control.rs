//! What users ask for reaches the tracker and the disk, or is refused with a reason.

use glam::{Quat, Vec3};
use posed_proto::v1::{
    CalibrateRequest, GetControlStateRequest, GetSkeletonRequest, MoveObjectRequest,
    RecordingFormat, ResetRequest, SetHeightRequest, SetTrackerRequest, Stance,
    StartRecordingRequest, StopRecordingRequest, Tracker, Vector3,
    control_service_client::ControlServiceClient, pose_service_client::PoseServiceClient,
};
use posed_tracker::ObjectMove;
use tonic::Code;

use super::fixture::Fixture;
use crate::{heights::Avatar, pipeline::tracking::Request};

fn height(height_m: f32) -> SetHeightRequest {
    SetHeightRequest {
        height_m,
        avatar_height_m: None,
    }
}

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
    client.set_height(height(height_m)).await.unwrap();
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
    assert_eq!(state.avatar_height_m, None);
    let told = Request::Height {
        metres: 1.65,
        avatar: Avatar::Keep,
    };
    assert_eq!(fixture.requests.pop(), Some(told));
    assert!(fixture.requests.pop().is_some());

    for height_m in [0.9, 2.6, f32::NAN] {
        let refused = client.set_height(height(height_m)).await;
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

#[tokio::test]
async fn objects_are_moved_and_avatars_grow_or_the_reason_is_told() {
    let mut fixture = Fixture::start();
    let mut client = ControlServiceClient::new(fixture.channel().await);
    let at = |x: f32| Some(Vector3 { x, y: 0.5, z: -1.0 });
    let good = MoveObjectRequest {
        index: 0,
        position: at(1.0),
        rotation: None,
        velocity: at(2.0),
        angular_velocity: None,
    };
    client.move_object(good).await.unwrap();
    let to = ObjectMove {
        index: 0,
        position: Vec3::new(1.0, 0.5, -1.0),
        rotation: Quat::IDENTITY,
        velocity: Vec3::new(2.0, 0.5, -1.0),
        angular_velocity: Vec3::ZERO,
    };
    assert_eq!(fixture.requests.pop(), Some(Request::Move(to)));
    let wrong = |change: fn(&mut MoveObjectRequest)| {
        let mut wrong = good;
        change(&mut wrong);
        wrong
    };
    for (request, why) in [
        (wrong(|r| r.index = 1), "not in the scene"),
        (wrong(|r| r.index = u32::MAX), "not in the scene"),
        (wrong(|r| r.position = None), "position is missing"),
        (wrong(|r| r.position = Some(far(f32::NAN))), "100 m away"),
        (wrong(|r| r.position = Some(far(200.0))), "100 m away"),
        (wrong(|r| r.velocity = Some(far(f32::INFINITY))), "30 m/s"),
        (wrong(|r| r.angular_velocity = Some(far(1e6))), "100 rad/s"),
        (
            wrong(|r| r.rotation = Some(Default::default())),
            "unit quaternion",
        ),
    ] {
        let refused = client.move_object(request).await.unwrap_err();
        assert_eq!(refused.code(), Code::InvalidArgument);
        assert!(refused.message().contains(why), "{refused}");
    }
    assert_eq!(fixture.requests.pop(), None);

    let tall = SetHeightRequest {
        height_m: 1.7,
        avatar_height_m: Some(2.0),
    };
    client.set_height(tall).await.unwrap();
    let state = client.get_control_state(GetControlStateRequest {}).await;
    let state = state.unwrap().into_inner();
    assert_eq!((state.height_m, state.avatar_height_m), (1.7, Some(2.0)));
    let mut poses = PoseServiceClient::new(fixture.channel().await);
    let skeleton = poses.get_skeleton(GetSkeletonRequest {}).await.unwrap();
    assert_eq!(skeleton.into_inner().skeleton.unwrap().height_m, 2.0);
    let giant = SetHeightRequest {
        height_m: 1.7,
        avatar_height_m: Some(9.0),
    };
    let refused = client.set_height(giant).await.unwrap_err();
    assert_eq!(refused.code(), Code::InvalidArgument);
    fixture.stop().await;
}

fn far(x: f32) -> Vector3 {
    Vector3 { x, y: 0.0, z: 0.0 }
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
