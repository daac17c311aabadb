//! What a simulated device is made of: sensors, IMU, frames and the configuration's view of
//! them. The frames are laid out as in Valve's configurations: a headset's model frame looks along
//! +Z with X left, a controller's along -Z.

use std::f64::consts::TAU;

use glam::{DMat3, DQuat, DVec3};

use super::device::{Model, Placement};
use super::options::Options;
use super::random::{Purpose, Random};

/// Sensors are where the configuration says times this; so it is with Index headsets and
/// controllers, as libsurvive (MIT) found, and readers know it by the model's name.
const HEADSET_SCALE: f64 = 1.0048;
const CONTROLLER_SCALE: f64 = 0.999;

/// A light sensor, in the model frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sensor {
    /// Hardware channel, as it stands in the light stream.
    pub(super) channel: u8,
    /// Where it is, metres.
    pub(super) position: DVec3,
    /// Where the configuration says it is, metres.
    pub(super) claimed: DVec3,
    /// Outward, unit.
    pub(super) normal: DVec3,
}

/// Something opaque that moves with the device: a capsule in the model frame.
#[derive(Debug, Clone, Copy)]
pub(super) struct Shade {
    /// Ends of its axis.
    pub(super) axis: [DVec3; 2],
    /// Metres.
    pub(super) radius: f64,
}

/// Calibration of the inertial sensors: what they add to and how they scale the truth.
#[derive(Debug, Clone, Copy)]
pub(super) struct ImuCalibration {
    /// m/s^2.
    pub(super) acc_bias: DVec3,
    pub(super) acc_scale: DVec3,
    /// rad/s.
    pub(super) gyro_bias: DVec3,
}

/// Full scale of the inertial sensors, as feature report 0x01 names it.
#[derive(Debug, Clone, Copy)]
pub(super) struct ImuRange {
    /// Index into 250, 500, 1000, 2000 degrees a second.
    pub(super) gyro_mode: u8,
    /// Index into 2, 4, 8, 16 g.
    pub(super) acc_mode: u8,
}

impl ImuRange {
    /// rad/s of one count.
    pub(super) fn gyro_lsb(self) -> f64 {
        (250.0 * f64::from(1u8 << self.gyro_mode)).to_radians() / 32_768.0
    }

    /// g of one count.
    pub(super) fn acc_lsb(self) -> f64 {
        2.0 * f64::from(1u8 << self.acc_mode) / 32_768.0
    }
}

/// A device's construction.
#[derive(Debug, Clone)]
pub(super) struct Blueprint {
    pub(super) sensors: Vec<Sensor>,
    pub(super) shades: Vec<Shade>,
    /// The IMU in the model frame.
    pub(super) imu: Placement,
    /// The tracking frame in the model frame.
    pub(super) head: Placement,
    pub(super) calibration: ImuCalibration,
    pub(super) range: ImuRange,
}

impl Blueprint {
    /// The `index`-th device of a simulation.
    pub(super) fn new(model: Model, options: &Options, index: usize) -> Self {
        let mut random = Random::new(options.seed, Purpose::Device, index);
        let mut sensors = match model {
            Model::Headset => headset_sensors(),
            Model::LeftController => controller_sensors(-1.0),
            Model::RightController => controller_sensors(1.0),
        };
        let scale = match model {
            Model::Headset => HEADSET_SCALE,
            Model::LeftController | Model::RightController => CONTROLLER_SCALE,
        };
        for sensor in &mut sensors {
            sensor.claimed += random.normal3(options.light.sensor_m);
            sensor.claimed /= scale;
        }
        let calibration = ImuCalibration {
            acc_bias: random.normal3(0.15),
            acc_scale: DVec3::ONE + random.normal3(0.003),
            gyro_bias: random.normal3(0.015),
        };
        let (shades, imu, head, range) = match model {
            Model::Headset => headset_frames(),
            Model::LeftController => controller_frames(-1.0),
            Model::RightController => controller_frames(1.0),
        };
        Self {
            sensors,
            shades,
            imu,
            head,
            calibration,
            range,
        }
    }

    /// The IMU in the tracking frame.
    pub(super) fn imu_in_head(&self) -> Placement {
        self.head.inverse().then(&self.imu)
    }
}

fn sensor(channel: usize, position: DVec3, outward: DVec3) -> Sensor {
    Sensor {
        channel: channel as u8,
        position,
        claimed: position,
        normal: outward.normalize(),
    }
}

/// 32 sensors in a spiral over the front half of an ellipsoid.
fn headset_sensors() -> Vec<Sensor> {
    const COUNT: usize = 32;
    let golden = TAU * (1.0 - 0.5 * (5f64.sqrt() - 1.0));
    let semi_axes = DVec3::new(0.093, 0.055, 0.070);
    let place = |index: usize| {
        let depth = 0.97 - 0.85 * (index as f64 / (COUNT - 1) as f64);
        let (sin, cos) = (golden * index as f64).sin_cos();
        let radius = (1.0 - depth * depth).sqrt();
        let direction = DVec3::new(radius * cos, radius * sin, depth);
        let channel = (index * 13 + 5) % COUNT;
        sensor(channel, direction * semi_axes, direction / semi_axes)
    };
    (0..COUNT).map(place).collect()
}

