//! The environment against its golden vectors, and the tracker with a policy that does nothing.

use glam::{DQuat, DVec3, Quat};
use posed_body::{
    Skeleton,
    character::{Character, CharacterPose, HINGES},
    scene::Scene,
    simulation::document,
};
use posed_signal::PoseHow;
use serde::Deserialize;

use super::{
    observation::{SIZE, VELOCITIES},
    *,
};
use crate::{Ik, Wearer, inference::shared_runtime, tracker::NO_INERTIAL};

/// Written by `questsim.golden`.
const GOLDEN: &str = include_str!("../../tests/data/questsim.golden.json");
/// A policy whose torques are all zero, written by `fixtures/limp_questsim.py`.
const LIMP: &[u8] = include_bytes!("../../tests/data/questsim_limp.onnx");

#[derive(Deserialize)]
struct Golden {
    stature: f64,
    mjcf: String,
    cases: Vec<Case>,
}

#[derive(Deserialize)]
struct Case {
    lookahead: usize,
    hands: bool,
    qpos: Vec<f64>,
    qvel: Vec<f64>,
    positions: Vec<[[f64; 3]; PARTS]>,
    quats: Vec<[[f64; 4]; PARTS]>,
    observation: Vec<f64>,
    action: Vec<f64>,
    qpos_next: Vec<f64>,
    qvel_next: Vec<f64>,
    observation_next: Vec<f64>,
}

fn golden() -> Golden {
    serde_json::from_str(GOLDEN).expect("golden vectors")
}

fn character_pose(qpos: &[f64]) -> CharacterPose {
    let mut angles = [0.0; HINGES];
    angles.copy_from_slice(&qpos[7..]);
    CharacterPose {
        root: DVec3::from_slice(&qpos[..3]),
        rotation: DQuat::from_xyzw(qpos[4], qpos[5], qpos[6], qpos[3]),
        angles,
    }
}

#[test]
fn training_runs_on_this_character() {
    let golden = golden();
    let character = Character::of_height(golden.stature).expect("a stature in range");
    assert!(
        document(&character, &Scene::default()) == golden.mjcf,
        "the character has changed: write the golden vectors anew and say so in the model's card"
    );
}

#[test]
fn both_environments_see_and_step_the_same() {
    let golden = golden();
    let mut world = World::new(
        &Skeleton::of_height(golden.stature as f32),
        &Scene::default(),
    )
    .expect("a character");
    for case in &golden.cases {
        let start = HostTime(5_000_000_000);
        let moment = |frame: usize| Moment {
            at: start.plus_ns((frame as i64 - 1) * STEP_NS),
            user: std::array::from_fn(|part| Part {
                position: DVec3::from_array(case.positions[frame][part]),
                rotation: DQuat::from_array(case.quats[frame][part]),
            }),
            hands: case.hands,
        };
        let mut timeline = Timeline::EMPTY;
        timeline.push(moment(0));
        timeline.push(moment(1));
        for frame in 0..FUTURE {
            timeline.foresee(frame, Some(moment(frame + 2)));
        }
        let (user, hands) = timeline.future(start, case.lookahead).expect("a user");
        let mut velocity = [0.0; VELOCITIES];
        velocity.copy_from_slice(&case.qvel);
        world.place(&character_pose(&case.qpos), &velocity);
        let mut seen = [0.0_f32; SIZE];
        world.observe(&user, hands, &mut seen);
        assert_same(&seen, &case.observation, 1e-4);
        let action: [f64; HINGES] = std::array::from_fn(|hinge| case.action[hinge]);
        assert!(world.apply(&action));
        let (pose, velocity) = world.moving();
        let next = character_pose(&case.qpos_next);
        assert!(pose.root.distance(next.root) < 1e-6);
        for hinge in 0..HINGES {
            assert!((pose.angles[hinge] - next.angles[hinge]).abs() < 1e-6);
        }
        for (here, there) in velocity.iter().zip(&case.qvel_next) {
            assert!((here - there).abs() < 1e-4, "{here} {there}");
        }
        world.observe(&user, hands, &mut seen);
        assert_same(&seen, &case.observation_next, 1e-3);
    }
}

