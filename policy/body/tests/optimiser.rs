//! The optimiser on standing, falling and walking people.

mod qp_oracle;

use glam::{Quat, Vec3};
use posed_body::motion::procedural;
use posed_body::optimiser::{Optimiser, Outcome, Reference, Settings, Solved};
use posed_body::qp::{Solver, Status};
use posed_body::scene::Ground;
use posed_body::{BodyPose, JOINTS, Joint, Skeleton};
use qp_oracle::{Verdict, judge};

const TICK: f64 = 1.0 / 60.0;
const MASS: f64 = 72.0;
const WEIGHT: f32 = 72.0 * 9.81;

fn optimiser(skeleton: &Skeleton) -> Optimiser {
    Optimiser::new(skeleton, MASS, TICK, Settings::default())
}

fn reference(pose: &BodyPose) -> Reference<'_> {
    Reference {
        pose,
        velocities: None,
        contacts: None,
    }
}

/// Numbers of a normal distribution, the same for every run.
struct Noise(u64);

impl Noise {
    fn uniform(&mut self) -> f32 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (self.0 >> 40) as f32 / (1_u64 << 24) as f32
    }

    fn normal(&mut self) -> f32 {
        (0..12).map(|_| self.uniform()).sum::<f32>() - 6.0
    }

    fn vector(&mut self, deviation: f32) -> Vec3 {
        Vec3::new(self.normal(), self.normal(), self.normal()) * deviation
    }

    /// White noise on the pelvis's position and every rotation.
    fn disturb(&mut self, pose: &BodyPose, metres: f32, degrees: f32) -> BodyPose {
        let mut noisy = *pose;
        noisy.root += self.vector(metres);
        for rotation in &mut noisy.rotations {
            let turn = Quat::from_scaled_axis(self.vector(degrees.to_radians()));
            *rotation = (*rotation * turn).normalize();
        }
        noisy
    }
}

/// Somebody who stands with lowered arms, knees a little bent, toe joints `clearance` metres
/// above the ground.
fn standing(skeleton: &Skeleton, clearance: f32) -> BodyPose {
    let mut pose = BodyPose::rest(Vec3::ZERO);
    for (joint, turn) in [
        (Joint::LeftShoulder, Quat::from_rotation_z(1.3)),
        (Joint::RightShoulder, Quat::from_rotation_z(-1.3)),
        (Joint::LeftHip, Quat::from_rotation_x(0.15)),
        (Joint::RightHip, Quat::from_rotation_x(0.15)),
        (Joint::LeftKnee, Quat::from_rotation_x(-0.25)),
        (Joint::RightKnee, Quat::from_rotation_x(-0.25)),
        (Joint::LeftAnkle, Quat::from_rotation_x(0.1)),
        (Joint::RightAnkle, Quat::from_rotation_x(0.1)),
    ] {
        pose.rotations[joint as usize] = turn;
    }
    pose.root.y = clearance - skeleton.forward(&pose).position(Joint::LeftFoot).y;
    pose
}

#[test]
fn standing_still_for_a_minute() {
    let skeleton = Skeleton::of_height(1.75);
    for clearance in [0.0, 0.035, 0.08] {
        let pose = standing(&skeleton, clearance);
        let mut optimiser = optimiser(&skeleton);
        let mut settled = None;
        for tick in 0..3600 {
            let solved = optimiser.step(&reference(&pose), &Ground::Flat);
            let joints = skeleton.forward(&solved.pose);
            let lowest = joints
                .positions
                .iter()
                .map(|p| p.y)
                .fold(f32::INFINITY, f32::min);
            assert!(lowest > -1e-3, "tick {tick}: {lowest}");
            let drift = joints.position(Joint::Pelvis).distance(pose.root);
            assert!(drift < 5e-3, "tick {tick}: {drift}");
            if tick >= 60 {
                assert_eq!(solved.outcome, Outcome::Full);
                let share = solved.ground_force.y / WEIGHT;
                assert!((share - 1.0).abs() < 0.02, "tick {tick}: {share}");
                let settled = *settled.get_or_insert(joints);
                let moved = settled
                    .position(Joint::Head)
                    .distance(joints.position(Joint::Head));
                assert!(moved < 1e-3, "tick {tick}: {moved}");
            }
        }
    }
}

