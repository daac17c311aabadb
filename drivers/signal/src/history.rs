//! Samples indexed by time. A history answers *at a time*, and says how the answer was made.

use crate::{
    sample::{Orientation, Pose},
    time::{HostTime, MILLISECOND_NS},
};

/// Beyond this age of the newest sample an extrapolation is no better than holding it: head
/// rotation predictions over 60 ms look worse than none, those up to 30 ms help.
pub const EXTRAPOLATE_NS_MAX: i64 = 60 * MILLISECOND_NS as i64;
/// Beyond this age of the newest sample it says nothing about the present.
pub const STALE_NS: i64 = 500 * MILLISECOND_NS as i64;

/// Something that moves: it can be interpolated between two samples and carried on from one.
pub trait Motion: Copy {
    /// When the sample is valid.
    fn at(&self) -> HostTime;
    /// Between `self` (at 0) and `later` (at 1).
    #[must_use]
    fn interpolate(&self, later: &Self, fraction: f32) -> Self;
    /// Carried on by its own velocity.
    #[must_use]
    fn extrapolate(&self, ns: i64) -> Self;
}

impl Motion for Pose {
    fn at(&self) -> HostTime {
        self.at
    }

    fn interpolate(&self, later: &Self, fraction: f32) -> Self {
        let ns = later.at.since_ns(self.at) as f64 * f64::from(fraction);
        let near = if fraction < 0.5 { self } else { later };
        Self {
            at: self.at.plus_ns(ns as i64),
            position: self.position.lerp(later.position, fraction),
            rotation: self.rotation.slerp(later.rotation, fraction).normalize(),
            velocity: self.velocity.lerp(later.velocity, fraction),
            angular_velocity: self.angular_velocity.lerp(later.angular_velocity, fraction),
            residual_rad: near.residual_rad,
            how: near.how,
        }
    }

    fn extrapolate(&self, ns: i64) -> Self {
        let dt = ns as f32 * 1e-9;
        let turn = glam::Quat::from_scaled_axis(self.angular_velocity * dt);
        Self {
            at: self.at.plus_ns(ns),
            position: self.position + self.velocity * dt,
            rotation: (turn * self.rotation).normalize(),
            ..*self
        }
    }
}

impl Motion for Orientation {
    fn at(&self) -> HostTime {
        self.at
    }

    fn interpolate(&self, later: &Self, fraction: f32) -> Self {
        let ns = later.at.since_ns(self.at) as f64 * f64::from(fraction);
        Self {
            at: self.at.plus_ns(ns as i64),
            rotation: self.rotation.slerp(later.rotation, fraction).normalize(),
            accel: self.accel.lerp(later.accel, fraction),
            angular_velocity: self.angular_velocity.lerp(later.angular_velocity, fraction),
        }
    }

    fn extrapolate(&self, ns: i64) -> Self {
        let turn = glam::Quat::from_scaled_axis(self.angular_velocity * (ns as f32 * 1e-9));
        Self {
            at: self.at.plus_ns(ns),
            rotation: (turn * self.rotation).normalize(),
            ..*self
        }
    }
}

/// An answer of a history, and how it was made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Lookup<T> {
    /// A sample of exactly that time.
    Exact(T),
    /// Between two samples.
    Interpolated(T),
    /// The newest sample carried on (or, with a negative number, the oldest carried back).
    Extrapolated {
        /// The answer, carried at most [`EXTRAPOLATE_NS_MAX`] and held from there on.
        value: T,
        /// Nanoseconds from the nearest sample to the time asked for.
        by_ns: i64,
    },
    /// The newest sample as it was measured: it is too old to carry on.
    Stale {
        /// The newest sample.
        value: T,
        /// Nanoseconds from it to the time asked for.
        age_ns: i64,
    },
    /// No sample yet.
    Empty,
}

