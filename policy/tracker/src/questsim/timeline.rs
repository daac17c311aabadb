//! What the user's devices said around now, read at the policy's own times.

use posed_signal::HostTime;

use super::observation::{FUTURE, PARTS, Part, User};

/// Ticks remembered: a tenth of a second at 500 a second.
const PAST: usize = 64;
/// Ticks closer than this to the last one replace it, ns.
const CLOSE_NS: i64 = 1_500_000;
/// One policy step, ns.
pub(super) const STEP_NS: i64 = 27_777_778;

/// The user at one time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Moment {
    pub at: HostTime,
    pub user: User,
    /// Whether both controllers were tracked.
    pub hands: bool,
}

/// The last moments, and those already known beyond the tick.
#[derive(Debug, Clone, Copy)]
pub(super) struct Timeline {
    past: [Option<Moment>; PAST],
    next: usize,
    ahead: [Option<Moment>; FUTURE],
}

impl Timeline {
    pub(super) const EMPTY: Self = Self {
        past: [None; PAST],
        next: 0,
        ahead: [None; FUTURE],
    };

    /// A tick: what was foreseen before it no longer counts.
    pub(super) fn push(&mut self, moment: Moment) {
        let last = (self.next + PAST - 1) % PAST;
        if self.past[last].is_some_and(|last| moment.at.since_ns(last.at) < CLOSE_NS) {
            self.past[last] = Some(moment);
        } else {
            self.past[self.next] = Some(moment);
            self.next = (self.next + 1) % PAST;
        }
    }

    /// What is known of the frame `index` (from 0) after the next tick.
    pub(super) fn foresee(&mut self, index: usize, moment: Option<Moment>) {
        if let Some(slot) = self.ahead.get_mut(index) {
            *slot = moment;
        }
    }

    /// Every moment in the order of time: the past, then what was foreseen.
    fn moments(&self) -> impl Iterator<Item = &Moment> {
        let past = (0..PAST).map(|step| &self.past[(self.next + step) % PAST]);
        past.chain(&self.ahead).flatten()
    }

    fn newest(&self) -> Option<&Moment> {
        self.moments().last()
    }

    /// The user at `at`, between two moments; the first or last one outside them.
    pub(super) fn at(&self, at: HostTime) -> Option<Moment> {
        let mut before: Option<&Moment> = None;
        for moment in self.moments() {
            if moment.at >= at {
                return Some(before.map_or(*moment, |before| between(before, moment, at)));
            }
            before = Some(moment);
        }
        before.copied()
    }

    /// The six frames after `at`: those measured, at most `lookahead`, and the others carried on.
    /// And whether the controllers are there.
    pub(super) fn future(&self, at: HostTime, lookahead: usize) -> Option<([User; FUTURE], bool)> {
        let newest = self.newest()?.at;
        let frame = |number: i64| self.at(at.plus_ns(number * STEP_NS));
        // Rounding must not cost a frame.
        let known = (newest.since_ns(at) + 1000).div_euclid(STEP_NS).max(0) as usize;
        let known = known.min(lookahead).min(FUTURE);
        let (last, before) = (frame(known as i64)?, frame(known as i64 - 1)?);
        let mut user = [last.user; FUTURE];
        for (index, slot) in user.iter_mut().enumerate() {
            let number = index + 1;
            *slot = if number <= known {
                frame(number as i64)?.user
            } else {
                std::array::from_fn(|part| {
                    last.user[part].carried(&before.user[part], number - known)
                })
            };
        }
        Some((user, last.hands))
    }
}

fn between(before: &Moment, after: &Moment, at: HostTime) -> Moment {
    let span = after.at.since_ns(before.at).max(1) as f64;
    let share = (at.since_ns(before.at) as f64 / span).clamp(0.0, 1.0);
    let mut moment = *after;
    moment.at = at;
    for part in 0..PARTS {
        let (a, b) = (&before.user[part], &after.user[part]);
        moment.user[part] = Part {
            position: a.position.lerp(b.position, share),
            rotation: a.rotation.slerp(b.rotation, share),
        };
    }
    moment
}

#[cfg(test)]
mod tests {
    use glam::{DQuat, DVec3};

    use super::*;

    fn moment(at: HostTime, x: f64) -> Moment {
        let part = Part {
            position: DVec3::X * x,
            rotation: DQuat::IDENTITY,
        };
        Moment {
            at,
            user: [part; PARTS],
            hands: true,
        }
    }

    #[test]
    fn frames_are_measured_as_far_as_they_are_and_carried_on_from_there() {
        let start = HostTime(1_000_000_000);
        let mut timeline = Timeline::EMPTY;
        // One metre a second, at 100 Hz.
        for tick in 0..20i64 {
            let seconds = tick as f64 * 0.01;
            timeline.push(moment(start.plus_ns(tick * 10_000_000), seconds));
        }
        let at = start.plus_ns(100_000_000);
        let x = |lookahead, frame: usize| {
            let (user, hands) = timeline.future(at, lookahead).expect("a timeline");
            assert!(hands);
            user[frame - 1][0].position.x
        };
        // The newest moment is 90 ms after `at`: three frames are measured.
        for frame in 1..=3 {
            assert!((x(6, frame) - 0.1 - frame as f64 / 36.0).abs() < 1e-6);
        }
        for lookahead in [0, 2, 6] {
            let last = x(lookahead, 6);
            assert!((0.2..0.1 + 6.0 / 36.0 + 1e-9).contains(&last), "{last}");
        }
        assert!(x(0, 6) < x(2, 6), "a carried velocity decays");
    }

    #[test]
    fn what_was_foreseen_lies_beyond_the_tick() {
        let start = HostTime(1_000_000_000);
        let mut timeline = Timeline::EMPTY;
        timeline.push(moment(start.plus_ns(-STEP_NS), -1.0));
        timeline.push(moment(start, 0.0));
        for frame in 0..FUTURE {
            let number = frame as i64 + 1;
            let ahead = moment(start.plus_ns(number * STEP_NS), number as f64 * 10.0);
            timeline.foresee(frame, Some(ahead));
        }
        let (user, _) = timeline.future(start, 2).expect("a timeline");
        assert_eq!([user[0][0].position.x, user[1][0].position.x], [10.0, 20.0]);
        assert!(user[5][0].position.x < 60.0);
        let (user, _) = timeline.future(start, 6).expect("a timeline");
        assert_eq!(user[5][0].position.x, 60.0);
    }
}
