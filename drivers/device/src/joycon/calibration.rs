//! Calibration of the inertial sensors, from the device's flash memory.

use std::ops::Range;

use glam::Vec3;

use super::wire::RawImu;

/// Standard gravity, m/s^2.
pub const G: f32 = 9.806_65;
/// Where the factory's calibration lies, and its length: origin and scale of the accelerometer,
/// origin and scale of the gyroscope, three numbers of 16 bits each.
pub const FACTORY: (u32, u8) = (0x6020, 24);
/// Where the user's lies, behind two bytes that say whether it counts.
pub const USER: (u32, u8) = (0x8026, 26);
/// Those two bytes.
const USER_COUNTS: [u8; 2] = [0xb2, 0xa1];

/// What the accelerometer's scale stands for, g.
const ACCEL_SCALE_G: f32 = 4.0;
/// What the gyroscope's scale stands for, degrees a second. The usual scale of 13,371 counts makes
/// 0.07 degrees a second a count, which is what the sensor's datasheet (LSM6DS3) says.
const GYRO_SCALE_DPS: f32 = 936.0;

/// How counts become units. The accelerometer's origin changes its scale but is not taken off:
/// dekuNukem's notes and the kernel's driver agree in that.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Calibration {
    /// m/s^2 a count.
    pub accel: Vec3,
    /// Counts at rest.
    pub gyro_origin: Vec3,
    /// rad/s a count.
    pub gyro: Vec3,
}

impl Default for Calibration {
    /// That of an average device.
    fn default() -> Self {
        Self {
            accel: Vec3::splat(ACCEL_SCALE_G * G / 16_384.0),
            gyro_origin: Vec3::ZERO,
            gyro: Vec3::splat((GYRO_SCALE_DPS / 13_371.0).to_radians()),
        }
    }
}

impl Calibration {
    /// From its 24 bytes; `None` where they make no sense, as in erased memory.
    fn from_bytes(bytes: &[u8; 24]) -> Option<Self> {
        let short = |at: usize| f32::from(i16::from_le_bytes([bytes[at], bytes[at + 1]]));
        let vector = |at: usize| Vec3::new(short(at), short(at + 2), short(at + 4));
        let (accel_origin, accel_scale) = (vector(0), vector(6));
        let (gyro_origin, gyro_scale) = (vector(12), vector(18));
        let spans = [accel_scale - accel_origin, gyro_scale - gyro_origin];
        // Half to twice the usual: anything else is not a calibration.
        let usual = spans[0].min_element() > 8_192.0
            && spans[0].max_element() < 32_768.0
            && spans[1].min_element() > 6_500.0
            && spans[1].max_element() < 27_000.0;
        usual.then(|| Self {
            accel: ACCEL_SCALE_G * G / spans[0],
            gyro_origin,
            gyro: GYRO_SCALE_DPS.to_radians() / spans[1],
        })
    }

    /// m/s^2.
    #[must_use]
    pub fn acceleration(&self, raw: &RawImu) -> Vec3 {
        vector(raw.accel) * self.accel
    }

    /// rad/s.
    #[must_use]
    pub fn angular_velocity(&self, raw: &RawImu) -> Vec3 {
        (vector(raw.gyro) - self.gyro_origin) * self.gyro
    }
}

fn vector(counts: [i16; 3]) -> Vec3 {
    Vec3::from_array(counts.map(f32::from))
}

/// Which calibration is in use.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Origin {
    /// That of an average device.
    #[default]
    Usual,
    /// The factory's.
    Factory,
    /// The user's.
    User,
}

impl Origin {
    /// The word used in JSON output.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Usual => "usual",
            Self::Factory => "factory",
            Self::User => "user",
        }
    }
}

/// What was read of the flash memory.
#[derive(Debug, Clone, Default)]
pub struct Flash {
    factory: [Option<u8>; FACTORY.1 as usize],
    user: [Option<u8>; USER.1 as usize],
}

