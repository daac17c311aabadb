//! The stand-in's last poses: how a character moves that is put in its place.

use posed_body::BodyPose;
use posed_signal::HostTime;

/// Poses remembered, and how far apart at least, ns.
const KEPT: usize = 16;
const APART_NS: i64 = 5_000_000;
/// Velocities are taken over this time, ns: long enough that a tracker's trembling is no movement.
const SPAN_NS: i64 = 48_000_000;
/// A longer pause makes a new beginning, ns.
const PAUSE_NS: i64 = 250_000_000;

#[derive(Debug)]
pub(super) struct Recent {
    poses: [Option<(HostTime, BodyPose)>; KEPT],
    next: usize,
    began: Option<HostTime>,
}

impl Recent {
    pub(super) const EMPTY: Self = Self {
        poses: [None; KEPT],
        next: 0,
        began: None,
    };

    fn last(&self) -> usize {
        (self.next + KEPT - 1) % KEPT
    }

    pub(super) fn push(&mut self, at: HostTime, pose: &BodyPose) {
        let gap = self.poses[self.last()].map(|(last, _)| at.since_ns(last));
        if gap.is_none_or(|gap| !(0..PAUSE_NS).contains(&gap)) {
            *self = Self::EMPTY;
            self.began = Some(at);
        } else if gap.is_some_and(|gap| gap < APART_NS) {
            return;
        }
        self.poses[self.next] = Some((at, *pose));
        self.next = (self.next + 1) % KEPT;
    }

    /// For how long there have been poses without a pause, ns.
    pub(super) fn lasting_ns(&self, now: HostTime) -> i64 {
        self.began.map_or(0, |began| now.since_ns(began))
    }

    /// The newest pose that is old enough for a velocity, and its age in seconds; the oldest one
    /// where none is.
    pub(super) fn earlier(&self, now: HostTime) -> Option<(&BodyPose, f64)> {
        let newest_first = (1..=KEPT).map(|back| &self.poses[(self.next + KEPT - back) % KEPT]);
        let mut found = None;
        for (at, pose) in newest_first.flatten() {
            let age = now.since_ns(*at);
            found = (age > APART_NS / 2).then_some((pose, age as f64 * 1e-9));
            if age >= SPAN_NS {
                break;
            }
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;

    fn pose(x: f32) -> BodyPose {
        BodyPose::rest(Vec3::X * x)
    }

    #[test]
    fn a_velocity_is_taken_over_a_twentieth_of_a_second_at_any_rate() {
        for rate in [60.0, 90.0, 500.0] {
            let mut recent = Recent::EMPTY;
            let at = |tick: u32| HostTime::from_secs_f64(1.0 + f64::from(tick) / rate);
            assert!(recent.earlier(at(0)).is_none());
            // One metre a second.
            let way = |tick: u32| (f64::from(tick) / rate) as f32;
            for tick in 0..300 {
                recent.push(at(tick), &pose(way(tick)));
                let Some((earlier, age)) = recent.earlier(at(tick + 1)) else {
                    continue;
                };
                let speed = f64::from(way(tick + 1) - earlier.root.x) / age;
                assert!((speed - 1.0).abs() < 1e-2, "{rate}: {speed}");
                if tick > 60 {
                    assert!((0.04..0.08).contains(&age), "{rate}: {age}");
                }
            }
        }
    }

    #[test]
    fn a_pause_is_a_new_beginning() {
        let mut recent = Recent::EMPTY;
        let second = |seconds: f64| HostTime::from_secs_f64(seconds);
        recent.push(second(1.0), &pose(0.0));
        recent.push(second(1.1), &pose(0.0));
        assert_eq!(recent.lasting_ns(second(1.2)), 200_000_000);
        recent.push(second(2.0), &pose(5.0));
        assert_eq!(recent.lasting_ns(second(2.0)), 0);
        assert!(recent.earlier(second(2.0)).is_none());
    }
}
