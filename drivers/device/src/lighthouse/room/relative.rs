//! Where a device is in the frame of a single base station, from nothing but the device's known
//! sensors: every device is a ruler that the room can be measured with.

use std::f64::consts::TAU;

use glam::{DMat3, DQuat, DVec3};
use nalgebra::{SMatrix, SVector};

use super::snapshot::{Residual, Snapshot, lean, moved, robust};
use crate::lighthouse::{
    base_station::{BaseStation, Source},
    model::Frame,
};

/// Residuals beyond this weigh less and less, rad; it narrows while a seed comes nearer.
const SOFT: [f64; 3] = [3e-2, 1e-2, 3e-3];
/// How near a solution has to come: rms and share of readings that fit, with a calibration that was
/// heard from the station, and with one that is taken as typical.
const HEARD: (f64, f64) = (1e-3, 4e-3);
const TYPICAL: (f64, f64) = (4e-3, 1.2e-2);
const FIT_SHARE: f64 = 0.8;
/// A second solution elsewhere has to be worse by this factor, else nothing is known.
const CLEARLY: f64 = 1.6;
/// Standard deviation of what a base station says of its own tilt, rad.
const UP_SIGMA: f64 = 0.03;
/// Devices are nearer to a station than this, m.
const REACH: f64 = 12.0;

/// What is known about a station before it has a place.
#[derive(Debug, Clone, Copy)]
pub(super) struct Unplaced {
    /// The station, standing at the origin and looking along -Z.
    pub(super) station: BaseStation,
    /// Whether its calibration was heard.
    pub(super) heard: bool,
    /// Up in its frame, as far as it is known.
    pub(super) up: Option<DVec3>,
}

/// A device in a station's frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct Relative {
    pub(super) frame: Frame,
    cost: f64,
}

/// Solves; `None` where there is too little light, nothing fits, or two poses fit alike.
pub(super) fn relative(snapshot: &Snapshot, source: Source, of: &Unplaced) -> Option<Relative> {
    let bearings = bearings(snapshot, source, &of.station);
    if bearings.len() < 4 {
        return None;
    }
    let mut found: Vec<Relative> = Vec::new();
    for rotation in seeds(snapshot.up, of.up) {
        let Some(position) = place(&bearings, rotation) else {
            continue;
        };
        let mut frame = Frame { position, rotation };
        let mut cost = f64::MAX;
        for soft in SOFT {
            (frame, cost) = refine(snapshot, source, of, frame, soft, 8);
        }
        let ahead = frame.position.z < 0.0 && frame.position.length() < REACH;
        if ahead && cost.is_finite() && snapshot.faces(source, &of.station, &frame) {
            found.push(Relative { frame, cost });
        }
    }
    found.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    let best = *found.first()?;
    let elsewhere = found
        .iter()
        .find(|other| !is_near(&other.frame, &best.frame));
    if elsewhere.is_some_and(|other| other.cost < CLEARLY * best.cost) {
        return None;
    }
    let (rms_max, fit) = if of.heard { HEARD } else { TYPICAL };
    let (mut square, mut fitting, mut all) = (0.0, 0usize, 0usize);
    for seen in snapshot
        .glimpses
        .iter()
        .filter(|seen| seen.source == source)
    {
        let value = Residual::new(seen, &of.station, &best.frame, DVec3::ZERO).value;
        all += 1;
        if value.abs() < fit {
            fitting += 1;
            square += value * value;
        }
    }
    let rms = (square / fitting.max(1) as f64).sqrt();
    let fits = fitting as f64 >= FIT_SHARE * all as f64 && rms < rms_max;
    fits.then_some(best)
}

fn is_near(a: &Frame, b: &Frame) -> bool {
    (a.position - b.position).length() < 0.1 && a.rotation.angle_between(b.rotation) < 0.1
}