impl<T: Copy> Lookup<T> {
    /// The value, unless there is none at all; stale ones included.
    #[must_use]
    pub fn value(&self) -> Option<T> {
        match *self {
            Self::Exact(value)
            | Self::Interpolated(value)
            | Self::Extrapolated { value, .. }
            | Self::Stale { value, .. } => Some(value),
            Self::Empty => None,
        }
    }

    /// The same answer with `change` made to its value.
    #[must_use]
    pub fn map(self, change: impl FnOnce(T) -> T) -> Self {
        match self {
            Self::Exact(value) => Self::Exact(change(value)),
            Self::Interpolated(value) => Self::Interpolated(change(value)),
            Self::Extrapolated { value, by_ns } => Self::Extrapolated {
                value: change(value),
                by_ns,
            },
            Self::Stale { value, age_ns } => Self::Stale {
                value: change(value),
                age_ns,
            },
            Self::Empty => Self::Empty,
        }
    }

    /// The value, unless it is stale or missing.
    #[must_use]
    pub fn fresh(&self) -> Option<T> {
        match *self {
            Self::Stale { .. } | Self::Empty => None,
            _ => self.value(),
        }
    }

    /// The word used in JSON output and in the API.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::Exact(_) => "exact",
            Self::Interpolated(_) => "interpolated",
            Self::Extrapolated { .. } => "extrapolated",
            Self::Stale { .. } => "stale",
            Self::Empty => "empty",
        }
    }
}

/// The last `N` samples of one stream, in the order of time. Nothing is allocated.
#[derive(Debug, Clone)]
pub struct History<T, const N: usize> {
    samples: [Option<T>; N],
    /// Number of samples ever taken; the newest is at `(taken - 1) % N`.
    taken: usize,
    out_of_order: u64,
}

impl<T: Motion, const N: usize> Default for History<T, N> {
    fn default() -> Self {
        const { assert!(N >= 2, "interpolation needs two samples") };
        Self {
            samples: [None; N],
            taken: 0,
            out_of_order: 0,
        }
    }
}

impl<T: Motion, const N: usize> History<T, N> {
    /// Takes a sample. One that is not newer than the newest is refused (`false`) and counted:
    /// a stream's time only moves forward, and what the past was has been answered already.
    pub fn push(&mut self, sample: T) -> bool {
        if self
            .newest()
            .is_some_and(|newest| sample.at() <= newest.at())
        {
            self.out_of_order += 1;
            return false;
        }
        self.samples[self.taken % N] = Some(sample);
        self.taken += 1;
        true
    }

    /// Forgets everything, as after a jump of the clock.
    pub fn clear(&mut self) {
        self.samples = [None; N];
        self.taken = 0;
    }

    /// The newest sample.
    #[must_use]
    pub fn newest(&self) -> Option<T> {
        self.nth_newest(0)
    }

    /// Samples refused because they were not newer than the newest.
    #[must_use]
    pub fn out_of_order(&self) -> u64 {
        self.out_of_order
    }

    /// Samples held now.
    #[must_use]
    pub fn len(&self) -> usize {
        self.taken.min(N)
    }

