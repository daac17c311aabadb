//! Rotations.

use std::f64::consts::{PI, TAU};

use glam::{DQuat, DVec3, Quat};
use posed_body::Joint;

use super::{Pair, mean};

/// Hips and shoulders: the joints of the SIP error.
pub(super) const SIP: [Joint; 4] = [
    Joint::LeftHip,
    Joint::RightHip,
    Joint::LeftShoulder,
    Joint::RightShoulder,
];

/// Angle between two rotations, radians; accurate near zero and near a half turn.
pub(super) fn angle(a: Quat, b: Quat) -> f64 {
    let turn = a.as_dquat().normalize().inverse() * b.as_dquat().normalize();
    2.0 * DVec3::new(turn.x, turn.y, turn.z)
        .length()
        .atan2(turn.w.abs())
}

/// The axis-angle vector of at most half a turn, radians.
fn axis_angle(rotation: Quat) -> DVec3 {
    let q = rotation.as_dquat().normalize();
    let q = if q.w < 0.0 {
        DQuat::from_xyzw(-q.x, -q.y, -q.z, -q.w)
    } else {
        q
    };
    let vector = DVec3::new(q.x, q.y, q.z);
    let sine = vector.length();
    if sine < 1e-12 {
        2.0 * vector
    } else {
        vector * (2.0 * sine.atan2(q.w) / sine)
    }
}

/// Mean angle between local rotations without the root's, degrees.
pub(super) fn local_geodesic(pair: &Pair<'_>) -> Option<f64> {
    let angles = (0..pair.frames).flat_map(|frame| {
        let (p, t) = (&pair.p.local[frame], &pair.t.local[frame]);
        p.iter().zip(t).skip(1).map(|(&p, &t)| angle(p, t))
    });
    mean(angles).map(f64::to_degrees)
}

/// Mean absolute difference of local axis-angle components without the root's, degrees.
pub(super) fn local_components(pair: &Pair<'_>) -> Option<f64> {
    let components = (0..pair.frames).flat_map(|frame| {
        let (p, t) = (&pair.p.local[frame], &pair.t.local[frame]);
        p.iter().zip(t).skip(1).flat_map(|(&p, &t)| {
            let difference = axis_angle(p) - axis_angle(t);
            difference.to_array().map(|component| {
                let wrapped = (component + PI).rem_euclid(TAU) - PI;
                wrapped.abs()
            })
        })
    });
    mean(components).map(f64::to_degrees)
}

/// Mean angle between world rotations, degrees.
pub(super) fn world_geodesic(pair: &Pair<'_>, joints: &[Joint]) -> Option<f64> {
    let angles = (0..pair.frames).flat_map(|frame| {
        let (p, t) = (&pair.p.world[frame], &pair.t.world[frame]);
        joints
            .iter()
            .map(move |&joint| angle(p[joint as usize], t[joint as usize]))
    });
    mean(angles).map(f64::to_degrees)
}
