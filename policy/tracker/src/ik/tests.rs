//! What must hold of the whole tracker.

use posed_signal::{Lookup, Pose, PoseHow};
use proptest::prelude::*;

use super::*;
use crate::{
    geometry::BEND_MAX,
    tracker::{NO_INERTIAL, Wearer},
};

const HANDS: [Role; 2] = [Role::LeftHand, Role::RightHand];

fn optical(position: Vec3, rotation: Quat) -> Lookup<Pose> {
    let pose = Pose::unknown(HostTime(0));
    Lookup::Exact(Pose {
        position,
        rotation,
        how: PoseHow::Optical,
        ..pose
    })
}

/// Head and hands of a person who walks in a circle, looks around, swings the arms and squats now
/// and then; scaled with the head height.
fn person(t: f32, tall: f32) -> [Place; 3] {
    let heading = 0.4 * t;
    let level = Quat::from_rotation_y(heading);
    let radius = 1.2;
    let squat = 0.25 * (0.5 - 0.5 * (0.7 * t).cos()).powi(4);
    let place = Vec3::new(-heading.cos() * radius, 0.0, heading.sin() * radius);
    let head = place + Vec3::Y * tall * (0.99 - squat + 0.01 * (9.0 * t).sin());
    let look = level * Quat::from_euler(glam::EulerRot::YXZ, 0.5 * (1.3 * t).sin(), -0.2, 0.05);
    let hand = |side: f32| {
        let swing = 0.15 * (4.5 * t).sin() * side;
        let offset = Vec3::new(side * 0.17, -0.3 + 0.1 * swing.abs(), -0.05 + swing) * tall;
        let turn = Quat::from_rotation_z(-side * 1.4) * Quat::from_rotation_y(side * 0.6);
        Place {
            position: head + level * offset,
            rotation: level * turn,
        }
    };
    [
        Place {
            position: head,
            rotation: look,
        },
        hand(-1.0),
        hand(1.0),
    ]
}

struct Stage {
    ik: Ik,
    wearer: Wearer,
    parts: [Lookup<Pose>; Role::COUNT],
}

impl Stage {
    fn new(height: f32) -> Self {
        let wearer = Wearer::of_height(height);
        Self {
            ik: Ik::default(),
            wearer,
            parts: [Lookup::Empty; Role::COUNT],
        }
    }

    fn set(&mut self, role: Role, place: &Place) {
        self.parts[role as usize] = optical(place.position, place.rotation);
    }

    fn lose(&mut self, role: Role) {
        self.parts[role as usize] = Lookup::Empty;
    }

    fn tick(&mut self, ms: u64) -> Tracked {
        let target = HostTime(ms * 1_000_000);
        self.ik.track(&Input {
            target,
            parts: &self.parts,
            inertial: &NO_INERTIAL,
            wearer: &self.wearer,
        })
    }

    fn show_person(&mut self, t: f32) {
        let tall = self.wearer.skeleton.head_height();
        let [head, left, right] = person(t, tall);
        self.set(Role::Head, &head);
        self.set(Role::LeftHand, &left);
        self.set(Role::RightHand, &right);
    }
}

/// Angle between the two bones at a hinge, radians: 0 when stretched.
fn hinge(joints: &posed_body::Joints, chain: [Joint; 3]) -> f32 {
    let [a, b, c] = chain.map(|joint| joints.position(joint));
    (b - a).angle_between(c - b)
}

#[test]
fn without_any_input_a_body_stands_at_the_origin() {
    let mut stage = Stage::new(1.75);
    let tracked = stage.tick(0);
    assert_eq!(tracked.quality, Quality::Held);
    assert!(tracked.pose.is_sound());
    let joints = stage.wearer.skeleton.forward(&tracked.pose);
    assert!((joints.position(Joint::Head).y - 1.46).abs() < 0.02);
    assert!(joints.position(Joint::LeftFoot).y < 0.04);
    assert!(joints.position(Joint::LeftWrist).y < 1.05, "arms hang");
}

