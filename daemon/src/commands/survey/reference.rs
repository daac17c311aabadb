//! How far poses are from those that libsurvive solved for in the same recording.

use std::{collections::BTreeMap, fs::File, path::Path};

use glam::{DQuat, DVec3};
use posed_device::{
    capture::{self, PoseLines, SurvivePoses},
    lighthouse::base_station::from_z_up,
};
use posed_signal::{HostTime, Pose, Sample};
use serde::Serialize;

use super::measure::{mean_rotation, optical};
use crate::commands::CommandError;

/// Poses are compared where ours is no further off in time than this, s.
const APART: f64 = 0.02;
/// Fewer are not compared.
const POSES_MIN: usize = 50;

/// The figures.
#[derive(Debug, Clone, Serialize)]
pub struct Comparison {
    /// Which of the recording's lines were compared with.
    pub lines: &'static str,
    /// Poses compared.
    pub poses: usize,
    /// Distances, m. The worlds are laid over each other first, by the one rigid motion that fits
    /// all poses best: where the base stations' file is older than the recording, the two differ.
    pub median_m: f64,
    /// As above.
    pub p95_m: f64,
    /// Angles, degrees.
    pub median_degrees: f64,
    /// As above.
    pub p95_degrees: f64,
    /// The median distance without that, m.
    pub unaligned_median_m: f64,
    /// The median angle without that, degrees.
    pub unaligned_median_degrees: f64,
}

/// A pose that libsurvive solved for: time, position in metres, rotation, in posed's axes.
type SolvedPose = (HostTime, DVec3, DQuat);

/// libsurvive's poses in a recording.
pub struct Reference {
    /// By serial number: which of the recording's lines, and the poses in them.
    devices: BTreeMap<String, (&'static str, Vec<SolvedPose>)>,
}

impl Reference {
    /// Reads a recording: poses given from elsewhere where there are any, else its own.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn read(path: &Path) -> Result<Self, CommandError> {
        let file = File::open(path).map_err(|error| CommandError::file(path, error))?;
        let SurvivePoses { devices, poses } = capture::survive_poses(file)
            .map_err(|error| CommandError::Input(format!("{}: {error}", path.display())))?;
        let turn = from_z_up();
        let of = |name: &str, lines: PoseLines| {
            let poses = poses
                .iter()
                .filter(|pose| pose.lines == lines && pose.device == name);
            poses
                .map(|pose| (pose.at, turn * pose.position, turn * pose.rotation))
                .collect::<Vec<_>>()
        };
        let device = |(name, serial): (String, String)| {
            let external = of(&format!("replay_{name}"), PoseLines::External);
            let found = if external.len() >= POSES_MIN {
                ("EXTERNAL_POSE", external)
            } else {
                ("POSE", of(&name, PoseLines::Solved))
            };
            (serial, found)
        };
        Ok(Self {
            devices: devices.into_iter().map(device).collect(),
        })
    }

    /// Compares a device's poses, whose times count from `origin`; `None` where there are too few.
    #[must_use]
    pub fn compare(
        &self,
        serial: &str,
        samples: &[Sample],
        origin: HostTime,
    ) -> Option<Comparison> {
        let (lines, theirs) = self.devices.get(serial)?;
        let ours = optical(samples);
        let pairs: Vec<_> = theirs
            .iter()
            .filter_map(|&(at, position, rotation)| {
                let at = origin.plus_ns(at.0 as i64);
                let pose = nearest(&ours, at)?;
                let dt = at.since_secs(pose.at);
                let moved = pose.position.as_dvec3() + dt * pose.velocity.as_dvec3();
                let spin = DQuat::from_scaled_axis(dt * pose.angular_velocity.as_dvec3());
                Some((
                    (moved, spin * pose.rotation.as_dquat()),
                    (position, rotation),
                ))
            })
            .collect();
        if pairs.len() < POSES_MIN {
            return None;
        }
        let identity = (DVec3::ZERO, DQuat::IDENTITY);
        let [metres, degrees] = differences(&pairs, identity);
        let [fit_metres, fit_degrees] = differences(&pairs, laid_over(&pairs));
        Some(Comparison {
            lines,
            poses: pairs.len(),
            median_m: quantile(&fit_metres, 0.5),
            p95_m: quantile(&fit_metres, 0.95),
            median_degrees: quantile(&fit_degrees, 0.5),
            p95_degrees: quantile(&fit_degrees, 0.95),
            unaligned_median_m: quantile(&metres, 0.5),
            unaligned_median_degrees: quantile(&degrees, 0.5),
        })
    }
}

fn nearest(poses: &[Pose], at: HostTime) -> Option<&Pose> {
    let after = poses.partition_point(|pose| pose.at < at);
    let candidates = [after.checked_sub(1), Some(after)];
    candidates
        .into_iter()
        .flatten()
        .filter_map(|index| poses.get(index))
        .min_by_key(|pose| pose.at.since_ns(at).abs())
        .filter(|pose| pose.at.since_secs(at).abs() < APART)
}

type Placed = (DVec3, DQuat);

/// The motion of our world that lays it over theirs.
fn laid_over(pairs: &[(Placed, Placed)]) -> Placed {
    let turn = mean_rotation(
        pairs
            .iter()
            .map(|(ours, theirs)| theirs.1 * ours.1.conjugate()),
    );
    let shift = |(ours, theirs): &(Placed, Placed)| theirs.0 - turn * ours.0;
    let mut shifts: [Vec<f64>; 3] = Default::default();
    for pair in pairs {
        for (axis, value) in shifts.iter_mut().zip(shift(pair).to_array()) {
            axis.push(value);
        }
    }
    // Medians, as outliers are what is to be measured.
    let middle = shifts.map(|mut axis| {
        axis.sort_by(f64::total_cmp);
        quantile(&axis, 0.5)
    });
    (DVec3::from(middle), turn)
}

/// Distances and angles, sorted.
fn differences(pairs: &[(Placed, Placed)], (shift, turn): Placed) -> [Vec<f64>; 2] {
    let metres = pairs
        .iter()
        .map(|(ours, theirs)| (turn * ours.0 + shift).distance(theirs.0));
    let degrees = pairs
        .iter()
        .map(|(ours, theirs)| (turn * ours.1).angle_between(theirs.1).to_degrees());
    let mut found = [metres.collect::<Vec<_>>(), degrees.collect()];
    for values in &mut found {
        values.sort_by(f64::total_cmp);
    }
    found
}

/// Of sorted values.
fn quantile(values: &[f64], q: f64) -> f64 {
    let index = (values.len().saturating_sub(1) as f64 * q) as usize;
    values.get(index).copied().unwrap_or(0.0)
}