/// Within `tolerance` of the larger of one and the number.
fn assert_same(seen: &[f32], golden: &[f64], tolerance: f64) {
    assert_eq!(seen.len(), golden.len());
    for (index, (&here, &there)) in seen.iter().zip(golden).enumerate() {
        let apart = (f64::from(here) - there).abs() / there.abs().max(1.0);
        assert!(apart < tolerance, "number {index}: {here}, not {there}");
    }
}

fn standing(wearer: &Wearer, at: HostTime) -> [Lookup<Pose>; Role::COUNT] {
    let mut parts = [Lookup::Empty; Role::COUNT];
    let place = |position| {
        Lookup::Exact(Pose {
            position,
            rotation: Quat::IDENTITY,
            how: PoseHow::Optical,
            ..Pose::unknown(at)
        })
    };
    let up = wearer.skeleton.head_height() + 0.02;
    parts[Role::Head as usize] = place(Vec3::new(0.0, up, 0.0));
    parts[Role::LeftHand as usize] = place(Vec3::new(-0.25, up - 0.7, -0.1));
    parts[Role::RightHand as usize] = place(Vec3::new(0.25, up - 0.7, -0.1));
    parts
}

#[test]
fn a_limp_character_falls_and_is_put_back_without_a_jump() {
    let runtime = shared_runtime();
    let stand_in = Box::new(Ik::default());
    let mut tracker =
        QuestSim::load(&runtime, "limp", LIMP, stand_in, Options::default()).expect("a policy");
    let wearer = Wearer::of_height(1.75);
    let (mut last, mut put_back): (Option<BodyPose>, Option<u64>) = (None, None);
    let mut own = 0;
    // Ninety ticks a second, off the policy's own grid.
    for tick in 0..450u64 {
        let target = HostTime(1_000_000_000 + tick * 11_111_111);
        let input = Input {
            target,
            parts: &standing(&wearer, target),
            wearer: &wearer,
            inertial: &NO_INERTIAL,
        };
        let before = tracker.recoveries().expect("a simulation");
        let tracked = tracker.track(&input);
        let pose = tracked.pose;
        assert!(pose.is_sound());
        if let Some(last) = last {
            let moved = pose.root.distance(last.root);
            assert!(moved < 0.12, "tick {tick}: the pelvis moved {moved} m");
        }
        last = Some(pose);
        if tracker.recoveries() != Some(before) {
            put_back = Some(tick);
        }
        // What is shown is the stand-in's for the 200 ms in which it leads over.
        let fades = put_back.is_some_and(|since| tick - since <= 17);
        assert!(!fades || tracked.kind == TrackerKind::Ik, "tick {tick}");
        own += u32::from(tracked.kind == TrackerKind::QuestSim);
    }
    assert!(own > 100, "{own} ticks are the character's own");
    let counts = tracker.recoveries().expect("a simulation");
    assert!(counts.falls + counts.drifts >= 2, "{counts:?}");
    assert_eq!(counts.faults, 0);
    // Five seconds of policy steps, and a shorter one at most respawns.
    let most = 182 + counts.total();
    assert!((160..=most).contains(&tracker.steps()), "{counts:?}");
}

#[test]
fn without_a_head_the_stand_in_shows() {
    let runtime = shared_runtime();
    let stand_in = Box::new(Ik::default());
    let mut tracker =
        QuestSim::load(&runtime, "limp", LIMP, stand_in, Options::default()).expect("a policy");
    let wearer = Wearer::of_height(1.75);
    for tick in 0..30u64 {
        let target = HostTime(1_000_000_000 + tick * 11_111_111);
        let input = Input {
            target,
            parts: &[Lookup::Empty; Role::COUNT],
            wearer: &wearer,
            inertial: &NO_INERTIAL,
        };
        let tracked = tracker.track(&input);
        assert!(tracked.pose.is_sound());
        assert_eq!(tracked.kind, TrackerKind::Ik);
    }
    assert!(tracker.forces().is_none());
    assert_eq!(tracker.steps(), 0);
}

