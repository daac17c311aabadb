//! From reports to samples.

use glam::Vec3;
use posed_signal::{Battery, Buttons, ClockMap, HostTime, Imu, Role, Sample, Serial};

use super::{
    calibration::{Calibration, Flash, Origin},
    start::{Missing, Start},
    wire::{self, Common, ImuMode, Input, RawImu, Reply},
};
use crate::{
    decode::{Command, DecodeError, Decoder, Emit, Identity},
    fusion::Fusion,
    usb::{Packet, Transfer},
};

/// The device is the only unit behind its link.
const UNIT: usize = 0;
/// The timer counts so many steps a second; a sample is one step.
const TIMER_HZ: f64 = 200.0;
/// In a report, one tick apart where reports come as they should.
const SAMPLES: u64 = 3;
/// Battery is told this often.
const TOLD_NS: i64 = 500_000_000;
/// A stick's middle and its reach, counts: no device is calibrated better than this unseen.
const STICK: (f32, f32) = (2_048.0, 1_500.0);

/// Which of the three it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// For the left hand.
    Left,
    /// For the right hand.
    Right,
    /// For both.
    Pro,
}

impl Kind {
    /// By the number in the device's answer.
    fn of(number: u8) -> Option<Self> {
        match number {
            1 => Some(Self::Left),
            2 => Some(Self::Right),
            3 => Some(Self::Pro),
            _ => None,
        }
    }

    /// For people.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Left => "Joy-Con (left)",
            Self::Right => "Joy-Con (right)",
            Self::Pro => "Pro Controller",
        }
    }
}

/// What the device says it is: subcommand 0x02's answer.
#[must_use]
pub fn device_info(data: &[u8]) -> Option<(Kind, Serial)> {
    let kind = Kind::of(*data.get(2)?)?;
    let address: &[u8; 6] = data.get(4..)?.first_chunk()?;
    let digits: String = address.iter().map(|byte| format!("{byte:02X}")).collect();
    Some((kind, Serial::new(&digits)))
}

/// Follows which mode the inertial sensors are in: asked for by an output report, in force when
/// the device has agreed. In between nobody knows.
#[derive(Debug, Clone, Copy, Default)]
pub struct ModeWatch {
    mode: ImuMode,
    asked: Option<ImuMode>,
}

impl ModeWatch {
    /// An output report went to the device.
    pub fn output(&mut self, report: &[u8]) {
        if let Some(asked) = wire::imu_request(report) {
            self.asked = Some(asked);
            if asked != self.mode {
                self.mode = ImuMode::Unknown;
            }
        }
    }

    /// The device answered.
    pub fn reply(&mut self, reply: &Reply<'_>) {
        if reply.subcommand == wire::SET_IMU
            && reply.accepted
            && let Some(asked) = self.asked.take()
        {
            self.mode = asked;
        }
    }

    /// The mode in force.
    #[must_use]
    pub fn mode(&self) -> ImuMode {
        self.mode
    }
}

/// Extends the 8-bit timer; where it may have wrapped several times, host time tells how often.
#[derive(Debug, Clone, Copy, Default)]
struct Timer {
    last: Option<(u64, HostTime)>,
}

impl Timer {
    fn extend(&mut self, timer: u8, at: HostTime) -> u64 {
        let extended = match self.last {
            None => 1 << 16 | u64::from(timer),
            Some((last, seen)) => {
                let step = u64::from(timer.wrapping_sub(last as u8));
                let passed = (at.since_secs(seen) * TIMER_HZ).max(0.0);
                let wraps = ((passed - step as f64) / 256.0).round().max(0.0);
                last + step + 256 * wraps as u64
            }
        };
        self.last = Some((extended, at));
        extended
    }
}

/// A Joy-Con or Pro Controller.
pub(super) struct Device {
    kind: Option<Kind>,
    mode: ModeWatch,
    flash: Flash,
    calibration: Calibration,
    timer: Timer,
    clock: ClockMap,
    fusion: Fusion,
    start: Start,
    heard: bool,
    full_reports: bool,
    battery_told: Option<HostTime>,
    buttons: [u8; 3],
}

impl Default for Device {
    fn default() -> Self {
        Self {
            kind: None,
            mode: ModeWatch::default(),
            flash: Flash::default(),
            calibration: Calibration::default(),
            timer: Timer::default(),
            clock: ClockMap::new(TIMER_HZ * SAMPLES as f64),
            fusion: Fusion::new(1.0 / TIMER_HZ),
            start: Start::default(),
            heard: false,
            full_reports: false,
            battery_told: None,
            buttons: [0; 3],
        }
    }
}

impl Decoder for Device {
    fn packet(&mut self, packet: &Packet, out: &mut dyn Emit) -> Result<(), DecodeError> {
        if packet.transfer != Transfer::Interrupt {
            return Ok(());
        }
        if !packet.is_input() {
            self.mode.output(&packet.data);
            return Ok(());
        }
        self.heard = true;
        match wire::input(&packet.data)? {
            Input::Full(common, samples) => {
                self.full_reports = true;
                self.common(packet.at, &common, out);
                self.inertial(packet.at, common.timer, &samples, out);
            }
            Input::Reply(common, reply) => {
                self.common(packet.at, &common, out);
                self.reply(&reply, out);
            }
            Input::Other => {}
        }
        Ok(())
    }

