//! Poses against credits, and every pose.

use std::time::Duration;

use posed_proto::v1::{
    FollowPosesRequest, FollowPosesResponse, StreamPosesRequest,
    pose_service_client::PoseServiceClient,
};
use tokio::{sync::mpsc, time};
use tokio_stream::wrappers::ReceiverStream;
use tonic::{
    Code, Streaming,
    transport::{Channel, Endpoint},
};

use super::fixture::Fixture;
use crate::grpc::window;

async fn poses(fixture: &Fixture) -> PoseServiceClient<Channel> {
    PoseServiceClient::new(fixture.channel().await)
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
        let poses = poses(fixture)
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
    let mut streamed = poses(&fixture)
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
    let mut client = poses(&fixture).await;
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
        while streams() > 16 {
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
    assert!(socket.exists());
    let stopped = tokio::spawn(fixture.stop());
    let ended = client.poses.message().await.unwrap_err();
    assert_eq!(ended.code(), Code::Unavailable);
    assert!(ended.message().contains("stopping"), "{ended}");
    stopped.await.unwrap();
    assert!(!socket.exists());
    drop(hub);
}