#[test]
fn walking_meets_the_inputs_and_never_slides_or_sinks() {
    for height in [1.3, 1.75, 2.1] {
        let mut stage = Stage::new(height);
        let tall = stage.wearer.skeleton.head_height();
        let mut last: Option<(posed_body::Joints, BodyPose)> = None;
        for tick in 0..1_800u64 {
            let t = tick as f32 / 90.0;
            stage.show_person(t);
            let tracked = stage.tick(tick * 1_000 / 90);
            assert_eq!(tracked.quality, Quality::Full);
            assert!(tracked.pose.is_sound());
            let joints = stage.wearer.skeleton.forward(&tracked.pose);
            let [head, left, right] = person(t, tall);
            assert!(joints.position(Joint::Head).distance(head.position) < 1e-4);
            assert!(joints.rotation(Joint::Head).angle_between(head.rotation) < 2e-3);
            for (joint, hand) in [(Joint::LeftWrist, left), (Joint::RightWrist, right)] {
                assert!(joints.rotation(joint).angle_between(hand.rotation) < 2e-3);
                let off = joints.position(joint).distance(hand.position);
                assert!(off < 2e-3, "{} is {off} m off at {t} s", joint.name());
            }
            for foot in [
                Joint::LeftFoot,
                Joint::RightFoot,
                Joint::LeftAnkle,
                Joint::RightAnkle,
            ] {
                assert!(
                    joints.position(foot).y > 0.01,
                    "{} in the floor",
                    foot.name()
                );
            }
            let pelvis = joints.position(Joint::Pelvis);
            assert!(pelvis.y > 0.3 * tall, "the pelvis is up at {t} s: {pelvis}");
            if let Some((before, _)) = last {
                for (index, joint) in Joint::ALL.into_iter().enumerate() {
                    let step = joints.positions[index].distance(before.positions[index]);
                    assert!(
                        step < 0.09 * tall,
                        "{} jumps {step} m at {t} s",
                        joint.name()
                    );
                }
            }
            last = Some((joints, tracked.pose));
        }
    }
}

#[test]
fn a_squat_bends_the_knees_and_leaves_the_feet() {
    let mut stage = Stage::new(1.75);
    let mut feet: Option<[Vec3; 2]> = None;
    for tick in 0..300u64 {
        let down = 0.45 * (0.5 - 0.5 * (tick as f32 / 150.0 * std::f32::consts::PI).cos());
        let head = Place {
            position: Vec3::new(0.0, 1.46 - down, -0.25 * down),
            rotation: Quat::from_rotation_x(-0.4 * down),
        };
        stage.set(Role::Head, &head);
        let tracked = stage.tick(tick * 1_000 / 60);
        let joints = stage.wearer.skeleton.forward(&tracked.pose);
        let now = [Joint::LeftFoot, Joint::RightFoot].map(|joint| joints.position(joint));
        let first = *feet.get_or_insert(now);
        assert!(now[0].distance(first[0]) < 5e-3 && now[1].distance(first[1]) < 5e-3);
        if tick == 150 {
            let knee = hinge(&joints, [Joint::LeftHip, Joint::LeftKnee, Joint::LeftAnkle]);
            assert!(knee > 0.9, "knee bent by {knee} rad");
            assert!(
                joints.position(Joint::Pelvis).z > -0.05,
                "the hips stay over the feet"
            );
        }
    }
}

#[test]
fn a_hand_is_lost_and_comes_back_without_a_jump() {
    let mut stage = Stage::new(1.7);
    let mut last: Option<posed_body::Joints> = None;
    for tick in 0..600u64 {
        let t = tick as f32 / 60.0;
        stage.show_person(0.3 * t);
        let lost = (120..360).contains(&tick);
        if lost {
            stage.lose(Role::LeftHand);
        }
        let tracked = stage.tick(tick * 1_000 / 60);
        let wanted = if lost {
            Quality::Partial
        } else {
            Quality::Full
        };
        assert_eq!(tracked.quality, wanted);
        let joints = stage.wearer.skeleton.forward(&tracked.pose);
        if let Some(before) = last {
            for joint in [Joint::LeftWrist, Joint::LeftElbow, Joint::RightElbow] {
                let step = joints.position(joint).distance(before.position(joint));
                assert!(
                    step < 0.06,
                    "{} jumps {step} m at tick {tick}",
                    joint.name()
                );
            }
        }
        last = Some(joints);
    }
}

#[test]
fn the_rate_of_ticks_does_not_matter() {
    let poses = [30u64, 60, 120].map(|hz| {
        let mut stage = Stage::new(1.75);
        let mut shown = None;
        for tick in 0..=(4 * hz) {
            // Slow enough that the feet stand: when they step is decided tick by tick.
            let t = tick as f32 / hz as f32;
            let sway = Vec3::new(
                0.03 * t.sin(),
                1.4 - 0.1 * (0.5 * t).sin(),
                0.02 * (2.0 * t).sin(),
            );
            let head = Place {
                position: sway,
                rotation: Quat::from_rotation_y(0.3 * t.sin()),
            };
            stage.set(Role::Head, &head);
            for (role, side) in HANDS.into_iter().zip([-0.2, 0.2]) {
                let hand = Vec3::new(side, -0.3, -0.2 - 0.1 * t.cos());
                let rotation = Quat::from_rotation_y(0.5);
                stage.set(
                    role,
                    &Place {
                        position: sway + hand,
                        rotation,
                    },
                );
            }
            shown = Some(stage.tick(tick * 1_000 / hz));
        }
        stage.wearer.skeleton.forward(&shown.unwrap().pose)
    });
    for other in &poses[1..] {
        for (index, joint) in Joint::ALL.into_iter().enumerate() {
            let off = other.positions[index].distance(poses[0].positions[index]);
            assert!(off < 0.012, "{} differs by {off} m", joint.name());
        }
    }
}

