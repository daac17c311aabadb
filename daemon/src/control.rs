//! The way of requests to the tracker and to the devices, for everybody who may make them: gRPC, the
//! page, the command line.

use std::sync::{Mutex, MutexGuard, PoisonError};

use posed_body::scene::Object;
use posed_signal::ring::Producer;
use posed_tracker::{TrackerKind, Wearer};
use tokio::sync::watch;

use crate::{
    config::HEIGHT_M,
    heights::{Avatar, Heights},
    pipeline::{source::Buzz, tracking::Request},
};

/// The ways in.
#[derive(Debug)]
pub struct Requests {
    /// To the tracker's thread, which takes them at its next tick.
    pub tracker: Producer<Request>,
    /// To the thread that owns the devices.
    pub buzzes: Producer<Buzz>,
}

/// Hands requests on, one after the other, and tells those who must know.
#[derive(Debug)]
pub struct Control {
    requests: Mutex<Requests>,
    wearer: watch::Sender<Wearer>,
    heights: watch::Sender<Heights>,
    resets: watch::Sender<u64>,
    tracker: watch::Sender<TrackerKind>,
    trackers: Vec<TrackerKind>,
    objects: Vec<Object>,
}

/// What can be asked for, and what holds at first.
#[derive(Debug, Clone)]
pub struct Known {
    /// How tall the wearer is, and the body shown.
    pub heights: Heights,
    /// The tracker at first.
    pub tracker: TrackerKind,
    /// The trackers that can be chosen.
    pub trackers: Vec<TrackerKind>,
    /// The things in the scene.
    pub objects: Vec<Object>,
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
    /// The scene has no such thing, or it cannot be there.
    #[error("object {index} {problem}")]
    Object {
        /// Which one.
        index: usize,
        /// What is wrong.
        problem: &'static str,
    },
}

impl Control {
    /// Requests go into `requests`; another body is told to `wearer`.
    #[must_use]
    pub fn new(requests: Requests, wearer: watch::Sender<Wearer>, known: Known) -> Self {
        Self {
            requests: Mutex::new(requests),
            wearer,
            heights: watch::Sender::new(known.heights),
            resets: watch::Sender::new(0),
            tracker: watch::Sender::new(known.tracker),
            trackers: known.trackers,
            objects: known.objects,
        }
    }

    /// Hands a request to the tracker, which takes it at its next tick.
    ///
    /// # Errors
    /// The request makes no sense, or too many are waiting.
    pub fn request(&self, request: Request) -> Result<(), Refusal> {
        match request {
            Request::Height { metres, avatar } => {
                if let Some(wrong) = self.heights().told(metres, avatar).wrong() {
                    return Err(Refusal::Height(wrong));
                }
            }
            Request::Move(to) => {
                if let Some(problem) = to.problem(self.objects.len()) {
                    let index = to.index;
                    return Err(Refusal::Object { index, problem });
                }
            }
            Request::Tracker(kind) if !self.trackers.contains(&kind) => {
                return Err(self.no_tracker(kind.name()));
            }
            _ => {}
        }
        if !self.lock().tracker.push(request) {
            return Err(Refusal::Busy);
        }
        match request {
            Request::Height { metres, avatar } => self.tell(self.heights().told(metres, avatar)),
            Request::Tracker(kind) => {
                self.tracker.send_replace(kind);
            }
            // The tracker goes on.
            Request::Move(_) => return Ok(()),
            Request::Reset | Request::Calibrate(_) => {}
        }
        self.resets.send_modify(|count| *count += 1);
        Ok(())
    }

    /// The things in the scene, as the configuration has them.
    #[must_use]
    pub fn objects(&self) -> &[Object] {
        &self.objects
    }

    /// How tall the wearer is, and the body shown.
    #[must_use]
    pub fn heights(&self) -> Heights {
        *self.heights.borrow()
    }

    /// The tracker loop has measured the wearer, and starts anew.
    pub fn measured(&self, metres: f32) {
        self.tell(self.heights().told(metres, Avatar::Keep));
        self.resets.send_modify(|count| *count += 1);
    }

    fn tell(&self, heights: Heights) {
        self.heights.send_replace(heights);
        self.wearer.send_replace(heights.body());
    }

