//! Base stations to simulate with, and the file that tells others about them.

use std::fmt::Write;

use glam::{DQuat, DVec3};
use half::f16;

use crate::lighthouse::base_station::{BaseStation, Generation, Source, from_z_up};
use crate::lighthouse::reproject::PlaneCalibration;

/// A base station of generation 2 in a corner of a room of 5 by 5 m, 2.3 m up, looking down at its
/// middle. The planes' numbers are in the order of [`PlaneCalibration`]'s fields.
fn corner(channel: u8, x: f64, z: f64, planes: [[f64; 7]; 2]) -> BaseStation {
    let plane = |values: [f64; 7]| {
        // They broadcast 16-bit floats: anything finer would be lost.
        let [phase, tilt, curve, gibphase, gibmag, ogeephase, ogeemag] =
            values.map(|value| f16::from_f64(value).to_f64());
        PlaneCalibration {
            phase,
            tilt,
            curve,
            gibphase,
            gibmag,
            ogeephase,
            ogeemag,
        }
    };
    BaseStation {
        source: Source::Channel(channel),
        id: 0x51a0_0000 | u32::from(channel),
        position: DVec3::new(x, 2.3, z),
        rotation: DQuat::from_rotation_y(x.atan2(z)) * DQuat::from_rotation_x(-25f64.to_radians()),
        calibration: planes.map(plane),
    }
}

/// Two base stations in opposite corners of the room, with deviations of the size that real ones
/// have.
#[must_use]
pub fn default_stations() -> Vec<BaseStation> {
    vec![
        corner(
            2,
            -2.4,
            -2.4,
            [
                [0.0, -0.048, 0.12, 2.1, -0.006, 1.9, 0.21],
                [-0.005, 0.046, 0.21, 2.5, -0.004, 2.8, -0.18],
            ],
        ),
        corner(
            8,
            2.4,
            2.4,
            [
                [0.0, -0.051, -0.06, 1.8, -0.003, 0.8, -0.15],
                [-0.007, 0.044, 0.29, 2.4, -0.005, 1.4, 0.24],
            ],
        ),
    ]
}

/// Four base stations, one in each corner: [`default_stations`] and two more.
#[must_use]
pub fn four_stations() -> Vec<BaseStation> {
    let mut stations = default_stations();
    stations.extend([
        corner(
            5,
            2.4,
            -2.4,
            [
                [0.0, -0.050, 0.08, 2.0, -0.005, 2.2, 0.12],
                [-0.006, 0.047, 0.25, 2.2, -0.006, 1.1, -0.09],
            ],
        ),
        corner(
            11,
            -2.4,
            2.4,
            [
                [0.0, -0.047, 0.03, 1.7, -0.004, 0.4, -0.22],
                [-0.004, 0.045, 0.19, 2.6, -0.003, 2.5, 0.16],
            ],
        ),
    ]);
    stations
}

/// Two base stations of generation 1, one that flashes first and one second, in the places of
/// [`default_stations`].
#[must_use]
pub fn generation_one_stations() -> Vec<BaseStation> {
    let plane = |values: [f64; 5]| {
        let [phase, tilt, curve, gibphase, gibmag] =
            values.map(|value| f16::from_f64(value).to_f64());
        PlaneCalibration {
            phase,
            tilt: tilt.tan(),
            curve,
            gibphase,
            gibmag,
            ..PlaneCalibration::default()
        }
    };
    let planes = [
        [
            [0.023, -0.0095, 0.0023, 1.81, 0.0206],
            [0.029, -0.0079, 0.0021, -1.18, -0.0123],
        ],
        [
            [0.059, 0.0013, -0.0019, 2.89, 0.0047],
            [0.062, 0.0001, -0.0036, 0.024, -0.0040],
        ],
    ];
    let placed = default_stations().into_iter().zip(planes).enumerate();
    placed
        .map(|(slot, (station, planes))| BaseStation {
            source: Source::Slot(slot as u8),
            calibration: planes.map(plane),
            ..station
        })
        .collect()
}

/// The stations in the file format that [`crate::lighthouse::base_station::parse_libsurvive`]
/// reads: libsurvive's, in its Z-up world, with digits enough to lose nothing.
#[must_use]
pub fn write_libsurvive(stations: &[BaseStation]) -> String {
    let old = |station: &BaseStation| station.source.generation() == Generation::One;
    let generation = if stations.iter().any(old) { 1 } else { 2 };
    let mut text = format!("\"v\":\"0\",\n\"lighthouse-gen\":\"{generation}\"\n");
    for (index, station) in stations.iter().enumerate() {
        let turn = from_z_up().conjugate();
        let position = turn * station.position;
        let q = turn * station.rotation;
        let both =
            |of: fn(&PlaneCalibration) -> f64| numbers(&station.calibration.each_ref().map(of));
        let pose = [position.x, position.y, position.z, q.w, q.x, q.y, q.z];
        // Writing into a `String` cannot fail.
        let _ = write!(
            text,
            "\"lighthouse{index}\":{{\n\"index\":\"{index}\",\n\"id\":\"{}\",\n\"mode\":\"{}\",\n\
             \"pose\":{},\n\"fcalphase\":{},\n\"fcaltilt\":{},\n\"fcalcurve\":{},\n\
             \"fcalgibpha\":{},\n\"fcalgibmag\":{},\n\"fcalogeephase\":{},\n\
             \"fcalogeemag\":{},\n\"OOTXSet\":\"1\",\n\"PositionSet\":\"1\"\n}}\n",
            station.id as i32,
            match station.source {
                // b flashes first, c second.
                Source::Slot(slot) => slot + 1,
                Source::Channel(channel) => channel,
            },
            numbers(&pose),
            both(|plane| plane.phase),
            both(|plane| plane.tilt),
            both(|plane| plane.curve),
            both(|plane| plane.gibphase),
            both(|plane| plane.gibmag),
            both(|plane| plane.ogeephase),
            both(|plane| plane.ogeemag),
        );
    }
    text
}

fn numbers(values: &[f64]) -> String {
    let quoted: Vec<String> = values
        .iter()
        .map(|value| format!("\"{value:.12}\""))
        .collect();
    format!("[{}]", quoted.join(","))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lighthouse::base_station::parse_libsurvive;

    #[test]
    fn the_file_reads_back() {
        let stations = default_stations();
        let old = generation_one_stations();
        let read = parse_libsurvive(&write_libsurvive(&stations)).unwrap();
        let read_old = parse_libsurvive(&write_libsurvive(&old)).unwrap();
        assert_eq!((read.len(), read_old.len()), (stations.len(), old.len()));
        let both = read
            .iter()
            .chain(&read_old)
            .zip(stations.iter().chain(&old));
        for (read, written) in both {
            assert_eq!((read.source, read.id), (written.source, written.id));
            assert!((read.position - written.position).length() < 1e-9);
            assert!(read.rotation.angle_between(written.rotation) < 1e-6);
            for (read, written) in read.calibration.iter().zip(&written.calibration) {
                assert!((read.curve - written.curve).abs() < 1e-11);
                assert!((read.ogeephase - written.ogeephase).abs() < 1e-11);
            }
        }
    }

    #[test]
    fn the_stations_look_down_at_the_room() {
        for station in four_stations() {
            let middle = station.to_local(DVec3::new(0.0, 1.0, 0.0));
            assert!(
                middle.z < -3.0 && middle.x.abs() < 0.05 && middle.y.abs() < 1.0,
                "{middle}"
            );
        }
    }
}
