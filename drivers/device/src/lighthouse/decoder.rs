//! The decoders behind [`super::decoder()`]: packets in, samples in host time out.

use glam::DVec3;
use posed_signal::{ClockMap, HostTime, Imu, Pose, PoseHow, Role, Sample, upright::Upright};

use super::{
    Settings, Variant,
    input::{self, InputState, WiredInput},
    light::{Light, Seen},
    model::{DeviceModel, ImuRange},
    motion::ImuSample,
    outlook::Outlook,
    output::{self, Output, Reach},
    reader::{Event, Reader},
    room::{Handle, Room},
    solve::Sighting,
    startup::Startup,
    track::Track,
    wire::{RawImu, TICKS_PER_SECOND},
};
use crate::{
    decode::{Command, DecodeError, Decoder, Emit},
    haptic::Haptic,
    trouble::Trouble,
    usb::Packet,
};

/// The one device that hangs on a Lighthouse USB device.
const UNIT: usize = 0;
/// Poses come no faster than this, s: a headset's every other inertial sample.
const POSE_INTERVAL: f64 = 0.0018;
/// While a device is lost its last pose is repeated no faster than this, s.
const LOST_INTERVAL: f64 = 0.02;
/// The room is told what a device sees this often, s.
const SNAPSHOT_INTERVAL: f64 = 0.25;
/// A step of the device's clock that the host's did not see is a restart, s.
const CLOCK_STEP: f64 = 0.25;

/// A tracked device, wired or by radio.
pub(super) struct Device {
    variant: Variant,
    reader: Reader,
    events: Vec<Event>,
    startup: Startup,
    settings: Settings,
    range: ImuRange,
    clock: ClockMap,
    light: Light,
    unit: Option<Unit>,
    /// Device and host time of the newest inertial sample, s.
    newest: Option<(f64, HostTime)>,
    /// Device time of the newest pose, s.
    posed: f64,
}

/// What is there once the configuration is known.
struct Unit {
    track: Track,
    input: InputState,
    /// The room as the track knows it: its revision and its world.
    room: (u64, u64),
    /// No snapshot before this device time, s.
    snapshot_after: f64,
    upright: Upright,
    outlook: Outlook,
}

impl Device {
    pub(super) fn new(variant: Variant, settings: &Settings) -> Self {
        Self {
            variant,
            reader: Reader::default(),
            events: Vec::new(),
            startup: Startup::new(variant),
            settings: settings.shared(),
            range: variant.range(),
            clock: ClockMap::new(TICKS_PER_SECOND),
            light: Light::default(),
            unit: None,
            newest: None,
            posed: f64::NEG_INFINITY,
        }
    }

    fn event(
        &mut self,
        event: &Event,
        at: HostTime,
        out: &mut dyn Emit,
    ) -> Result<(), DecodeError> {
        self.startup.event(event, at);
        match event {
            Event::Imu { ticks, raw } => self.imu(*ticks, raw, at, out),
            Event::Sync { .. } | Event::Sweep { .. } | Event::Pulse { .. } => self.light(event),
            Event::Configuration(text) => return self.configure(text, out),
            Event::Ranges(gyro, accel) => {
                self.range = ImuRange::from_codes(*gyro, *accel).unwrap_or(self.range);
            }
            Event::Battery(byte) | Event::Wired(WiredInput::Battery(byte)) => {
                out.sample(UNIT, Sample::Battery(input::battery(*byte, at)));
            }
            Event::Radio(input) => {
                if let Some(unit) = &mut self.unit {
                    out.sample(UNIT, Sample::Buttons(unit.input.radio(input, at)));
                }
            }
            Event::Wired(input) => {
                let buttons = self
                    .unit
                    .as_mut()
                    .and_then(|unit| unit.input.wired(input, at));
                if let Some(buttons) = buttons {
                    out.sample(UNIT, Sample::Buttons(buttons));
                }
            }
            Event::Off => self.off(at, out),
            Event::RawBeams
            | Event::Mainboard(_)
            | Event::RadioPacket
            | Event::ConfigurationProgress => {}
        }
        Ok(())
    }

