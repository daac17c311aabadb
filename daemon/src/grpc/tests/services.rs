//! One pose, skeleton, clock, devices, health, reflection, limits.

use posed_proto::v1::{
    ApplyHapticsRequest, GetClockRequest, GetPoseRequest, GetSkeletonRequest, ListDevicesRequest,
    Lookup, WatchDevicesRequest, device_service_client::DeviceServiceClient,
    pose_service_client::PoseServiceClient,
};
use posed_signal::{DeviceId, HostTime, Role, Serial};
use tonic::{Code, transport::Channel};
use tonic_health::pb::{
    HealthCheckRequest, health_check_response::ServingStatus, health_client::HealthClient,
};

use super::fixture::{Fixture, PERIOD_NS};
use crate::published::{DeviceState, tests::held_pose_at};

async fn poses(fixture: &Fixture) -> PoseServiceClient<Channel> {
    PoseServiceClient::new(fixture.channel().await)
}

#[tokio::test]
async fn one_pose_can_be_asked_for_by_time() {
    let mut fixture = Fixture::start();
    let mut client = poses(&fixture).await;
    let at = |ns| GetPoseRequest {
        target_time_ns: Some(ns),
    };
    let early = client
        .get_pose(GetPoseRequest::default())
        .await
        .unwrap_err();
    assert_eq!(early.code(), Code::Unavailable);
    for sequence in 5..=20 {
        fixture.publish(sequence).await;
    }
    let newest = client
        .get_pose(GetPoseRequest::default())
        .await
        .unwrap()
        .into_inner();
    assert_eq!(
        (newest.lookup(), newest.pose.unwrap().sequence),
        (Lookup::Exact, 20)
    );
    let between = client
        .get_pose(at(7 * PERIOD_NS + 3))
        .await
        .unwrap()
        .into_inner();
    assert_eq!(between.lookup(), Lookup::Interpolated);
    assert_eq!(between.pose.unwrap().target_time_ns, 7 * PERIOD_NS + 3);
    let ahead = client
        .get_pose(at(22 * PERIOD_NS))
        .await
        .unwrap()
        .into_inner();
    assert_eq!(
        (ahead.lookup(), ahead.offset_ns),
        (Lookup::Extrapolated, 2 * PERIOD_NS as i64)
    );
    let old = client.get_pose(at(4 * PERIOD_NS)).await.unwrap_err();
    assert_eq!(old.code(), Code::OutOfRange);
    let clock = client
        .get_clock(GetClockRequest {})
        .await
        .unwrap()
        .into_inner();
    assert_eq!(clock.time_ns, 123_456);
    let skeleton = client
        .get_skeleton(GetSkeletonRequest {})
        .await
        .unwrap()
        .into_inner();
    assert_eq!(skeleton.skeleton.unwrap().height_m, 1.8);
}

fn device(id: u8, packets: u64) -> DeviceState {
    DeviceState {
        id: DeviceId(id),
        serial: Serial::new("LHR-DFCF00EE"),
        model: "Index headset".into(),
        role: Role::Head,
        connected: true,
        radio: None,
        battery: None,
        rate_hz: 250.0,
        tracked_share: 1.0,
        packets,
        errors: 0,
        dropped: 0,
        has_haptics: id == 1,
        haptics: 0,
        haptics_dropped: 0,
        troubles: Vec::new(),
        pose: None,
    }
}

#[tokio::test]
async fn devices_are_listed_and_watched() {
    let fixture = Fixture::start();
    let mut client = DeviceServiceClient::new(fixture.channel().await);
    let watched = client.watch_devices(WatchDevicesRequest {}).await.unwrap();
    let mut watched = watched.into_inner();
    assert_eq!(watched.message().await.unwrap().unwrap().devices, []);
    fixture
        .devices
        .send_replace(vec![device(0, 7), device(1, 9)]);
    let seen = watched.message().await.unwrap().unwrap().devices;
    let listed = client
        .list_devices(ListDevicesRequest {})
        .await
        .unwrap()
        .into_inner()
        .devices;
    assert_eq!(seen, listed);
    assert_eq!(
        listed
            .iter()
            .map(|device| device.packets)
            .collect::<Vec<_>>(),
        [7, 9]
    );
}

