use std::fmt::Write;

use glam::{DQuat, DVec3};
use mujoco_rs::prelude::{MjData, MjModel};

use super::*;
use crate::skeleton::{JOINTS, NAMES, PARENTS, Skeleton};

/// The same tree in MuJoCo's XML.
fn tree_xml(tree: &Tree) -> String {
    fn link(tree: &Tree, joint: usize, xml: &mut String) {
        let triple = |v: DVec3| format!("{} {} {}", v.x, v.y, v.z);
        let kind = match joint {
            0 => "<freejoint/>".to_owned(),
            _ => format!("<joint type=\"ball\" armature=\"{}\"/>", tree.armature),
        };
        write!(
            xml,
            "<body name=\"{}\" pos=\"{}\">{kind}<inertial pos=\"{}\" mass=\"{}\" \
             diaginertia=\"{}\"/>",
            NAMES[joint],
            triple(tree.offsets[joint]),
            triple(tree.coms[joint]),
            tree.masses[joint],
            triple(tree.inertias[joint])
        )
        .expect("a string");
        for child in (0..JOINTS).filter(|&child| PARENTS[child] == Some(joint)) {
            link(tree, child, xml);
        }
        xml.push_str("</body>");
    }
    let mut xml = "<mujoco><compiler boundinertia=\"0\" boundmass=\"0\" balanceinertia=\"true\"/>\
        <option gravity=\"0 -9.81 0\"/><worldbody>"
        .to_owned();
    link(tree, 0, &mut xml);
    xml.push_str("</worldbody></mujoco>");
    xml
}

/// Joints in the order in which MuJoCo numbers them: depth first.
fn depth_first() -> Vec<usize> {
    fn visit(joint: usize, order: &mut Vec<usize>) {
        order.push(joint);
        for child in (0..JOINTS).filter(|&child| PARENTS[child] == Some(joint)) {
            visit(child, order);
        }
    }
    let mut order = Vec::new();
    visit(0, &mut order);
    order
}

fn wave(seed: f64, index: usize) -> f64 {
    (seed + 2.3 * index as f64).sin()
}

fn moving(seed: f64) -> Motion {
    let axis = |joint| {
        DVec3::new(
            wave(seed, joint),
            wave(seed, joint + 7),
            wave(seed, joint + 9),
        )
    };
    Motion {
        root: DVec3::new(0.1, 1.0, -0.4),
        rotations: std::array::from_fn(|joint| DQuat::from_scaled_axis(0.8 * axis(joint))),
        velocity: std::array::from_fn(|index| 2.0 * wave(seed + 0.5, index)),
    }
}

#[test]
fn dynamics_agree_with_mujoco() {
    let tree = Tree::new(&Skeleton::of_height(1.8), 80.0);
    let model = MjModel::from_xml_string(&tree_xml(&tree)).expect("a sound document");
    let order = depth_first();
    // Our index of each of MuJoCo's velocities.
    let ours: Vec<usize> = (0..3)
        .chain(
            order
                .iter()
                .flat_map(|&joint| (0..3).map(move |axis| 3 + 3 * joint + axis)),
        )
        .collect();
    for seed in 0..10 {
        let motion = moving(f64::from(seed));
        let mut data = MjData::new(&model);
        let qpos = data.qpos_mut();
        qpos[..3].copy_from_slice(&motion.root.to_array());
        for (place, &joint) in order.iter().enumerate() {
            let q = motion.rotations[joint];
            qpos[3 + 4 * place..7 + 4 * place].copy_from_slice(&[q.w, q.x, q.y, q.z]);
        }
        for (index, &ours) in ours.iter().enumerate() {
            data.qvel_mut()[index] = motion.velocity[ours];
        }
        data.forward();
        let frames = Frames::new(&tree, &motion);
        let mut equation = Equation::default();
        equation.update(&tree, &frames);
        let mut full = vec![0.0; VELOCITIES * VELOCITIES];
        data.full_m(&mut full).expect("room for the matrix");
        for (row, &our_row) in ours.iter().enumerate() {
            let bias = data.qfrc_bias()[row];
            assert!(
                (bias - equation.bias[our_row]).abs() < 1e-7 * (1.0 + bias.abs()),
                "h[{row}]"
            );
            for (column, &our_column) in ours.iter().enumerate() {
                let theirs = full[row * VELOCITIES + column];
                let apart = (theirs - equation.inertia[our_row][our_column]).abs();
                assert!(
                    apart < 1e-9 * (1.0 + theirs.abs()),
                    "M[{row}][{column}]: {theirs}"
                );
            }
        }
    }
}

#[test]
fn drifts_are_the_derivatives_of_velocities() {
    let tree = Tree::new(&Skeleton::of_height(1.7), 70.0);
    let motion = moving(0.7);
    let frames = Frames::new(&tree, &motion);
    let dt = 1e-6;
    let mut later = motion;
    later.advance(&[0.0; VELOCITIES], dt);
    let moved = Frames::new(&tree, &later);
    for joint in 0..JOINTS {
        let velocity = (moved.positions[joint] - frames.positions[joint]) / dt;
        assert!(
            (velocity - frames.velocities[joint]).length() < 1e-4,
            "{}",
            NAMES[joint]
        );
        let drift = (moved.velocities[joint] - frames.velocities[joint]) / dt;
        assert!(
            (drift - frames.drifts[joint]).length() < 1e-3,
            "{}",
            NAMES[joint]
        );
        let point = DVec3::new(0.1, 0.2, -0.1);
        let mut by_columns = DVec3::ZERO;
        let place = frames.place(joint, point);
        frames.for_each_column(joint, place, |index, column| {
            by_columns += column * motion.velocity[index];
        });
        let velocity = (moved.place(joint, point) - place) / dt;
        assert!((velocity - by_columns).length() < 1e-4, "{}", NAMES[joint]);
    }
}