    pub(super) fn configure(&mut self, text: &str, out: &mut dyn Emit) -> Result<(), DecodeError> {
        let model = DeviceModel::from_json(text)?;
        if self
            .unit
            .as_ref()
            .is_some_and(|unit| unit.track.model().identity == model.identity)
        {
            return Ok(());
        }
        self.range = model.range;
        out.identity(UNIT, model.identity);
        let input = InputState::new(model.controls);
        let mut outlook = Outlook::default();
        let (stations, room) = self.settings.room.with(|room| {
            outlook.follow(room, true);
            (room.placed(), (room.revision(), room.world()))
        });
        self.unit = Some(Unit {
            track: Track::new(model, stations),
            input,
            room,
            snapshot_after: f64::NEG_INFINITY,
            upright: Upright::default(),
            outlook,
        });
        Ok(())
    }

    fn imu(&mut self, ticks: u64, raw: &RawImu, at: HostTime, out: &mut dyn Emit) {
        let time = ticks as f64 / TICKS_PER_SECOND;
        if let Some((newest, seen)) = self.newest.replace((time, at)) {
            let step = time - newest;
            if step.abs() > CLOCK_STEP && (step - at.since_secs(seen)).abs() > CLOCK_STEP {
                // The device restarted. The very first sample often stems from before that.
                self.clock = ClockMap::new(TICKS_PER_SECOND);
            }
            if step < 0.0 {
                self.posed = f64::NEG_INFINITY;
            }
        }
        self.clock.observe(ticks, at);
        let (Some(unit), Some(stamp)) = (&mut self.unit, self.clock.stamp(ticks)) else {
            return;
        };
        let calibration = &unit.track.model().imu;
        let sample = ImuSample::new(time, raw, self.range, calibration);
        unit.outlook.pass(time);
        unit.follow(&self.settings.room);
        unit.track.imu(sample);
        unit.survey(time, &self.settings.room);
        let (gyro, accel) = unit.track.unbiased(&sample);
        out.sample(
            UNIT,
            Sample::Imu(Imu {
                at: stamp,
                accel: accel.as_vec3(),
                gyro: gyro.as_vec3(),
            }),
        );
        if time - self.posed < POSE_INTERVAL {
            return;
        }
        let Some(found) = unit.track.output() else {
            return;
        };
        if found.how == PoseHow::Lost && time - self.posed < LOST_INTERVAL {
            return;
        }
        self.posed = time;
        let pose = Pose {
            at: stamp,
            position: found.position.as_vec3(),
            rotation: found.rotation.as_quat(),
            velocity: found.velocity.as_vec3(),
            angular_velocity: found.angular_velocity.as_vec3(),
            residual_rad: found.residual as f32,
            how: found.how,
        };
        if pose.is_sound() {
            out.sample(UNIT, Sample::Pose(pose));
        }
    }

    fn light(&mut self, event: &Event) {
        let Self {
            light,
            settings,
            unit,
            ..
        } = self;
        light.event(event, &mut |seen| match seen {
            Seen::Sweep(sweep) => {
                if let Some(unit) = unit.as_mut() {
                    unit.outlook.swept(sweep.source);
                    unit.track.sighting(Sighting {
                        time: sweep.ticks / TICKS_PER_SECOND,
                        station: sweep.source.index() as u8,
                        plane: sweep.plane,
                        sensor: sweep.sensor,
                        angle: sweep.angle,
                    });
                }
            }
            Seen::Broadcast(source, broadcast) => {
                settings.room.with(|room| room.heard(source, &broadcast));
            }
            Seen::Shared(source) => {
                if let Some(unit) = unit.as_mut() {
                    unit.outlook.shared(source);
                }
            }
        });
    }