#[tokio::test]
async fn a_controller_is_made_to_buzz() {
    let mut fixture = Fixture::start();
    let mut client = DeviceServiceClient::new(fixture.channel().await);
    fixture
        .devices
        .send_replace(vec![device(0, 7), device(1, 9)]);
    let request = |device| ApplyHapticsRequest {
        device,
        amplitude: Some(0.5),
        ..Default::default()
    };
    client.apply_haptics(request(1)).await.unwrap();
    let buzz = fixture.buzzes.pop().unwrap();
    assert_eq!(buzz.device, DeviceId(1));
    assert_eq!((buzz.haptic.periods(), buzz.haptic.strength()), (16, 0.5));
    let mut refused = async |request| client.apply_haptics(request).await.unwrap_err().code();
    assert_eq!(refused(request(0)).await, Code::FailedPrecondition);
    assert_eq!(refused(request(2)).await, Code::NotFound);
    assert_eq!(refused(request(300)).await, Code::NotFound);
    let endless = ApplyHapticsRequest {
        duration_s: Some(f32::INFINITY),
        ..request(1)
    };
    assert_eq!(refused(endless).await, Code::InvalidArgument);
    assert_eq!(fixture.buzzes.pop(), None);
    // Nobody takes them: two wait, a third is refused.
    for _ in 0..2 {
        client.apply_haptics(request(1)).await.unwrap();
    }
    let busy = client.apply_haptics(request(1)).await.unwrap_err();
    assert_eq!(busy.code(), Code::ResourceExhausted);
}

#[tokio::test]
async fn health_follows_the_headset() {
    let mut fixture = Fixture::start();
    let mut client = HealthClient::new(fixture.channel().await);
    let request = |service: &str| HealthCheckRequest {
        service: service.into(),
    };
    for service in ["", "posed.v1.DeviceService"] {
        let answer = client.check(request(service)).await.unwrap().into_inner();
        assert_eq!(answer.status(), ServingStatus::Serving, "{service}");
    }
    let unknown = client.check(request("posed.v1.Nothing")).await.unwrap_err();
    assert_eq!(unknown.code(), Code::NotFound);

    let watched = client.watch(request("posed.v1.PoseService")).await.unwrap();
    let mut watched = watched.into_inner();
    let mut next = async || watched.message().await.unwrap().unwrap().status();
    assert_eq!(next().await, ServingStatus::NotServing);
    fixture.publish_pose(&held_pose_at(1, HostTime(1))).await;
    fixture.publish(2).await;
    assert_eq!(next().await, ServingStatus::Serving);
    // Nothing comes any more.
    assert_eq!(next().await, ServingStatus::NotServing);
}

#[tokio::test]
async fn reflection_knows_the_services() {
    use tonic_reflection::pb::v1::{
        ServerReflectionRequest, server_reflection_client::ServerReflectionClient,
        server_reflection_request::MessageRequest, server_reflection_response::MessageResponse,
    };
    let fixture = Fixture::start();
    let ask = |what| ServerReflectionRequest {
        host: String::new(),
        message_request: Some(what),
    };
    let requests = tokio_stream::iter([
        ask(MessageRequest::ListServices(String::new())),
        ask(MessageRequest::FileContainingSymbol(
            "posed.v1.PoseService".into(),
        )),
    ]);
    let mut client = ServerReflectionClient::new(fixture.channel().await);
    let mut answers = client
        .server_reflection_info(requests)
        .await
        .unwrap()
        .into_inner();
    let mut next = async || {
        answers
            .message()
            .await
            .unwrap()
            .unwrap()
            .message_response
            .unwrap()
    };
    let MessageResponse::ListServicesResponse(list) = next().await else {
        panic!("services are listed");
    };
    let names: Vec<_> = list
        .service
        .iter()
        .map(|service| service.name.as_str())
        .collect();
    for name in [
        "posed.v1.PoseService",
        "posed.v1.DeviceService",
        "grpc.health.v1.Health",
    ] {
        assert!(names.contains(&name), "{name} is missing in {names:?}");
    }
    let MessageResponse::FileDescriptorResponse(files) = next().await else {
        panic!("the service's file is known");
    };
    assert!(!files.file_descriptor_proto.is_empty());
}

#[tokio::test]
async fn requests_larger_than_any_real_one_are_refused() {
    let fixture = Fixture::start();
    let mut grpc = tonic::client::Grpc::new(fixture.channel().await);
    grpc.ready().await.unwrap();
    // A valid message of another type, far longer than the request may be.
    let long = posed_proto::v1::SkeletonJoint {
        name: "x".repeat(100_000),
        ..Default::default()
    };
    let codec: tonic_prost::ProstCodec<_, posed_proto::v1::GetPoseResponse> =
        tonic_prost::ProstCodec::default();
    let path = "/posed.v1.PoseService/GetPose".parse().unwrap();
    let refused = grpc
        .unary(tonic::Request::new(long), path, codec)
        .await
        .unwrap_err();
    assert_eq!(refused.code(), Code::OutOfRange, "{refused}");
}
