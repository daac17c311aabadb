//! SlimeVR trackers behind one receiver: from the trackers' paths to the receiver's USB traffic.
//!
//! Each tracker measures with errors of its own, works out its orientation with the filter that
//! the firmware runs, and sends it in its time slot. The receiver counts what the radio loses,
//! fills reports as its firmware does (`hid.c`), and names its trackers in what is left of them.

use std::collections::VecDeque;

use glam::{DQuat, Quat};
use posed_signal::{HostTime, Imu, Orientation, Role, time::MILLISECOND_NS};

use super::{
    SimulateError, Truth,
    device::Path,
    imu::inertial,
    options::ImuNoise,
    random::{Purpose, Random},
    startup::{device_descriptor, get_descriptor},
};
use crate::{
    fusion::Fusion,
    simulate::Placement,
    slimevr::wire::{
        Content, Firmware, LinkStatus, Motion, PACKETS, Packet as Content16, Power, REPORT_BYTES,
        Signal, WORLD,
    },
    usb::{Packet, Port, Transfer, UsbId},
};

/// The receiver's ids.
pub const RECEIVER: UsbId = UsbId::new(0x1209, 0x7690);
/// At most this many trackers: the receiver's time slots.
pub const TRACKERS_MAX: usize = 10;

/// The sensors are read this often.
const IMU_INTERVAL_S: f64 = 0.005;
/// Motion is sent with every second reading: 100 times a second.
const READINGS_PER_MOTION: u64 = 2;
/// Turned less than this since the last packet, a tracker sends full precision, rad.
const STILL: f32 = 0.005;
/// Motion with battery is sent at least this often, and so is what the tracker is, readings.
const INFO_READINGS: u64 = 20;
/// The radio link is summed up this often, readings.
const STATUS_READINGS: u64 = 200;
/// The receiver names its trackers this often while there is nothing else to say.
const REGISTER_NS: u64 = 100 * MILLISECOND_NS;
/// From a reading to the receiver: the tracker's slot and the time on air, seconds.
const RADIO_DELAY_S: (f64, f64) = (1.0e-3, 0.5e-3);
/// Least time from a USB frame's begin to the time stamp of a transfer in it, seconds.
const TRANSFER_S: f64 = 6e-5;

/// A tracker.
pub struct Tracker {
    /// Its address: its name.
    pub address: u64,
    /// Where it is worn, for the truth.
    pub role: Role,
    /// Motion of its frame in the world: x to its right, y to its top, z out of its face.
    pub path: Box<dyn Path>,
}

/// What can be chosen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Options {
    /// Everything random follows from it.
    pub seed: u64,
    /// Host time of the start.
    pub start: HostTime,
    /// Seconds.
    pub duration_s: f64,
    /// Errors of the inertial sensors.
    pub imu: ImuNoise,
    /// Share of packets that the radio loses.
    pub loss: f64,
    /// Mean of the delay between a transfer and its time stamp, seconds.
    pub jitter_s: f64,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            seed: 1,
            start: HostTime::from_secs_f64(1_000.0),
            duration_s: 20.0,
            imu: ImuNoise::TRACKER,
            loss: 0.0,
            jitter_s: 15e-6,
        }
    }
}

/// The receiver and its trackers: an iterator over its packets in the order of arrival.
pub struct Receiver {
    options: Options,
    port: Port,
    trackers: Vec<Worn>,
    frame: u64,
    /// The number of the tracker that is named next.
    named: usize,
    registered_ns: Option<u64>,
    random: Random,
    queue: VecDeque<Packet>,
    last: HostTime,
}

impl Receiver {
    /// A receiver on `port`.
    ///
    /// # Errors
    /// An option is out of range, or there are more trackers than a receiver takes.
    pub fn new(
        options: Options,
        port: Port,
        trackers: Vec<Tracker>,
    ) -> Result<Self, SimulateError> {
        let count = trackers.len() as f64;
        for (what, value, high) in [
            ("duration, seconds", options.duration_s, 3_600.0),
            ("share of packets lost", options.loss, 1.0),
            ("delay of time stamps, seconds", options.jitter_s, 0.1),
            ("number of trackers", count, TRACKERS_MAX as f64),
        ] {
            if !(0.0..=high).contains(&value) {
                return Err(SimulateError::Range { what, value, high });
            }
        }
        let worn = |(index, tracker)| Worn::new(tracker, &options, index);
        let mut receiver = Self {
            trackers: trackers.into_iter().enumerate().map(worn).collect(),
            frame: 0,
            named: 0,
            registered_ns: None,
            random: Random::new(options.seed, Purpose::Usb, 1),
            queue: VecDeque::new(),
            last: HostTime(0),
            options,
            port,
        };
        let descriptor = device_descriptor(RECEIVER);
        receiver.send(0x80, Transfer::Control(get_descriptor()), descriptor, 1e-4);
        Ok(receiver)
    }

