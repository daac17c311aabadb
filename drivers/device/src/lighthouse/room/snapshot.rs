//! What one device saw in a moment in which it was still or moved calmly: the raw material that base stations
//! are placed from. Raw readings are kept, so that a calibration that becomes known later, or a
//! better place of a station, can be brought to bear on them.

use std::sync::Arc;

use glam::{DQuat, DVec3};
use nalgebra::{SMatrix, SVector};

use crate::lighthouse::{
    base_station::{BaseStation, Source},
    model::{DeviceModel, Frame},
};

/// Fewest readings of one station that a pose relative to it is solved from, and fewest sensors
/// behind them.
const READINGS_MIN: usize = 16;
const SENSORS_MIN: u32 = 5;

/// One reading of a snapshot.
#[derive(Debug, Clone, Copy)]
pub(in crate::lighthouse) struct Glimpse {
    pub(in crate::lighthouse) source: Source,
    /// 0 or 1.
    pub(in crate::lighthouse) plane: u8,
    /// The sensor's hardware channel.
    pub(in crate::lighthouse) sensor: u8,
    /// Reading, rad.
    pub(in crate::lighthouse) angle: f64,
    /// Where the sensor was, in the IMU's frame at the snapshot's time, metres.
    pub(in crate::lighthouse) arm: DVec3,
    /// Seconds after the snapshot's time; negative before it.
    pub(in crate::lighthouse) tau: f64,
}

/// A moment of one device.
#[derive(Debug, Clone)]
pub(in crate::lighthouse) struct Snapshot {
    pub(in crate::lighthouse) model: Arc<DeviceModel>,
    /// Up, by the accelerometer, in the IMU's frame; unit.
    pub(in crate::lighthouse) up: DVec3,
    /// Standard deviation of that, rad.
    pub(in crate::lighthouse) up_sigma: f64,
    /// The IMU's frame in the world, where the device is tracked.
    pub(in crate::lighthouse) pose: Option<Frame>,
    pub(in crate::lighthouse) glimpses: Vec<Glimpse>,
}

impl Snapshot {
    /// Stations that it holds enough light of for a pose relative to them.
    pub(super) fn sources(&self) -> Vec<Source> {
        let mut sources: Vec<Source> = self.glimpses.iter().map(|seen| seen.source).collect();
        sources.sort_unstable();
        sources.dedup();
        sources.retain(|source| self.is_enough(*source));
        sources
    }

    fn is_enough(&self, source: Source) -> bool {
        let of_it = || self.glimpses.iter().filter(|seen| seen.source == source);
        let sensors = of_it().fold([0u32; 2], |mut sensors, seen| {
            sensors[usize::from(seen.plane & 1)] |= 1 << (seen.sensor & 31);
            sensors
        });
        of_it().count() >= READINGS_MIN
            && sensors
                .iter()
                .all(|sensors| sensors.count_ones() >= SENSORS_MIN - 1)
            && (sensors[0] | sensors[1]).count_ones() >= SENSORS_MIN
    }

    /// Whether most sensors that saw a station look at it, with the device at `pose`.
    pub(super) fn faces(&self, source: Source, station: &BaseStation, pose: &Frame) -> bool {
        let (mut facing, mut all) = (0, 0);
        for seen in self.glimpses.iter().filter(|seen| seen.source == source) {
            let sensor = self.model.sensors.get(usize::from(seen.sensor));
            let Some(sensor) = sensor.copied().flatten() else {
                continue;
            };
            let point = pose.position + pose.rotation * seen.arm;
            let to_station = station.position - point;
            all += 1;
            facing += u32::from((pose.rotation * sensor.normal).dot(to_station) > 0.0);
        }
        facing * 5 >= all * 4
    }
}

/// A reading less what is expected, and the derivatives of what is expected over position and
/// rotation of the device, over what its velocity (in its own frame) is off, and over position and
/// rotation of the station; rotations are counted in the turned frame.
pub(super) struct Residual {
    pub(super) value: f64,
    pub(super) by_device: SVector<f64, 9>,
    pub(super) by_station: SVector<f64, 6>,
}

impl Residual {
    /// `off`: what the snapshot's velocity is off, m/s in the device's frame.
    pub(super) fn new(seen: &Glimpse, station: &BaseStation, pose: &Frame, off: DVec3) -> Self {
        let arm = seen.arm + seen.tau * off;
        let point = pose.position + pose.rotation * arm;
        let local = station.to_local(point);
        let (expected, gradient) = station.reading(usize::from(seen.plane & 1), local);
        let by_point = station.rotation * gradient;
        let in_device = pose.rotation.conjugate() * by_point;
        let turned = arm.cross(in_device);
        let by_off = seen.tau * in_device;
        let by_turn = gradient.cross(local);
        let device = [by_point, turned, by_off];
        let station = [-by_point, by_turn];
        Self {
            value: seen.angle - expected,
            by_device: SVector::from_iterator(device.iter().flat_map(DVec3::to_array)),
            by_station: SVector::from_iterator(station.iter().flat_map(DVec3::to_array)),
        }
    }
}

/// Adds to normal equations over position, rotation and `N - 6` further unknowns that the device's
/// `up` points along `expected` (unit, outer frame).
pub(super) fn lean<const N: usize>(
    up: DVec3,
    expected: DVec3,
    rotation: DQuat,
    weight: f64,
    matrix: &mut SMatrix<f64, N, N>,
    gradient: &mut SVector<f64, N>,
) -> f64 {
    let off = expected - rotation * up;
    for axis in 0..3 {
        let turned = up.cross(rotation.conjugate() * DVec3::AXES[axis]);
        let mut row = SVector::<f64, N>::zeros();
        (row[3], row[4], row[5]) = (turned.x, turned.y, turned.z);
        matrix.ger(weight, &row, &row, 1.0);
        gradient.axpy(weight * off[axis], &row, 1.0);
    }
    weight * off.length_squared()
}

/// Moves a frame by a small change: position, then rotation in the turned frame.
pub(super) fn moved(frame: &Frame, change: &[f64]) -> Frame {
    let part = |at: usize| DVec3::new(change[at], change[at + 1], change[at + 2]);
    Frame {
        position: frame.position + part(0),
        rotation: (frame.rotation * DQuat::from_scaled_axis(part(3))).normalize(),
    }
}

/// Weight of a residual and its cost (Cauchy), in units of `soft`.
pub(super) fn robust(value: f64, soft: f64) -> (f64, f64) {
    let square = (value / soft).powi(2);
    (1.0 / (1.0 + square), (1.0 + square).ln())
}
