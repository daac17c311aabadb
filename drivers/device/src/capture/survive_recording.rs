//! libsurvive's recordings (`.rec`, often gzip'd): a text of `time device what ...` lines.
//!
//! Such a recording holds no USB packets, but what libsurvive read out of them: configurations, raw
//! inertial samples, syncs and sweeps (`W`, `Y`) or pulses (`C`). Each becomes the packet that a
//! wired device would have sent for it alone, so that a recording runs through the decoders like
//! any capture. Solved lines are skipped; libsurvive's own poses are read by [`survive_poses`].

use std::{
    collections::VecDeque,
    io::{BufRead, BufReader, Read, Write},
};

use flate2::{Compression, write::ZlibEncoder};
use glam::{DQuat, DVec3};
use posed_signal::HostTime;
use serde::Deserialize;

use super::{
    CaptureError,
    lines::{BadLine, Lines},
    pairing::Pairing,
    reader::Found,
    records::Step,
    source::Source,
};
use crate::usb::{Packet, Port, Setup, Transfer, UsbId};

/// Devices in one recording.
const DEVICES_MAX: usize = 32;
/// What every device is presented as: its configuration says what it really is.
const WIRED: UsbId = UsbId::new(0x28de, 0x2300);
/// Bytes of a configuration in one report.
const PIECE: usize = 62;
const IMU_ENDPOINT: u8 = 0x81;
const LIGHT_ENDPOINT: u8 = 0x83;

struct Device {
    name: String,
    /// Of the newest inertial sample.
    sequence: u8,
    /// The channel of each of its sensors, by the configuration: sweeps are written by sensor,
    /// pulses by channel.
    channels: Vec<u8>,
}

/// Reads the text line by line.
pub(super) struct SurviveRecording<'a> {
    lines: Lines<'a>,
    devices: Vec<Device>,
    queue: VecDeque<Found>,
}

impl<'a> SurviveRecording<'a> {
    /// Whether a text begins like this: a time, a device or a kind of message, a capital word.
    pub(super) fn recognises(text: &[u8]) -> bool {
        let end = text.iter().position(|&byte| byte == b'\n');
        let line = &text[..end.unwrap_or(text.len())];
        let Ok(line) = std::str::from_utf8(line) else {
            return false;
        };
        let mut words = line.split_ascii_whitespace();
        let time = words.next().is_some_and(|word| seconds(word).is_some());
        let word = |word: &str| word.starts_with(|first: char| first.is_ascii_alphanumeric());
        time && words.next().is_some_and(word) && words.next().is_some()
    }

    pub(super) fn new(source: Source<'a>) -> Self {
        Self {
            lines: Lines::new(source),
            devices: Vec::new(),
            queue: VecDeque::new(),
        }
    }

    /// Reads on to the next packet or line.
    pub(super) fn step(&mut self, pairing: &mut Pairing) -> Step<Found> {
        if let Some(found) = self.queue.pop_front() {
            pairing.statistics.records += 1;
            return Step::Record(found);
        }
        let Self {
            lines,
            devices,
            queue,
        } = self;
        lines.step(pairing, |line| {
            for packet in packets(devices, line)? {
                let device = Some((packet.port, WIRED));
                let packet = Some(packet);
                queue.push_back(Found { device, packet });
            }
            Ok(queue.pop_front().unwrap_or_default())
        })
    }
}

/// The packets that a line stands for.
fn packets(devices: &mut Vec<Device>, line: &str) -> Result<Vec<Packet>, BadLine> {
    let mut words = line.splitn(4, ' ');
    let (Some(time), Some(name), Some(what)) = (words.next(), words.next(), words.next()) else {
        return Ok(Vec::new());
    };
    let rest = words.next().unwrap_or_default();
    if !matches!(what, "CONFIG" | "IMU_SCALES" | "i" | "W" | "Y" | "C") {
        return Ok(Vec::new());
    }
    let at = seconds(time).ok_or(BadLine)?;
    let index = match devices.iter().position(|device| device.name == name) {
        Some(index) => index,
        None if devices.len() < DEVICES_MAX => {
            devices.push(Device {
                name: name.to_owned(),
                sequence: 0,
                channels: Vec::new(),
            });
            devices.len() - 1
        }
        None => return Err(BadLine),
    };
    let port = Port {
        bus: 0,
        address: index as u16 + 1,
    };
    let wire = Wire { at, port };
    if what == "CONFIG" {
        devices[index].channels = channels(rest);
        return Ok(wire.configuration(rest));
    }
    let packet = match what {
        "IMU_SCALES" => wire.scales(rest),
        "i" => wire.imu(rest, &mut devices[index].sequence),
        "W" => wire.sweep(rest, &devices[index].channels),
        "Y" => wire.sync(rest),
        _ => wire.pulse(rest),
    };
    packet.map(|packet| vec![packet]).ok_or(BadLine)
}

