//! The decoders as a whole, on real captures and against the simulator's truth.

mod broadcasts;
mod captures;
mod generation1;
mod simulated;
mod troubles;
mod walk;

use posed_signal::{Imu, Pose, Sample};

use crate::decode::{Emit, Identity};

/// What a decoder gave.
#[derive(Default)]
struct Tracked {
    serial: String,
    imu: Vec<Imu>,
    poses: Vec<Pose>,
}

impl Emit for Tracked {
    fn identity(&mut self, _unit: usize, identity: Identity) {
        self.serial = identity.serial.to_string();
    }

    fn sample(&mut self, _unit: usize, sample: Sample) {
        match sample {
            Sample::Imu(imu) => self.imu.push(imu),
            Sample::Pose(pose) => self.poses.push(pose),
            _ => {}
        }
    }
}

fn quantile(values: impl Iterator<Item = f64>, q: f64) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values[((values.len() - 1) as f64 * q) as usize]
}