/// 24 sensors: 14 on a ring in two rows, 6 on its front, 4 at the handle's end; `side` is +1 for
/// the right hand's controller and mirrors it for the left.
fn controller_sensors(side: f64) -> Vec<Sensor> {
    let centre = DVec3::new(0.015, -0.012, 0.0);
    let mut places = Vec::new();
    for index in 0..14 {
        let (sin, cos) = (TAU * f64::from(index) / 14.0).sin_cos();
        let row = if index % 2 == 0 { 1.0 } else { -1.0 };
        let out = DVec3::new(cos, sin, 0.0);
        places.push((
            centre + out * 0.052 + DVec3::Z * (0.018 * row),
            out + DVec3::Z * (0.55 * row),
        ));
    }
    for index in 0..6 {
        let (sin, cos) = (TAU * (f64::from(index) + 0.25) / 6.0).sin_cos();
        let out = DVec3::new(cos, sin, 0.0);
        places.push((
            centre + out * 0.028 - DVec3::Z * 0.038,
            out * 0.5 - DVec3::Z,
        ));
    }
    for (x, y, z) in [
        (1.0, 0.3, 0.6),
        (-1.0, 0.3, 0.6),
        (0.4, -1.0, 0.4),
        (-0.3, -0.2, 1.0),
    ] {
        let out = DVec3::new(x, y, z);
        places.push((DVec3::new(0.0, -0.085, 0.112) + out * 0.014, out));
    }
    let mirror = DVec3::new(side, 1.0, 1.0);
    let place = |(index, (position, outward)): (usize, (DVec3, DVec3))| {
        sensor((index * 7 + 3) % 32, position * mirror, outward * mirror)
    };
    places.into_iter().enumerate().map(place).collect()
}

type Frames = (Vec<Shade>, Placement, Placement, ImuRange);

fn headset_frames() -> Frames {
    let wearers_head = Shade {
        axis: [DVec3::new(0.0, 0.03, -0.105), DVec3::new(0.0, -0.04, -0.10)],
        radius: 0.085,
    };
    let imu = Placement {
        position: DVec3::new(-0.047, 0.032, 0.051),
        rotation: frame(DVec3::NEG_Y, DVec3::Z),
    };
    let head = Placement {
        position: DVec3::new(0.0, 0.0, -0.011),
        rotation: frame(DVec3::NEG_X, DVec3::NEG_Z),
    };
    let range = ImuRange {
        gyro_mode: 1,
        acc_mode: 1,
    };
    (vec![wearers_head], imu, head, range)
}

fn controller_frames(side: f64) -> Frames {
    let hand = Shade {
        axis: [
            DVec3::new(0.0, -0.032, 0.048),
            DVec3::new(0.0, -0.068, 0.092),
        ],
        radius: 0.028,
    };
    let imu = Placement {
        position: DVec3::new(-0.009 * side, -0.055, 0.09),
        rotation: DQuat::from_rotation_y(1.4 * side) * DQuat::from_rotation_x(0.7),
    };
    let head = Placement {
        position: DVec3::new(0.011 * side, 0.022, -0.042),
        rotation: DQuat::from_rotation_y(-0.18 * side) * DQuat::from_rotation_x(0.43),
    };
    let range = ImuRange {
        gyro_mode: 3,
        acc_mode: 2,
    };
    (vec![hand], imu, head, range)
}

/// The frame whose axes are these; `plus_x` and `plus_z` are the configuration's words.
fn frame(plus_x: DVec3, plus_z: DVec3) -> DQuat {
    DQuat::from_mat3(&DMat3::from_cols(plus_x, plus_z.cross(plus_x), plus_z))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all() -> [Blueprint; 3] {
        let models = [
            Model::Headset,
            Model::LeftController,
            Model::RightController,
        ];
        models.map(|model| Blueprint::new(model, &Options::default(), 0))
    }

    #[test]
    fn sensors_have_channels_of_their_own_and_stand_in_the_open() {
        for (blueprint, count) in all().iter().zip([32, 24, 24]) {
            assert_eq!(blueprint.sensors.len(), count);
            let mut channels: Vec<u8> = blueprint.sensors.iter().map(|s| s.channel).collect();
            channels.sort_unstable();
            channels.dedup();
            assert_eq!(channels.len(), count);
            assert!(channels.iter().all(|&channel| channel < 32));
            for sensor in &blueprint.sensors {
                assert!((sensor.claimed - sensor.position).length() < 2e-3);
                for shade in &blueprint.shades {
                    let [a, b] = shade.axis;
                    let along = (sensor.position - a).dot(b - a) / (b - a).length_squared();
                    let nearest = a + (b - a) * along.clamp(0.0, 1.0);
                    assert!((sensor.position - nearest).length() > shade.radius);
                }
            }
        }
    }

    #[test]
    fn ranges_are_those_of_the_real_devices() {
        let [headset, left, _] = all();
        assert!((1.0 / headset.range.acc_lsb() - 8192.0).abs() < 1e-9);
        assert!((1.0 / left.range.acc_lsb() - 4096.0).abs() < 1e-9);
        let degrees = left.range.gyro_lsb().to_degrees() * 32_768.0;
        assert!((degrees - 2000.0).abs() < 1e-9);
    }

    #[test]
    fn a_headsets_tracking_frame_looks_where_its_sensors_look() {
        let [headset, ..] = all();
        let forward = headset.head.rotation * DVec3::NEG_Z;
        let mean: DVec3 = headset.sensors.iter().map(|sensor| sensor.normal).sum();
        assert!(forward.dot(mean.normalize()) > 0.99);
    }
}
