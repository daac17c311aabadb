//! Pelvis, spine and neck below a known head.
//!
//! Only directions are guessed; the pelvis then follows from the bones, so that the head joint is
//! met exactly. The guesses are least-squares fits to the training clips of the CMU, SNU and FuBOT
//! motion sets, symmetric in left and right; errors there (r.m.s., each set predicted from the
//! others): pelvis pitch 7, chest pitch 9, rolls 4 and 6, pelvis yaw 18, chest yaw 15 degrees.

use glam::{Quat, Vec3};
use posed_body::{Joint, Skeleton};

use crate::{
    fade::Place,
    geometry::{direction, gain, wrap, yaw_confidence, yaw_of},
};

/// Yaw of the body against the head, radians for each head height by which both hands together
/// are to the right, and the left hand is behind the right one.
const YAW_BY_HANDS_RIGHT: f32 = -0.7;
const YAW_BY_LEFT_BEHIND: f32 = 1.4;
/// The body never turns farther than this from the head, radians.
const YAW_MAX: f32 = 1.0;
/// Time constants with which chest and pelvis follow in yaw, seconds.
const CHEST_YAW_S: f32 = 0.15;
const PELVIS_YAW_S: f32 = 0.25;
/// Time constant of the leans, seconds.
const LEAN_S: f32 = 0.1;
/// Limits of a lean, radians: backward, forward (negative), to a side.
const PITCH_RANGE: (f32, f32) = (-1.9, 0.5);
const ROLL_MAX: f32 = 0.8;
/// Least height of the pelvis over head height: lying down.
const PELVIS_LOW: f32 = 0.07;

/// What the body is guessed from, in the head's heading frame; lengths over head height.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Cues {
    /// Wrists from the head joint, left and right.
    pub hands: [Vec3; 2],
    /// The head joint from the middle between the feet, in the *chest's* heading frame.
    pub over_feet: Vec3,
    /// Height of the head over its height when standing, less 1.
    pub raised: f32,
}

/// Leans of one part, radians: about +X (negative is forward) and about +Z (negative is right).
#[derive(Debug, Clone, Copy, PartialEq)]
struct Lean {
    pitch: f32,
    roll: f32,
}

impl Lean {
    const UPRIGHT: Self = Self {
        pitch: 0.0,
        roll: 0.0,
    };

    fn limited(pitch: f32, roll: f32) -> Self {
        Self {
            pitch: pitch.clamp(PITCH_RANGE.0, PITCH_RANGE.1),
            roll: roll.clamp(-ROLL_MAX, ROLL_MAX),
        }
    }

    fn follow(&mut self, goal: Self, share: f32) {
        self.pitch += (goal.pitch - self.pitch) * share;
        self.roll += (goal.roll - self.roll) * share;
    }

    fn with_yaw(self, yaw: f32) -> Quat {
        let tilt = Vec3::new(self.pitch, 0.0, self.roll);
        Quat::from_rotation_y(yaw) * Quat::from_scaled_axis(tilt)
    }
}

/// The torso's state over ticks.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Torso {
    chest_yaw: f32,
    pelvis_yaw: f32,
    head_yaw: f32,
    chest: Lean,
    pelvis: Lean,
    started: bool,
}

/// Rotations to the world, and where they put the pelvis.
#[derive(Debug, Clone, Copy)]
pub(crate) struct TorsoPose {
    pub root: Vec3,
    pub pelvis: Quat,
    pub spine: [Quat; 3],
    pub neck: Quat,
}

impl Torso {
    pub(crate) const NEW: Self = Self {
        chest_yaw: 0.0,
        pelvis_yaw: 0.0,
        head_yaw: 0.0,
        chest: Lean::UPRIGHT,
        pelvis: Lean::UPRIGHT,
        started: false,
    };

    /// Headings of pelvis and chest, radians about +Y.
    pub(crate) fn pelvis_yaw(&self) -> f32 {
        self.pelvis_yaw
    }

    /// See [`Torso::pelvis_yaw`].
    pub(crate) fn chest_yaw(&self) -> f32 {
        self.chest_yaw
    }

    /// The head's heading; the last one while the head is upside down and has none.
    pub(crate) fn head_yaw(&mut self, head: Quat) -> f32 {
        let turn = wrap(yaw_of(head) - self.head_yaw);
        let trust = (4.0 * yaw_confidence(head)).min(1.0);
        let share = if self.started { trust } else { 1.0 };
        self.head_yaw = wrap(self.head_yaw + turn * share);
        self.head_yaw
    }

