//! The way of requests to the tracker, for everybody who may make them: gRPC, the page, the
//! command line.

use std::sync::{Mutex, MutexGuard, PoisonError};

use posed_signal::ring::Producer;
use posed_tracker::{TrackerKind, Wearer};
use tokio::sync::watch;

use crate::{config::HEIGHT_M, pipeline::tracking::Request};

/// Hands requests on, one after the other, and tells those who must know.
#[derive(Debug)]
pub struct Control {
    requests: Mutex<Producer<Request>>,
    wearer: watch::Sender<Wearer>,
    resets: watch::Sender<u64>,
    tracker: watch::Sender<TrackerKind>,
    trackers: Vec<TrackerKind>,
}

/// Why a request is not handed on.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// The tracker takes requests at its next tick; it has none to take them at, or a client asks
    /// too much.
    #[error("too many requests are waiting; try again")]
    Busy,
    /// Nobody is so tall.
    #[error("a height of {0} m: give {low} to {high}", low = HEIGHT_M.start(), high = HEIGHT_M.end())]
    Height(f32),
    /// This posed has no such tracker.
    #[error("tracker {name}: there are {known}")]
    Tracker {
        /// Its name.
        name: String,
        /// Those that there are.
        known: String,
    },
}

impl Control {
    /// Requests go into `requests`; a new height is told to `wearer`. The tracker can be one of
    /// `trackers`, and is `tracker` at first.
    #[must_use]
    pub fn new(
        requests: Producer<Request>,
        wearer: watch::Sender<Wearer>,
        tracker: TrackerKind,
        trackers: Vec<TrackerKind>,
    ) -> Self {
        Self {
            requests: Mutex::new(requests),
            wearer,
            resets: watch::Sender::new(0),
            tracker: watch::Sender::new(tracker),
            trackers,
        }
    }

    /// Hands a request to the tracker, which takes it at its next tick.
    ///
    /// # Errors
    /// The request makes no sense, or too many are waiting.
    pub fn request(&self, request: Request) -> Result<(), Refusal> {
        match request {
            Request::Height(height) if !HEIGHT_M.contains(&height) => {
                return Err(Refusal::Height(height));
            }
            Request::Tracker(kind) if !self.trackers.contains(&kind) => {
                return Err(self.no_tracker(kind.name()));
            }
            _ => {}
        }
        if !self.lock().push(request) {
            return Err(Refusal::Busy);
        }
        match request {
            Request::Height(height) => {
                self.wearer.send_replace(Wearer::of_height(height));
            }
            Request::Tracker(kind) => {
                self.tracker.send_replace(kind);
            }
            Request::Reset | Request::Calibrate(_) => {}
        }
        self.resets.send_modify(|count| *count += 1);
        Ok(())
    }

    /// What to say to somebody who wants a tracker that is not there.
    #[must_use]
    pub fn no_tracker(&self, name: &str) -> Refusal {
        let known: Vec<_> = self.trackers.iter().map(|kind| kind.name()).collect();
        Refusal::Tracker {
            name: name.into(),
            known: known.join(", "),
        }
    }

    /// Requests go into `requests` from now on: another tracker loop has taken over.
    pub fn renew(&self, requests: Producer<Request>) {
        *self.lock() = requests;
    }

    /// The trackers that can be asked for.
    #[must_use]
    pub fn trackers(&self) -> &[TrackerKind] {
        &self.trackers
    }

    /// The tracker asked for last.
    #[must_use]
    pub fn tracker(&self) -> TrackerKind {
        *self.tracker.borrow()
    }

    /// Counts up whenever the tracker starts anew: after a reset, another height or tracker.
    #[must_use]
    pub fn resets(&self) -> watch::Receiver<u64> {
        self.resets.subscribe()
    }

    /// Nothing half-done can be left behind in a ring.
    fn lock(&self) -> MutexGuard<'_, Producer<Request>> {
        self.requests.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use posed_signal::ring::{Consumer, ring};

    use super::*;

    /// A control of `ik` and `pip` with room for two requests, and its other end.
    pub(crate) fn control(wearer: watch::Sender<Wearer>) -> (Control, Consumer<Request>) {
        let (producer, consumer) = ring(2);
        let trackers = vec![TrackerKind::Ik, TrackerKind::Pip];
        (
            Control::new(producer, wearer, TrackerKind::Ik, trackers),
            consumer,
        )
    }

    #[test]
    fn requests_arrive_in_order_and_too_many_are_refused() {
        let (wearer, seen) = watch::channel(Wearer::of_height(1.75));
        let (control, mut consumer) = control(wearer);
        let resets = control.resets();
        assert_eq!(control.request(Request::Height(1.6)), Ok(()));
        assert_eq!(control.request(Request::Tracker(TrackerKind::Pip)), Ok(()));
        assert_eq!(
            control.request(Request::Height(1.9)),
            Err(Refusal::Busy),
            "two are waiting"
        );
        assert_eq!((seen.borrow().height, *resets.borrow()), (1.6, 2));
        assert_eq!(control.tracker(), TrackerKind::Pip);
        assert_eq!(consumer.pop(), Some(Request::Height(1.6)));
        assert_eq!(consumer.pop(), Some(Request::Tracker(TrackerKind::Pip)));
        assert_eq!(control.request(Request::Reset), Ok(()));
    }

    #[test]
    fn what_makes_no_sense_is_refused_in_words() {
        let (control, mut consumer) = control(watch::Sender::new(Wearer::of_height(1.75)));
        for height in [0.5, 3.0, f32::NAN, f32::INFINITY] {
            let refusal = control.request(Request::Height(height)).unwrap_err();
            assert!(refusal.to_string().contains("give 1 to 2.5"), "{refusal}");
        }
        let refusal = control
            .request(Request::Tracker(TrackerKind::QuestSim))
            .unwrap_err();
        assert_eq!(refusal.to_string(), "tracker questsim: there are ik, pip");
        assert_eq!(consumer.pop(), None);
    }
}
