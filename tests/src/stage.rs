//! A whole posed, from transport to published pose, stepped by a capture's own time.

use std::path::Path;

use posed::{
    assemble::{Assembly, Options, assemble},
    commands::replay::recording,
    pipeline::{
        replay::{Span, Watcher, replay},
        source::Source,
    },
    published::PublishedPose,
};
use posed_device::{
    lighthouse::base_station::parse_libsurvive,
    rig::DeviceInfo,
    transport::{Merge, Replay, Transport},
};
use posed_signal::{DeviceId, HostTime, Pose, PoseHow, Role, Sample};

/// Everything that a replay gave.
#[derive(Default)]
pub(crate) struct Run {
    pub(crate) poses: Vec<PublishedPose>,
    pub(crate) samples: Vec<(DeviceId, Sample)>,
    pub(crate) devices: Vec<DeviceInfo>,
    pub(crate) warnings: Vec<String>,
    pub(crate) span: Span,
}

impl Watcher for Run {
    fn pace(&mut self, _time: HostTime) -> bool {
        true
    }

    fn sample(&mut self, device: DeviceId, sample: &Sample) {
        self.samples.push((device, *sample));
    }

    fn pose(&mut self, pose: &PublishedPose, _source: &Source) {
        self.poses.push(*pose);
    }

    fn warning(&mut self, text: &str) {
        self.warnings.push(text.to_owned());
    }
}

impl Run {
    /// Replays `transport` at 90 Hz.
    pub(crate) fn of(transport: impl Transport + 'static, options: Options) -> Self {
        let Assembly {
            mut source,
            mut tracker,
            ..
        } = assemble(Box::new(transport), options);
        let mut run = Self::default();
        run.span = replay(&mut source, &mut tracker, 90.0, &mut run);
        run.devices = source.rig().devices().to_vec();
        run
    }

    /// Replays a capture file with the base stations of another file.
    pub(crate) fn of_file(capture: &Path, base_stations: &Path) -> Self {
        let recording = recording(capture).expect("the capture can be opened");
        let mut options = Options::default();
        let text = std::fs::read_to_string(base_stations).expect("the base stations can be read");
        options.rig.devices.lighthouse.base_stations =
            parse_libsurvive(&text).expect("the base stations hold");
        Self::of(Replay::new(vec![recording], Merge::OneSession), options)
    }

    /// The device of a serial number.
    pub(crate) fn device(&self, serial: &str) -> &DeviceInfo {
        let found = self
            .devices
            .iter()
            .find(|d| d.identity.serial.as_str() == serial);
        found.unwrap_or_else(|| panic!("{serial} is not among {:?}", self.devices))
    }

    /// All poses of a device.
    pub(crate) fn device_poses(&self, device: DeviceId) -> impl Iterator<Item = &Pose> {
        self.samples
            .iter()
            .filter_map(move |(id, sample)| match sample {
                Sample::Pose(pose) if *id == device => Some(pose),
                _ => None,
            })
    }

    /// The optical poses of a device, from `seconds` after the start on.
    pub(crate) fn optical(&self, device: DeviceId, seconds: f64) -> Vec<Pose> {
        let begin = self.span.start.plus_secs(seconds);
        let optical = |pose: &&Pose| pose.how == PoseHow::Optical && pose.at >= begin;
        self.device_poses(device).filter(optical).copied().collect()
    }

    /// Share of ticks, from `seconds` after the start on, at which light stood behind the newest
    /// pose of a role.
    pub(crate) fn tracked(&self, role: Role, seconds: f64) -> f64 {
        let begin = self.span.start.plus_secs(seconds);
        let ticks: Vec<_> = self
            .poses
            .iter()
            .filter(|pose| pose.target_at >= begin)
            .collect();
        let tracked = ticks.iter().filter(|tick| {
            let part = tick.parts[role as usize].fresh();
            part.is_some_and(|pose| pose.how == PoseHow::Optical)
        });
        tracked.count() as f64 / ticks.len().max(1) as f64
    }
}

/// The value below which `share` of `values` lie.
pub(crate) fn quantile(values: &mut [f64], share: f64) -> f64 {
    assert!(
        !values.is_empty(),
        "there is something to take a quantile of"
    );
    values.sort_by(f64::total_cmp);
    values[((values.len() - 1) as f64 * share) as usize]
}