    /// The device was switched off: its last pose is the last.
    fn off(&mut self, at: HostTime, out: &mut dyn Emit) {
        let Some(unit) = &mut self.unit else { return };
        if let Some(last) = unit.track.output() {
            let position = last.position.as_vec3();
            let rotation = last.rotation.as_quat();
            let pose = Pose {
                position,
                rotation,
                ..Pose::unknown(at)
            };
            if pose.is_sound() {
                out.sample(UNIT, Sample::Pose(pose));
            }
        }
        unit.track.reset();
    }
}

impl Unit {
    /// Takes over what became known about the room.
    fn follow(&mut self, room: &Handle) {
        room.with(|room| {
            if self.room == (room.revision(), room.world()) {
                return;
            }
            if self.room.1 != room.world() {
                let by = room.carried().filter(|_| self.room.1 + 1 == room.world());
                self.track.carry(by.as_ref());
                self.upright = Upright::default();
            }
            self.track.set_stations(room.placed());
            self.room = (room.revision(), room.world());
        });
    }

    /// Tells the room what the device sees of it.
    fn survey(&mut self, time: f64, room: &Handle) {
        if time < self.snapshot_after && time > self.snapshot_after - 2.0 * SNAPSHOT_INTERVAL {
            return;
        }
        self.snapshot_after = time + SNAPSHOT_INTERVAL;
        room.with(|room| self.tell(time, room));
    }

    fn tell(&mut self, time: f64, room: &mut Room) {
        self.outlook.set_astray(self.track.is_astray(time));
        if let Some(source) = self.track.take_suspect() {
            room.disagrees(source);
        }
        self.outlook.follow(room, false);
        if room.is_given() {
            return;
        }
        if let Some(snapshot) = self.track.snapshot() {
            if self.track.is_astray(time) {
                room.contradicts(&snapshot);
            }
            room.offer(snapshot);
        }
        let head = self.track.model().identity.natural_role == Role::Head;
        if let Some((frame, rate)) = self
            .track
            .head_now()
            .filter(|_| head && room.wants_upright())
        {
            let lean = (frame.rotation * DVec3::Y).angle_between(DVec3::Y);
            if let Some(eyes) = self.upright.watch(time, frame.position.y, lean, rate) {
                room.upright(eyes);
            }
        }
    }
}

impl Decoder for Device {
    fn packet(&mut self, packet: &Packet, out: &mut dyn Emit) -> Result<(), DecodeError> {
        let mut events = std::mem::take(&mut self.events);
        let mut result = self.reader.packet(packet, &mut events);
        for event in events.drain(..) {
            let done = self.event(&event, packet.at, out);
            result = result.and(done);
        }
        self.events = events;
        result
    }

    fn tick(&mut self, now: HostTime, commands: &mut Vec<Command>) {
        self.startup.tick(now, commands);
    }

    fn troubles(&self, _unit: usize, troubles: &mut Vec<Trouble>) {
        if let Some(unit) = &self.unit {
            unit.outlook.troubles(troubles);
        }
    }

    fn buzz(&mut self, _unit: usize, haptic: &Haptic, commands: &mut Vec<Command>) -> bool {
        let unit = self.unit.as_ref();
        let can = unit.is_some_and(|unit| unit.track.model().identity.has_haptics);
        if can {
            let reach = match self.variant {
                Variant::Watchman => Reach::Radio,
                Variant::Wired(_) | Variant::Mainboard => Reach::Wired,
            };
            commands.push(output::haptic(reach, haptic).command());
        }
        can
    }
}

/// A Vive's mainboard: it has to be told to power up, and says nothing about tracking.
#[derive(Debug, Default)]
pub(super) struct Mainboard {
    powered: bool,
}

impl Decoder for Mainboard {
    fn packet(&mut self, _packet: &Packet, _out: &mut dyn Emit) -> Result<(), DecodeError> {
        Ok(())
    }

    fn tick(&mut self, _now: HostTime, commands: &mut Vec<Command>) {
        if !self.powered {
            commands.push(Output::Power(true).command());
            self.powered = true;
        }
    }
}