    fn tick(&mut self, now: HostTime, commands: &mut Vec<Command>) {
        let origin = self.flash.calibration().1;
        let missing = Missing {
            identity: self.kind.is_none(),
            factory: origin == Origin::Usual && !self.flash.is_complete(),
            user: !self.flash.is_complete(),
            imu: self.mode.mode() != ImuMode::Raw,
            reports: !self.full_reports,
        };
        self.start.tick(now, self.heard, missing, commands);
    }
}

impl Device {
    fn reply(&mut self, reply: &Reply<'_>, out: &mut dyn Emit) {
        self.mode.reply(reply);
        if !reply.accepted {
            return;
        }
        match reply.subcommand {
            wire::DEVICE_INFO => {
                if let Some((kind, serial)) = device_info(reply.data) {
                    self.kind = Some(kind);
                    let identity = Identity {
                        serial,
                        model: kind.name(),
                        natural_role: Role::None,
                        has_haptics: false,
                    };
                    out.identity(UNIT, identity);
                }
            }
            wire::FLASH_READ => {
                self.flash.take(reply.data);
                self.calibration = self.flash.calibration().0;
            }
            _ => {}
        }
    }

    /// The three samples of a report, oldest first; the timer stands for the newest. Without a
    /// gyroscope, which packed rotations take the place of, there is no inertial sample.
    fn inertial(&mut self, at: HostTime, timer: u8, samples: &[RawImu; 3], out: &mut dyn Emit) {
        let before = self.timer.last.map_or(0, |(ticks, _)| ticks);
        let ticks = self.timer.extend(timer, at);
        // Thirds of a tick: a report that follows sooner than its samples' 15 ms holds them closer
        // together, so that none is older than the last of the report before.
        let apart = (ticks - before).min(SAMPLES);
        let ticks = ticks * SAMPLES;
        self.clock.observe(ticks, at);
        if self.mode.mode() != ImuMode::Raw {
            return;
        }
        for (age, raw) in [2, 1, 0].into_iter().zip(samples) {
            let Some(at) = self
                .clock
                .stamp(ticks - age * apart)
                .filter(|_| !raw.is_empty())
            else {
                continue;
            };
            let imu = Imu {
                at,
                accel: self.turned(self.calibration.acceleration(raw)),
                gyro: self.turned(self.calibration.angular_velocity(raw)),
            };
            out.sample(UNIT, Sample::Imu(imu));
            out.sample(UNIT, Sample::Orientation(self.fusion.update(&imu)));
        }
    }

    /// The right Joy-Con's sensor lies half a turn about x from the left one's: here both have
    /// the left one's frame.
    fn turned(&self, vector: Vec3) -> Vec3 {
        match self.kind {
            Some(Kind::Right) => Vec3::new(vector.x, -vector.y, -vector.z),
            _ => vector,
        }
    }

    fn common(&mut self, at: HostTime, common: &Common, out: &mut dyn Emit) {
        let due = self
            .battery_told
            .is_none_or(|told| !(0..TOLD_NS).contains(&at.since_ns(told)));
        if due {
            self.battery_told = Some(at);
            let quarters = f32::from(common.battery >> 5).min(4.0);
            let battery = Battery {
                at,
                charge: quarters / 4.0,
                charging: common.battery & 0x10 != 0,
            };
            out.sample(UNIT, Sample::Battery(battery));
        }
        if common.buttons != std::mem::replace(&mut self.buttons, common.buttons) {
            out.sample(UNIT, Sample::Buttons(self.state(at, common)));
        }
    }

    fn state(&self, at: HostTime, common: &Common) -> Buttons {
        let [right, both, left] = common.buttons;
        let of_left = self.kind == Some(Kind::Left);
        let hand = if of_left { left } else { right };
        let bit = |byte: u8, bit: u8, button: u32| if byte & bit != 0 { button } else { 0 };
        let [menu, stick, system] = if of_left {
            [0x01, 0x08, 0x20]
        } else {
            [0x02, 0x04, 0x10]
        };
        let pressed = bit(right, 0x08, Buttons::A)
            | bit(right, 0x04, Buttons::B)
            | bit(hand, 0x40, Buttons::SQUEEZE)
            | bit(hand, 0x80, Buttons::TRIGGER)
            | bit(both, menu, Buttons::MENU)
            | bit(both, stick, Buttons::THUMBSTICK)
            | bit(both, system, Buttons::SYSTEM);
        let axis = |counts: u16| ((f32::from(counts) - STICK.0) / STICK.1).clamp(-1.0, 1.0);
        let share = |button: u32| if pressed & button != 0 { 1.0 } else { 0.0 };
        Buttons {
            at,
            pressed,
            touched: 0,
            trigger: share(Buttons::TRIGGER),
            squeeze: share(Buttons::SQUEEZE),
            stick: common.sticks[usize::from(!of_left)].map(axis),
        }
    }
}
