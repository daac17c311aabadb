//! `posed setup`: where the floor is and which way is ahead.
//!
//! Light and accelerometers tell base stations' places and what is level, but neither the floor's
//! height nor a heading. The headset tells both: first it lies on the floor, then its wearer looks
//! ahead.

use std::sync::{Arc, atomic::AtomicBool, atomic::Ordering};

use glam::{DQuat, DVec3};
use posed_device::{
    lighthouse::room::Handle,
    rig::{DeviceInfo, Rig},
    transport::{Event, Merge, Replay, Transport},
};
use posed_signal::{Clock as _, HostTime, Pose, PoseHow, Role};

use super::{CommandError, live, replay, settings};
use crate::{cli::SetupArgs, clock::Monotonic, room};

/// The headset has to be held still for so long, s, within this, m and rad.
const STILL_S: f64 = 1.5;
const STILL: (f64, f64) = (0.01, 0.03);
/// A wearer stands still less well.
const WORN: (f64, f64) = (0.06, 0.15);
/// A worn headset is at least so high over the floor, m, and looks no farther up or down, rad.
const WORN_HEIGHT: f64 = 0.8;
const LEVEL: f64 = 0.5;
/// The longest wait for an event, ns.
const WAIT_NS: u64 = 20_000_000;
/// Decoders are ticked this often, ns.
const TICK_NS: i64 = 50_000_000;

/// What the wearer has to do next.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Step {
    Floor,
    Ahead,
    Done,
}

/// The set-up as a state machine over the headset's poses.
#[derive(Debug)]
pub struct Setup {
    room: Handle,
    step: Step,
    /// Where and since when the headset has been still.
    still: Option<(Pose, HostTime)>,
}

impl Setup {
    /// Sets `room` up.
    #[must_use]
    pub fn new(room: Handle) -> Self {
        Self {
            room,
            step: Step::Floor,
            still: None,
        }
    }

    /// What the wearer has to do now; `None` when all is done.
    #[must_use]
    pub fn asks(&self) -> Option<&'static str> {
        match self.step {
            Step::Floor => Some(
                "Put the headset on the floor, in the middle of the room, where base stations see it.",
            ),
            Step::Ahead => Some("Put it on, stand in the middle of the room and look ahead."),
            Step::Done => None,
        }
    }

    /// Takes a pose of the headset; answers whether a step was done.
    pub fn pose(&mut self, pose: &Pose) -> bool {
        let (metres, radians) = if self.step == Step::Floor {
            STILL
        } else {
            WORN
        };
        let goes_on = self.still.is_some_and(|(first, _)| {
            (first.position - pose.position).length() < metres as f32
                && first.rotation.angle_between(pose.rotation) < radians as f32
        });
        if pose.how != PoseHow::Optical || !goes_on {
            self.still = (pose.how == PoseHow::Optical).then_some((*pose, pose.at));
            return false;
        }
        let Some((_, since)) = self.still else {
            return false;
        };
        if pose.at.since_secs(since) < STILL_S {
            return false;
        }
        let (position, rotation) = (pose.position.as_dvec3(), pose.rotation.as_dquat());
        self.still = None;
        match self.step {
            Step::Floor => self.floor(position, rotation),
            Step::Ahead => self.ahead(position, rotation),
            Step::Done => false,
        }
    }

    fn floor(&mut self, position: DVec3, rotation: DQuat) -> bool {
        self.room.with(|room| {
            let height = position.y + room.lowest(rotation);
            room.set_floor(height);
        });
        self.step = Step::Ahead;
        true
    }

    fn ahead(&mut self, position: DVec3, rotation: DQuat) -> bool {
        let gaze = rotation * DVec3::NEG_Z;
        if position.y < WORN_HEIGHT || gaze.y.abs() > LEVEL.sin() {
            return false;
        }
        self.room.with(|room| room.set_heading(position, rotation));
        self.step = Step::Done;
        true
    }
}

/// Asks for both steps, and keeps the room.
///
/// # Errors
/// Base stations are given by a file, a device or the state directory cannot be had, or the set-up
/// was broken off.
pub fn run(args: &SetupArgs) -> Result<(), CommandError> {
    let config = settings::configuration(&args.body)?;
    if config.devices.base_stations.is_some() {
        return Err(CommandError::Input(
            "base stations are given by a file, floor and heading with them: leave \
             devices.base_stations and --base-stations out for posed to find its own"
                .into(),
        ));
    }
    let path = match &args.out {
        Some(path) => path.clone(),
        None => room::path().ok_or_else(|| {
            CommandError::Input(
                "neither XDG_STATE_HOME nor HOME is set: name a file by --out".into(),
            )
        })?,
    };
    let options = settings::options(&config)?;
    let handle = options.rig.devices.lighthouse.room.clone();
    let (transport, stop): (Box<dyn Transport>, _) = if args.files.is_empty() {
        settings::take_kept_room(&handle, &path);
        live::transport()?
    } else {
        let recordings = args.files.iter().map(|path| replay::recording(path));
        let recordings = recordings.collect::<Result<Vec<_>, _>>()?;
        let replay: Box<dyn Transport> = Box::new(Replay::new(recordings, Merge::OneSession));
        (replay, Arc::new(AtomicBool::new(false)))
    };
    let (rig, _rings) = Rig::new(options.rig);
    follow(transport, rig, Setup::new(handle.clone()), &stop)?;
    let stored = handle.with(|room| room.to_store());
    room::save(&path, &stored)?;
    println!("The room is set up: {}", path.display());
    Ok(())
}

