//! Server and client in one process, over real sockets.

use std::{
    path::{Path, PathBuf},
    sync::Arc,
    time::Duration,
};

use posed_proto::v1::{
    FollowPosesRequest, FollowPosesResponse, GetClockRequest, GetPoseRequest, GetSkeletonRequest,
    ListDevicesRequest, Lookup, StreamPosesRequest, WatchDevicesRequest,
    device_service_client::DeviceServiceClient, pose_service_client::PoseServiceClient,
};
use posed_signal::{DeviceId, HostTime, Role, Serial};
use posed_tracker::{Quality, Wearer};
use tokio::{
    sync::{mpsc, oneshot, watch},
    task::JoinHandle,
    time,
};
use tokio_stream::wrappers::ReceiverStream;
use tonic::{
    Code, Streaming,
    transport::{Channel, Endpoint},
};
use tonic_health::pb::{
    HealthCheckRequest, health_check_response::ServingStatus, health_client::HealthClient,
};

use super::*;
use crate::{
    config::{Grpc, Loopback, UnixSocket},
    follow::{Follower, Late},
    published::{DeviceState, PublishedPose, tests::pose_at},
};

const PERIOD_NS: u64 = 10_000_000;

/// A server with its sockets in a folder of its own.
struct Fixture {
    sink: Option<PoseSink>,
    hub: Hub,
    devices: watch::Sender<Vec<DeviceState>>,
    socket: PathBuf,
    tcp: std::net::SocketAddr,
    stop: Option<oneshot::Sender<()>>,
    server: JoinHandle<Result<(), ServeError>>,
    _folder: tempfile::TempDir,
    _wearer: watch::Sender<Wearer>,
}

impl Fixture {
    fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let socket = folder.path().join("posed.sock");
        let any_port = Loopback::try_from("127.0.0.1:0".parse::<std::net::SocketAddr>().unwrap());
        let config = Grpc {
            unix: UnixSocket::At(socket.clone()),
            tcp: Some(any_port.unwrap()),
        };
        let listeners = Listeners::open(&config, None).unwrap();
        let tcp = listeners.tcp_addrs().next().unwrap();
        let (sink, hub) = Hub::new().unwrap();
        let (devices, devices_seen) = watch::channel(Vec::new());
        let (wearer, wearer_seen) = watch::channel(Wearer::of_height(1.8));
        let services = Services {
            hub: hub.clone(),
            devices: devices_seen,
            wearer: wearer_seen,
            clock: Arc::new(HostTime(123_456)),
        };
        let (stop, stopped) = oneshot::channel::<()>();
        let server = tokio::spawn(serve(services, listeners, async {
            let _ = stopped.await;
        }));
        Self {
            sink: Some(sink),
            hub,
            devices,
            socket,
            tcp,
            stop: Some(stop),
            server,
            _folder: folder,
            _wearer: wearer,
        }
    }

    async fn channel(&self) -> Channel {
        crate::follow::Server::Unix(self.socket.clone())
            .connect()
            .await
            .unwrap()
    }

    async fn poses(&self) -> PoseServiceClient<Channel> {
        PoseServiceClient::new(self.channel().await)
    }

    /// Publishes a pose and waits until readers can see it.
    async fn publish(&mut self, sequence: u64) {
        let pose = pose_at(sequence, HostTime(sequence * PERIOD_NS));
        self.publish_pose(&pose).await;
    }

    async fn publish_pose(&mut self, pose: &PublishedPose) {
        let mut changes = self.hub.changes();
        self.sink.as_mut().unwrap().publish(pose);
        while self.hub.newest() < Some(pose.sequence) {
            changes.changed().await.unwrap();
        }
    }

    async fn stop(mut self) {
        drop(self.stop.take());
        self.server.await.unwrap().unwrap();
    }
}

/// A client of `FollowPoses` that grants credits by hand.
struct ByHand {
    credits: mpsc::Sender<FollowPosesRequest>,
    poses: Streaming<FollowPosesResponse>,
    catch_up: u32,
}

impl ByHand {
    async fn new(fixture: &Fixture, catch_up: u32) -> Self {
        let (credits, requests) = mpsc::channel(8);
        let requests = ReceiverStream::new(requests);
        let poses = fixture
            .poses()
            .await
            .follow_poses(requests)
            .await
            .unwrap()
            .into_inner();
        Self {
            credits,
            poses,
            catch_up,
        }
    }

    async fn grant(&self, credit: u32) {
        let request = FollowPosesRequest {
            credit,
            catch_up: self.catch_up,
        };
        self.credits.send(request).await.unwrap();
    }

