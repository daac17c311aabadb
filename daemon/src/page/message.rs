//! What goes to the browser: a pose as bytes, everything slower as JSON.

use posed_body::{optimiser::FootForce, skeleton};
use posed_signal::{Lookup, Pose, Role};
use posed_tracker::{Mounts, TrackerKind};
use serde::Serialize;
use serde_json::{Value, json};

use super::{Page, Station};
use crate::published::{DeviceState, PublishedPose};

/// Times of poses that are remembered for a browser between two messages.
pub(super) const TIMINGS_MAX: usize = 64;

/// A foot with less than this does not stand, N.
const FORCE_N_MIN: f32 = 5.0;

/// When a pose was published: how old its newest measurement was, and how long after the pose
/// before, ms.
pub(super) type Timing = [f32; 2];

/// A pose, little-endian: sequence number (u32), quality, tracker, number of devices and of timings
/// (u8 each), target time (f64, seconds), number of contacts and of things (u16 each); 22 joints in
/// the world, each position and quaternion (7 f32); the devices, each role, lookup, tracking and a
/// zero (u8 each), position and quaternion; the timings, two f32 each; the contacts of the feet with
/// the ground, each position and force in newtons (6 f32); the things in the scene, each position,
/// quaternion and whether the body touches it (u32). Devices are where the sensors of the body parts
/// are worn.
pub(super) fn pose(pose: &PublishedPose, mounts: &Mounts, timings: &[Timing]) -> Vec<u8> {
    let devices: Vec<_> = Role::ALL
        .into_iter()
        .filter_map(|role| Some((role, how(&pose.parts[role as usize])?)))
        .collect();
    let contacts = contacts(pose);
    let timings = &timings[timings.len().saturating_sub(TIMINGS_MAX)..];
    let things = pose.objects.len() * 32;
    let lists = devices.len() * 32 + timings.len() * 8 + contacts.len() * 24 + things;
    let mut bytes = Vec::with_capacity(20 + 22 * 28 + lists);
    // The browser only looks whether it grows.
    bytes.extend((pose.sequence as u32).to_le_bytes());
    let counts = [devices.len() as u8, timings.len() as u8];
    bytes.extend([pose.quality as u8, pose.kind as u8]);
    bytes.extend(counts);
    bytes.extend((pose.target_at.0 as f64 * 1e-9).to_le_bytes());
    bytes.extend((contacts.len() as u16).to_le_bytes());
    bytes.extend((pose.objects.len() as u16).to_le_bytes());
    let joints = pose.joints.positions.iter().zip(&pose.joints.rotations);
    for (position, rotation) in joints {
        floats(&mut bytes, &position.to_array());
        floats(&mut bytes, &rotation.to_array());
    }
    for (role, (lookup, part)) in devices {
        let device = mounts.get(role).device_pose(&part);
        bytes.extend([role as u8, lookup, device.how as u8, 0]);
        floats(&mut bytes, &device.position.to_array());
        floats(&mut bytes, &device.rotation.to_array());
    }
    for timing in timings {
        floats(&mut bytes, timing);
    }
    for foot in contacts {
        floats(&mut bytes, &foot.centre.to_array());
        floats(&mut bytes, &foot.force.to_array());
    }
    for object in pose.objects.iter() {
        floats(&mut bytes, &object.position.to_array());
        floats(&mut bytes, &object.rotation.to_array());
        bytes.extend(u32::from(object.touched).to_le_bytes());
    }
    bytes
}

/// The feet that the ground carries.
fn contacts(pose: &PublishedPose) -> Vec<FootForce> {
    let feet = pose.forces.iter().flat_map(|forces| forces.feet);
    feet.filter(|foot| foot.force.length() > FORCE_N_MIN)
        .collect()
}

fn floats(bytes: &mut Vec<u8>, values: &[f32]) {
    bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
}

/// How a part's pose was made, as a number; `None` where there is none.
fn how(part: &Lookup<Pose>) -> Option<(u8, Pose)> {
    match *part {
        Lookup::Exact(pose) => Some((0, pose)),
        Lookup::Interpolated(pose) => Some((1, pose)),
        Lookup::Extrapolated { value, .. } => Some((2, value)),
        Lookup::Stale { value, .. } => Some((3, value)),
        Lookup::Empty => None,
    }
}

/// What does not change while the page is open.
pub(super) fn hello(page: &Page) -> Value {
    json!({ "hello": {
        "version": env!("CARGO_PKG_VERSION"),
        "parents": skeleton::PARENTS,
        "roles": Role::ALL.map(Role::name),
        "tracker_names": TrackerKind::ALL.map(TrackerKind::name),
        "trackers": page.services.control.trackers().iter().map(|kind| kind.name()).collect::<Vec<_>>(),
        "rate_hz": page.rate_hz,
        "objects": page.services.control.objects(),
    }})
}

/// A device, as the page lists it.
#[derive(Debug, Serialize)]
struct Device<'a> {
    id: u8,
    serial: &'a str,
    model: &'a str,
    role: &'static str,
    connected: bool,
    charge: Option<f32>,
    charging: bool,
    rate_hz: f32,
    tracked_share: f32,
    packets: u64,
    errors: u64,
    dropped: u64,
    how: Option<&'static str>,
    residual_rad: Option<f32>,
    troubles: Vec<String>,
}

