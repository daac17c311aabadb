//! The live page: what posed sees, in a browser on the same machine.
//!
//! The page is embedded in the binary and asks for nothing from outside. Poses come to it through a
//! WebSocket against credits, so that a slow browser gets fewer of them and never old ones;
//! requests go back as small JSON posts. [`guard`] decides who may do either.

mod control;
pub mod guard;
mod message;
mod socket;

use std::{fmt, io, net::TcpListener, sync::Arc};

use axum::{
    Router,
    body::Bytes,
    extract::{DefaultBodyLimit, State, WebSocketUpgrade},
    http::{HeaderMap, StatusCode, header},
    middleware,
    response::{IntoResponse, Response},
    routing::{get, post},
};
use posed_device::lighthouse::{base_station::BaseStation, room};
use serde::Serialize;
use tokio::{
    runtime::Handle,
    sync::{Semaphore, watch},
};

use crate::{
    config,
    grpc::Services,
    pipeline::{live::Shared, playback::Playback},
};
use guard::Access;

/// Browsers that may watch at once.
const WATCHERS_MAX: usize = 8;
/// Bytes of a request's body; the longest sensible one has 30.
const BODY_BYTES_MAX: usize = 256;

/// A base station, for the scene.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
struct Station {
    /// In the world, metres.
    position: [f32; 3],
    /// Its frame (looks along -Z) to the world.
    rotation: [f32; 4],
}

impl From<&BaseStation> for Station {
    fn from(station: &BaseStation) -> Self {
        Self {
            position: station.position.as_vec3().to_array(),
            rotation: station.rotation.as_quat().to_array(),
        }
    }
}

/// Why there is no page.
#[derive(Debug, thiserror::Error)]
pub enum PageError {
    /// Its address cannot be used.
    #[error("the live page cannot be served: {0}; give another address as page.listen, or \"off\"")]
    Listen(String),
    /// The configuration lets in too many.
    #[error("the live page needs {0}")]
    Access(String),
}

/// What the page shows, and what it can do.
pub struct Page {
    /// Poses, devices, wearer.
    pub services: Services,
    /// The tracker loop's counters; absent in a replay.
    pub ticks: Option<Arc<Shared>>,
    /// Where a replay stands; absent when live.
    pub playback: Option<Arc<Playback>>,
    /// Poses a second that the tracker is set to.
    pub rate_hz: f64,
    /// Where base stations stand, as far as that is known.
    pub room: room::Handle,
}

impl fmt::Debug for Page {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Page")
            .field("services", &self.services)
            .finish_non_exhaustive()
    }
}

/// What the handlers share.
#[derive(Clone)]
struct Shelf {
    page: Arc<Page>,
    watchers: Arc<Semaphore>,
    stop: watch::Receiver<()>,
}

/// Serves the page where the configuration says, until the last pose was published. Answers the
/// page's address, for people; `None` where the page is off.
///
/// # Errors
/// The address is taken or not this machine's, or others could come in without a token.
pub fn start(
    runtime: &Handle,
    config: &config::Page,
    page: Page,
) -> Result<Option<String>, PageError> {
    let Some(address) = config.listen else {
        return Ok(None);
    };
    let access = config.access().map_err(PageError::Access)?;
    let fail = |error: io::Error| PageError::Listen(format!("{address}: {error}"));
    let listener = TcpListener::bind(address).map_err(fail)?;
    let url = format!("http://{}/", listener.local_addr().map_err(fail)?);
    let mut changes = page.services.hub.changes();
    let ended = async move { while changes.changed().await.is_ok() {} };
    runtime.spawn(async move {
        if let Err(error) = serve(page, access, listener, ended).await {
            tracing::error!(%error, "the live page ended");
        }
    });
    Ok(Some(url))
}