/// The channels of a configuration's sensors; none where it has no map or cannot be read.
fn channels(configuration: &str) -> Vec<u8> {
    #[derive(Default, Deserialize)]
    struct Lighthouse {
        #[serde(rename = "channelMap", default)]
        channel_map: Vec<u8>,
    }
    #[derive(Deserialize)]
    struct Configuration {
        #[serde(default)]
        lighthouse_config: Lighthouse,
    }
    serde_json::from_str::<Configuration>(configuration)
        .map(|configuration| configuration.lighthouse_config.channel_map)
        .unwrap_or_default()
}

/// Makes the packets of one line.
struct Wire {
    at: HostTime,
    port: Port,
}

impl Wire {
    fn interrupt(&self, endpoint: u8, data: Vec<u8>) -> Packet {
        Packet {
            at: self.at,
            port: self.port,
            endpoint,
            transfer: Transfer::Interrupt,
            data,
        }
    }

    fn feature(&self, id: u8, data: Vec<u8>) -> Packet {
        let setup = Setup {
            request_type: 0xa1,
            request: Setup::HID_GET_REPORT,
            value: u16::from(Setup::REPORT_FEATURE) << 8 | u16::from(id),
            index: 0,
            length: 64,
        };
        Packet {
            at: self.at,
            port: self.port,
            endpoint: 0x80,
            transfer: Transfer::Control(setup),
            data,
        }
    }

    /// The read of a configuration, piece by piece.
    fn configuration(&self, text: &str) -> Vec<Packet> {
        let mut encoder = ZlibEncoder::new(Vec::new(), Compression::fast());
        let packed = encoder
            .write_all(text.as_bytes())
            .and_then(|()| encoder.finish());
        // Writing into a vector cannot fail.
        let packed = packed.unwrap_or_default();
        let mut packets = vec![self.feature(0x10, vec![0x10; 2])];
        for piece in packed.chunks(PIECE).chain([&[][..]]) {
            let mut data = vec![0x11, piece.len() as u8];
            data.extend(piece);
            packets.push(self.feature(0x11, data));
        }
        packets
    }

    /// Codes of the full scales: gyroscope, accelerometer.
    fn scales(&self, rest: &str) -> Option<Packet> {
        let mut words = rest.split_ascii_whitespace();
        let mut code = || words.next()?.parse::<u8>().ok();
        Some(self.feature(0x01, vec![0x01, code()?, code()?]))
    }

    /// `mask time accelerometer gyroscope magnetometer number`: raw, though written as floats.
    fn imu(&self, rest: &str, sequence: &mut u8) -> Option<Packet> {
        let mut words = rest.split_ascii_whitespace().skip(1);
        let ticks: u32 = words.next()?.parse().ok()?;
        let mut slot = Vec::with_capacity(17);
        for _ in 0..6 {
            let value: f64 = words.next()?.parse().ok()?;
            if !value.is_finite() {
                return None;
            }
            slot.extend((value.round() as i16).to_le_bytes());
        }
        slot.extend(ticks.to_le_bytes());
        *sequence = sequence.wrapping_add(1);
        slot.push(*sequence);
        // The report repeats the last three samples; one that repeats one sample three times says
        // the same.
        let report = [&[0x20][..], &slot, &slot, &slot].concat();
        Some(self.interrupt(IMU_ENDPOINT, report))
    }

    /// `channel sensor time flag`, the first channel a base station's; `channels`: the sensors'.
    fn sweep(&self, rest: &str, channels: &[u8]) -> Option<Packet> {
        let mut words = rest.split_ascii_whitespace();
        let channel: u8 = words.next()?.parse().ok()?;
        let sensor: u8 = words.next()?.parse().ok()?;
        let sensor = channels.get(usize::from(sensor)).copied().unwrap_or(sensor);
        if sensor >= 32 {
            return None;
        }
        let ticks: u32 = words.next()?.parse().ok()?;
        self.light(
            channel,
            u32::from(sensor) << 27 | (ticks & 0xff_ffff) << 3 | 2,
        )
    }

