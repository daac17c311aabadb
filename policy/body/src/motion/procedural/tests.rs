//! The made-up person moves as a person does.

use glam::{DVec3, Vec3};
use proptest::prelude::*;

use super::*;
use crate::motion::Trajectory;
use crate::skeleton::{BodyPose, Joint};

const FEET: [Joint; 2] = [Joint::LeftFoot, Joint::RightFoot];

#[test]
fn it_lasts_about_forty_seconds_and_repeats_by_seed() {
    let clip = timeline(1.75, 1);
    assert!(
        (35.0..50.0).contains(&clip.duration()),
        "{} s",
        clip.duration()
    );
    assert!(clip.frames.iter().all(BodyPose::is_sound));
    assert_eq!(clip, timeline(1.75, 1));
    assert_ne!(clip.frames, timeline(1.75, 2).frames);
    assert!(timeline(f32::NAN, 1).frames.iter().all(BodyPose::is_sound));
}

#[test]
fn the_head_squats_turns_and_goes_about() {
    let clip = timeline(1.75, 1);
    let heads: Vec<_> = clip
        .frames
        .iter()
        .map(|f| clip.skeleton.forward(f))
        .collect();
    let extent = |of: fn(Vec3) -> f32| {
        let values = heads.iter().map(|joints| of(joints.position(Joint::Head)));
        values.fold((f32::MAX, f32::MIN), |(low, high), v| {
            (low.min(v), high.max(v))
        })
    };
    let (low, high) = extent(|p| p.y);
    assert!(
        (1.40..1.50).contains(&high),
        "standing head joint at {high} m"
    );
    assert!(low < high - 0.35, "squats down to {low} m");
    for of in [|p: Vec3| p.x, |p: Vec3| p.z] {
        let (low, high) = extent(of);
        assert!(
            high - low > 1.0 && low > -1.6 && high < 1.6,
            "{low} to {high}"
        );
    }
    let backwards = heads
        .iter()
        .any(|joints| (joints.rotation(Joint::Head) * Vec3::NEG_Z).z > 0.9);
    assert!(backwards, "turns all the way round");
    let raised = |wrist| {
        heads
            .iter()
            .any(|joints| joints.position(wrist).y > joints.position(Joint::Head).y)
    };
    assert!(raised(Joint::LeftWrist) && raised(Joint::RightWrist));
}

/// Checks one person's feet and limbs; the share of frames in which each foot stands.
fn check(height: f32, seed: u64) -> [f64; 2] {
    let clip = timeline(height, seed);
    let trajectory = Trajectory::new(&clip);
    let floor = 0.0143 * f64::from(height);
    let mut standing = [0.0; 2];
    // Where each foot that stands came down.
    let mut prints = [None::<DVec3>; 2];
    for index in 0..clip.frames.len() {
        let t = index as f64 / clip.fps;
        let feet = FEET.map(|foot| trajectory.joint(foot, t).position);
        for (side, foot) in feet.into_iter().enumerate() {
            assert!(foot.y > floor - 1e-4, "a foot in the floor at {t}");
            if foot.y > floor + 5e-4 {
                prints[side] = None;
                continue;
            }
            standing[side] += 1.0 / clip.frames.len() as f64;
            let slid = foot.distance(*prints[side].get_or_insert(foot));
            assert!(slid < 0.005, "foot {side} slides by {slid} m at {t}");
        }
        let lowest = feet[0].y.min(feet[1].y);
        assert!(lowest < floor + 5e-4, "in the air at {t}: {lowest}");
        for joint in Joint::ALL {
            let motion = trajectory.joint(joint, t);
            let (a, w) = (
                motion.acceleration.length(),
                motion.angular_velocity.length(),
            );
            assert!(
                a < 45.0 && w < 12.0,
                "{joint:?}: {a} m/s^2, {w} rad/s at {t}"
            );
        }
        let head = trajectory.joint(Joint::Head, t).acceleration.length();
        assert!(head < 10.0, "head: {head} m/s^2 at {t}");
    }
    standing
}

#[test]
fn feet_stand_while_they_bear_weight() {
    for share in check(1.75, 1) {
        assert!((0.5..0.95).contains(&share), "{share}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]
    #[test]
    fn so_does_anybody(height in 1.2f32..2.1, seed in any::<u64>()) {
        check(height, seed);
    }
}
