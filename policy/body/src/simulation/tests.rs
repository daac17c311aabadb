use glam::{DQuat, DVec3};

use super::*;
use crate::character::{CharacterPose, HINGES, hinges_of};
use crate::scene::{Ground, Object};

fn character(stature: f64) -> Character {
    Character::of_height(stature).expect("a stature in range")
}

fn scenes() -> Vec<(&'static str, Scene)> {
    let ground = |ground| Scene {
        ground,
        ..Scene::default()
    };
    let with = |object| Scene {
        objects: vec![object],
        ..Scene::default()
    };
    let (position, yaw) = ([0.1, 0.15, -0.4], 20.0);
    let block = Object::Box {
        size: [0.4, 0.3, 0.4],
        position,
        yaw,
        mass: Some(6.0),
    };
    let ball = Object::Ball {
        radius: 0.2,
        position: [0.1, 0.2, -0.4],
        mass: 0.6,
    };
    let chair = Object::Chair {
        position: [0.0, 0.0, 0.35],
        yaw: 0.0,
        seat: 0.45,
    };
    vec![
        ("floor", Scene::default()),
        (
            "slope",
            ground(Ground::Slope {
                degrees: 10.0,
                heading: 30.0,
            }),
        ),
        (
            "rough",
            ground(Ground::Rough {
                amplitude: 0.15,
                hills: 1.0,
                seed: 3,
            }),
        ),
        (
            "steps",
            ground(Ground::Steps {
                start: 0.3,
                rise: 0.15,
                run: 0.3,
                count: 5,
            }),
        ),
        ("box", with(block)),
        ("ball", with(ball)),
        ("chair", with(chair)),
    ]
}

/// A number in ±1 for a seed: the same for every run.
fn noise(seed: &mut u64) -> f64 {
    *seed = seed
        .wrapping_mul(6_364_136_223_846_793_005)
        .wrapping_add(1_442_695_040_888_963_407);
    (*seed >> 11) as f64 / (1_u64 << 52) as f64 - 1.0
}

#[test]
fn kinematics_agree_with_mujoco() {
    let model = Model::new(character(1.8), Scene::default()).expect("a sound model");
    let mut state = model.state();
    let mut seed = 1;
    for _ in 0..20 {
        let mut pose = CharacterPose::rest(DVec3::new(noise(&mut seed), 1.0, noise(&mut seed)));
        pose.rotation = DQuat::from_scaled_axis(DVec3::new(0.3, 2.0, -0.4) * noise(&mut seed));
        pose.angles = std::array::from_fn(|_| noise(&mut seed));
        state.set_pose(&pose);
        let ours = model.character().forward(&pose);
        for link in Link::ALL {
            // Body 0 is the world.
            let theirs = DVec3::from(state.data.xpos()[link as usize + 1]);
            assert!(
                theirs.abs_diff_eq(ours.positions[link as usize], 1e-6),
                "{}",
                link.name()
            );
        }
        for index in 0..HINGES {
            let theirs = DVec3::from(state.data.xaxis()[index + 1]);
            assert!(theirs.abs_diff_eq(ours.axes[index], 1e-6));
        }
        assert_eq!(state.pose().angles, pose.angles);
    }
}

#[test]
fn a_stiff_body_stands_on_both_feet() {
    let character = character(1.75);
    let weight = character.mass() * GRAVITY;
    let model = Model::new(character, Scene::default()).expect("a sound model");
    let mut state = model.state();
    let mut rest = state.pose();
    // The rest pose leans back: bring the body's weight over the middle of the feet.
    let lean = 0.07;
    rest.rotation = DQuat::from_rotation_x(-lean);
    rest.angles[hinges_of(Link::LeftFoot).start] = lean;
    rest.angles[hinges_of(Link::RightFoot).start] = lean;
    state.set_pose(&rest);
    let mut mean = DVec3::ZERO;
    // Springs hold the pose but do not balance: within a second it has not yet toppled.
    for step in 0..120 {
        let (pose, velocity) = (state.pose(), state.velocity());
        let torque = |i: usize| 600.0 * (rest.angles[i] - pose.angles[i]) - 8.0 * velocity[6 + i];
        assert_eq!(state.step(&std::array::from_fn(torque), 1), Step::Sound);
        if step >= 40 {
            mean += state.contact_force() / 80.0;
        }
    }
    assert!(
        (mean.y / weight - 1.0).abs() < 0.02,
        "{mean} against {weight}"
    );
    let feet = state.feet();
    assert!(
        feet.iter()
            .all(|foot| foot.points >= 2 && foot.force.y > 0.2 * weight),
        "{feet:?}"
    );
    assert!(state.pose().root.y > 0.95 * model.character().standing_height());
}

#[test]
fn random_torques_stay_finite_on_every_scene() {
    for (name, scene) in scenes() {
        let character = character(1.75);
        let mass = character.mass();
        let torque: [f64; HINGES] = character.hinges.map(|hinge| hinge.torque);
        let model = Model::new(character, scene).expect(name);
        let mut state = model.state();
        let mut pose = state.pose();
        pose.root.y += 0.3;
        state.set_pose(&pose);
        let mut seed = 7;
        for _ in 0..5 * 36 {
            let torques = torque.map(|limit| limit * noise(&mut seed));
            assert_eq!(state.step(&torques, 4), Step::Sound, "{name}");
            let [potential, kinetic] = state.energy();
            assert!(
                potential.abs() < 20.0 * mass * GRAVITY,
                "{name}: {potential} J"
            );
            assert!(kinetic < 200.0 * mass, "{name}: {kinetic} J");
        }
        assert_eq!(state.quarantines(), 0, "{name}");
    }
}

#[test]
fn the_ground_is_where_the_scene_says() {
    for (name, scene) in scenes().into_iter().take(4) {
        let ground = scene.ground;
        let model = Model::new(character(1.75), scene).expect(name);
        let mut state = model.state();
        let mut seed = 5;
        for _ in 0..200 {
            let (x, z) = (3.0 * noise(&mut seed), 3.0 * noise(&mut seed));
            if x.hypot(z) < 1.0 {
                continue; // The character stands in the way.
            }
            let (_, down) = state
                .data
                .ray(&[x, 4.0, z], &[0.0, -1.0, 0.0], None, true, None, None);
            let height = 4.0 - down;
            let ours = ground.at(x, z).height;
            assert!(
                (height - ours).abs() < 2e-3,
                "{name} at {x} {z}: {height} {ours}"
            );
        }
    }
}

#[test]
fn an_unsound_state_is_put_back() {
    let model = Model::new(character(1.75), Scene::default()).expect("a sound model");
    let mut state = model.state();
    let before = state.pose();
    state.data.qpos_mut()[2] = 1e5;
    assert_eq!(state.step(&[0.0; HINGES], 1), Step::Quarantined);
    assert_eq!(state.quarantines(), 1);
    assert_eq!(state.pose(), before);
    assert_eq!(state.step(&[f64::NAN; HINGES], 4), Step::Sound);
}

#[test]
fn a_clone_goes_its_own_way_and_the_same_way() {
    let model = Model::new(character(1.75), Scene::default()).expect("a sound model");
    let mut one = model.state();
    one.step(&[1.0; HINGES], 10);
    let mut two = one.clone();
    one.step(&[2.0; HINGES], 40);
    assert_ne!(one.pose(), two.pose());
    two.step(&[2.0; HINGES], 40);
    assert_eq!(one.pose(), two.pose());
}