#[test]
fn forces_torques_and_the_zero_moment_point_agree() {
    let skeleton = Skeleton::of_height(1.75);
    let pose = standing(&skeleton, 0.035);
    let mut optimiser = optimiser(&skeleton);
    let mut solved = optimiser.step(&reference(&pose), &Ground::Flat);
    assert_eq!(solved.outcome, Outcome::Kinematic);
    for _ in 0..120 {
        solved = optimiser.step(&reference(&pose), &Ground::Flat);
    }
    let feet = solved.feet;
    assert!(
        (feet[0].force.y - feet[1].force.y).abs() < 0.01 * WEIGHT,
        "an even stance"
    );
    // Both feet push inwards or outwards alike; nothing is left over sideways.
    assert!(solved.ground_force.x.abs() < 1.0, "{}", solved.ground_force);
    let pressure = (feet[0].centre * feet[0].force.y + feet[1].centre * feet[1].force.y)
        / (feet[0].force.y + feet[1].force.y);
    let point = solved.zero_moment_point.expect("carried by the ground");
    assert!(
        pressure.distance(point) < 0.02,
        "{pressure} against {point}"
    );
    // The knees carry about the same, and nothing outlandish.
    let knees = [Joint::LeftKnee, Joint::RightKnee].map(|knee| solved.torques[knee as usize]);
    assert!(
        (knees[0].x - knees[1].x).abs() < 1.0 && knees[0].length() < 150.0,
        "{knees:?}"
    );
}

#[test]
fn a_body_in_the_air_falls_freely() {
    let skeleton = Skeleton::of_height(1.75);
    let mut pose = standing(&skeleton, 0.035);
    let mut optimiser = optimiser(&skeleton);
    let start = pose.root.y + 3.0;
    let mut last = None;
    for tick in 0..30 {
        let time = tick as f32 / 60.0;
        pose.root.y = start - 0.5 * 9.81 * time * time;
        last = Some(optimiser.step(&reference(&pose), &Ground::Flat));
    }
    let last: Solved = last.expect("thirty ticks");
    assert!(
        last.ground_force.length() < 0.02 * WEIGHT,
        "{}",
        last.ground_force
    );
    assert!(last.residual.length() < 0.05 * WEIGHT, "{}", last.residual);
    assert_eq!(last.zero_moment_point, None);
}

#[test]
fn noise_is_taken_out_and_the_motion_is_kept() {
    let clip = procedural::timeline(1.75, 5).resampled(60.0);
    let frames = &clip.frames[..1800.min(clip.frames.len())];
    let mut noise = Noise(17);
    let mut clean = optimiser(&clip.skeleton);
    let mut noisy = optimiser(&clip.skeleton);
    let (mut truth, mut followed, mut disturbed, mut smoothed) = (vec![], vec![], vec![], vec![]);
    for pose in frames {
        let bad = noise.disturb(pose, 0.02, 3.0);
        truth.push(clip.skeleton.forward(pose).positions);
        disturbed.push(clip.skeleton.forward(&bad).positions);
        let solved = clean.step(&reference(pose), &Ground::Flat);
        followed.push(clip.skeleton.forward(&solved.pose).positions);
        let solved = noisy.step(&reference(&bad), &Ground::Flat);
        smoothed.push(clip.skeleton.forward(&solved.pose).positions);
    }
    assert!(aligned_error(&followed, &truth) < 0.01);
    assert!(jitter(&followed) < jitter(&truth) + 0.05);
    assert!(jitter(&smoothed) < jitter(&disturbed) / 5.0);
    assert!(aligned_error(&smoothed, &truth) < aligned_error(&disturbed, &truth) + 0.005);
    let lowest = followed
        .iter()
        .flatten()
        .map(|p| p.y)
        .fold(f32::INFINITY, f32::min);
    assert!(lowest > -0.005, "{lowest}");
}

