//! The places of all base stations and the poses of all snapshots at once: bundle adjustment
//! (Triggs et al. 2000), with every snapshot's own unknowns eliminated first (Schur complement).
//!
//! Snapshots say what is up, so that the world stays level; its heading and origin are free, and
//! are brought back to where they were by the caller.

use nalgebra::{DMatrix, DVector, SMatrix, SVector};

use super::snapshot::{Residual, Snapshot, lean, moved, robust};
use crate::lighthouse::{
    base_station::{BaseStation, Source},
    model::Frame,
};
use glam::DVec3;

/// Residuals beyond this weigh less and less, rad; it narrows on the way.
const SOFT: [f64; 3] = [2e-2, 4e-3, 1e-3];
const ROUNDS: usize = 12;
/// Standard deviation of a reading, rad: what calibration leaves of it is larger than its noise, and
/// repeats within a snapshot.
const SIGMA: f64 = 6e-4;
/// Standard deviation of what the velocity of a snapshot is off, m/s.
const OFF_SIGMA: f64 = 0.03;
/// Unknowns of a snapshot: position, rotation, and what its velocity is off.
const OWN: usize = 9;
/// Readings that deviate by more than this are not counted in the result, rad.
const FIT: f64 = 4e-3;

/// A base station with its source, and a snapshot with its pose: what is adjusted.
#[derive(Debug, Clone)]
pub(super) struct Bundle {
    pub(super) stations: Vec<(Source, BaseStation)>,
    pub(super) snapshots: Vec<(Snapshot, Frame)>,
    /// What every snapshot's velocity is off, m/s in its device's frame.
    pub(super) off: Vec<DVec3>,
}

struct Normal {
    stations: DMatrix<f64>,
    right: DVector<f64>,
    /// For every snapshot: its own block, its coupling with the stations, its right side.
    own: Vec<(SMatrix<f64, OWN, OWN>, DMatrix<f64>, SVector<f64, OWN>)>,
    cost: f64,
}

impl Bundle {
    /// Adjusts; answers the root mean square of those residuals that fit, rad, and their share.
    pub(super) fn adjust(&mut self) -> (f64, f64) {
        for soft in SOFT {
            self.minimise(soft);
        }
        let (mut square, mut fitting, mut all) = (0.0, 0.0, 0.0);
        self.each(&mut |_, _, residual| {
            all += 1.0;
            if residual.value.abs() < FIT {
                square += residual.value * residual.value;
                fitting += 1.0;
            }
        });
        (
            (square / f64::max(fitting, 1.0)).sqrt(),
            fitting / f64::max(all, 1.0),
        )
    }

    /// Every reading of a station that is there: indices of snapshot and station, and the residual.
    fn each(&self, take: &mut dyn FnMut(usize, usize, &Residual)) {
        let mut index_of = [None; Source::COUNT];
        for (index, (source, _)) in self.stations.iter().enumerate() {
            index_of[source.index()] = Some(index);
        }
        for (at, (snapshot, frame)) in self.snapshots.iter().enumerate() {
            for seen in &snapshot.glimpses {
                if let Some(index) = index_of[seen.source.index()] {
                    take(
                        at,
                        index,
                        &Residual::new(seen, &self.stations[index].1, frame, self.off[at]),
                    );
                }
            }
        }
    }

    fn minimise(&mut self, soft: f64) {
        let mut normal = self.normal(soft);
        let mut damping = 1e-4;
        for _ in 0..ROUNDS {
            let Some(next) = self.step(&normal, damping) else {
                return;
            };
            let next_normal = next.normal(soft);
            if next_normal.cost < normal.cost {
                let done = normal.cost - next_normal.cost < 1e-6 * normal.cost;
                (*self, normal) = (next, next_normal);
                damping = (damping * 0.2f64).max(1e-9);
                if done {
                    return;
                }
            } else {
                damping *= 10.0;
                if damping > 1e4 {
                    return;
                }
            }
        }
    }

    fn normal(&self, soft: f64) -> Normal {
        let size = 6 * self.stations.len();
        let fresh = || {
            let own = SMatrix::<f64, OWN, OWN>::zeros();
            (
                own,
                DMatrix::<f64>::zeros(size, OWN),
                SVector::<f64, OWN>::zeros(),
            )
        };
        let mut normal = Normal {
            stations: DMatrix::zeros(size, size),
            right: DVector::zeros(size),
            own: self.snapshots.iter().map(|_| fresh()).collect(),
            cost: 0.0,
        };
        self.each(&mut |snapshot, station, residual| {
            let (share, cost) = robust(residual.value, soft);
            let weight = share / (SIGMA * SIGMA);
            normal.cost += cost * (soft / SIGMA).powi(2);
            let (by_station, by_device) = (&residual.by_station, &residual.by_device);
            let at = 6 * station;
            let mut block = normal.stations.fixed_view_mut::<6, 6>(at, at);
            block.ger(weight, by_station, by_station, 1.0);
            let mut right = normal.right.fixed_rows_mut::<6>(at);
            right.axpy(weight * residual.value, by_station, 1.0);
            let (own, coupling, right) = &mut normal.own[snapshot];
            own.ger(weight, by_device, by_device, 1.0);
            let mut coupling = coupling.fixed_view_mut::<6, OWN>(at, 0);
            coupling.ger(weight, by_station, by_device, 1.0);
            right.axpy(weight * residual.value, by_device, 1.0);
        });
        let own = self.snapshots.iter().zip(&self.off).zip(&mut normal.own);
        for (((snapshot, frame), off), (own, _, right)) in own {
            let weight = snapshot.up_sigma.powi(-2);
            normal.cost += lean(snapshot.up, DVec3::Y, frame.rotation, weight, own, right);
            let weight = OFF_SIGMA.powi(-2);
            for axis in 0..3 {
                own[(6 + axis, 6 + axis)] += weight;
                right[6 + axis] -= weight * off[axis];
            }
            normal.cost += weight * off.length_squared();
        }
        normal
    }