impl Flash {
    /// Takes the answer to a read: address, length, bytes. What lies elsewhere is of no use here.
    pub fn take(&mut self, reply: &[u8]) {
        let Some((head, bytes)) = reply.split_first_chunk::<5>() else {
            return;
        };
        let [a, b, c, d, length] = *head;
        let address = u32::from_le_bytes([a, b, c, d]);
        let bytes = &bytes[..bytes.len().min(usize::from(length))];
        fill(&mut self.factory, FACTORY.0, address, bytes);
        fill(&mut self.user, USER.0, address, bytes);
    }

    /// Whether both places were read whole.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.factory.iter().chain(&self.user).all(Option::is_some)
    }

    /// The calibration that counts.
    #[must_use]
    pub fn calibration(&self) -> (Calibration, Origin) {
        let counts = known::<2>(&self.user, 0..2) == Some(USER_COUNTS);
        let user = known::<24>(&self.user, 2..26).filter(|_| counts);
        if let Some(calibration) = user.as_ref().and_then(Calibration::from_bytes) {
            return (calibration, Origin::User);
        }
        let factory = known::<24>(&self.factory, 0..24);
        match factory.as_ref().and_then(Calibration::from_bytes) {
            Some(calibration) => (calibration, Origin::Factory),
            None => (Calibration::default(), Origin::Usual),
        }
    }
}

/// Copies what of `bytes`, read at `address`, lies in the place that begins at `begin`.
fn fill(place: &mut [Option<u8>], begin: u32, address: u32, bytes: &[u8]) {
    for (offset, &byte) in bytes.iter().enumerate() {
        let at = u64::from(address) + offset as u64;
        let index = at.checked_sub(u64::from(begin));
        if let Some(slot) = index.and_then(|index| place.get_mut(index as usize)) {
            *slot = Some(byte);
        }
    }
}

fn known<const N: usize>(place: &[Option<u8>], range: Range<usize>) -> Option<[u8; N]> {
    let bytes: Option<Vec<u8>> = place[range].iter().copied().collect();
    bytes?.try_into().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(address: u32, bytes: &[u8]) -> Vec<u8> {
        let mut reply = address.to_le_bytes().to_vec();
        reply.push(bytes.len() as u8);
        reply.extend(bytes);
        reply
    }

    fn bytes(origin: i16, gyro_origin: i16) -> Vec<u8> {
        let numbers = [[origin; 3], [0x4000; 3], [gyro_origin; 3], [0x343b; 3]];
        numbers
            .iter()
            .flatten()
            .flat_map(|n| n.to_le_bytes())
            .collect()
    }

    #[test]
    fn the_users_calibration_counts_only_if_it_says_so() {
        let mut flash = Flash::default();
        assert_eq!(flash.calibration(), (Calibration::default(), Origin::Usual));
        flash.take(&read(0x6020, &bytes(100, 0)));
        flash.take(&read(0x8028, &bytes(0, 371)));
        assert_eq!(flash.calibration().1, Origin::Factory);
        assert!(!flash.is_complete());
        // The two bytes come at the end of a longer read.
        let mut longer = vec![0xff; 22];
        longer.extend(USER_COUNTS);
        flash.take(&read(0x8010, &longer));
        let (calibration, origin) = flash.calibration();
        assert!(flash.is_complete());
        assert_eq!(
            (origin, calibration.gyro_origin),
            (Origin::User, Vec3::splat(371.0))
        );
        let raw = RawImu {
            accel: [4_096, 0, 0],
            gyro: [371 + 1_300, 371, 371],
        };
        let accel = calibration.acceleration(&raw);
        assert!(accel.distance(Vec3::X * G) < 1e-4, "{accel}");
        let gyro = calibration.angular_velocity(&raw) * 180.0 / std::f32::consts::PI;
        assert!(gyro.distance(Vec3::X * 93.6) < 1e-2, "{gyro}");
    }

    #[test]
    fn erased_memory_is_no_calibration() {
        let mut flash = Flash::default();
        flash.take(&read(0x6020, &[0xff; 24]));
        flash.take(&read(0x8026, &[0xff; 26]));
        assert_eq!(flash.calibration().1, Origin::Usual);
        flash.take(&[0x20, 0x60]);
        flash.take(&read(u32::MAX, &[1, 2, 3]));
    }
}
