//! A device as its configuration describes it: sensors, IMU and frames.
//!
//! Three frames meet here. The configuration gives everything in the *reference* frame of its
//! plastics ("trackref"). The filter works in the *IMU*'s frame, where the accelerometer needs no
//! lever arm. Poses are those of the *head* frame, the one that OpenXR knows: for a headset x
//! right, y up and -z forward between the eyes, for a controller or a tracker the frame that its
//! maker chose. All are right-handed, in metres.

use glam::{DMat3, DQuat, DVec3};
use posed_signal::{Role, Serial};
use serde::Deserialize;

use super::input::Controls;
use crate::decode::{DecodeError, Identity};

/// At most this many sensors: the light stream has five bits for them.
pub const SENSORS_MAX: usize = 32;

/// Standard gravity, m/s^2.
pub const GRAVITY: f64 = 9.806_65;

/// A photodiode, in the IMU's frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sensor {
    /// Metres.
    pub position: DVec3,
    /// Where it looks, unit.
    pub normal: DVec3,
}

/// Full scales of the IMU.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImuRange {
    /// m/s^2 per LSB.
    pub accel: f64,
    /// rad/s per LSB.
    pub gyro: f64,
}

impl ImuRange {
    /// From full scales in g and degrees a second.
    fn full_scale(accel_g: f64, gyro_dps: f64) -> Self {
        Self {
            accel: accel_g * GRAVITY / 32_768.0,
            gyro: gyro_dps.to_radians() / 32_768.0,
        }
    }

    /// What headsets are set to: 4 g and 500 degrees a second.
    #[must_use]
    pub fn headset() -> Self {
        Self::full_scale(4.0, 500.0)
    }

    /// What controllers and trackers are set to: 8 g and 2000 degrees a second.
    #[must_use]
    pub fn controller() -> Self {
        Self::full_scale(8.0, 2_000.0)
    }

    /// From feature report 0x01: a code for the gyroscope, then one for the accelerometer.
    #[must_use]
    pub fn from_codes(gyro: u8, accel: u8) -> Option<Self> {
        (gyro < 4 && accel < 4)
            .then(|| Self::full_scale(f64::from(2u8 << accel), 250.0 * f64::from(1u8 << gyro)))
    }
}

/// Factory calibration of the IMU, applied to raw times full scale.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImuCalibration {
    /// m/s^2, taken off first.
    pub accel_bias: DVec3,
    /// Then multiplied.
    pub accel_scale: DVec3,
    /// rad/s, taken off first.
    pub gyro_bias: DVec3,
    /// Then multiplied.
    pub gyro_scale: DVec3,
}

/// A rigid transform.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// Origin in the outer frame, metres.
    pub position: DVec3,
    /// Inner to outer.
    pub rotation: DQuat,
}

impl Frame {
    const IDENTITY: Self = Self {
        position: DVec3::ZERO,
        rotation: DQuat::IDENTITY,
    };

    /// A point of the outer frame in the inner one.
    fn to_inner(self, point: DVec3) -> DVec3 {
        self.rotation.conjugate() * (point - self.position)
    }
}

/// What is known about a device.
#[derive(Debug, Clone)]
pub struct DeviceModel {
    /// Who it is.
    pub identity: Identity,
    pub(super) controls: Controls,
    /// Full scales that devices of its class are set to.
    pub range: ImuRange,
    /// Factory calibration.
    pub imu: ImuCalibration,
    /// The head frame in the IMU's frame.
    pub head: Frame,
    /// Sensors by hardware channel.
    pub sensors: [Option<Sensor>; SENSORS_MAX],
}

impl DeviceModel {
    /// Reads the configuration's JSON.
    ///
    /// # Errors
    /// It is not JSON of the expected kind, a number is not finite, or there are no sensors.
    pub fn from_json(text: &str) -> Result<Self, DecodeError> {
        let file: File = serde_json::from_str(text)
            .map_err(|cause| DecodeError::Configuration(cause.to_string()))?;
        let imu = file.imu_frame()?;
        let head = file.head_frame()?;
        let make = file.make();
        let rotation = imu.rotation.conjugate();
        Ok(Self {
            identity: Identity {
                serial: Serial::new(&file.device_serial_number),
                model: make.name,
                natural_role: make.role,
                has_haptics: make.controls != Controls::Other,
            },
            controls: make.controls,
            range: if make.headset {
                ImuRange::headset()
            } else {
                ImuRange::controller()
            },
            imu: file.imu_calibration(),
            head: Frame {
                position: imu.to_inner(head.position),
                rotation: rotation * head.rotation,
            },
            sensors: file.sensors(imu, make.sensor_scale)?,
        })
    }
}