impl<'a> From<&'a DeviceState> for Device<'a> {
    fn from(state: &'a DeviceState) -> Self {
        Self {
            id: state.id.0,
            serial: state.serial.as_str(),
            model: &state.model,
            role: state.role.name(),
            connected: state.connected,
            charge: state.battery.map(|battery| battery.charge),
            charging: state.battery.is_some_and(|battery| battery.charging),
            rate_hz: state.rate_hz,
            tracked_share: state.tracked_share,
            packets: state.packets,
            errors: state.errors,
            dropped: state.dropped,
            how: state.pose.map(|pose| pose.how.name()),
            residual_rad: state.pose.map(|pose| pose.residual_rad),
            troubles: state.troubles.iter().map(ToString::to_string).collect(),
        }
    }
}

/// What changes a few times a second.
pub(super) fn status(page: &Page) -> Value {
    use std::sync::atomic::Ordering::Relaxed;
    let states = page.services.devices.borrow();
    let devices: Vec<_> = states.iter().map(Device::from).collect();
    let stations: Vec<_> = page
        .room
        .with(|room| room.stations().map(Station::from).collect());
    let ticks = page.ticks.as_ref().map(|shared| {
        json!({
            "done": shared.ticks.load(Relaxed),
            "late": shared.late_ticks.load(Relaxed),
            "lateness_max_ms": shared.lateness_max_ns.load(Relaxed) as f64 * 1e-6,
            "real_time": shared.real_time.load(Relaxed),
        })
    });
    json!({ "status": {
        "height_m": page.services.control.heights().wearer,
        "devices": devices,
        "stations": stations,
        "ticks": ticks,
        "recoveries": page.services.hub.latest().and_then(|pose| pose.recoveries).map(|counts| {
            json!({ "falls": counts.falls, "drifts": counts.drifts, "faults": counts.faults })
        }),
        "starts": *page.services.control.resets().borrow(),
        "recording": page.services.recorder.recording().map(|recording| json!({
            "poses": recording.poses,
            "error": recording.error,
        })),
        "replay": page.playback.as_ref().map(|playback| playback.position()),
    }})
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use posed_signal::HostTime;
    use posed_tracker::Wearer;

    use super::*;
    use crate::published::tests::pose_at;

    #[test]
    fn a_pose_is_laid_out_as_said() {
        let wearer = Wearer::of_height(1.75);
        let published = pose_at(7, HostTime(2_500_000_000));
        let timings = [[4.5, 11.0], [4.25, 12.0]];
        let bytes = pose(&published, &Mounts::index(&wearer), &timings);
        let float = |at: usize| f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
        let vector = |at: usize| Vec3::new(float(at), float(at + 4), float(at + 8));
        assert_eq!(bytes.len(), 20 + 22 * 28 + 3 * 32 + 2 * 8 + 2 * 24 + 32);
        assert_eq!((&bytes[..4], bytes[4], bytes[5]), (&[7, 0, 0, 0][..], 3, 0));
        assert_eq!(bytes[6..8], [3, 2], "three devices, two timings");
        assert_eq!(f64::from_le_bytes(bytes[8..16].try_into().unwrap()), 2.5);
        assert_eq!(
            bytes[16..20],
            [2, 0, 1, 0],
            "both feet stand, one thing lies there"
        );
        for joint in 0..22 {
            assert_eq!(vector(20 + joint * 28), published.joints.positions[joint]);
            assert_eq!(
                float(20 + joint * 28 + 24),
                published.joints.rotations[joint].w
            );
        }
        let devices = 20 + 22 * 28;
        assert_eq!(
            bytes[devices..devices + 4],
            [1, 2, 0, 0],
            "head, extrapolated, lost"
        );
        assert_eq!(
            bytes[devices + 64..devices + 66],
            [3, 3],
            "right hand, stale"
        );
        let head = published.parts[1].value().unwrap().position;
        assert!(
            vector(devices + 4).y > head.y,
            "the headset is above the head joint"
        );
        let timing = devices + 3 * 32;
        assert_eq!([float(timing), float(timing + 12)], [4.5, 12.0]);
        let feet = published.forces.unwrap().feet;
        let foot = timing + 2 * 8;
        assert_eq!(
            (vector(foot), vector(foot + 12)),
            (feet[0].centre, feet[0].force)
        );
        assert_eq!(vector(foot + 24), feet[1].centre);
        let thing = foot + 2 * 24;
        assert_eq!(vector(thing), published.objects[0].position);
        assert_eq!(float(thing + 24), published.objects[0].rotation.w);
        assert_eq!(bytes[thing + 28..], [0; 4], "untouched");
    }

    #[test]
    fn only_the_newest_timings_are_sent() {
        let published = pose_at(2, HostTime(1));
        let timings: Vec<_> = (0..100).map(|index| [index as f32, 0.0]).collect();
        let bytes = pose(&published, &Mounts::IDENTITY, &timings);
        assert_eq!(usize::from(bytes[7]), TIMINGS_MAX);
        let things = 32 * published.objects.len();
        let last = bytes.len() - 8 - things;
        assert_eq!(bytes[last..last + 4], 99f32.to_le_bytes());
    }
}