    /// Moves on by `dt` seconds.
    pub(crate) fn update(
        &mut self,
        head: &Place,
        cues: &Cues,
        skeleton: &Skeleton,
        dt: f32,
    ) -> TorsoPose {
        self.follow_yaw(cues, dt);
        let back = Quat::from_rotation_y(-self.chest_yaw);
        let tilt = near_identity(back * head.rotation).to_scaled_axis();
        let (pelvis, chest) = guess_leans(tilt, cues);
        let share = if self.started { gain(dt, LEAN_S) } else { 1.0 };
        self.pelvis.follow(pelvis, share);
        self.chest.follow(chest, share);
        self.started = true;
        let pelvis = self.pelvis.with_yaw(self.pelvis_yaw);
        let chest = self.chest.with_yaw(self.chest_yaw);
        let mut pose = TorsoPose {
            root: head.position,
            pelvis,
            spine: [
                pelvis.slerp(chest, 1.0 / 3.0),
                pelvis.slerp(chest, 2.0 / 3.0),
                chest,
            ],
            neck: chest.slerp(head.rotation, 0.5),
        };
        pose.hang_from(head.position, skeleton);
        pose.fit_height(head.position, skeleton, self.pelvis_yaw);
        pose
    }

    fn follow_yaw(&mut self, cues: &Cues, dt: f32) {
        let [left, right] = cues.hands;
        let guess =
            YAW_BY_HANDS_RIGHT * (left.x + right.x) + YAW_BY_LEFT_BEHIND * (left.z - right.z);
        let goal = self.head_yaw + guess.clamp(-YAW_MAX, YAW_MAX);
        let follow = |yaw: f32, tau| {
            let share = if self.started { gain(dt, tau) } else { 1.0 };
            wrap(yaw + wrap(goal - yaw) * share)
        };
        (self.chest_yaw, self.pelvis_yaw) = (
            follow(self.chest_yaw, CHEST_YAW_S),
            follow(self.pelvis_yaw, PELVIS_YAW_S),
        );
    }
}

/// Leans of pelvis and chest: squat and bow are told apart by how far the head is out over the
/// feet.
fn guess_leans(head_tilt: Vec3, cues: &Cues) -> (Lean, Lean) {
    let raised = cues.raised.clamp(-0.9, 0.05);
    let forward = (-cues.over_feet.z).clamp(-0.5, 0.6);
    let right = cues.over_feet.x.clamp(-0.5, 0.5);
    let pitch = head_tilt.x.clamp(-1.5, 1.0);
    let left_higher = (cues.hands[0].y - cues.hands[1].y).clamp(-0.6, 0.6);
    let pelvis = Lean::limited(0.22 * raised - 1.26 * forward, -0.64 * right);
    let chest = Lean::limited(
        0.31 * pitch + 0.41 * raised - 1.01 * forward,
        -right - 0.33 * left_higher,
    );
    (pelvis, chest)
}

impl TorsoPose {
    /// Puts the pelvis where the bones below the head joint lead.
    fn hang_from(&mut self, head: Vec3, skeleton: &Skeleton) {
        let bone = |joint: Joint| skeleton.offsets[joint as usize];
        self.root = head
            - self.neck * bone(Joint::Head)
            - self.spine[2] * bone(Joint::Neck)
            - self.spine[1] * bone(Joint::Spine3)
            - self.spine[0] * bone(Joint::Spine2)
            - self.pelvis * bone(Joint::Spine1);
    }

    /// Where the chest joint (spine3) is.
    pub(crate) fn chest_at(&self, skeleton: &Skeleton) -> Vec3 {
        let bone = |joint: Joint| skeleton.offsets[joint as usize];
        self.root
            + self.pelvis * bone(Joint::Spine1)
            + self.spine[0] * bone(Joint::Spine2)
            + self.spine[1] * bone(Joint::Spine3)
    }

    /// Turns the torso about the head joint until the pelvis is neither higher than the legs
    /// reach nor in the floor.
    fn fit_height(&mut self, head: Vec3, skeleton: &Skeleton, yaw: f32) {
        let high = standing_pelvis(skeleton);
        let low = PELVIS_LOW * skeleton.head_height();
        let goal = self.root.y.max(low).min(high);
        let chain = self.root - head;
        let length = chain.length();
        if goal == self.root.y || length < 1e-3 {
            return;
        }
        let down = (goal - head.y).clamp(-length, length);
        let backward = Quat::from_rotation_y(yaw) * Vec3::Z;
        let level = Vec3::new(chain.x, 0.0, chain.z) + backward * (0.02 * length);
        let level = direction(level, backward);
        let wanted = level * (length * length - down * down).max(0.0).sqrt() + Vec3::Y * down;
        let turn = Quat::from_rotation_arc(chain / length, direction(wanted, Vec3::NEG_Y));
        self.pelvis = (turn * self.pelvis).normalize();
        self.spine = self.spine.map(|rotation| (turn * rotation).normalize());
        self.neck = (turn * self.neck).normalize();
        self.hang_from(head, skeleton);
    }
}

/// Height of the pelvis above the floor when standing with straight legs.
fn standing_pelvis(skeleton: &Skeleton) -> f32 {
    let bone = |joint: Joint| skeleton.offsets[joint as usize].y;
    let leg = bone(Joint::LeftHip) + bone(Joint::LeftKnee) + bone(Joint::LeftAnkle);
    super::toe_height(skeleton) - leg - bone(Joint::LeftFoot)
}

/// The same rotation with the quaternion of the lesser turn from the identity.
fn near_identity(rotation: Quat) -> Quat {
    if rotation.w < 0.0 {
        -rotation
    } else {
        rotation
    }
}