/// What depends on the product.
#[derive(Debug, Clone, Copy)]
struct Make {
    name: &'static str,
    role: Role,
    controls: Controls,
    headset: bool,
    /// The configurations' sensor positions are off by a factor that depends on the product, as
    /// libsurvive (MIT) found.
    sensor_scale: f64,
}

impl Make {
    fn new(name: &'static str, role: Role, controls: Controls, sensor_scale: f64) -> Self {
        Self {
            name,
            role,
            controls,
            headset: role == Role::Head,
            sensor_scale,
        }
    }

    /// By what the configuration calls it, spelt with and without dots; else by its class.
    fn find(model: &str, class: &str) -> Self {
        use Controls::{Index, Other, Wand};
        let plain = model.replace(['.', '_'], " ").to_lowercase();
        let plain: Vec<&str> = plain.split_whitespace().collect();
        match (plain.join(" ").as_str(), class) {
            ("knuckles right" | "knuckles ev3 0 right", _) => {
                Self::new("Index controller", Role::RightHand, Index, 0.999)
            }
            ("knuckles left" | "knuckles ev3 0 left", _) => {
                Self::new("Index controller", Role::LeftHand, Index, 0.999)
            }
            ("utah mp", _) => Self::new("Index headset", Role::Head, Other, 1.0048),
            ("vive controller mv", _) => Self::new("Vive wand", Role::None, Wand, 1.0),
            ("vive tracker pro mv", _) => Self::new("Vive Tracker 2018", Role::None, Other, 1.0034),
            ("vive tracker 3 0 mv", _) => Self::new("Vive Tracker 3.0", Role::None, Other, 1.0034),
            ("vive tracker mv", _) => Self::new("Vive Tracker", Role::None, Other, 1.005_85),
            ("vive mv", _) => Self::new("Vive headset", Role::Head, Other, 1.004),
            ("vive pro mv", _) => Self::new("Vive Pro headset", Role::Head, Other, 1.0028),
            ("tundra tracker", _) => Self::new("Tundra Tracker", Role::None, Other, 1.0),
            (_, "hmd") => Self::new("Lighthouse headset", Role::Head, Other, 1.0),
            (_, "controller") => Self::new("Lighthouse controller", Role::None, Wand, 1.0),
            _ => Self::new("Lighthouse tracker", Role::None, Other, 1.0),
        }
    }
}

/// The configuration's JSON. Old devices keep the IMU's calibration and the frames at the top
/// level, new ones in `imu` and `head`.
#[derive(Deserialize)]
struct File {
    #[serde(default)]
    device_serial_number: String,
    #[serde(default)]
    device_class: String,
    #[serde(default)]
    model_number: String,
    #[serde(default)]
    model_name: String,
    imu: Option<ImuEntry>,
    head: Option<AxesEntry>,
    #[serde(flatten)]
    calibration: CalibrationEntry,
    /// Quaternion x, y, z, w, then position.
    trackref_from_imu: Option<[f64; 7]>,
    trackref_from_head: Option<[f64; 7]>,
    lighthouse_config: LighthouseEntry,
}

#[derive(Deserialize)]
struct ImuEntry {
    #[serde(flatten)]
    axes: AxesEntry,
    #[serde(flatten)]
    calibration: CalibrationEntry,
}

#[derive(Deserialize, Default, Clone, Copy)]
struct CalibrationEntry {
    /// m/s^2.
    acc_bias: Option<[f64; 3]>,
    acc_scale: Option<[f64; 3]>,
    /// rad/s.
    gyro_bias: Option<[f64; 3]>,
    gyro_scale: Option<[f64; 3]>,
}