    /// Where the trackers truly are, one sample of each every `step_ns`.
    pub fn truth(&self, step_ns: u64) -> impl Iterator<Item = Truth> + '_ {
        let step = step_ns.max(1);
        let duration = HostTime::from_secs_f64(self.options.duration_s).0;
        (0..=duration / step).flat_map(move |index| {
            let since_start = index * step;
            self.trackers.iter().map(move |worn| {
                let place = worn.tracker.path.at(HostTime(since_start).as_secs_f64());
                Truth {
                    t_ns: self.options.start.0 + since_start,
                    device: format!("{:012X}", worn.tracker.address),
                    role: worn.tracker.role.name(),
                    position: place.position.to_array(),
                    rotation: place.rotation.to_array(),
                }
            })
        })
    }

    /// One USB frame.
    fn step(&mut self) {
        let frame_ns = self.frame * MILLISECOND_NS;
        let now = HostTime(frame_ns).as_secs_f64();
        let mut waiting: Vec<Content16> = Vec::new();
        for (number, worn) in self.trackers.iter_mut().enumerate() {
            // A newer packet takes the place of an older one that has not gone out.
            if let Some(content) = worn.arrived(now) {
                waiting.push(Content16 {
                    tracker: number as u8,
                    content,
                });
            }
        }
        self.frame += 1;
        let since = self.registered_ns.map(|last| frame_ns - last);
        let quiet = since.is_some_and(|since| since < REGISTER_NS);
        if self.trackers.is_empty() || (waiting.is_empty() && quiet) {
            return;
        }
        self.registered_ns = Some(frame_ns);
        let mut report = Vec::with_capacity(REPORT_BYTES);
        for packet in waiting.iter().take(PACKETS) {
            report.extend(packet.write());
        }
        // What does not fit is lost, and the receiver says so only to its own log.
        while report.len() < REPORT_BYTES {
            let number = self.named;
            self.named = (number + 1) % self.trackers.len();
            let address = self.trackers[number].tracker.address;
            let register = Content16 {
                tracker: number as u8,
                content: Content::Register { address },
            };
            report.extend(register.write());
        }
        self.send(0x81, Transfer::Interrupt, report, now);
    }

    fn send(&mut self, endpoint: u8, transfer: Transfer, data: Vec<u8>, seconds: f64) {
        let delay = TRANSFER_S + self.random.exponential(self.options.jitter_s);
        let arrival = self.options.start.plus_secs(seconds + delay);
        // usbmon's captures count microseconds.
        let at = HostTime(arrival.max(self.last.plus_ns(1_000)).0 / 1_000 * 1_000);
        self.last = at;
        self.queue.push_back(Packet {
            at,
            port: self.port,
            endpoint,
            transfer,
            data,
        });
    }
}

impl Iterator for Receiver {
    type Item = Packet;

    fn next(&mut self) -> Option<Packet> {
        loop {
            if let Some(packet) = self.queue.pop_front() {
                return Some(packet);
            }
            let frames = HostTime::from_secs_f64(self.options.duration_s).0 / MILLISECOND_NS;
            if self.frame >= frames {
                return None;
            }
            self.step();
        }
    }
}

/// A tracker with what is in it.
struct Worn {
    tracker: Tracker,
    fusion: Fusion,
    noise: ImuNoise,
    random: Random,
    accel_bias: glam::DVec3,
    gyro_bias: glam::DVec3,
    loss: f64,
    /// When it reads its sensors first, seconds: each tracker has a time slot of its own.
    phase_s: f64,
    reading: u64,
    sent: Option<Quat>,
    /// Packets on their way, with the time of their arrival; at most a few.
    on_air: VecDeque<(f64, Content)>,
    received: u8,
    lost: u8,
}

impl Worn {
    fn new(tracker: Tracker, options: &Options, index: usize) -> Self {
        let mut random = Random::new(options.seed, Purpose::Imu, 16 + index);
        let noise = options.imu;
        Self {
            fusion: Fusion::new(IMU_INTERVAL_S),
            accel_bias: random.normal3(noise.accel_bias),
            gyro_bias: random.normal3(noise.gyro_bias),
            phase_s: index as f64 * IMU_INTERVAL_S * 2.0 / TRACKERS_MAX as f64,
            noise,
            random,
            loss: options.loss,
            reading: 0,
            sent: None,
            on_air: VecDeque::new(),
            received: 0,
            lost: 0,
            tracker,
        }
    }