/// Serves the page until `shutdown`; then says good-bye to the browsers and returns.
///
/// # Errors
/// The socket fails.
pub async fn serve(
    page: Page,
    access: Access,
    listener: TcpListener,
    shutdown: impl Future<Output = ()> + Send + 'static,
) -> io::Result<()> {
    listener.set_nonblocking(true)?;
    let listener = tokio::net::TcpListener::from_std(listener)?;
    let (stopper, stop) = watch::channel(());
    let shelf = Shelf {
        page: Arc::new(page),
        watchers: Arc::new(Semaphore::new(WATCHERS_MAX)),
        stop,
    };
    let ended = async move {
        shutdown.await;
        drop(stopper);
    };
    axum::serve(listener, router(shelf, access))
        .with_graceful_shutdown(ended)
        .await
}

fn router(shelf: Shelf, access: Access) -> Router {
    Router::new()
        .route("/", get(|| file(HTML, "text/html; charset=utf-8")))
        .route("/page.css", get(|| file(CSS, "text/css; charset=utf-8")))
        .route("/page.js", get(|| file(PAGE_JS, SCRIPT)))
        .route("/scene.js", get(|| file(SCENE_JS, SCRIPT)))
        .route("/shapes.js", get(|| file(SHAPES_JS, SCRIPT)))
        .route("/charts.js", get(|| file(CHARTS_JS, SCRIPT)))
        .route("/icon.svg", get(|| file(ICON, "image/svg+xml")))
        .route("/live", get(live))
        .route("/control", post(control))
        .layer(DefaultBodyLimit::max(BODY_BYTES_MAX))
        .layer(middleware::from_fn_with_state(
            Arc::new(access),
            guard::check,
        ))
        .with_state(shelf)
}

const SCRIPT: &str = "text/javascript; charset=utf-8";
const HTML: &str = include_str!("assets/page.html");
const CSS: &str = include_str!("assets/page.css");
const PAGE_JS: &str = include_str!("assets/page.js");
const SCENE_JS: &str = include_str!("assets/scene.js");
const SHAPES_JS: &str = include_str!("assets/shapes.js");
const CHARTS_JS: &str = include_str!("assets/charts.js");
const ICON: &str = include_str!("assets/icon.svg");

/// The browser is told to fetch from nowhere else and to be shown inside no other page.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; \
                      img-src 'self'; connect-src 'self'; base-uri 'none'; \
                      form-action 'none'; frame-ancestors 'none'";

async fn file(text: &'static str, kind: &'static str) -> Response {
    let headers = [
        (header::CONTENT_TYPE, kind),
        (header::CACHE_CONTROL, "no-cache"),
        (header::CONTENT_SECURITY_POLICY, POLICY),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
    ];
    (headers, text).into_response()
}

async fn live(State(shelf): State<Shelf>, upgrade: WebSocketUpgrade) -> Response {
    let Ok(place) = Arc::clone(&shelf.watchers).try_acquire_owned() else {
        let text = format!("{WATCHERS_MAX} browsers are watching already; close one of them");
        return (StatusCode::SERVICE_UNAVAILABLE, text).into_response();
    };
    upgrade
        .max_message_size(socket::MESSAGE_BYTES_MAX)
        .on_upgrade(async move |browser| {
            socket::watch(browser, &shelf.page, shelf.stop).await;
            drop(place);
        })
}

async fn control(State(shelf): State<Shelf>, headers: HeaderMap, body: Bytes) -> Response {
    // A form of another site could be sent without the browser's asking; JSON could not.
    if headers
        .get(header::CONTENT_TYPE)
        .is_none_or(|kind| kind != "application/json")
    {
        return (StatusCode::UNSUPPORTED_MEDIA_TYPE, "send application/json").into_response();
    }
    match control::take(&body, &shelf.page).await {
        Ok(text) if text.is_empty() => StatusCode::NO_CONTENT.into_response(),
        Ok(text) => text.into_response(),
        Err(refusal) => refusal.into_response(),
    }
}

#[cfg(test)]
mod tests;
