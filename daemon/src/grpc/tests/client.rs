//! The client library against a real server.

use std::io;

use posed_signal::HostTime;

use super::fixture::Fixture;
use crate::{
    follow::{Follower, Format, Late, Printer, Server, follow},
    published::tests::pose_at,
};

#[tokio::test]
async fn the_client_library_hides_credits_and_knows_ages() {
    let mut fixture = Fixture::start();
    let server = Server::Tcp(fixture.tcp);
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
    let mut fixture = Fixture::start();
    fixture.publish(1).await;
    let server = Server::Unix(fixture.socket.clone());
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
