//! Feet that stand stay where they are.
//!
//! The network says how likely each foot stands, yet its feet drift by some centimetres a second
//! meanwhile. While one stands, what it is predicted to drift is taken back, up to a few
//! centimetres; while it swings, the difference goes. So nothing jumps, whatever the network says.

use glam::Vec3;

use super::refine::Draft;

/// A foot is taken to stand from the first probability on, fully from the second.
const STANDS: [f32; 2] = [0.4, 0.8];
/// A standing foot gives way to the prediction in this time, seconds.
const KEEP_S: f32 = 1.0;
/// A swinging one is where it is predicted after about this time, seconds.
const LET_GO_S: f32 = 0.12;
/// Farthest from the prediction, metres.
const FAR: f32 = 0.08;
/// What moves farther between two ticks has not drifted, metres.
const JUMP: f32 = 0.25;

/// One foot.
#[derive(Debug, Clone, Copy, Default)]
struct Foot {
    /// Shown less predicted, level, metres.
    offset: Vec3,
    /// Ankle and toe joint as predicted a tick ago.
    last: Option<[Vec3; 2]>,
}

impl Foot {
    /// Takes the next prediction; `stands` are the probabilities of ankle and toes.
    fn update(&mut self, joints: [Vec3; 2], stands: [f32; 2], dt: f32) {
        let Some(last) = self.last.replace(joints) else {
            return;
        };
        // The likelier of heel and toes is the one that stands.
        let [ankle, toes] = stands.map(|p| p * p + 1e-6);
        let drift = ((joints[0] - last[0]) * ankle + (joints[1] - last[1]) * toes) / (ankle + toes);
        let drift = drift * Vec3::new(1.0, 0.0, 1.0);
        if !drift.is_finite() || drift.length() > JUMP {
            self.offset = Vec3::ZERO;
            return;
        }
        let [from, fully] = STANDS;
        let share = ((stands[0].max(stands[1]) - from) / (fully - from)).clamp(0.0, 1.0);
        let rate = (1.0 - share) / LET_GO_S + share / KEEP_S;
        let offset = (self.offset - drift * share) * (-rate * dt).exp();
        self.offset = offset.clamp_length_max(FAR);
    }
}

/// Both feet.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Feet([Foot; 2]);

impl Feet {
    /// Forgets where they stood.
    pub(super) fn reset(&mut self) {
        *self = Self::default();
    }

    /// Keeps the draft's standing feet in place. `contact` are the probabilities that the ankles
    /// (left, right) and toes (left, right) stand.
    pub(super) fn keep(&mut self, draft: &mut Draft<'_>, contact: [f32; 4], dt: f32) {
        for (side, foot) in self.0.iter_mut().enumerate() {
            let joints = draft.foot(side);
            foot.update(joints, [contact[side], contact[side + 2]], dt);
            if foot.offset.length_squared() > 1e-10 {
                draft.meet_ankle(side, joints[0] + foot.offset);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_standing_foot_drifts_less_and_lets_go_when_it_swings() {
        let mut foot = Foot::default();
        let dt = 1.0 / 60.0;
        let at = |x: f32| [Vec3::new(x, 0.1, 0.0), Vec3::new(x, 0.02, -0.15)];
        let mut shown = Vec::new();
        // Half a second of drifting at 6 cm/s, then a step of half a metre.
        for n in 0..60u8 {
            let n = f32::from(n);
            let (x, stands) = if n < 30.0 {
                (0.06 * n * dt, [0.95, 0.9])
            } else {
                (0.03 + (n - 30.0) * dt, [0.05, 0.02])
            };
            foot.update(at(x), stands, dt);
            shown.push(x + foot.offset.x);
        }
        assert!(shown[29] < 0.01, "it slid {} m", shown[29]);
        assert!((shown[59] - (0.03 + 29.0 * dt)).abs() < 0.003);
        let step = shown
            .windows(2)
            .map(|pair| pair[1] - pair[0])
            .fold(0.0, f32::max);
        assert!(step < 1.4 * dt, "it jumped by {step} m");
    }
}
