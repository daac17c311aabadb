//! PIP as it ships on somebody who sits: shanks and pelvis are as upright as those of who stands, so
//! only the memory of having sat down tells.

use glam::{EulerRot, Quat, Vec3};
use posed_body::{BodyPose, Joint, Skeleton, motion::Clip, scene::Scene};
use posed_tracker::{
    TrackerKind,
    eval::{self, Sensors, evaluate},
    metrics::Track,
};

use crate::shared::models;

const RATE_HZ: f64 = 60.0;
const STANDS_S: f64 = 2.0;
const SITS_DOWN_S: f64 = 1.8;

fn ease(t: f64) -> f64 {
    let t = t.clamp(0.0, 1.0);
    t * t * t * (10.0 + t * (6.0 * t - 15.0))
}

/// Somebody who stands, sits down and stays so, moving a little as people do, for `sit_s` seconds.
fn sitter(sit_s: f64) -> Clip {
    let skeleton = Skeleton::of_height(1.75);
    let standing = skeleton.forward(&BodyPose::rest(Vec3::new(0.0, 0.0, 0.0)));
    let ankle = standing.position(Joint::LeftAnkle);
    let frame = |index: usize| {
        let seconds = index as f64 / RATE_HZ;
        let down = ease((seconds - STANDS_S) / SITS_DOWN_S) as f32;
        // The trunk leans forward on the way and comes back.
        let lean = 0.15 * down + 0.6 * (std::f32::consts::PI * down).sin();
        let idle = |rate: f64, size: f32| size * down * ((rate * seconds).sin() as f32);
        let mut pose = BodyPose::rest(Vec3::ZERO);
        let mut turn = |joint: Joint, rotation: Quat| pose.rotations[joint as usize] = rotation;
        let pelvis = Quat::from_euler(
            EulerRot::YXZ,
            idle(0.31, 0.05),
            idle(0.23, 0.03) - lean,
            idle(0.17, 0.03),
        );
        turn(Joint::Pelvis, pelvis);
        turn(Joint::Neck, Quat::from_rotation_x(0.7 * lean));
        turn(Joint::Head, Quat::from_rotation_y(idle(0.41, 0.4)));
        let thigh = 1.45 * down;
        for (hip, knee) in [
            (Joint::LeftHip, Joint::LeftKnee),
            (Joint::RightHip, Joint::RightKnee),
        ] {
            turn(hip, pelvis.inverse() * Quat::from_rotation_x(thigh));
            turn(knee, Quat::from_rotation_x(-thigh));
        }
        // From hanging to the lap.
        for (shoulder, elbow, side) in [
            (Joint::LeftShoulder, Joint::LeftElbow, 1.0f32),
            (Joint::RightShoulder, Joint::RightElbow, -1.0),
        ] {
            let forward = 0.5 * down + idle(0.6 + 0.1 * f64::from(side), 0.1);
            let hang = Quat::from_rotation_z(side * 1.45);
            turn(shoulder, Quat::from_rotation_x(forward) * hang);
            turn(elbow, Quat::from_rotation_y(-side * 1.0 * down));
        }
        // The feet stay.
        let joints = skeleton.forward(&pose);
        pose.root = ankle - joints.position(Joint::LeftAnkle) + Vec3::Y * 0.9;
        pose
    };
    let frames = ((STANDS_S + SITS_DOWN_S + sit_s) * RATE_HZ) as usize;
    Clip {
        name: "sits".into(),
        subject: "procedural".into(),
        split: "test".into(),
        fps: RATE_HZ,
        frames: (0..frames).map(frame).collect(),
        skeleton,
    }
}

/// Degrees between a joint's bone and the one it hangs from.
fn bend(track: &Track, frame: usize, [upper, lower]: [Joint; 2]) -> f32 {
    let turns = &track.world[frame];
    let angle = turns[upper as usize].angle_between(turns[lower as usize]);
    angle.to_degrees()
}

#[test]
fn a_long_sit_stays_a_sit() {
    let clip = sitter(120.0);
    let mut pip = models()
        .tracker(TrackerKind::Pip, &Scene::default())
        .expect("the model fits")
        .expect("PIP is built in");
    let options = eval::Options {
        sensors: Sensors::Imu6,
        dump: true,
        ..eval::Options::default()
    };
    let result = evaluate(&clip, &mut *pip, &options);
    let told = result.dump.expect("it was asked for").predicted;
    let legs = [
        [Joint::Pelvis, Joint::LeftHip],
        [Joint::Pelvis, Joint::RightHip],
        [Joint::LeftHip, Joint::LeftKnee],
        [Joint::RightHip, Joint::RightKnee],
    ];
    for leg in legs {
        let standing = bend(&told, RATE_HZ as usize, leg);
        assert!(standing < 20.0, "{leg:?} of who stands: {standing} degrees");
        // Truly 83 degrees; somebody who stands would be far below the bound.
        let seated = ((STANDS_S + SITS_DOWN_S) * RATE_HZ) as usize;
        for frame in seated..told.len() {
            let angle = bend(&told, frame, leg);
            let seconds = frame as f64 / RATE_HZ;
            assert!(angle > 50.0, "{leg:?} at {seconds:.1} s: {angle} degrees");
        }
    }
}
