use glam::{DQuat, DVec3};

use super::*;
use crate::character::{CharacterPose, HINGES, hinges_of};
use crate::scene::{Object, Place, samples};

fn character(stature: f64) -> Character {
    Character::of_height(stature).expect("a stature in range")
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
    for (name, scene) in samples() {
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
    for (name, scene) in samples().into_iter().take(4) {
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

#[test]
fn objects_are_put_touched_and_fetched_back() {
    let position = [2.0, 0.25, 0.0];
    let scene = Scene {
        objects: vec![
            Object::Ball {
                radius: 0.25,
                position,
                mass: 2.0,
            },
            Object::Chair {
                position: [0.0, 0.0, 3.0],
                yaw: 90.0,
                seat: 0.45,
            },
        ],
        ..Scene::default()
    };
    let model = Model::new(character(1.75), scene.clone()).expect("a sound model");
    let mut state = model.state();
    assert_eq!(state.objects(), 2);
    let apart =
        |a: Place, b: Place| a.position.distance(b.position) + a.rotation.angle_between(b.rotation);
    for (index, object) in scene.objects.iter().enumerate() {
        let here = state.object(index).expect("an object");
        assert!(apart(here, object.place()) < 1e-6, "{here:?}");
    }
    assert_eq!((state.object(2), state.touched()), (None, 0));

    // Thrown at the character from the side, the ball hits it and comes back.
    let to = Place {
        position: DVec3::new(1.5, 1.0, 0.0),
        rotation: DQuat::IDENTITY,
    };
    state.put_object(0, &to, [DVec3::NEG_X * 6.0, DVec3::Y]);
    let mut touched = 0;
    for _ in 0..72 {
        assert_eq!(state.step(&[0.0; HINGES], 1), Step::Sound);
        touched |= state.touched();
    }
    assert_eq!(touched, 1, "the ball, not the chair");

    // A chair put behind the falling body carries some of it, also after the world was unsound.
    let seat = Place {
        position: DVec3::new(0.0, 0.0, -0.2),
        rotation: DQuat::from_rotation_y(0.5),
    };
    state.put_object(1, &seat, [DVec3::ZERO; 2]);
    state.data.qpos_mut()[2] = 1e5;
    assert_eq!(state.step(&[0.0; HINGES], 1), Step::Quarantined);
    assert!(apart(state.object(1).expect("a chair"), seat) < 1e-6);
    let rest = model.state().pose();
    state.set_pose(&rest);
    for _ in 0..144 {
        state.step(&[0.0; HINGES], 1);
        touched |= state.touched();
    }
    assert_eq!(touched, 3);

    // Nonsense changes nothing; what has left the scene comes back.
    let before = state.object(0).expect("a ball");
    let nowhere = |x: f64| Place {
        position: DVec3::X * x,
        rotation: DQuat::IDENTITY,
    };
    for (index, to, speed) in [
        (0, nowhere(f64::NAN), 0.0),
        (0, nowhere(101.0), 0.0),
        (0, nowhere(0.0), f64::INFINITY),
        (7, nowhere(0.0), 0.0),
    ] {
        state.put_object(index, &to, [DVec3::X * speed, DVec3::ZERO]);
    }
    assert_eq!(state.object(0), Some(before));
    state.put_object(0, &nowhere(99.9), [DVec3::X * 100.0, DVec3::ZERO]);
    state.step(&[0.0; HINGES], 8);
    assert!(state.object(0).expect("a ball").position.x > 100.0);
    state.fetch_objects();
    assert!(apart(state.object(0).expect("a ball"), scene.objects[0].place()) < 1e-6);
    state.put_objects_back();
    assert!(apart(state.object(1).expect("a chair"), scene.objects[1].place()) < 1e-6);
}
