//! The physics optimiser as a tracker's last stage: whatever the tracker says is made to obey the
//! equation of motion over the floor (PIP, Yi et al. 2022, section 3.2).

use posed_body::{
    optimiser::{Optimiser, Reference, Settings, Solved},
    scene::Ground,
};

use posed_signal::{HostTime, Lookup, Pose, Role};

use crate::{
    objects::{ObjectMove, Objects},
    tracker::{Forces, Input, Recoveries, Tracked, Tracker, TrackerKind, Wearer},
};

/// Body mass index of the wearer whose mass is not known, kg/m²: 72 kg at 1.75 m.
const MASS_INDEX: f64 = 23.5;

/// Mass of a wearer of average build, kilograms.
pub(crate) fn average_mass(wearer: &Wearer) -> f64 {
    MASS_INDEX * f64::from(wearer.height).powi(2)
}

/// A tracker, and physics behind it. Ticks have to come at the rate it was made for.
pub struct Physical {
    inner: Box<dyn Tracker>,
    optimiser: Optimiser,
    ground: Ground,
    wearer: Wearer,
    last: Option<Solved>,
}

impl Physical {
    /// Puts physics behind `inner`, for this wearer, at `rate_hz` ticks a second on flat ground.
    #[must_use]
    pub fn new(inner: Box<dyn Tracker>, wearer: &Wearer, rate_hz: f64) -> Self {
        let settings = Settings::default();
        let (skeleton, mass) = (&wearer.skeleton, average_mass(wearer));
        Self {
            inner,
            optimiser: Optimiser::new(skeleton, mass, 1.0 / rate_hz, settings),
            ground: Ground::Flat,
            wearer: *wearer,
            last: None,
        }
    }

    /// Forces and torques of the last tick.
    #[must_use]
    pub fn solved(&self) -> Option<&Solved> {
        self.last.as_ref()
    }
}

impl Tracker for Physical {
    fn kind(&self) -> TrackerKind {
        self.inner.kind()
    }

    fn reset(&mut self) {
        self.inner.reset();
        self.optimiser.reset();
        self.last = None;
    }

    fn foresight(&self) -> &'static [i64] {
        self.inner.foresight()
    }

    fn foresee(&mut self, index: usize, at: HostTime, parts: &[Lookup<Pose>; Role::COUNT]) {
        self.inner.foresee(index, at, parts);
    }

    fn recoveries(&self) -> Option<Recoveries> {
        self.inner.recoveries()
    }

    fn objects(&self) -> Objects {
        self.inner.objects()
    }

    fn move_object(&mut self, to: &ObjectMove) {
        self.inner.move_object(to);
    }

    fn track(&mut self, input: &Input<'_>) -> Tracked {
        let tracked = self.inner.track(input);
        if self.wearer != *input.wearer {
            self.wearer = *input.wearer;
            self.optimiser
                .wear(&self.wearer.skeleton, average_mass(&self.wearer));
        }
        let reference = Reference {
            pose: &tracked.pose,
            velocities: None,
            // A network that is unsure of a standing foot says so and lets it slide: feet slide
            // less where the optimiser goes by how they move.
            contacts: None,
        };
        let solved = self.optimiser.step(&reference, &self.ground);
        self.last = Some(solved);
        Tracked {
            pose: solved.pose,
            forces: Some(Forces::of(&solved)),
            ..tracked
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use posed_signal::PoseHow;

    use super::*;
    use crate::Ik;
    use crate::tracker::NO_INERTIAL;

    /// Newtons on the ground under somebody who stands still from `start` ticks on, mean of two
    /// seconds after two to settle.
    fn weight(tracker: &mut Physical, wearer: &Wearer, start: u64) -> f64 {
        let mut parts = [Lookup::Empty; Role::COUNT];
        let mut weight = 0.0;
        for tick in 0..240u64 {
            let at = HostTime(1_000_000_000 + (start + tick) * 16_666_667);
            let head = Pose {
                position: Vec3::new(0.0, wearer.skeleton.head_height() + 0.02, 0.0),
                how: PoseHow::Optical,
                ..Pose::unknown(at)
            };
            parts[Role::Head as usize] = Lookup::Exact(head);
            let input = Input {
                target: at,
                parts: &parts,
                inertial: &NO_INERTIAL,
                wearer,
            };
            assert!(tracker.track(&input).pose.is_sound());
            if tick >= 120 {
                weight +=
                    f64::from(tracker.solved().expect("a tick was done").ground_force.y) / 120.0;
            }
        }
        weight
    }

    #[test]
    fn somebody_who_stands_weighs_on_the_floor() {
        let wearer = Wearer::of_height(1.75);
        let mut tracker = Physical::new(Box::new(Ik::default()), &wearer, 60.0);
        // A taller one puts the headset on.
        for (start, wearer) in [(0, wearer), (240, Wearer::of_height(1.9))] {
            let mean = weight(&mut tracker, &wearer, start);
            let expected = MASS_INDEX * f64::from(wearer.height).powi(2) * 9.81;
            assert!(
                (mean / expected - 1.0).abs() < 0.02,
                "{mean} N, not {expected} N"
            );
        }
    }
}