#[derive(Deserialize, Clone, Copy)]
struct AxesEntry {
    plus_x: [f64; 3],
    plus_z: [f64; 3],
    position: [f64; 3],
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct LighthouseEntry {
    channel_map: Option<Vec<i64>>,
    model_points: Vec<[f64; 3]>,
    model_normals: Vec<[f64; 3]>,
}

fn error(what: &str) -> DecodeError {
    DecodeError::Configuration(what.to_owned())
}

impl AxesEntry {
    fn frame(&self) -> Result<Frame, DecodeError> {
        let (x, z) = (DVec3::from(self.plus_x), DVec3::from(self.plus_z));
        let position = DVec3::from(self.position);
        let square = x.dot(z).abs() < 0.01 && (x.length() - 1.0).abs() < 0.01;
        if !square || (z.length() - 1.0).abs() >= 0.01 || !position.is_finite() {
            return Err(error(
                "`plus_x` and `plus_z` are not unit vectors at right angles",
            ));
        }
        let rotation = DQuat::from_mat3(&DMat3::from_cols(x, z.cross(x), z)).normalize();
        Ok(Frame { position, rotation })
    }
}

/// The old style: quaternion x, y, z, w, then position.
fn old_frame(numbers: [f64; 7]) -> Result<Frame, DecodeError> {
    let [x, y, z, w, position @ ..] = numbers;
    let (rotation, position) = (DQuat::from_xyzw(x, y, z, w), DVec3::from(position));
    if (rotation.length() - 1.0).abs() >= 0.01 || !position.is_finite() {
        return Err(error(
            "`trackref_from_*` does not begin with a unit quaternion",
        ));
    }
    Ok(Frame {
        position,
        rotation: rotation.normalize(),
    })
}

impl File {
    fn make(&self) -> Make {
        let named = if self.model_number.is_empty() {
            &self.model_name
        } else {
            &self.model_number
        };
        Make::find(named, &self.device_class)
    }

    /// The IMU's frame in the reference frame.
    fn imu_frame(&self) -> Result<Frame, DecodeError> {
        match (&self.imu, self.trackref_from_imu) {
            (Some(imu), _) => imu.axes.frame(),
            (None, Some(numbers)) => old_frame(numbers),
            (None, None) => Ok(Frame::IDENTITY),
        }
    }

    fn head_frame(&self) -> Result<Frame, DecodeError> {
        match (&self.head, self.trackref_from_head) {
            (Some(head), _) => head.frame(),
            (None, Some(numbers)) => old_frame(numbers),
            (None, None) => Ok(Frame::IDENTITY),
        }
    }

    fn imu_calibration(&self) -> ImuCalibration {
        let entry = self
            .imu
            .as_ref()
            .map_or(self.calibration, |imu| imu.calibration);
        // Garbage here must not keep a device from being tracked: biases are estimated anyway.
        let sound = |numbers: Option<[f64; 3]>, default, low: f64, high: f64| {
            let vector = numbers.map_or(default, DVec3::from);
            let inside = vector
                .to_array()
                .iter()
                .all(|number| (low..=high).contains(number));
            if inside { vector } else { default }
        };
        ImuCalibration {
            accel_bias: sound(entry.acc_bias, DVec3::ZERO, -2.0, 2.0),
            accel_scale: sound(entry.acc_scale, DVec3::ONE, 0.9, 1.1),
            gyro_bias: sound(entry.gyro_bias, DVec3::ZERO, -0.5, 0.5),
            gyro_scale: sound(entry.gyro_scale, DVec3::ONE, 0.9, 1.1),
        }
    }

    fn sensors(
        &self,
        imu: Frame,
        scale: f64,
    ) -> Result<[Option<Sensor>; SENSORS_MAX], DecodeError> {
        let LighthouseEntry {
            channel_map,
            model_points,
            model_normals,
        } = &self.lighthouse_config;
        if model_points.is_empty() || model_points.len() > SENSORS_MAX {
            return Err(error("there are no sensors, or more than 32"));
        }
        if model_normals.len() != model_points.len() {
            return Err(error("there are not as many normals as sensors"));
        }
        let mut sensors = [None; SENSORS_MAX];
        for (index, (point, normal)) in model_points.iter().zip(model_normals).enumerate() {
            let channel = match channel_map {
                Some(map) => map.get(index).copied().unwrap_or(-1),
                None => index as i64,
            };
            let (point, normal) = (DVec3::from(*point) * scale, DVec3::from(*normal));
            if !point.is_finite() || point.length() > 2.0 || !(0.9..1.1).contains(&normal.length())
            {
                return Err(error("a sensor has no sound position or normal"));
            }
            // Sensors that are not connected have a channel of -1.
            if let Some(slot) = usize::try_from(channel)
                .ok()
                .and_then(|i| sensors.get_mut(i))
            {
                let normal = (imu.rotation.conjugate() * normal).normalize();
                *slot = Some(Sensor {
                    position: imu.to_inner(point),
                    normal,
                });
            }
        }
        Ok(sensors)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Frames as an Index headset has them, with two sensors.
    const NEW: &str = r#"{
        "device_class": "hmd", "model_number": "Utah MP", "device_serial_number": "LHR-1",
        "head": {"plus_x": [-1, 0, 0], "plus_z": [0, 0, -1], "position": [0, 0, -0.01]},
        "imu": {"acc_bias": [0.1, 0, 0], "acc_scale": [1, 1.01, 1], "gyro_bias": [0, 0, 0.02],
                "plus_x": [0, -1, 0], "plus_z": [0, 0, 1], "position": [-0.05, 0.04, 0.06]},
        "lighthouse_config": {"channelMap": [13, 2], "modelPoints": [[0.1, 0, 0], [0, 0.1, 0]],
                              "modelNormals": [[1, 0, 0], [0, 0, 1]]}
    }"#;

