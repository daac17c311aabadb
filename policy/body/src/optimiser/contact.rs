//! Where the body meets the ground: contact probabilities, contact points and how well each can
//! carry a force.

use glam::{DMat3, DVec3};

use super::dynamics::Frames;
use super::tree::Tree;
use crate::character::{FOOT_OVER_STATURE, HEEL_BEHIND_ANKLE, Sole};
use crate::scene::Ground;
use crate::skeleton::{Joint, Skeleton};

/// Ankle and toe joint of each foot.
pub(super) const FEET: [(Joint, Joint); 2] = [
    (Joint::LeftAnkle, Joint::LeftFoot),
    (Joint::RightAnkle, Joint::RightFoot),
];

/// Joints other than the feet that may rest on the ground (PIP leaves out wrists and clavicles;
/// here hands carry weight too, as a VR user's do), and the flesh around each, over stature.
pub(super) const SITES: [(Joint, f64); 9] = [
    (Joint::Pelvis, 0.06),
    (Joint::LeftKnee, 0.03),
    (Joint::RightKnee, 0.03),
    (Joint::Spine3, 0.06),
    (Joint::Head, 0.05),
    (Joint::LeftElbow, 0.025),
    (Joint::RightElbow, 0.025),
    (Joint::LeftWrist, 0.02),
    (Joint::RightWrist, 0.02),
];
/// A site higher than this above the ground is left out, metres.
const SITE_REACH: f64 = 0.12;

/// Points under one foot: two under the heel, two under the toes.
pub(super) const FOOT_POINTS: usize = 4;
/// Most contact points at once.
pub(super) const POINTS_MAX: usize = 2 * FOOT_POINTS + SITES.len();

/// A toe joint that moves slower than the first speed can be in contact, one faster than the
/// second cannot; m/s.
const SPEEDS: [f64; 2] = [0.6, 1.4];
/// A toe joint slower than this shows how high it stands, m/s.
const STILL: f64 = 0.15;
/// The same as for speeds for its height above where it is when the foot stands, metres.
const HEIGHTS: [f64; 2] = [0.03, 0.08];
/// How fast a contact probability may rise, per second: a foot that stops for a moment on its
/// way is not standing.
const RISE: f64 = 40.0;
/// Height of the toe joint above the sole never taken to be more than this, metres.
const CLEARANCE_MAX: f64 = 0.12;

/// A point where the ground can push.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// The joint whose link it lies on.
    pub joint: usize,
    /// Where it is, metres.
    pub place: DVec3,
    /// Columns: tangent, normal, tangent of the ground below.
    pub ground: DMat3,
    /// Weight of the squared force at the point, over that of the squared residual force.
    pub reluctance: f64,
    /// The foot it belongs to, if any.
    pub foot: Option<u8>,
}

impl Default for Point {
    fn default() -> Self {
        Self {
            joint: 0,
            place: DVec3::ZERO,
            ground: DMat3::IDENTITY,
            reluctance: 1.0,
            foot: None,
        }
    }
}

/// Axes of the ground: tangent, normal, tangent.
pub(super) fn ground_axes(normal: DVec3) -> DMat3 {
    let first = normal.cross(DVec3::Z).normalize_or(DVec3::X);
    DMat3::from_cols(first, normal, first.cross(normal))
}

/// Heights of the toe joints above the ground.
fn heights(frames: &Frames, ground: &Ground) -> [f64; 2] {
    FEET.map(|(_, toe)| {
        let place = frames.positions[toe as usize];
        place.y - ground.at(place.x, place.z).height
    })
}

/// What is known of the feet from tick to tick.
#[derive(Debug, Clone)]
pub struct Feet {
    /// Probability that each stands.
    pub probabilities: [f64; 2],
    /// Height of the toe joint above the ground when the foot stands, metres.
    clearance: f64,
    default_clearance: f64,
    /// The toe joint from the ankle joint in the rest pose.
    toes: [DVec3; 2],
    heel: f64,
    half_width: f64,
}