    /// What has arrived at the receiver by `now`; of several packets the newest.
    fn arrived(&mut self, now: f64) -> Option<Content> {
        while self.phase_s + self.reading as f64 * IMU_INTERVAL_S <= now {
            self.read();
        }
        let mut newest = None;
        while self.on_air.front().is_some_and(|(time, _)| *time <= now) {
            newest = self.on_air.pop_front().map(|(_, content)| content);
        }
        newest.map(|content| self.summed_up(content))
    }

    /// The receiver fills in what it counted, and how strong the signal was.
    fn summed_up(&mut self, content: Content) -> Content {
        let Content::Status { mut link, signal } = content else {
            return content;
        };
        (link.received, link.lost) = (self.received, self.lost);
        (link.windows_hit, link.windows_missed) = (self.received, 0);
        (self.received, self.lost) = (0, 0);
        Content::Status { link, signal }
    }

    /// Reads the sensors, and sends what is due.
    fn read(&mut self) {
        let seconds = self.phase_s + self.reading as f64 * IMU_INTERVAL_S;
        let (force, rate) = inertial(&*self.tracker.path, &Placement::IDENTITY, seconds);
        let step = self.noise.gyro_walk * IMU_INTERVAL_S.sqrt();
        self.gyro_bias += self.random.normal3(step);
        let force = force + self.accel_bias + self.random.normal3(self.noise.accel);
        let rate = rate + self.gyro_bias + self.random.normal3(self.noise.gyro);
        let orientation = self.fusion.update(&Imu {
            at: HostTime::from_secs_f64(1.0 + seconds),
            accel: force.as_vec3(),
            gyro: rate.as_vec3(),
        });
        let reading = self.reading;
        self.reading += 1;
        if reading.is_multiple_of(READINGS_PER_MOTION) {
            let content = self.motion(reading, &orientation);
            self.transmit(seconds, content);
        } else if let Some(content) = self.other(reading) {
            self.transmit(seconds, content);
        }
    }

    fn motion(&mut self, reading: u64, orientation: &Orientation) -> Content {
        let rotation = WORLD.inverse() * orientation.rotation;
        let motion = Motion {
            rotation,
            accel: orientation.rotation.inverse() * orientation.accel,
        };
        let turned = self
            .sent
            .map_or(f32::MAX, |sent| sent.angle_between(rotation));
        self.sent = Some(rotation);
        if turned < STILL && !reading.is_multiple_of(INFO_READINGS) {
            Content::Motion(motion)
        } else {
            Content::MotionAndPower {
                motion,
                power: POWER,
                signal: self.signal(),
            }
        }
    }

    /// What is told between motions.
    fn other(&mut self, reading: u64) -> Option<Content> {
        let signal = self.signal();
        if reading % STATUS_READINGS == 1 {
            let link = LinkStatus {
                server_status: 1,
                ..LinkStatus::default()
            };
            return Some(Content::Status { link, signal });
        }
        (reading % INFO_READINGS == 5).then_some(Content::Info {
            power: POWER,
            firmware: FIRMWARE,
            signal,
        })
    }

    fn signal(&mut self) -> Signal {
        Signal((52.0 + self.random.normal(3.0)).clamp(30.0, 95.0) as u8)
    }

    fn transmit(&mut self, seconds: f64, content: Content) {
        let (least, spread) = RADIO_DELAY_S;
        let arrival = seconds + least + self.random.exponential(spread);
        if self.random.chance(self.loss) {
            self.lost = self.lost.saturating_add(1);
            return;
        }
        self.received = self.received.saturating_add(1);
        let last = self.on_air.back().map_or(0.0, |(time, _)| *time);
        self.on_air.push_back((arrival.max(last), content));
    }
}

/// 83 percent, 3.98 V, 31 degrees Celsius.
const POWER: Power = Power {
    battery: 0x80 | 83,
    voltage: 153,
    temperature: 140,
};

/// An nRF52840 with an ICM-45686, firmware 1.0.4 of the 9th of March 2025.
const FIRMWARE: Firmware = Firmware {
    board: 17,
    mcu: 8,
    imu: 11,
    magnetometer: 0,
    date: 5 << 9 | 3 << 5 | 9,
    version: [1, 0, 4],
};

/// The frame of a tracker strapped to a limb: `up` along the limb to its top, `out` away from the
/// body, in the limb's frame.
#[must_use]
pub fn strapped(up: glam::DVec3, out: glam::DVec3) -> DQuat {
    let z = (out - up * out.dot(up)).normalize();
    DQuat::from_mat3(&glam::DMat3::from_cols(up.cross(z), up, z))
}