fn follow(
    mut transport: Box<dyn Transport>,
    mut rig: Rig,
    mut setup: Setup,
    stop: &AtomicBool,
) -> Result<(), CommandError> {
    let mut asked = None;
    let mut commands = Vec::new();
    let mut next_tick = HostTime(0);
    let mut newest = HostTime(0);
    while let Some(asks) = setup.asks() {
        if asked != Some(asks) {
            println!("{asks}");
            asked = Some(asks);
        }
        if stop.load(Ordering::Relaxed) {
            return Err(CommandError::Input("the set-up was broken off".into()));
        }
        match transport.next(WAIT_NS) {
            Event::Attached { port, id } => rig.attach(port, id),
            Event::Detached { port } => rig.detach(port),
            Event::Packet(packet) => rig.packet(&packet),
            Event::Warning(warning) => eprintln!("warning: {warning}"),
            Event::Idle => {}
            Event::End => {
                return Err(CommandError::Input(
                    "the capture ended before the set-up was done".into(),
                ));
            }
        }
        let now = Monotonic.now();
        if now >= next_tick {
            next_tick = now.plus_ns(TICK_NS);
            rig.tick(now, &mut commands);
            for (port, command) in commands.drain(..) {
                let _ = transport.send(port, &command);
            }
        }
        if let Some(pose) = headset(rig.devices()).filter(|pose| pose.at > newest) {
            newest = pose.at;
            setup.pose(&pose);
        }
    }
    Ok(())
}

fn headset(devices: &[DeviceInfo]) -> Option<Pose> {
    devices
        .iter()
        .find(|device| device.role == Role::Head && device.connected)?
        .pose
}

#[cfg(test)]
mod tests {
    use glam::{Quat, Vec3};

    use super::*;

    fn hold(setup: &mut Setup, begin: f64, position: Vec3, rotation: Quat) -> bool {
        (0..200).any(|n| {
            let at = HostTime::from_secs_f64(begin + 0.01 * f64::from(n));
            setup.pose(&Pose {
                position,
                rotation,
                how: PoseHow::Optical,
                ..Pose::unknown(at)
            })
        })
    }

    #[test]
    fn a_headset_on_the_floor_and_then_on_a_head_sets_the_room_up() {
        let room = Handle::default();
        let mut setup = Setup::new(room.clone());
        let lying = Quat::from_rotation_x(1.2);
        assert!(hold(&mut setup, 1.0, Vec3::new(0.5, 0.9, 0.2), lying));
        assert!(setup.asks().unwrap().contains("look ahead"));
        // The world has gone down by 0.9 m.
        let turned = Quat::from_rotation_y(0.7);
        assert!(
            !hold(&mut setup, 4.0, Vec3::new(0.5, 0.3, 0.2), turned),
            "it is not worn"
        );
        let down = turned * Quat::from_rotation_x(-1.0);
        assert!(
            !hold(&mut setup, 7.0, Vec3::new(0.5, 1.6, 0.2), down),
            "it looks down"
        );
        assert!(hold(&mut setup, 10.0, Vec3::new(0.5, 1.6, 0.2), turned));
        assert_eq!(setup.asks(), None);
        let carried = room.with(|room| room.carried()).unwrap();
        let ahead = carried.rotation * (turned * Vec3::NEG_Z).as_dvec3();
        assert!((ahead - DVec3::NEG_Z).length() < 1e-6);
        let place = carried.position + carried.rotation * DVec3::new(0.5, 1.6, 0.2);
        assert!((place - DVec3::Y * 1.6).length() < 1e-6);
    }

    #[test]
    fn a_headset_that_moves_or_is_not_seen_sets_nothing_up() {
        let mut setup = Setup::new(Handle::default());
        for n in 0..400u16 {
            let at = HostTime::from_secs_f64(f64::from(n) * 0.01);
            let position = Vec3::X * f32::from(n) * 1e-3;
            let how = PoseHow::Optical;
            assert!(!setup.pose(&Pose {
                position,
                how,
                ..Pose::unknown(at)
            }));
            assert!(!setup.pose(&Pose::unknown(at)));
        }
    }
}