/// One up to `full`, zero from `none` on, smooth between.
pub(super) fn ramp(value: f64, [full, none]: [f64; 2]) -> f64 {
    let t = ((none - value) / (none - full)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

impl Feet {
    /// The feet of a person.
    #[must_use]
    pub fn new(skeleton: &Skeleton) -> Self {
        let stature = f64::from(skeleton.stature());
        let toes = FEET.map(|(_, toe)| skeleton.offsets[toe as usize].as_dvec3());
        let sole = Sole::new(stature, toes[0]);
        let clearance = (toes[0].y - sole.y).clamp(0.0, CLEARANCE_MAX);
        Self {
            probabilities: [0.0; 2],
            clearance,
            default_clearance: clearance,
            toes,
            heel: HEEL_BEHIND_ANKLE * FOOT_OVER_STATURE * stature,
            half_width: 0.8 * sole.half_width,
        }
    }

    /// Forgets the past.
    pub fn reset(&mut self) {
        self.probabilities = [0.0; 2];
        self.clearance = self.default_clearance;
    }

    /// Height of the toe joint above the ground when a foot stands, as learnt so far; metres.
    #[must_use]
    pub fn clearance(&self) -> f64 {
        self.clearance
    }

    /// Takes the first pose, at rest: if a foot is near the ground, it stands.
    pub(super) fn begin(&mut self, reference: &Frames, ground: &Ground) {
        let lower = heights(reference, ground)
            .into_iter()
            .fold(f64::INFINITY, f64::min);
        if lower < CLEARANCE_MAX {
            self.clearance = lower.max(0.0);
        }
        self.probabilities = [1.0; 2];
        self.update(None, reference, ground, 0.0);
    }

    /// Takes the tracker's contact probabilities or, where it has none, works them out from how
    /// high and how fast the toe joints of the reference are.
    pub(super) fn update(
        &mut self,
        given: Option<[f32; 2]>,
        reference: &Frames,
        ground: &Ground,
        tick: f64,
    ) {
        let heights = heights(reference, ground);
        let speeds = FEET.map(|(_, toe)| reference.velocities[toe as usize].length());
        self.learn_clearance(heights, speeds, tick);
        for foot in 0..2 {
            let seen = match given {
                Some(given) if given[foot].is_finite() => f64::from(given[foot]).clamp(0.0, 1.0),
                Some(_) => 0.0,
                None => ramp(heights[foot] - self.clearance, HEIGHTS) * ramp(speeds[foot], SPEEDS),
            };
            let limit = self.probabilities[foot] + RISE * tick;
            self.probabilities[foot] = seen.min(limit);
        }
    }

    /// The lower of two slow feet stands: its height is the clearance. Rigs put the toe joint
    /// anywhere between the sole and 8 cm above it, so it is learnt: quickly downwards, slowly
    /// upwards.
    fn learn_clearance(&mut self, heights: [f64; 2], speeds: [f64; 2], tick: f64) {
        let lower = usize::from(heights[1] < heights[0]);
        if speeds[lower] > STILL {
            return;
        }
        let height = heights[lower].clamp(0.0, CLEARANCE_MAX);
        let time = if height < self.clearance { 0.1 } else { 1.0 };
        self.clearance += (height - self.clearance) * (tick / time).min(1.0);
    }

    /// Lists the points where the ground can push; their number.
    pub(super) fn points(
        &self,
        frames: &Frames,
        tree: &Tree,
        ground: &Ground,
        points: &mut [Point; POINTS_MAX],
    ) -> usize {
        let mut count = 0;
        for (foot, (ankle, toe)) in FEET.into_iter().enumerate() {
            let sole = self.toes[foot].y - self.clearance;
            let w = self.half_width;
            let under = [
                (ankle, DVec3::new(-0.6 * w, sole, self.heel)),
                (ankle, DVec3::new(0.6 * w, sole, self.heel)),
                (toe, DVec3::new(-w, -self.clearance, -0.15 * self.heel)),
                (toe, DVec3::new(w, -self.clearance, -0.15 * self.heel)),
            ];
            for (joint, offset) in under {
                let place = frames.place(joint as usize, offset);
                let surface = ground.at(place.x, place.z);
                let height = place.y - surface.height;
                points[count] = Point {
                    joint: joint as usize,
                    place,
                    ground: ground_axes(surface.normal),
                    reluctance: reluctance(height, self.probabilities[foot]),
                    foot: Some(foot as u8),
                };
                count += 1;
            }
        }
        for (joint, flesh) in SITES {
            let place = frames.positions[joint as usize];
            let surface = ground.at(place.x, place.z);
            let height = place.y - surface.height - flesh * tree.stature;
            if height < SITE_REACH {
                points[count] = Point {
                    joint: joint as usize,
                    place: place - surface.normal * (flesh * tree.stature),
                    ground: ground_axes(surface.normal),
                    reluctance: reluctance(height, 1.0),
                    foot: None,
                };
                count += 1;
            }
        }
        count
    }
}

/// How unwilling the ground is to push at a point: next to nothing where a standing foot
/// touches, a hundred times the weight of a residual force 10 cm higher. Smooth in both, so that
/// forces come and go without a jump. PIP's term (10 max(d, 0.005))² in one more degree.
fn reluctance(height: f64, probability: f64) -> f64 {
    let high = (height.max(0.0) / 0.01).powi(4);
    let loose = ((1.0 - probability) / 0.35).powi(4);
    0.01 * (1.0 + high + loose)
}
