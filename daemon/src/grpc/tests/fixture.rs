//! A server in the test's own process, on real sockets.

use std::{net::SocketAddr, path::PathBuf};

use posed_signal::{HostTime, ring::Consumer};
use tokio::{
    sync::{oneshot, watch},
    task::JoinHandle,
};
use tonic::transport::Channel;

use crate::{
    config::{Grpc, Loopback, UnixSocket},
    follow::Server,
    grpc::{
        Hub, Listeners, PoseSink, ServeError, serve,
        services::tests::{Ends, services},
    },
    pipeline::{source::Buzz, tracking::Request},
    published::{DeviceState, PublishedPose, tests::pose_at},
};

/// Poses are so far apart.
pub(super) const PERIOD_NS: u64 = 10_000_000;

/// A server with its sockets in a folder of its own.
pub(super) struct Fixture {
    pub(super) sink: Option<PoseSink>,
    pub(super) hub: Hub,
    pub(super) devices: watch::Sender<Vec<DeviceState>>,
    pub(super) socket: PathBuf,
    pub(super) tcp: SocketAddr,
    stop: Option<oneshot::Sender<()>>,
    server: JoinHandle<Result<(), ServeError>>,
    pub(super) requests: Consumer<Request>,
    pub(super) buzzes: Consumer<Buzz>,
    _folder: tempfile::TempDir,
}

impl Fixture {
    pub(super) fn start() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let socket = folder.path().join("posed.sock");
        let any_port = Loopback::try_from("127.0.0.1:0".parse::<SocketAddr>().unwrap());
        let config = Grpc {
            unix: UnixSocket::At(socket.clone()),
            tcp: Some(any_port.unwrap()),
        };
        let listeners = Listeners::open(&config, None).unwrap();
        let tcp = listeners.tcp_addrs().next().unwrap();
        let (sink, hub) = Hub::new().unwrap();
        let recordings = folder.path().join("recordings");
        let (services, ends) = services(&hub, Some(&recordings));
        let Ends {
            devices,
            requests,
            buzzes,
        } = ends;
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
            requests,
            buzzes,
            _folder: folder,
        }
    }

    pub(super) async fn channel(&self) -> Channel {
        Server::Unix(self.socket.clone()).connect().await.unwrap()
    }

    /// Publishes a pose and waits until readers can see it.
    pub(super) async fn publish(&mut self, sequence: u64) {
        let pose = pose_at(sequence, HostTime(sequence * PERIOD_NS));
        self.publish_pose(&pose).await;
    }

    pub(super) async fn publish_pose(&mut self, pose: &PublishedPose) {
        let mut changes = self.hub.changes();
        self.sink.as_mut().unwrap().publish(pose);
        while self.hub.newest() < Some(pose.sequence) {
            changes.changed().await.unwrap();
        }
    }

    pub(super) async fn stop(mut self) {
        drop(self.stop.take());
        self.server.await.unwrap().unwrap();
    }
}