    /// Sequence number and gap of the next message.
    async fn next(&mut self) -> Option<(u64, u64)> {
        let message = self.poses.message().await.unwrap()?;
        Some((message.pose.unwrap().sequence, message.gap))
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_slow_client_gets_the_newest_and_a_fast_one_everything() {
    // The slow client takes as long for a message as 20 poses take.
    const ROUNDS: u64 = 30;
    const SLOW: u64 = 20;
    let mut fixture = Fixture::start();
    let mut slow = ByHand::new(&fixture, 0).await;
    let mut fast = ByHand::new(&fixture, 0).await;
    let mut streamed = fixture
        .poses()
        .await
        .stream_poses(StreamPosesRequest {})
        .await
        .unwrap()
        .into_inner();
    let mut sequence = 0;
    for round in 0..ROUNDS {
        for _ in 0..SLOW {
            fast.grant(1).await;
            sequence += 1;
            fixture.publish(sequence).await;
            assert_eq!(fast.next().await, Some((sequence, 0)));
        }
        slow.grant(1).await;
        let gap = if round == 0 { 0 } else { SLOW - 1 };
        assert_eq!(
            slow.next().await,
            Some((sequence, gap)),
            "none older than the newest"
        );
    }
    for expected in 1..=sequence {
        let message = streamed.message().await.unwrap().unwrap();
        assert_eq!(
            (message.pose.unwrap().sequence, message.lost),
            (expected, 0)
        );
    }
}

#[tokio::test]
async fn a_client_that_is_late_for_a_moment_catches_up() {
    let mut fixture = Fixture::start();
    let mut client = ByHand::new(&fixture, 16).await;
    client.grant(1).await;
    fixture.publish(1).await;
    assert_eq!(client.next().await, Some((1, 0)));
    for sequence in 2..=10 {
        fixture.publish(sequence).await;
    }
    client.grant(9).await;
    for sequence in 2..=10 {
        assert_eq!(client.next().await, Some((sequence, 0)));
    }
    for sequence in 11..=30 {
        fixture.publish(sequence).await;
    }
    client.grant(1).await;
    assert_eq!(client.next().await, Some((30, 19)), "too late to catch up");
}

#[tokio::test]
async fn credits_bound_what_is_sent_and_the_end_is_orderly() {
    let mut fixture = Fixture::start();
    let mut client = ByHand::new(&fixture, 64).await;
    for sequence in 1..=5 {
        fixture.publish(sequence).await;
    }
    client.grant(2).await;
    assert_eq!(
        client.next().await,
        Some((5, 0)),
        "the first pose is the newest"
    );
    fixture.publish(6).await;
    assert_eq!(client.next().await, Some((6, 0)));
    fixture.publish(7).await;
    let nothing = time::timeout(Duration::from_millis(100), client.next()).await;
    assert!(nothing.is_err(), "no credit, no pose");
    // The tracker stops; what it published is still there for those who ask.
    drop(fixture.sink.take());
    client.grant(5).await;
    assert_eq!(client.next().await, Some((7, 0)));
    assert_eq!(client.next().await, None);
}

#[tokio::test]
async fn a_client_that_asks_for_no_more_gets_what_it_asked_for() {
    let mut fixture = Fixture::start();
    let requests = tokio_stream::iter([FollowPosesRequest {
        credit: 2,
        catch_up: 8,
    }]);
    let mut client = fixture.poses().await;
    let mut poses = client.follow_poses(requests).await.unwrap().into_inner();
    fixture.publish(1).await;
    assert_eq!(
        poses
            .message()
            .await
            .unwrap()
            .unwrap()
            .pose
            .unwrap()
            .sequence,
        1
    );
    fixture.publish(2).await;
    assert_eq!(
        poses
            .message()
            .await
            .unwrap()
            .unwrap()
            .pose
            .unwrap()
            .sequence,
        2
    );
    assert!(poses.message().await.unwrap().is_none());
}

#[tokio::test]
async fn a_recorder_that_falls_behind_is_told_how_many_it_lost() {
    const PUBLISHED: u64 = 3 * window::POSES_MAX as u64;
    let mut fixture = Fixture::start();
    // By default the transport would keep megabytes for a client that does not read.
    let endpoint = Endpoint::from_shared(format!("unix:{}", fixture.socket.display())).unwrap();
    let channel = endpoint
        .initial_stream_window_size(65_535)
        .connect()
        .await
        .unwrap();
    let mut client = PoseServiceClient::new(channel);
    let mut poses = client
        .stream_poses(StreamPosesRequest {})
        .await
        .unwrap()
        .into_inner();
    for sequence in 1..=PUBLISHED {
        fixture.publish(sequence).await;
    }
    drop(fixture.sink.take());
    let (mut received, mut lost, mut last) = (0, 0, 0);
    while let Some(message) = poses.message().await.unwrap() {
        let sequence = message.pose.unwrap().sequence;
        assert_eq!(sequence, last + message.lost + 1);
        (received, lost, last) = (received + 1, lost + message.lost, sequence);
    }
    assert_eq!((received + lost, last), (PUBLISHED, PUBLISHED));
    assert!(lost > 0, "{PUBLISHED} poses fit nowhere");
}

#[tokio::test]
async fn the_client_library_hides_credits_and_knows_ages() {
    let mut fixture = Fixture::start();
    let server = crate::follow::Server::Tcp(fixture.tcp);
    // The server's clock stands at 123,456 ns, this one at 100,000 ns.
    let mut follower = Follower::connect(&server, HostTime(100_000), Late::Newest)
        .await
        .unwrap();
    let mut pose = pose_at(1, HostTime(50_000));
    (pose.sample_at, pose.publish_at) = (HostTime(23_456), HostTime(103_456));
    fixture.publish_pose(&pose).await;
    let followed = follower.next().await.unwrap().unwrap();
    assert_eq!(followed.pose, pose);
    assert_eq!(
        (followed.gap, followed.age_ns, followed.sample_age_ns),
        (0, 20_000, 100_000)
    );
    drop(fixture.sink.take());
    assert_eq!(follower.next().await.unwrap(), None);
}

/// An output whose reader has gone.
struct Gone;

impl io::Write for Gone {
    fn write(&mut self, _: &[u8]) -> io::Result<usize> {
        Err(io::ErrorKind::BrokenPipe.into())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[tokio::test]
async fn following_ends_with_the_count_the_server_or_the_reader() {
    use crate::follow::{Format, Printer, follow};
    let mut fixture = Fixture::start();
    fixture.publish(1).await;
    let server = crate::follow::Server::Unix(fixture.socket.clone());
    let forever = std::future::pending::<()>;
    let clock = HostTime(0);

    let mut out = Vec::new();
    let mut printer = Printer::new(Format::Json, &mut out);
    let summary = follow(&server, clock, &mut printer, Some(1), forever())
        .await
        .unwrap();
    assert_eq!(
        (
            summary.poses,
            out.iter().filter(|byte| **byte == b'\n').count()
        ),
        (1, 1)
    );

    let mut gone = Gone;
    let mut printer = Printer::new(Format::Json, &mut gone);
    follow(&server, clock, &mut printer, None, forever())
        .await
        .unwrap();

    drop(fixture.sink.take());
    let mut out = Vec::new();
    let mut printer = Printer::new(Format::Json, &mut out);
    let summary = follow(&server, clock, &mut printer, None, forever())
        .await
        .unwrap();
    assert_eq!(summary.poses, 1);
}

#[tokio::test]
async fn one_pose_can_be_asked_for_by_time() {
    let mut fixture = Fixture::start();
    let mut client = fixture.poses().await;
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
        battery: None,
        rate_hz: 250.0,
        tracked_share: 1.0,
        packets,
        errors: 0,
        dropped: 0,
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
    let held = PublishedPose {
        quality: Quality::Held,
        ..pose_at(1, HostTime(1))
    };
    fixture.publish_pose(&held).await;
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
async fn clients_that_vanish_cost_nothing() {
    let mut fixture = Fixture::start();
    // More than there are places for connections, one after the other.
    for round in 0..100 {
        let client = ByHand::new(&fixture, 0).await;
        client.grant(1000).await;
        if round % 2 == 0 {
            fixture.publish(round + 1).await;
        }
    }
    // Each stream held a hub of its own; those of the fixture and the server stay.
    let streams = || fixture.hub.clones();
    let few = time::timeout(Duration::from_secs(20), async {
        while streams() > 8 {
            time::sleep(Duration::from_millis(10)).await;
        }
    });
    assert!(few.await.is_ok(), "{} streams are left", streams());
    let mut client = ByHand::new(&fixture, 0).await;
    client.grant(1).await;
    assert!(client.next().await.is_some());
}

#[tokio::test]
async fn stopping_ends_streams_at_once_and_removes_the_socket() {
    let fixture = Fixture::start();
    let mut client = ByHand::new(&fixture, 0).await;
    client.grant(1).await;
    let (socket, hub) = (fixture.socket.clone(), fixture.hub.clone());
    assert!(Path::new(&socket).exists());
    let stopped = tokio::spawn(fixture.stop());
    let ended = client.poses.message().await.unwrap_err();
    assert_eq!(ended.code(), Code::Unavailable);
    assert!(ended.message().contains("stopping"), "{ended}");
    stopped.await.unwrap();
    assert!(!socket.exists());
    drop(hub);
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