#[test]
fn bones_that_make_no_sense_give_a_sound_pose() {
    for number in [0.0, f32::NAN, f32::INFINITY, 1e20, -1.0] {
        let mut stage = Stage::new(1.75);
        stage.wearer.skeleton.offsets = [Vec3::splat(number); 22];
        for tick in 0..20 {
            let place = Place {
                position: Vec3::new(0.1, 1.4, 0.0),
                rotation: Quat::IDENTITY,
            };
            stage.set(Role::Head, &place);
            stage.set(Role::LeftHand, &place);
            let tracked = stage.tick(tick * 16);
            assert!(tracked.pose.is_sound(), "{number}: {tracked:?}");
        }
    }
}

fn anywhere() -> impl Strategy<Value = Option<Place>> {
    let numbers = prop::array::uniform6(-3.0f32..3.0);
    prop::option::weighted(0.8, numbers).prop_map(|numbers| {
        let [x, y, z, a, b, c] = numbers?;
        let rotation = Quat::from_scaled_axis(Vec3::new(a, b, c));
        Some(Place {
            position: Vec3::new(x, 1.2 + 0.6 * y, z),
            rotation,
        })
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    #[test]
    fn anything_gives_a_sound_body_with_the_head_where_it_is(
        places in prop::collection::vec((anywhere(), anywhere(), anywhere(), 1u64..700), 1..25),
        height in 1.2f32..2.2,
    ) {
        let mut stage = Stage::new(height);
        let mut ms = 0;
        for (head, left, right, gap) in places {
            ms += gap;
            for (role, place) in [(Role::Head, head), (Role::LeftHand, left), (Role::RightHand, right)] {
                match place {
                    Some(place) => stage.set(role, &place),
                    None => stage.lose(role),
                }
            }
            let tracked = stage.tick(ms);
            prop_assert!(tracked.pose.is_sound(), "{tracked:?}");
            let joints = stage.wearer.skeleton.forward(&tracked.pose);
            if let (Some(head), true) = (head, tracked.quality >= Quality::Partial) {
                let off = joints.position(Joint::Head).distance(head.position);
                prop_assert!(off < 2e-4, "head {off} m off");
            }
            for side in 0..2usize {
                let joint = |joint: Joint| Joint::ALL[joint as usize + side];
                let leg = [Joint::LeftHip, Joint::LeftKnee, Joint::LeftAnkle].map(joint);
                let knee = hinge(&joints, leg);
                prop_assert!(knee < BEND_MAX + 0.05, "knee {knee}");
                let toe = joints.position(joint(Joint::LeftFoot)).y;
                let hip = joints.position(joint(Joint::LeftHip)).y;
                prop_assert!(toe > -2e-3 || hip < 0.2, "toe at {toe}, hip at {hip}");
            }
        }
    }

    #[test]
    fn small_changes_of_the_input_change_the_pose_little(
        places in (anywhere(), anywhere(), anywhere()),
        nudge in prop::array::uniform3(-1e-3f32..1e-3),
    ) {
        let (Some(head), Some(left), Some(right)) = places else { return Ok(()) };
        let hands = [left, right].map(|hand| Place {
            position: head.position + (hand.position - Vec3::Y * 1.2) * 0.15,
            ..hand
        });
        let run = |by: Vec3| {
            let mut stage = Stage::new(1.75);
            let mut joints = None;
            for tick in 0..30 {
                let moved = |place: &Place| Place { position: place.position + by, ..*place };
                stage.set(Role::Head, &moved(&head));
                for side in 0..2 {
                    stage.set(HANDS[side], &moved(&hands[side]));
                }
                joints = Some(stage.tick(tick * 16));
            }
            stage.wearer.skeleton.forward(&joints.unwrap().pose)
        };
        let (a, b) = (run(Vec3::ZERO), run(nudge.into()));
        for joint in [Joint::Pelvis, Joint::Spine3, Joint::LeftElbow, Joint::RightElbow] {
            let off = a.position(joint).distance(b.position(joint));
            prop_assert!(off < 0.05, "{} moves {off} m for a millimetre", joint.name());
        }
    }
}
