//! `grpc.health.v1`: the server serves; `PoseService` does while there is a headset to follow.

use std::time::Duration;

use posed_proto::v1::{
    device_service_server::DeviceServiceServer, pose_service_server::PoseServiceServer,
};
use tokio::{sync::watch, time};
use tonic_health::{
    pb::health_server::HealthServer,
    server::{HealthReporter, HealthService},
};

use super::{closed, device_service::Devices, hub::Hub, pose_service::Poses};

/// How often the state is looked at.
const INTERVAL: Duration = Duration::from_millis(250);
/// Looks without a new pose until the tracker counts as stopped.
const LOOKS_MAX: u32 = 4;

/// The service, and the handle to set its states by.
pub(super) fn service() -> (HealthServer<HealthService>, HealthReporter) {
    let reporter = HealthReporter::new();
    (
        HealthServer::new(HealthService::from_health_reporter(reporter.clone())),
        reporter,
    )
}

/// Keeps the states up to date until the server stops.
pub(super) async fn report(reporter: HealthReporter, hub: Hub, stop: watch::Receiver<()>) {
    reporter.set_serving::<DeviceServiceServer<Devices>>().await;
    reporter.set_not_serving::<PoseServiceServer<Poses>>().await;
    tokio::select! {
        () = follow(&reporter, &hub) => {}
        () = closed(stop) => {}
    }
}

async fn follow(reporter: &HealthReporter, hub: &Hub) {
    let mut looks = time::interval(INTERVAL);
    let (mut is_serving, mut sequence, mut idle) = (false, None, 0);
    loop {
        looks.tick().await;
        let latest = hub.latest();
        let newest = latest.as_ref().map(|pose| pose.sequence);
        idle = if newest == sequence { idle + 1 } else { 0 };
        sequence = newest;
        let has_input = latest.is_some_and(|pose| pose.has_input()) && idle < LOOKS_MAX;
        if has_input == is_serving {
            continue;
        }
        is_serving = has_input;
        if is_serving {
            reporter.set_serving::<PoseServiceServer<Poses>>().await;
        } else {
            reporter.set_not_serving::<PoseServiceServer<Poses>>().await;
        }
    }
}