    /// `channel time data generation`.
    fn sync(&self, rest: &str) -> Option<Packet> {
        let mut words = rest.split_ascii_whitespace();
        let channel: u8 = words.next()?.parse().ok()?;
        let ticks: u32 = words.next()?.parse().ok()?;
        let data = words.next()? == "1";
        self.light(channel, (ticks & 0xff_ffff) << 2 | u32::from(data) << 26)
    }

    fn light(&self, channel: u8, word: u32) -> Option<Packet> {
        if channel > 15 {
            return None;
        }
        let mut data = vec![0x28, 5, channel << 4 | 1];
        data.extend(word.to_le_bytes());
        data.resize(64, 0);
        Some(self.interrupt(LIGHT_ENDPOINT, data))
    }

    /// `sensor time length`.
    fn pulse(&self, rest: &str) -> Option<Packet> {
        let mut words = rest.split_ascii_whitespace();
        let sensor: u8 = words.next()?.parse().ok()?;
        let ticks: u32 = words.next()?.parse().ok()?;
        let length: u16 = words.next()?.parse().ok()?;
        let mut data = vec![0x25, sensor];
        data.extend(length.to_le_bytes());
        data.extend(ticks.to_le_bytes());
        data.resize(64, 0xff);
        Some(self.interrupt(LIGHT_ENDPOINT, data))
    }
}

/// `seconds.fraction` since the recording began.
fn seconds(text: &str) -> Option<HostTime> {
    let plain = |byte: u8| byte.is_ascii_digit() || byte == b'.';
    if !text.contains('.') || !text.bytes().all(plain) {
        return None;
    }
    let seconds: f64 = text.parse().ok()?;
    (seconds < 1e9).then(|| HostTime::from_secs_f64(seconds))
}

/// Lines of a recording that hold poses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PoseLines {
    /// `POSE`: solved as the recording was made.
    Solved,
    /// `EXTERNAL_POSE`: given to libsurvive from elsewhere.
    External,
}

/// A pose in a recording.
#[derive(Debug, Clone, PartialEq)]
pub struct SurvivePose {
    /// What kind of line it stood in.
    pub lines: PoseLines,
    /// libsurvive's name of the device, for example `T20`; `replay_T20` where the recording is of
    /// a replay that knew the poses of the run before.
    pub device: String,
    /// Since the recording began.
    pub at: HostTime,
    /// Metres, in libsurvive's world: Z up.
    pub position: DVec3,
    /// Device to world.
    pub rotation: DQuat,
}

/// What a recording holds beside its raw lines.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SurvivePoses {
    /// Names and serial numbers of the devices whose configurations it holds.
    pub devices: Vec<(String, String)>,
    /// The poses, in the order of the file.
    pub poses: Vec<SurvivePose>,
}

/// Reads the poses in a recording; lines that cannot be read are left out.
///
/// # Errors
/// The input is empty, or cannot be read at all.
pub fn survive_poses<'a>(input: impl Read + Send + 'a) -> Result<SurvivePoses, CaptureError> {
    let mut found = SurvivePoses::default();
    let source = BufReader::new(Source::new(Box::new(input))?);
    for line in source.lines().map_while(Result::ok) {
        let mut words = line.split_ascii_whitespace();
        let (Some(time), Some(device), Some(what)) = (words.next(), words.next(), words.next())
        else {
            continue;
        };
        match what {
            "CONFIG" if found.devices.len() < DEVICES_MAX => {
                let serial = line.split_once("CONFIG").and_then(|(_, text)| serial(text));
                found
                    .devices
                    .extend(serial.map(|serial| (device.to_owned(), serial)));
            }
            "POSE" | "EXTERNAL_POSE" => {
                let lines = if what == "POSE" {
                    PoseLines::Solved
                } else {
                    PoseLines::External
                };
                found.poses.extend(pose(lines, time, device, words));
            }
            _ => {}
        }
    }
    Ok(found)
}

fn serial(configuration: &str) -> Option<String> {
    let value: serde_json::Value = serde_json::from_str(configuration.trim()).ok()?;
    Some(value.get("device_serial_number")?.as_str()?.to_owned())
}

