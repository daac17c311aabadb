//! The way of requests to the tracker, for everybody who may make them: gRPC, the page, the
//! command line.

use std::sync::{Mutex, PoisonError};

use posed_signal::ring::Producer;
use posed_tracker::Wearer;
use tokio::sync::watch;

use crate::pipeline::tracking::Request;

/// Hands requests on, one after the other, and tells those who must know.
#[derive(Debug)]
pub struct Control {
    requests: Mutex<Producer<Request>>,
    wearer: watch::Sender<Wearer>,
    resets: watch::Sender<u64>,
}

impl Control {
    /// Requests go into `requests`; a new height is told to `wearer`.
    #[must_use]
    pub fn new(requests: Producer<Request>, wearer: watch::Sender<Wearer>) -> Self {
        Self {
            requests: Mutex::new(requests),
            wearer,
            resets: watch::Sender::new(0),
        }
    }

    /// Hands a request to the tracker, which takes it at its next tick; `false` where too many are
    /// waiting.
    pub fn request(&self, request: Request) -> bool {
        // Nothing half-done can be left behind in a ring.
        let mut requests = self.requests.lock().unwrap_or_else(PoisonError::into_inner);
        if !requests.push(request) {
            return false;
        }
        if let Request::Height(height) = request {
            self.wearer.send_replace(Wearer::of_height(height));
        }
        self.resets.send_modify(|count| *count += 1);
        true
    }

    /// Counts up whenever the tracker starts anew: after a reset, another height or tracker.
    #[must_use]
    pub fn resets(&self) -> watch::Receiver<u64> {
        self.resets.subscribe()
    }
}

#[cfg(test)]
mod tests {
    use posed_signal::ring::ring;

    use super::*;

    #[test]
    fn requests_arrive_in_order_and_too_many_are_refused() {
        let (producer, mut consumer) = ring(2);
        let (wearer, seen) = watch::channel(Wearer::of_height(1.75));
        let control = Control::new(producer, wearer);
        let resets = control.resets();
        assert!(control.request(Request::Height(1.6)) && control.request(Request::Reset));
        assert!(!control.request(Request::Height(1.9)), "two are waiting");
        assert_eq!((seen.borrow().height, *resets.borrow()), (1.6, 2));
        assert_eq!(consumer.pop(), Some(Request::Height(1.6)));
        assert_eq!(consumer.pop(), Some(Request::Reset));
        assert!(control.request(Request::Reset));
    }
}
