//! One browser: poses against credits, the slower things a few times a second.

use std::time::Duration;

use axum::extract::ws::{CloseFrame, Message, WebSocket, close_code};
use posed_signal::HostTime;
use posed_tracker::Mounts;
use tokio::{sync::watch, time};

use super::{
    Page,
    message::{self, TIMINGS_MAX, Timing},
};
use crate::published::PublishedPose;

/// Bytes of a message from the browser: a credit is one byte.
pub(super) const MESSAGE_BYTES_MAX: usize = 64;
/// How often the devices and counters are sent.
const STATUS_INTERVAL: Duration = Duration::from_millis(200);
/// A browser that takes nothing for so long is gone.
const SEND_TIMEOUT: Duration = Duration::from_secs(10);

/// When the last poses were published.
#[derive(Debug, Default)]
struct Timings {
    last: Option<(u64, HostTime)>,
    waiting: Vec<Timing>,
}

impl Timings {
    /// Notes a pose, if it is a new one.
    fn note(&mut self, pose: &PublishedPose) {
        if self
            .last
            .is_some_and(|(sequence, _)| sequence == pose.sequence)
        {
            return;
        }
        let before = self.last.replace((pose.sequence, pose.publish_at));
        // Before the first measurement there is no age.
        let age_ms = if pose.sample_at > HostTime(0) {
            pose.publish_at.since_secs(pose.sample_at) as f32 * 1e3
        } else {
            f32::NAN
        };
        // After a gap there is no interval.
        let interval_ms = before
            .filter(|(sequence, _)| sequence + 1 == pose.sequence)
            .map_or(f32::NAN, |(_, at)| {
                pose.publish_at.since_secs(at) as f32 * 1e3
            });
        if self.waiting.len() == TIMINGS_MAX {
            self.waiting.remove(0);
        }
        self.waiting.push([age_ms, interval_ms]);
    }
}

/// Serves a browser until it goes or `stop` closes. Every message of the browser is a credit for
/// one pose: it grants the next when it has drawn the last, and then gets the newest.
pub(super) async fn watch(mut browser: WebSocket, page: &Page, mut stop: watch::Receiver<()>) {
    let mut changes = page.services.hub.changes();
    let mut status = time::interval(STATUS_INTERVAL);
    status.set_missed_tick_behavior(time::MissedTickBehavior::Delay);
    let mut timings = Timings::default();
    let (mut has_credit, mut sent) = (false, None);
    if !send(&mut browser, text(&message::hello(page))).await {
        return;
    }
    loop {
        let next = tokio::select! {
            changed = changes.changed() => {
                if changed.is_err() {
                    break;
                }
                None
            }
            _ = stop.changed() => break,
            _ = status.tick() => Some(text(&message::status(page))),
            message = browser.recv() => match message {
                Some(Ok(Message::Text(_) | Message::Binary(_))) => {
                    has_credit = true;
                    None
                }
                Some(Ok(Message::Ping(_) | Message::Pong(_))) => None,
                Some(Ok(Message::Close(_)) | Err(_)) | None => return,
            },
        };
        if let Some(message) = next
            && !send(&mut browser, message).await
        {
            return;
        }
        let Some(pose) = page.services.hub.latest() else {
            continue;
        };
        timings.note(&pose);
        if has_credit && sent != Some(pose.sequence) {
            (has_credit, sent) = (false, Some(pose.sequence));
            let mounts = Mounts::index(&page.services.wearer.borrow());
            let bytes = message::pose(&pose, &mounts, &timings.waiting);
            timings.waiting.clear();
            if !send(&mut browser, Message::Binary(bytes.into())).await {
                return;
            }
        }
    }
    let close = CloseFrame {
        code: close_code::AWAY,
        reason: "posed is stopping".into(),
    };
    send(&mut browser, Message::Close(Some(close))).await;
}

fn text(value: &serde_json::Value) -> Message {
    Message::Text(value.to_string().into())
}

/// Whether the browser took it.
async fn send(browser: &mut WebSocket, message: Message) -> bool {
    matches!(
        time::timeout(SEND_TIMEOUT, browser.send(message)).await,
        Ok(Ok(()))
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::published::tests::pose_at;

    #[test]
    fn timings_are_of_every_pose_once_and_bounded() {
        let mut timings = Timings::default();
        let at = |sequence: u64| pose_at(sequence, HostTime(1_000_000_000 + sequence * 10_000_000));
        for sequence in [1, 2, 2, 3, 5, 6] {
            timings.note(&at(sequence));
        }
        let intervals: Vec<_> = timings.waiting.iter().map(|timing| timing[1]).collect();
        assert_eq!(intervals.len(), 5);
        assert!(
            intervals[0].is_nan() && intervals[3].is_nan(),
            "first, and after a gap"
        );
        assert!((intervals[1] - 10.0).abs() < 1e-3 && (intervals[4] - 10.0).abs() < 1e-3);
        assert!(
            timings
                .waiting
                .iter()
                .all(|timing| (timing[0] - 4.5).abs() < 1e-3)
        );
        timings.note(&PublishedPose {
            sample_at: HostTime(0),
            ..at(7)
        });
        assert!(timings.waiting[5][0].is_nan(), "nothing was measured yet");
        for sequence in 8..500 {
            timings.note(&at(sequence));
        }
        assert_eq!(timings.waiting.len(), TIMINGS_MAX);
    }
}
