//! The data that a base station broadcasts, one bit a rotation ("OOTX"): 17 zeros
//! and a one, the length, the payload and its CRC-32, with a one after every 16 bits so that the
//! preamble stays unique.

use half::f16;

use crate::lighthouse::base_station::{BaseStation, Generation};
use crate::lighthouse::reproject::PlaneCalibration;

/// Firmware version that the payload states.
const FIRMWARE: u16 = 2568;
/// Gravity in the base station's frame is sent in units of 1/127 g.
const GRAVITY_UNIT: f64 = 127.0;

/// The bits of one frame; they repeat without a pause.
pub(super) fn frame_bits(station: &BaseStation) -> Vec<bool> {
    let payload = payload(station);
    let mut crc = flate2::Crc::new();
    crc.update(&payload);
    let mut bytes = (payload.len() as u16).to_le_bytes().to_vec();
    bytes.extend(&payload);
    if payload.len() % 2 == 1 {
        bytes.push(0);
    }
    bytes.extend(crc.sum().to_le_bytes());
    let mut bits = vec![false; 17];
    bits.push(true);
    for pair in bytes.chunks(2) {
        for byte in pair {
            bits.extend((0..8).rev().map(|bit| byte >> bit & 1 == 1));
        }
        bits.push(true);
    }
    bits
}

fn payload(station: &BaseStation) -> Vec<u8> {
    let halves = |of: fn(&PlaneCalibration) -> f64| {
        let [first, second] = station.calibration.each_ref().map(of);
        [first, second]
            .map(|value| f16::from_f64(value).to_le_bytes())
            .concat()
    };
    let up = station.rotation.conjugate() * glam::DVec3::Y * GRAVITY_UNIT;
    let generation = station.source.generation();
    let mut bytes = FIRMWARE.to_le_bytes().to_vec();
    bytes.extend(station.id.to_le_bytes());
    bytes.extend(halves(|plane| plane.phase));
    match generation {
        // The model's slope is the tangent of what is sent.
        Generation::One => bytes.extend(halves(|plane| plane.tilt.atan())),
        Generation::Two => bytes.extend(halves(|plane| plane.tilt)),
    }
    // Unlock count and hardware model.
    bytes.extend([1, 15]);
    bytes.extend(halves(|plane| plane.curve));
    bytes.extend(up.to_array().map(|x| x.round() as i8 as u8));
    bytes.extend(halves(|plane| plane.gibphase));
    bytes.extend(halves(|plane| plane.gibmag));
    if generation == Generation::One {
        // Mode A or b, and no faults.
        bytes.extend([station.source.index() as u8 & 1, 0]);
        return bytes;
    }
    // Mode, which is the channel with the top bit set, and no faults.
    bytes.extend([0x80 | station.source.index() as u8, 0]);
    bytes.extend(halves(|plane| plane.ogeephase));
    bytes.extend(halves(|plane| plane.ogeemag));
    bytes.extend((station.id as u16 ^ 0x5a5a).to_le_bytes());
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::default_stations;

    #[test]
    fn a_frame_is_as_long_as_the_real_ones() {
        // 43 bytes of payload: a frame repeats after 443 rotations in captures.
        let station = default_stations()[0];
        assert_eq!(payload(&station).len(), 43);
        assert_eq!(frame_bits(&station).len(), 443);
    }

    #[test]
    fn the_preamble_is_unique_and_the_payload_reads_back() {
        let station = default_stations()[1];
        let bits = frame_bits(&station);
        let twice = [bits.clone(), bits.clone()].concat();
        let preambles = (0..bits.len())
            .filter(|&i| twice[i..i + 17].iter().all(|bit| !bit))
            .count();
        assert_eq!(preambles, 1);
        let byte = |bits: &[bool]| {
            bits.iter()
                .fold(0u8, |byte, &bit| byte << 1 | u8::from(bit))
        };
        let bytes: Vec<u8> = bits[18..]
            .chunks(17)
            .flat_map(|word| {
                assert!(word[16]);
                [byte(&word[..8]), byte(&word[8..16])]
            })
            .collect();
        assert_eq!(bytes[..2], [43, 0]);
        assert_eq!(bytes[4..8], station.id.to_le_bytes());
        assert_eq!(bytes[2..45], payload(&station));
        let tilt = f16::from_le_bytes([bytes[12], bytes[13]]).to_f64();
        assert_eq!(tilt, station.calibration[0].tilt);
        let gravity = bytes[23] as i8;
        assert!(
            (100..127).contains(&gravity),
            "looks down a little: {gravity}"
        );
    }
}