    /// Has a device buzz, as soon as the thread that owns it looks.
    ///
    /// # Errors
    /// Too many are waiting.
    pub fn buzz(&self, buzz: Buzz) -> Result<(), Refusal> {
        let pushed = self.lock().buzzes.push(buzz);
        pushed.then_some(()).ok_or(Refusal::Busy)
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
    pub fn renew(&self, requests: Requests) {
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
    fn lock(&self) -> MutexGuard<'_, Requests> {
        self.requests.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use posed_signal::ring::{Consumer, ring};

    use glam::{Quat, Vec3};
    use posed_tracker::ObjectMove;

    use super::*;

    fn height(metres: f32) -> Request {
        Request::Height {
            metres,
            avatar: Avatar::Keep,
        }
    }

    /// A control of `ik` and `pip` with one thing in the scene and room for two requests of either
    /// kind, and its other ends.
    pub(crate) fn control(
        wearer: watch::Sender<Wearer>,
    ) -> (Control, Consumer<Request>, Consumer<Buzz>) {
        let (tracker, tracker_end) = ring(2);
        let (buzzes, buzzes_end) = ring(2);
        let requests = Requests { tracker, buzzes };
        let known = Known {
            heights: Heights::of(wearer.borrow().height),
            tracker: TrackerKind::Ik,
            trackers: vec![TrackerKind::Ik, TrackerKind::Pip],
            objects: vec![Object::Ball {
                radius: 0.1,
                position: [0.0, 0.1, -1.0],
                mass: 0.4,
            }],
        };
        let control = Control::new(requests, wearer, known);
        (control, tracker_end, buzzes_end)
    }

    #[test]
    fn requests_arrive_in_order_and_too_many_are_refused() {
        let (wearer, seen) = watch::channel(Wearer::of_height(1.75));
        let (control, mut consumer, _) = control(wearer);
        let resets = control.resets();
        assert_eq!(control.request(height(1.6)), Ok(()));
        assert_eq!(control.request(Request::Tracker(TrackerKind::Pip)), Ok(()));
        assert_eq!(
            control.request(height(1.9)),
            Err(Refusal::Busy),
            "two are waiting"
        );
        assert_eq!((seen.borrow().height, *resets.borrow()), (1.6, 2));
        assert_eq!(control.tracker(), TrackerKind::Pip);
        assert_eq!(consumer.pop(), Some(height(1.6)));
        assert_eq!(consumer.pop(), Some(Request::Tracker(TrackerKind::Pip)));
        assert_eq!(control.request(Request::Reset), Ok(()));
    }

    #[test]
    fn the_body_is_as_tall_as_the_avatar() {
        let (wearer, seen) = watch::channel(Wearer::of_height(1.75));
        let (control, mut consumer, _) = control(wearer);
        let tall = Request::Height {
            metres: 1.6,
            avatar: Avatar::Metres(2.0),
        };
        assert_eq!(control.request(tall), Ok(()));
        assert_eq!((seen.borrow().height, control.heights().wearer), (2.0, 1.6));
        control.measured(1.7);
        assert_eq!((seen.borrow().height, control.heights().wearer), (2.0, 1.7));
        let own = Request::Height {
            metres: 1.65,
            avatar: Avatar::Own,
        };
        assert_eq!(control.request(own), Ok(()));
        assert_eq!(
            (seen.borrow().height, control.heights().wearer),
            (1.65, 1.65)
        );
        assert_eq!((consumer.pop(), consumer.pop()), (Some(tall), Some(own)));
        let resets = *control.resets().borrow();
        let to = ObjectMove {
            index: 0,
            position: Vec3::ONE,
            rotation: Quat::IDENTITY,
            velocity: Vec3::ZERO,
            angular_velocity: Vec3::ZERO,
        };
        assert_eq!(control.request(Request::Move(to)), Ok(()));
        assert_eq!(consumer.pop(), Some(Request::Move(to)));
        assert_eq!(*control.resets().borrow(), resets, "nothing starts anew");
    }

    #[test]
    fn what_makes_no_sense_is_refused_in_words() {
        let (control, mut consumer, _) = control(watch::Sender::new(Wearer::of_height(1.75)));
        for metres in [0.5, 3.0, f32::NAN, f32::INFINITY] {
            let refusal = control.request(height(metres)).unwrap_err();
            assert!(refusal.to_string().contains("give 1 to 2.5"), "{refusal}");
            let avatar = Avatar::Metres(metres);
            let refusal = control.request(Request::Height {
                metres: 1.8,
                avatar,
            });
            let refusal = refusal.unwrap_err();
            assert!(refusal.to_string().contains("give 1 to 2.5"), "{refusal}");
        }
        let refusal = control
            .request(Request::Tracker(TrackerKind::QuestSim))
            .unwrap_err();
        assert_eq!(refusal.to_string(), "tracker questsim: there are ik, pip");
        let to = ObjectMove {
            index: 1,
            position: Vec3::ZERO,
            rotation: Quat::IDENTITY,
            velocity: Vec3::ZERO,
            angular_velocity: Vec3::ZERO,
        };
        let refusal = control.request(Request::Move(to)).unwrap_err();
        assert_eq!(refusal.to_string(), "object 1 is not in the scene");
        assert_eq!(consumer.pop(), None);
    }
}
