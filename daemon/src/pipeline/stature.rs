//! The wearer's height, from the first seconds upright.

use glam::Vec3;
use posed_signal::{HostTime, Pose, PoseHow, upright::Upright};
use posed_tracker::sensors::EYES_OVER_STATURE;

/// Heights outside are none of somebody who stands upright on the floor, metres.
const HEIGHT_M: std::ops::RangeInclusive<f32> = 1.5..=2.0;

/// Watches the headset, if it is to, until it knows the wearer's height.
#[derive(Debug, Clone, Copy, Default)]
pub struct Stature {
    is_wanted: bool,
    is_told: bool,
    upright: Upright,
    measured: Option<f32>,
}

impl Stature {
    /// Watches if `is_wanted`.
    #[must_use]
    pub fn new(is_wanted: bool) -> Self {
        Self {
            is_wanted,
            ..Self::default()
        }
    }

    /// Whether it was asked to watch.
    #[must_use]
    pub fn is_wanted(&self) -> bool {
        self.is_wanted
    }

    /// The height measured, metres, since the last reset or since somebody told it.
    #[must_use]
    pub fn measured(&self) -> Option<f32> {
        self.measured
    }

    /// Begins anew: it may be another wearer.
    pub fn reset(&mut self) {
        *self = Self::new(self.is_wanted);
    }

    /// Somebody has told the height: nothing is measured until the next reset.
    pub fn told(&mut self) {
        self.reset();
        self.is_told = true;
    }

    /// Takes the headset's newest pose. Answers the wearer's height once, when it is known. Whoever
    /// sits or kneels first is measured when they stand.
    pub fn watch(&mut self, now: HostTime, headset: Option<&Pose>) -> Option<f32> {
        if !self.is_wanted || self.is_told || self.measured.is_some() {
            return None;
        }
        let pose = headset.filter(|pose| pose.how == PoseHow::Optical)?;
        let lean = (pose.rotation * Vec3::Y).angle_between(Vec3::Y);
        let rate = pose.angular_velocity.length();
        let eyes = self.upright.watch(
            now.0 as f64 * 1e-9,
            pose.position.y.into(),
            lean.into(),
            rate.into(),
        )?;
        // To the centimetre, as people say it.
        let height = (100.0 * eyes as f32 / EYES_OVER_STATURE).round() / 100.0;
        self.upright = Upright::default();
        if !HEIGHT_M.contains(&height) {
            return None;
        }
        self.measured = Some(height);
        self.measured
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ten seconds with the eyes so high.
    fn stand(stature: &mut Stature, start: u64, eyes: f32) -> Option<f32> {
        let mut told = (0..900u64).filter_map(|tick| {
            let at = HostTime(start + tick * 11_111_111);
            let mut pose = Pose::unknown(at);
            pose.position = Vec3::new(0.1, eyes, 0.2);
            pose.angular_velocity = Vec3::Y * 0.1;
            pose.how = PoseHow::Optical;
            stature.watch(at, Some(&pose))
        });
        let first = told.next();
        assert_eq!(told.next(), None, "it is told once");
        first
    }

    #[test]
    fn who_sits_first_is_measured_when_they_stand() {
        let mut stature = Stature::new(true);
        assert_eq!(stand(&mut stature, 0, 1.15), None);
        let eyes = EYES_OVER_STATURE * 1.82;
        assert_eq!(stand(&mut stature, 10_000_000_000, eyes), Some(1.82));
        assert_eq!(stature.measured(), Some(1.82));
        stature.told();
        assert_eq!(stand(&mut stature, 20_000_000_000, eyes), None);
        stature.reset();
        assert_eq!(stand(&mut stature, 30_000_000_000, eyes), Some(1.82));
        assert_eq!(stand(&mut Stature::new(false), 0, eyes), None);
    }
}