    /// Standard deviations of the poses of all stations but the first, relative to that one: m and
    /// rad, over all axes. They follow from how readings scatter and where devices were; what is
    /// wrong with the devices' own dimensions, which are the rulers, comes on top.
    pub(super) fn sigmas(&self) -> Option<Vec<[f64; 2]>> {
        let normal = self.normal(SOFT[SOFT.len() - 1]);
        let mut reduced = normal.stations;
        for (own, coupling, _) in &normal.own {
            reduced -= coupling * own.cholesky()?.inverse() * coupling.transpose();
        }
        let (_, first) = self.stations.first()?;
        // Origin and heading are free: held at the first station, they change no relative pose.
        let up = first.rotation.conjugate() * DVec3::Y;
        for row in 0..3 {
            reduced[(row, row)] += 1.0;
            for column in 0..3 {
                reduced[(3 + row, 3 + column)] += up[row] * up[column];
            }
        }
        let covariance = reduced.cholesky()?.inverse();
        let back = first.rotation.conjugate();
        let sigma = |(index, station): (usize, &BaseStation)| {
            let there = back * (station.position - first.position);
            let turn = station.rotation.conjugate() * first.rotation;
            // How the relative pose goes with place and turn of the first and of this station.
            let mut by = SMatrix::<f64, 6, 12>::zeros();
            for axis in 0..3 {
                let unit = DVec3::AXES[axis];
                let columns = [
                    (axis, back * -unit, DVec3::ZERO),
                    (3 + axis, there.cross(unit), turn * -unit),
                    (6 + axis, back * unit, DVec3::ZERO),
                    (9 + axis, DVec3::ZERO, unit),
                ];
                for (column, place, turned) in columns {
                    for row in 0..3 {
                        by[(row, column)] = place[row];
                        by[(3 + row, column)] = turned[row];
                    }
                }
            }
            let at = |n: usize| if n < 6 { n } else { 6 * index + n - 6 };
            let joint =
                SMatrix::<f64, 12, 12>::from_fn(|row, column| covariance[(at(row), at(column))]);
            let relative = by * joint * by.transpose();
            let size = |from: usize| (from..from + 3).map(|n| relative[(n, n)]).sum::<f64>();
            [size(0).sqrt(), size(3).sqrt()]
        };
        let others = self.stations.iter().map(|(_, station)| station).enumerate();
        Some(others.skip(1).map(sigma).collect())
    }

    /// The bundle after a damped step.
    fn step(&self, normal: &Normal, damping: f64) -> Option<Self> {
        let damp = |value: &mut f64| *value = *value * (1.0 + damping) + damping;
        let mut reduced = normal.stations.clone();
        let mut right = normal.right.clone();
        for axis in 0..reduced.nrows() {
            damp(&mut reduced[(axis, axis)]);
        }
        let mut inverses = Vec::with_capacity(normal.own.len());
        for (own, coupling, own_right) in &normal.own {
            let mut own = *own;
            for axis in 0..OWN {
                damp(&mut own[(axis, axis)]);
            }
            let inverse = own.cholesky()?.inverse();
            let across = coupling * inverse;
            reduced -= &across * coupling.transpose();
            right -= &across * own_right;
            inverses.push(inverse);
        }
        let change = reduced.cholesky()?.solve(&right);
        let mut next = self.clone();
        for (index, (_, station)) in next.stations.iter_mut().enumerate() {
            let frame = Frame {
                position: station.position,
                rotation: station.rotation,
            };
            let frame = moved(&frame, &change.as_slice()[6 * index..6 * index + 6]);
            (station.position, station.rotation) = (frame.position, frame.rotation);
        }
        let own = next.snapshots.iter_mut().zip(&mut next.off);
        for (((_, frame), off), (inverse, (_, coupling, own_right))) in
            own.zip(inverses.iter().zip(&normal.own))
        {
            let pull = coupling.transpose() * &change;
            let pull = SVector::<f64, OWN>::from_iterator(pull.iter().copied());
            let own: SVector<f64, OWN> = inverse * (own_right - pull);
            *frame = moved(frame, &own.as_slice()[..6]);
            *off += DVec3::new(own[6], own[7], own[8]);
        }
        Some(next)
    }
}