/// Rotations to begin with: the device's up brought to the station's, which is known or may lean
/// any way, and turned about it.
fn seeds(up: DVec3, station_up: Option<DVec3>) -> Vec<DQuat> {
    let level = |up_there: DVec3, turns: u32| {
        let first = DQuat::from_rotation_arc(up, up_there);
        (0..turns).map(move |n| {
            DQuat::from_axis_angle(up_there, TAU * f64::from(n) / f64::from(turns)) * first
        })
    };
    if let Some(up_there) = station_up {
        return level(up_there, 16).collect();
    }
    // Looking down by 0, 30 and 60 degrees, upright, on a side and upside down.
    let mut seeds = Vec::new();
    for roll in 0..4 {
        for pitch in 0..3 {
            let roll = DQuat::from_rotation_z(f64::from(roll) * TAU / 4.0);
            let pitch = DQuat::from_rotation_x(f64::from(pitch) * TAU / 12.0);
            seeds.extend(level(roll * (pitch * DVec3::Y), 12));
        }
    }
    seeds
}

/// Directions in which sensors were seen, with where those sensors are on the device.
fn bearings(snapshot: &Snapshot, source: Source, station: &BaseStation) -> Vec<(DVec3, DVec3)> {
    let of_it = || {
        snapshot
            .glimpses
            .iter()
            .filter(|seen| seen.source == source)
    };
    let mut found = Vec::new();
    for first in of_it().filter(|seen| seen.plane == 0) {
        let partner = of_it().find(|other| other.plane == 1 && other.sensor == first.sensor);
        if let Some(second) = partner {
            found.push((station.bearing([first.angle, second.angle]), first.arm));
        }
    }
    found
}

/// Where the device has to be, given its rotation, for its sensors to lie nearest to their bearings.
fn place(bearings: &[(DVec3, DVec3)], rotation: DQuat) -> Option<DVec3> {
    let (mut normal, mut right) = (DMat3::ZERO, DVec3::ZERO);
    for &(direction, arm) in bearings {
        let along = DMat3::from_cols(
            direction * direction.x,
            direction * direction.y,
            direction * direction.z,
        );
        let across = DMat3::IDENTITY - along;
        normal += across;
        right -= across * (rotation * arm);
    }
    let usable = normal.determinant().abs() > 1e-9;
    usable
        .then(|| normal.inverse() * right)
        .filter(|place| place.is_finite() && place.z < -0.1 && place.length() < 2.0 * REACH)
}

/// Levenberg and Marquardt.
fn refine(
    snapshot: &Snapshot,
    source: Source,
    of: &Unplaced,
    start: Frame,
    soft: f64,
    rounds: usize,
) -> (Frame, f64) {
    let mut best = start;
    let (mut matrix, mut gradient, mut least) = normal(snapshot, source, of, &best, soft);
    let mut damping = 1e-3;
    for _ in 0..rounds {
        let mut damped = matrix;
        for axis in 0..6 {
            damped[(axis, axis)] *= 1.0 + damping;
        }
        let Some(change) = damped.cholesky().map(|factor| factor.solve(&gradient)) else {
            break;
        };
        let next = moved(&best, change.as_slice());
        let (next_matrix, next_gradient, cost) = normal(snapshot, source, of, &next, soft);
        if cost < least {
            let done = least - cost < 1e-6 * least;
            (best, matrix, gradient, least) = (next, next_matrix, next_gradient, cost);
            damping = (damping * 0.2f64).max(1e-9);
            if done {
                break;
            }
        } else {
            damping *= 8.0;
        }
    }
    (best, least)
}

fn normal(
    snapshot: &Snapshot,
    source: Source,
    of: &Unplaced,
    at: &Frame,
    soft: f64,
) -> (SMatrix<f64, 6, 6>, SVector<f64, 6>, f64) {
    let mut matrix = SMatrix::<f64, 6, 6>::zeros();
    let mut gradient = SVector::<f64, 6>::zeros();
    let mut cost = 0.0;
    for seen in snapshot
        .glimpses
        .iter()
        .filter(|seen| seen.source == source)
    {
        let residual = Residual::new(seen, &of.station, at, DVec3::ZERO);
        let (weight, share) = robust(residual.value, soft);
        let weight = weight / (soft * soft);
        cost += share;
        let row = residual.by_device.fixed_rows::<6>(0);
        matrix.ger(weight, &row, &row, 1.0);
        gradient.axpy(weight * residual.value, &row, 1.0);
    }
    if let Some(up) = of.up {
        let weight = UP_SIGMA.powi(-2);
        cost += lean(
            snapshot.up,
            up,
            at.rotation,
            weight,
            &mut matrix,
            &mut gradient,
        );
    }
    (matrix, gradient, cost)
}