    /// Whether there is no sample.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.taken == 0
    }

    fn nth_newest(&self, n: usize) -> Option<T> {
        (n < self.len())
            .then(|| self.samples[(self.taken - 1 - n) % N])
            .flatten()
    }

    /// The value at `time`.
    #[must_use]
    pub fn at(&self, time: HostTime) -> Lookup<T> {
        let Some(newest) = self.newest() else {
            return Lookup::Empty;
        };
        let ahead = time.since_ns(newest.at());
        if ahead > 0 {
            return Self::beyond(newest, ahead);
        }
        let mut later = newest;
        for n in 0..self.len() {
            let Some(sample) = self.nth_newest(n) else {
                break;
            };
            if sample.at() == time {
                return Lookup::Exact(sample);
            }
            if sample.at() < time {
                let span = later.at().since_ns(sample.at()) as f64;
                let fraction = time.since_ns(sample.at()) as f64 / span;
                return Lookup::Interpolated(sample.interpolate(&later, fraction as f32));
            }
            later = sample;
        }
        Self::beyond(later, time.since_ns(later.at()))
    }

    fn beyond(nearest: T, ns: i64) -> Lookup<T> {
        if ns.abs() > STALE_NS {
            return Lookup::Stale {
                value: nearest,
                age_ns: ns,
            };
        }
        let reach = ns.clamp(-EXTRAPOLATE_NS_MAX, EXTRAPOLATE_NS_MAX);
        Lookup::Extrapolated {
            value: nearest.extrapolate(reach),
            by_ns: ns,
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::{Quat, Vec3};
    use proptest::prelude::*;

    use super::*;
    use crate::sample::PoseHow;

    fn moving(ns: u64) -> Pose {
        let t = ns as f32 * 1e-9;
        Pose {
            at: HostTime(ns),
            position: Vec3::new(2.0 * t, 1.0, 0.0),
            rotation: Quat::from_rotation_y(0.5 * t),
            velocity: Vec3::new(2.0, 0.0, 0.0),
            angular_velocity: Vec3::new(0.0, 0.5, 0.0),
            residual_rad: 0.0,
            how: PoseHow::Optical,
        }
    }

    #[test]
    fn says_how_each_answer_was_made() {
        let mut history = History::<Pose, 8>::default();
        assert_eq!(history.at(HostTime(5)), Lookup::Empty);
        for ms in [1_000, 1_010, 1_020] {
            assert!(history.push(moving(ms * MILLISECOND_NS)));
        }
        let at = |ms: u64| history.at(HostTime(ms * MILLISECOND_NS));
        assert!(matches!(at(1_010), Lookup::Exact(_)));
        assert!(matches!(at(1_015), Lookup::Interpolated(_)));
        assert!(matches!(
            at(1_030),
            Lookup::Extrapolated {
                by_ns: 10_000_000,
                ..
            }
        ));
        assert!(matches!(
            at(990),
            Lookup::Extrapolated {
                by_ns: -10_000_000,
                ..
            }
        ));
        assert!(matches!(
            at(1_600),
            Lookup::Stale {
                age_ns: 580_000_000,
                ..
            }
        ));
        assert_eq!(at(1_600).fresh(), None);
        assert!(at(1_600).value().is_some());
    }

    #[test]
    fn refuses_and_counts_samples_that_are_not_newer() {
        let mut history = History::<Pose, 4>::default();
        assert!(history.push(moving(10)));
        assert!(!history.push(moving(10)));
        assert!(!history.push(moving(9)));
        assert_eq!((history.len(), history.out_of_order()), (1, 2));
    }

    proptest! {
        #[test]
        fn uniform_motion_is_answered_truly(
            gaps in prop::collection::vec(1_000_000u64..20_000_000, 2..40),
            ask in -0.2f64..1.2,
        ) {
            let mut history = History::<Pose, 16>::default();
            let mut ns = 1_000_000_000;
            for gap in &gaps {
                ns += gap;
                history.push(moving(ns));
            }
            let span: u64 = gaps[gaps.len().saturating_sub(16)..].iter().skip(1).sum();
            let time = (ns as f64 - span as f64 * (1.0 - ask)) as u64;
            let lookup = history.at(HostTime(time));
            if let (Some(pose), true) = (lookup.fresh(), within_reach(&lookup)) {
                let truth = moving(time);
                prop_assert!((pose.position - truth.position).length() < 1e-4);
                prop_assert!(pose.rotation.angle_between(truth.rotation) < 2e-3);
            }
        }
    }

    fn within_reach(lookup: &Lookup<Pose>) -> bool {
        !matches!(lookup, Lookup::Extrapolated { by_ns, .. } if by_ns.abs() > EXTRAPOLATE_NS_MAX)
    }
}