/// `x y z`, then the quaternion `w x y z`.
fn pose<'l>(
    lines: PoseLines,
    time: &str,
    device: &str,
    mut words: impl Iterator<Item = &'l str>,
) -> Option<SurvivePose> {
    let at = seconds(time)?;
    let mut number = || words.next()?.parse::<f64>().ok().filter(|x| x.is_finite());
    let position = DVec3::new(number()?, number()?, number()?);
    let (w, x, y, z) = (number()?, number()?, number()?, number()?);
    let rotation = DQuat::from_xyzw(x, y, z, w);
    let unit = (rotation.length() - 1.0).abs() < 0.01;
    unit.then(|| SurvivePose {
        lines,
        device: device.to_owned(),
        at,
        position,
        rotation: rotation.normalize(),
    })
}

#[cfg(test)]
mod tests {
    use super::{super::open, *};
    use crate::capture::Item;

    const RECORDING: &str = "0.000000 INFO LOG Recording to 'x.rec'\r\n\
        0.100000 T20 CONFIG {\"device_serial_number\": \"LHR-1\"}\r\n\
        0.150000 T20 IMU_SCALES 3 2\r\n\
        0.200000 T20 i 3 3144688562 -7166.000000 -438.000000 4052.000000 26.000000 94.000000 \
        66.000000  0.000000 0.000000 0.000000 1\r\n\
        0.300000 T20 Y 11 4736743 0 1\r\n\
        0.300001 T20 W 7 25 5018113 0\r\n\
        0.400000 HMD C 15 2532046858 3063\r\n\
        0.500000 replay_T20 EXTERNAL_POSE 1.0 2.0 3.0 1.0 0.0 0.0 0.0 \r\n\
        0.600000 T20 W 77 25 5018113 0\r\n\
        0.700000 T20 POSE 1.0 nan 3.0 1.0 0.0 0.0 0.0\r\n";

    fn packets(text: &str) -> Vec<Packet> {
        let items = open(text.as_bytes()).unwrap();
        items
            .filter_map(|item| match item {
                Item::Packet(packet) => Some(packet),
                _ => None,
            })
            .collect()
    }

    /// Sweeps are written by sensor: on the wire they carry its channel.
    #[test]
    fn sweeps_get_their_sensors_channel() {
        let text = "0.100000 T20 CONFIG {\"lighthouse_config\": {\"channelMap\": [3, 9]}}\n\
            0.200000 T20 W 7 1 5018113 0\n0.300000 T20 W 7 5 5018113 0\n";
        let sensors: Vec<u32> = packets(text)
            .iter()
            .filter(|packet| packet.data[0] == 0x28)
            .map(|packet| u32::from_le_bytes(*packet.data[3..].first_chunk().unwrap()) >> 27)
            .collect();
        assert_eq!(sensors, [9, 5]);
    }

    #[test]
    fn lines_become_reports() {
        let packets = packets(RECORDING);
        let inputs: Vec<_> = packets
            .iter()
            .filter(|packet| packet.transfer == Transfer::Interrupt)
            .map(|packet| (packet.port.address, packet.data[0], packet.data.len()))
            .collect();
        assert_eq!(
            inputs,
            [(1, 0x20, 52), (1, 0x28, 64), (1, 0x28, 64), (2, 0x25, 64)]
        );
        let imu = &packets
            .iter()
            .find(|packet| packet.data[0] == 0x20)
            .unwrap()
            .data;
        assert_eq!(imu[1..3], (-7_166i16).to_le_bytes());
        assert_eq!(imu[13..17], 3_144_688_562u32.to_le_bytes());
        let configuration = packets.iter().filter(|packet| packet.data[0] == 0x11);
        assert_eq!(configuration.count(), 2, "one piece and the end");
    }

    #[test]
    fn poses_are_read_apart() {
        let found = survive_poses(RECORDING.as_bytes()).unwrap();
        assert_eq!(found.devices, [("T20".to_owned(), "LHR-1".to_owned())]);
        assert_eq!(found.poses.len(), 1, "a pose that is no number is none");
        assert_eq!(found.poses[0].lines, PoseLines::External);
        assert_eq!(found.poses[0].position, DVec3::new(1.0, 2.0, 3.0));
    }

    #[test]
    fn other_texts_are_not_taken_for_it() {
        for text in ["hello world again\n", "1 2 3\n", "0.5\n", "0.5 %% %%\n"] {
            assert!(!SurviveRecording::recognises(text.as_bytes()), "{text}");
        }
    }
}
