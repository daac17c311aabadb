//! Trackers that nobody has given a role get theirs from how the wearer moves.

use glam::Quat;
use posed_device::rig::{DeviceInfo, Rig};
use posed_signal::{HostTime, Role, Serial};
use posed_tracker::worn::naming::{Naming, ORDER, Progress};

/// A tracker that has said nothing for longer is not asked, ns.
const SILENT_NS: i64 = 500_000_000;

/// Watches inertial trackers without a role while there are as many as roles of the six that
/// PIP needs are free.
#[derive(Debug, Default)]
pub(super) struct Unnamed {
    trackers: Vec<Serial>,
    free: Vec<Role>,
    naming: Option<Naming>,
}

impl Unnamed {
    /// Takes the trackers' newest orientations, and gives them their roles as soon as these are
    /// known. Answers with what the wearer should be told.
    pub(super) fn tick(&mut self, now: HostTime, rig: &mut Rig) -> Option<String> {
        let inertial = |device: &&DeviceInfo| {
            let fresh = device
                .orientation
                .is_some_and(|orientation| now.since_ns(orientation.at) < SILENT_NS);
            fresh && device.pose.is_none()
        };
        let (trackers, rotations): (Vec<Serial>, Vec<Quat>) = rig
            .unassigned()
            .filter(inertial)
            .filter_map(|device| Some((device.identity.serial, device.orientation?.rotation)))
            .unzip();
        if trackers.len() < 2 {
            *self = Self::default();
            return None;
        }
        let worn = |role: &Role| {
            let mut devices = rig.devices().iter();
            devices.any(|device| device.connected && device.role == *role)
        };
        let free: Vec<Role> = ORDER.into_iter().filter(|role| !worn(role)).collect();
        if trackers.len() != free.len() {
            *self = Self::default();
            return None;
        }
        if self.trackers != trackers || self.free != free {
            self.naming = Some(Naming::new(&free));
            let text = invitation(&free);
            (self.trackers, self.free) = (trackers, free);
            return Some(text);
        }
        let naming = self.naming.as_mut()?;
        let known = naming.known();
        match naming.tick(now, &rotations) {
            Progress::Waiting => None,
            Progress::Found(role) => {
                tracing::info!(%role, "a tracker showed where it is worn");
                None
            }
            // Whoever has not begun just moves about.
            Progress::Refused(_) if known == 0 => None,
            Progress::Refused(problem) => Some(format!("trackers without a role: {problem}")),
            Progress::Done(roles) => {
                for (serial, role) in self.trackers.iter().zip(roles) {
                    tracing::info!(%serial, %role, "a tracker has its role from how it moved");
                    rig.assign(*serial, role);
                }
                *self = Self::default();
                None
            }
        }
    }
}

/// What the wearer is asked to do.
fn invitation(free: &[Role]) -> String {
    let moves: Vec<&str> = free[..free.len() - 1].iter().map(movement).collect();
    format!(
        "{} trackers have no role: name them in [devices.roles], or stand still and then, one after \
         the other with a second's rest between, {}",
        free.len(),
        moves.join(", "),
    )
}

fn movement(role: &Role) -> &'static str {
    match role {
        Role::LeftWrist => "bend the left elbow",
        Role::RightWrist => "bend the right elbow",
        Role::LeftKnee => "lift the left heel behind you",
        Role::RightKnee => "lift the right heel behind you",
        _ => "turn the head to one side and back",
    }
}