    #[test]
    fn frames_turn_as_the_configuration_says() {
        let model = DeviceModel::from_json(NEW).unwrap();
        assert_eq!(model.identity.natural_role, Role::Head);
        assert_eq!(model.identity.serial.as_str(), "LHR-1");
        assert!(model.sensors[13].is_some() && model.sensors[2].is_some());
        assert_eq!(model.sensors.iter().flatten().count(), 2);
        // The reference frame's +z is forward, and its +x the wearer's left.
        let forward = model.head.rotation.conjugate() * model.sensors[2].unwrap().normal;
        assert!((forward - DVec3::NEG_Z).length() < 1e-9, "{forward}");
        let left = model.head.rotation.conjugate() * model.sensors[13].unwrap().normal;
        assert!((left - DVec3::NEG_X).length() < 1e-9, "{left}");
        // A sensor's place seen from the head frame is what the reference frame says.
        let sensor = model.sensors[13].unwrap().position;
        let from_head = model.head.to_inner(sensor);
        assert!(
            (from_head - DVec3::new(-0.100_48, 0.0, -0.01)).length() < 1e-9,
            "{from_head}"
        );
        assert_eq!(model.imu.accel_bias.x, 0.1);
    }

    #[test]
    fn the_old_style_is_read() {
        let old = r#"{
            "device_class": "generic_tracker", "model_name": "Vive Tracker MV",
            "acc_bias": [0.2, 0, 0], "gyro_scale": [1, 1, 1],
            "trackref_from_head": [-1, 0, 0, 0, 0, 0.04, 0.05],
            "trackref_from_imu": [0, 0, 0, 1, 0.01, 0.02, 0.06],
            "lighthouse_config": {"modelPoints": [[0, 0, 0]], "modelNormals": [[0, 0, 1]]}
        }"#;
        let model = DeviceModel::from_json(old).unwrap();
        assert_eq!(model.identity.model, "Vive Tracker");
        assert!((model.head.position - DVec3::new(-0.01, 0.02, -0.01)).length() < 1e-12);
        assert!((model.head.rotation * DVec3::Y - DVec3::NEG_Y).length() < 1e-12);
        assert!(
            (model.sensors[0].unwrap().position + DVec3::new(0.01, 0.02, 0.06)).length() < 1e-9
        );
        assert_eq!(model.imu.accel_bias.x, 0.2);
    }

    #[test]
    fn what_cannot_be_is_refused() {
        for (from, to) in [
            ("[-1, 0, 0], \"plus_z\"", "[-2, 0, 0], \"plus_z\""),
            ("[[0.1, 0, 0]", "[[1e9, 0, 0]"),
            ("[1, 0, 0], [0, 0, 1]", "[1, 0, 0]"),
            ("{\"channelMap\"", "[\"channelMap\""),
        ] {
            let text = NEW.replacen(from, to, 1);
            assert_ne!(text, NEW);
            assert!(DeviceModel::from_json(&text).is_err(), "{to}");
        }
        let absurd_bias = NEW.replacen("[0.1, 0, 0]", "[1e9, 0, 0]", 1);
        assert_eq!(
            DeviceModel::from_json(&absurd_bias).unwrap().imu.accel_bias,
            DVec3::ZERO
        );
    }

    #[test]
    fn ranges_follow_the_codes() {
        let range = ImuRange::from_codes(3, 2).unwrap();
        assert_eq!(range, ImuRange::controller());
        assert_eq!(ImuRange::from_codes(1, 1), Some(ImuRange::headset()));
        assert_eq!(ImuRange::from_codes(4, 0), None);
    }

    proptest! {
        #[test]
        fn any_text_gives_an_answer(text in ".{0,200}", cut in 0usize..800) {
            let _ = DeviceModel::from_json(&text);
            let _ = DeviceModel::from_json(NEW.get(..cut).unwrap_or(NEW));
        }
    }
}