/// Mean distance of the joints with the pelvises brought together, metres.
fn aligned_error(a: &[[Vec3; JOINTS]], b: &[[Vec3; JOINTS]]) -> f32 {
    let apart = a.iter().zip(b).flat_map(|(a, b)| {
        let shift = b[0] - a[0];
        (0..JOINTS).map(move |joint| (a[joint] + shift).distance(b[joint]))
    });
    apart.sum::<f32>() / (a.len() * JOINTS) as f32
}

/// Mean jerk of the joints, km/s³ at 60 frames a second.
fn jitter(frames: &[[Vec3; JOINTS]]) -> f32 {
    let third = frames.windows(4).flat_map(|w| {
        (0..JOINTS).map(|joint| {
            (w[3][joint] - 3.0 * w[2][joint] + 3.0 * w[1][joint] - w[0][joint]).length()
        })
    });
    third.sum::<f32>() * 216.0 / ((frames.len() - 3) * JOINTS) as f32
}

#[test]
fn solutions_are_clarabels() {
    let clip = procedural::timeline(1.75, 9).resampled(60.0);
    let mut optimiser = optimiser(&clip.skeleton);
    let mut noise = Noise(3);
    for (tick, pose) in clip.frames.iter().take(1200).enumerate() {
        let noisy = noise.disturb(pose, 0.01, 2.0);
        let solved = optimiser.step(&reference(&noisy), &Ground::Flat);
        if tick % 60 != 30 || solved.outcome != Outcome::Full {
            continue;
        }
        let problem = optimiser.problem();
        let mut solver = Solver::new(problem.unknowns(), problem.constraints());
        assert_eq!(solver.solve(problem, &[]), Status::Solved);
        let Verdict::Minimum(theirs) = judge(problem) else {
            continue;
        };
        let ours = problem.objective(solver.x());
        let apart = (ours - theirs).abs() / theirs.abs();
        assert!(apart < 1e-6, "tick {tick}: {ours} against {theirs}");
    }
}

#[test]
fn unsound_and_jumping_references_are_survived() {
    let skeleton = Skeleton::of_height(1.75);
    let mut pose = standing(&skeleton, 0.035);
    let mut optimiser = optimiser(&skeleton);
    for _ in 0..10 {
        optimiser.step(&reference(&pose), &Ground::Flat);
    }
    let before = optimiser.step(&reference(&pose), &Ground::Flat).pose;
    let mut bad = pose;
    bad.rotations[4] = Quat::from_xyzw(f32::NAN, 0.0, 0.0, 1.0);
    let held = optimiser.step(&reference(&bad), &Ground::Flat);
    assert_eq!((held.outcome, held.pose), (Outcome::Held, before));
    let still = [Vec3::NAN; JOINTS];
    let unsound = Reference {
        pose: &pose,
        velocities: Some(&still),
        contacts: None,
    };
    assert_eq!(
        optimiser.step(&unsound, &Ground::Flat).outcome,
        Outcome::Held
    );
    pose.root.x += 3.0;
    let jumped = optimiser.step(&reference(&pose), &Ground::Flat);
    assert_eq!(jumped.outcome, Outcome::Kinematic);
    assert!(jumped.pose.root.distance(pose.root) < 1e-3);
    // Half a metre under the floor: the tracker's floor is wrong.
    pose.root = Vec3::new(-3.0, pose.root.y - 0.5, 0.0);
    for _ in 0..100 {
        let solved = optimiser.step(&reference(&pose), &Ground::Flat);
        let joints = skeleton.forward(&solved.pose);
        assert!(joints.positions.iter().all(|p| p.y > -1e-3));
    }
}

#[test]
fn velocities_alone_carry_the_body_along() {
    let skeleton = Skeleton::of_height(1.75);
    let mut pose = standing(&skeleton, 0.035);
    let mut optimiser = optimiser(&skeleton);
    let start = pose.root;
    let velocity = [Vec3::new(0.0, 0.0, -0.5); JOINTS];
    for _ in 0..60 {
        let moving = Reference {
            pose: &pose,
            velocities: Some(&velocity),
            contacts: Some([0.0; 2]),
        };
        optimiser.step(&moving, &Ground::Flat);
        // Such a tracker knows nothing of where the root is.
        pose.root = Vec3::ZERO;
    }
    let moving = Reference {
        pose: &pose,
        velocities: Some(&velocity),
        contacts: Some([0.0; 2]),
    };
    let travelled = optimiser.step(&moving, &Ground::Flat).pose.root - start;
    assert!((travelled.z + 0.5).abs() < 0.05, "{travelled}");
}

