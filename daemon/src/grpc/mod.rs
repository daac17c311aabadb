//! The gRPC server: `posed.v1`, health and reflection, on local sockets.
//!
//! [`Hub`] brings poses from the tracker thread to the services, [`Listeners`] are the sockets,
//! [`serve`] joins them. Only [`convert`] knows both the domain and the messages.

mod accept;
mod control_service;
pub mod convert;
mod device_service;
mod health;
mod hub;
pub mod listen;
mod pose_service;
pub(crate) mod services;
mod window;

use std::{io, time::Duration};

use posed_proto::v1::{
    control_service_server::ControlServiceServer, device_service_server::DeviceServiceServer,
    pose_service_server::PoseServiceServer,
};
use tokio::{sync::watch, task::JoinSet, time};
use tonic::{
    Status,
    service::{Routes, RoutesBuilder},
    transport::{Server, server::Router},
};
use tonic_health::{pb::health_server::HealthServer, server::HealthService};

pub use hub::{Hub, PoseSink};
pub use listen::{ListenError, Listeners};
pub use services::Services;
pub(crate) use window::Behind;

/// Streams that one connection may have open.
const STREAMS_MAX: u32 = 32;
/// Bytes of a request: the longest takes under 100.
const REQUEST_BYTES_MAX: usize = 4096;
/// Bytes of a request's headers.
const HEADER_BYTES_MAX: u32 = 16 * 1024;
/// A connection that has been silent this long is asked for a sign of life,
const KEEPALIVE_INTERVAL: Duration = Duration::from_secs(15);
/// and closed when none comes within this time.
const KEEPALIVE_TIMEOUT: Duration = Duration::from_secs(10);
/// Streams are told at once that the server stops; connections get this long to go.
const STOP_GRACE: Duration = Duration::from_secs(1);

/// Why serving ended early.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// A listening socket cannot be used.
    #[error("a socket that was bound cannot be listened on: {0}")]
    Socket(#[from] io::Error),
    /// The server failed.
    #[error("the gRPC server failed: {0}")]
    Transport(#[from] tonic::transport::Error),
    /// The descriptors built in do not fit the reflection service.
    #[error("server reflection: {0}")]
    Reflection(#[from] tonic_reflection::server::Error),
}

/// Serves until `shutdown`; then ends every stream with `UNAVAILABLE` and returns.
///
/// # Errors
/// A socket fails. A client's failure is only that client's.
pub async fn serve(
    services: Services,
    listeners: Listeners,
    shutdown: impl Future<Output = ()>,
) -> Result<(), ServeError> {
    let (stopper, stop) = watch::channel(());
    let (health, reporter) = health::service();
    let mut servers: JoinSet<Result<(), ServeError>> = JoinSet::new();
    let report = health::report(reporter, services.hub.clone(), stop.clone());
    let router = router(routes(&services, &stop, health)?);
    for listener in &listeners.unix {
        let incoming = accept::unix(listener.try_clone()?)?;
        let server = router
            .clone()
            .serve_with_incoming_shutdown(incoming, closed(stop.clone()));
        servers.spawn(async { Ok(server.await?) });
    }
    for listener in &listeners.tcp {
        let incoming = accept::tcp(listener.try_clone()?)?;
        let server = router
            .clone()
            .serve_with_incoming_shutdown(incoming, closed(stop.clone()));
        servers.spawn(async { Ok(server.await?) });
    }
    tokio::select! {
        () = report => {}
        () = shutdown => {}
        Some(ended) = servers.join_next() => ended.unwrap_or(Ok(()))?,
    }
    drop(stopper);
    // A client that does not let go is left to the runtime's end.
    let _ = time::timeout(STOP_GRACE, async {
        while servers.join_next().await.is_some() {}
    })
    .await;
    Ok(())
}

fn routes(
    services: &Services,
    stop: &watch::Receiver<()>,
    health: HealthServer<HealthService>,
) -> Result<Routes, ServeError> {
    let poses = pose_service::Poses {
        services: services.clone(),
        stop: stop.clone(),
    };
    let devices = device_service::Devices {
        services: services.clone(),
        stop: stop.clone(),
    };
    let controls = control_service::Controls {
        services: services.clone(),
    };
    let reflection = || {
        tonic_reflection::server::Builder::configure()
            .register_encoded_file_descriptor_set(posed_proto::FILE_DESCRIPTOR_SET)
            .register_encoded_file_descriptor_set(tonic_health::pb::FILE_DESCRIPTOR_SET)
    };
    let mut routes = RoutesBuilder::default();
    routes
        .add_service(PoseServiceServer::new(poses).max_decoding_message_size(REQUEST_BYTES_MAX))
        .add_service(DeviceServiceServer::new(devices).max_decoding_message_size(REQUEST_BYTES_MAX))
        .add_service(
            ControlServiceServer::new(controls).max_decoding_message_size(REQUEST_BYTES_MAX),
        )
        .add_service(health)
        .add_service(reflection().build_v1()?)
        .add_service(reflection().build_v1alpha()?);
    Ok(routes.routes())
}

fn router(routes: Routes) -> Router {
    Server::builder()
        .max_concurrent_streams(STREAMS_MAX)
        .http2_max_header_list_size(HEADER_BYTES_MAX)
        .http2_keepalive_interval(Some(KEEPALIVE_INTERVAL))
        .http2_keepalive_timeout(Some(KEEPALIVE_TIMEOUT))
        .add_routes(routes)
}

/// Resolves when the sender of `stop` is dropped.
async fn closed(mut stop: watch::Receiver<()>) {
    while stop.changed().await.is_ok() {}
}

/// What streams end with when the server stops.
fn stopping() -> Status {
    Status::unavailable("posed is stopping")
}

#[cfg(test)]
mod tests;