/// A limp character, at so many ticks a second: the last pose, the policy steps, and
/// the farthest that the pelvis went in a tick, metres.
fn limp(rate_hz: f64, seconds: f64) -> (BodyPose, u64, f32) {
    let stand_in = Box::new(Ik::default());
    let options = Options::default();
    let loaded = QuestSim::load(&shared_runtime(), "limp", LIMP, stand_in, options);
    let mut tracker = loaded.expect("a policy");
    let wearer = Wearer::of_height(1.75);
    let (mut last, mut most): (Option<BodyPose>, f32) = (None, 0.0);
    for tick in 0..=(seconds * rate_hz).round() as u32 {
        let target = HostTime::from_secs_f64(1.0 + f64::from(tick) / rate_hz);
        let input = Input {
            target,
            parts: &standing(&wearer, target),
            wearer: &wearer,
            inertial: &NO_INERTIAL,
        };
        let pose = tracker.track(&input).pose;
        let moved = last.map_or(0.0, |last: BodyPose| pose.root.distance(last.root));
        most = most.max(moved);
        last = Some(pose);
    }
    (last.expect("a tick"), tracker.steps(), most)
}

#[test]
fn ticks_of_any_rate_see_the_same_fall() {
    // Nine steps of the policy once the stand-in has settled; all these rates have a tick at both ends.
    let (end, steps, _) = limp(36.0, 0.75);
    assert_eq!(steps, 9);
    for rate in [20.0, 60.0, 72.0, 100.0, 144.0, 500.0, 1000.0] {
        let (pose, steps, most) = limp(rate, 0.75);
        assert!((9..=10).contains(&steps), "{rate} Hz: {steps} steps");
        let apart = pose.root.distance(end.root);
        assert!(apart < 1e-3, "{rate} Hz: {apart} m");
        for (a, b) in pose.rotations.iter().zip(&end.rotations) {
            assert!(a.angle_between(*b) < 0.01, "{rate} Hz");
        }
        // Between steps the pose goes on: it never stands still and jumps.
        let speed = f64::from(most) * rate;
        assert!(speed < 3.0, "{rate} Hz: {speed} m/s");
    }
}

#[test]
fn where_the_ground_is_raised_the_character_is_seen_as_on_the_floor() {
    let ground = posed_body::scene::Ground::Steps {
        start: 0.0,
        rise: 0.4,
        run: 5.0,
        count: 1,
    };
    let scene = Scene {
        ground,
        ..Scene::default()
    };
    let skeleton = Skeleton::of_height(1.75);
    let [mut flat, mut raised] =
        [Scene::default(), scene].map(|scene| World::new(&skeleton, &scene).expect("a character"));
    let mut pose = BodyPose::rest(Vec3::new(0.0, 1.0, -2.0));
    flat.spawn(&pose, None);
    pose.root.y += 0.4;
    raised.spawn(&pose, None);
    assert!((raised.floor(raised.to.root) - 0.4).abs() < 1e-9);
    let part = Part {
        position: DVec3::new(0.1, 1.5, -2.0),
        rotation: DQuat::IDENTITY,
    };
    let user = [[part; PARTS]; FUTURE];
    let mut seen = [[0.0_f32; SIZE]; 2];
    flat.observe(&user, true, &mut seen[0]);
    raised.observe(&user, true, &mut seen[1]);
    for (a, b) in seen[0].iter().zip(&seen[1]) {
        assert!((a - b).abs() < 1e-3, "{a} {b}");
    }
    assert!(lost(&raised, None, pose.root.y - 0.4).is_none());
}
