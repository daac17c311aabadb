//! What the page's buttons ask for.

use axum::http::StatusCode;
use posed_tracker::TrackerKind;
use serde::Deserialize;

use super::Page;
use crate::{
    control::Refusal,
    grpc::Services,
    heights::Avatar,
    output::record::{Format, RecordError, Recording, Wish as RecordWish},
    pipeline::{playback::Playback, tracking::Request},
};

/// `"reset"`, `{"height_m": 1.8}`, `{"tracker": "ik"}`, `{"record": "bvh"}`, `"stop_recording"`;
/// in a replay `{"pause": true}` and `{"seek_s": 12.5}`.
#[derive(Debug, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Wish {
    Reset,
    HeightM(f32),
    Tracker(String),
    Record(String),
    StopRecording,
    Pause(bool),
    SeekS(f64),
}

type Answer<T> = Result<T, (StatusCode, String)>;

/// Does what `body` asks for. Answers what there is to say about it, if there is anything.
pub(super) async fn take(body: &[u8], page: &Page) -> Answer<String> {
    let services = &page.services;
    let wish = serde_json::from_slice(body)
        .map_err(|error| (StatusCode::BAD_REQUEST, format!("no request: {error}")))?;
    match wish {
        Wish::Reset => request(services, Request::Reset),
        Wish::HeightM(metres) => {
            let avatar = Avatar::Keep;
            request(services, Request::Height { metres, avatar })
        }
        Wish::Tracker(name) => match TrackerKind::from_name(&name) {
            Some(kind) => request(services, Request::Tracker(kind)),
            None => Err(refused(&services.control.no_tracker(&name))),
        },
        Wish::Pause(paused) => {
            playback(page)?.pause(paused);
            Ok(String::new())
        }
        Wish::SeekS(seconds) => {
            playback(page)?.seek(seconds);
            Ok(String::new())
        }
        Wish::Record(name) => {
            let unknown = || (StatusCode::BAD_REQUEST, format!("no format: {name}"));
            let wish = RecordWish {
                format: Format::from_name(&name).ok_or_else(unknown)?,
                name: String::new(),
                names: None,
            };
            let recorder = services.recorder.clone();
            let begun = blocking(move || recorder.start(&wish)).await?;
            Ok(format!("Recording to {}.", begun.path.display()))
        }
        Wish::StopRecording => {
            let recorder = services.recorder.clone();
            let ended = blocking(move || recorder.stop()).await?;
            match ended.error {
                None => Ok(format!(
                    "{} poses in {}.",
                    ended.poses,
                    ended.path.display()
                )),
                Some(error) => Err((StatusCode::INTERNAL_SERVER_ERROR, error)),
            }
        }
    }
}

fn playback(page: &Page) -> Answer<&Playback> {
    let live = || (StatusCode::CONFLICT, "this is no replay".to_owned());
    page.playback.as_deref().ok_or_else(live)
}

fn request(services: &Services, request: Request) -> Answer<String> {
    let asked = services.control.request(request);
    asked
        .map(|()| String::new())
        .map_err(|error| refused(&error))
}

fn refused(refusal: &Refusal) -> (StatusCode, String) {
    let status = match refusal {
        Refusal::Busy => StatusCode::SERVICE_UNAVAILABLE,
        Refusal::Height(_) | Refusal::Tracker { .. } | Refusal::Object { .. } => {
            StatusCode::BAD_REQUEST
        }
    };
    (status, refusal.to_string())
}

/// Disks may keep one waiting; other browsers must not.
async fn blocking(
    work: impl FnOnce() -> Result<Recording, RecordError> + Send + 'static,
) -> Answer<Recording> {
    let failed = |error: &dyn std::error::Error| (StatusCode::CONFLICT, error.to_string());
    tokio::task::spawn_blocking(work)
        .await
        .map_err(|error| failed(&error))?
        .map_err(|error| failed(&error))
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use posed_signal::HostTime;

    use super::*;
    use crate::{
        grpc::{Hub, services::tests::services},
        pipeline::playback::Next,
    };

    #[tokio::test]
    async fn wishes_become_requests() {
        let (_sink, hub) = Hub::new().unwrap();
        let (services, mut ends) = services(&hub, None);
        let mut page = Page {
            services,
            ticks: None,
            playback: None,
            rate_hz: 90.0,
            room: Default::default(),
        };
        let wishes = [
            ("\"reset\"", Request::Reset),
            (
                "{\"height_m\": 1.8}",
                Request::Height {
                    metres: 1.8,
                    avatar: Avatar::Keep,
                },
            ),
            ("{\"tracker\": \"pip\"}", Request::Tracker(TrackerKind::Pip)),
        ];
        for (text, request) in wishes {
            assert_eq!(take(text.as_bytes(), &page).await, Ok(String::new()));
            assert_eq!(ends.requests.pop(), Some(request), "{text}");
        }
        let wrong = [
            "",
            "reset",
            "{}",
            "[]",
            "{\"reset\": 1}",
            "\"explode\"",
            "{\"height_m\": 0.5}",
            "{\"height_m\": 3}",
            "{\"height_m\": 1e99}",
            "{\"height_m\": null}",
            "{\"height_m\": \"tall\"}",
            "{\"record\": \"gif\"}",
            "{\"tracker\": \"questsim\"}",
        ];
        for text in wrong {
            let (status, why) = take(text.as_bytes(), &page).await.unwrap_err();
            assert_eq!(status, StatusCode::BAD_REQUEST, "{text}: {why}");
        }
        for (text, why) in [
            ("{\"record\": \"bvh\"}", "recording.folder"),
            ("\"stop_recording\"", "nothing is being recorded"),
            ("{\"seek_s\": 1.5}", "no replay"),
            ("{\"pause\": true}", "no replay"),
        ] {
            let (status, said) = take(text.as_bytes(), &page).await.unwrap_err();
            assert!(
                status == StatusCode::CONFLICT && said.contains(why),
                "{said}"
            );
        }
        assert_eq!(ends.requests.pop(), None);

        let playback = page.playback.insert(Arc::default()).clone();
        for text in ["{\"pause\": true}", "{\"seek_s\": 1.5}"] {
            assert_eq!(take(text.as_bytes(), &page).await, Ok(String::new()));
        }
        assert!(playback.position().paused);
        assert_eq!(playback.next(HostTime(5)), Next::Skip);
    }
}