#[test]
fn standing_feet_stay_where_the_reference_slides() {
    let skeleton = Skeleton::of_height(1.75);
    let mut pose = standing(&skeleton, 0.035);
    let mut optimiser = optimiser(&skeleton);
    let toe = |pose: &BodyPose| skeleton.forward(pose).position(Joint::LeftFoot);
    let mut path = Vec::new();
    for tick in 0..90 {
        if (30..60).contains(&tick) {
            pose.root.z -= 0.08 / 60.0;
        }
        let solved = optimiser.step(&reference(&pose), &Ground::Flat);
        path.push((toe(&solved.pose), solved.pose.root));
    }
    let (moved, followed) = (path[89].0 - path[29].0, path[89].1 - path[29].1);
    assert!(moved.length() < 0.005, "{moved}");
    assert!((followed.z + 0.04).abs() < 0.01, "{followed}");
    // Further than the leash they go along in the end.
    for _ in 0..180 {
        pose.root.z -= 0.1 / 60.0;
        path.push((
            toe(&optimiser.step(&reference(&pose), &Ground::Flat).pose),
            pose.root,
        ));
    }
    let moved = path[269].0 - path[29].0;
    assert!((-0.34..-0.2).contains(&moved.z), "{moved}");
}

#[test]
fn standing_feet_stay_where_the_reference_turns_them() {
    let skeleton = Skeleton::of_height(1.75);
    let mut pose = standing(&skeleton, 0.035);
    let rest = pose.rotations[Joint::LeftAnkle as usize];
    let mut optimiser = optimiser(&skeleton);
    let (mut shown, mut given) = (0.0_f32, 0.0_f32);
    let mut last: Option<[[Vec3; 2]; 2]> = None;
    for tick in 0..240_u8 {
        // The toes of one foot wander by 3 cm, once in two seconds.
        let yaw = 0.13 * (f32::from(tick) * std::f32::consts::TAU / 120.0).sin();
        pose.rotations[Joint::LeftAnkle as usize] = Quat::from_rotation_y(yaw) * rest;
        let solved = optimiser.step(&reference(&pose), &Ground::Flat);
        let now = [&solved.pose, &pose].map(|pose| {
            let joints = skeleton.forward(pose);
            [Joint::LeftAnkle, Joint::LeftFoot].map(|joint| joints.position(joint))
        });
        if let Some(last) = last.replace(now) {
            let way = |whose: usize| -> f32 {
                let pairs = now[whose].iter().zip(last[whose]);
                pairs.map(|(now, last)| now.distance(last)).sum()
            };
            shown += way(0);
            given += way(1);
        }
    }
    assert!(given > 0.1, "the reference moved its foot by {given} m");
    assert!(shown < 0.2 * given, "{shown} m of {given} m");
}

#[test]
fn feet_follow_the_ground() {
    let skeleton = Skeleton::of_height(1.75);
    let pose = standing(&skeleton, 0.035);
    let ground = Ground::Steps {
        start: 0.05,
        rise: 0.10,
        run: 3.0,
        count: 1,
    };
    let mut optimiser = optimiser(&skeleton);
    let mut solved = optimiser.step(&reference(&pose), &ground);
    for _ in 0..240 {
        solved = optimiser.step(&reference(&pose), &ground);
    }
    // The toe joints are over the step: they come up, the heels stay behind it.
    let joints = skeleton.forward(&solved.pose);
    for toe in [Joint::LeftFoot, Joint::RightFoot] {
        assert!(joints.position(toe).y > 0.095, "{}", joints.position(toe));
    }
    assert!(solved.pose.is_sound());
}
