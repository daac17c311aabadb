//! A device's configuration as it travels: JSON, deflated, in chunks behind feature report 0x11.

use std::io::Write;

use flate2::{Compression, write::ZlibEncoder};
use glam::DVec3;
use serde_json::{Value, json};

use super::blueprint::{Blueprint, Sensor};
use super::device::{Model, Placement};

/// Data bytes in a report 0x11.
const CHUNK: usize = 62;

/// The configuration in Valve's layout.
pub(super) fn document(model: Model, serial: &str, blueprint: &Blueprint) -> Value {
    let (class, name, role) = match model {
        Model::Headset => ("hmd", "Utah MP", None),
        Model::LeftController => ("controller", "Knuckles Left", Some("left_hand")),
        Model::RightController => ("controller", "Knuckles Right", Some("right_hand")),
    };
    let column = |of: fn(&Sensor) -> DVec3| {
        let rows = blueprint.sensors.iter().map(|sensor| numbers(of(sensor)));
        rows.collect::<Vec<_>>()
    };
    let channels: Vec<u8> = blueprint
        .sensors
        .iter()
        .map(|sensor| sensor.channel)
        .collect();
    let mut imu = frame(&blueprint.imu);
    imu["acc_bias"] = json!(numbers(blueprint.calibration.acc_bias));
    imu["acc_scale"] = json!(numbers(blueprint.calibration.acc_scale));
    imu["gyro_bias"] = json!(numbers(blueprint.calibration.gyro_bias));
    let mut document = json!({
        "device_class": class,
        "device_pid": 8192,
        "device_serial_number": serial,
        "device_vid": 10462,
        "head": frame(&blueprint.head),
        "imu": imu,
        "lighthouse_config": {
            "channelMap": channels,
            "modelNormals": column(|sensor| sensor.normal),
            "modelPoints": column(|sensor| sensor.claimed),
        },
        "manufacturer": "posed simulator",
        "model_number": name,
        "revision": 1,
    });
    if let Some(role) = role {
        document["tracked_controller_role"] = json!(role);
    }
    document
}

fn frame(placement: &Placement) -> Value {
    json!({
        "plus_x": numbers(placement.rotation * DVec3::X),
        "plus_z": numbers(placement.rotation * DVec3::Z),
        "position": numbers(placement.position),
    })
}

/// Nine decimals: a nanometre.
fn numbers(vector: DVec3) -> [f64; 3] {
    vector.to_array().map(|x| (x * 1e9).round() / 1e9)
}

/// The answers to one `GET_REPORT` of 0x10 and to those of 0x11 until the end, 64 bytes each.
pub(super) fn feature_reports(document: &Value) -> Vec<Vec<u8>> {
    let text = serde_json::to_vec_pretty(document).unwrap_or_default();
    let mut blob = deflate(&text);
    let length = (blob.len() as u16).to_be_bytes();
    // Real devices end the blob with two bytes that are not part of the deflated data.
    blob.extend([0, 0]);
    let report = |head: &[u8], data: &[u8]| {
        let mut report = [head, data].concat();
        report.resize(64, 0);
        report
    };
    let mut reports = vec![report(&[0x10, length[0], length[1]], &[])];
    for chunk in blob.chunks(CHUNK) {
        reports.push(report(&[0x11, chunk.len() as u8], chunk));
    }
    reports.push(report(&[0x11, 0], &[]));
    reports
}

fn deflate(text: &[u8]) -> Vec<u8> {
    let mut encoder = ZlibEncoder::new(Vec::new(), Compression::best());
    // Writing into a `Vec` cannot fail.
    let _ = encoder.write_all(text);
    encoder.finish().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use std::io::Read;

    use super::*;
    use crate::simulate::Options;

    #[test]
    fn the_reports_hold_the_document() {
        let blueprint = Blueprint::new(Model::LeftController, &Options::default(), 1);
        let document = document(Model::LeftController, "SIM-X", &blueprint);
        let reports = feature_reports(&document);
        assert!(reports.iter().all(|report| report.len() == 64));
        assert_eq!((reports[0][0], reports.last().unwrap()[1]), (0x10, 0));
        let blob: Vec<u8> = reports[1..]
            .iter()
            .flat_map(|report| report[2..2 + usize::from(report[1])].to_vec())
            .collect();
        let stated = u16::from_be_bytes([reports[0][1], reports[0][2]]);
        assert_eq!(blob.len(), usize::from(stated) + 2);
        let mut text = String::new();
        let mut decoder = flate2::read::ZlibDecoder::new(&blob[..]);
        decoder.read_to_string(&mut text).unwrap();
        assert_eq!(serde_json::from_str::<Value>(&text).unwrap(), document);
        assert_eq!(document["tracked_controller_role"], "left_hand");
        assert_eq!(
            document["lighthouse_config"]["modelPoints"]
                .as_array()
                .unwrap()
                .len(),
            24
        );
    }
}
