//! What `posed inspect` says of SlimeVR receivers and of Joy-Cons.

use std::fmt::Write as _;

use posed_device::{joycon, slimevr};
use serde_json::{Value, json};

pub(super) fn slimevr_json(report: &slimevr::inspect::Report) -> Value {
    let tracker = |(number, tracker): (&u8, &slimevr::inspect::TrackerReport)| {
        json!({
            "number": number,
            "serial": tracker.address,
            "motions": tracker.motions,
            "rate_hz": tracker.rate_hz,
            "mean_accel": tracker.mean_accel,
            "battery": tracker.charge,
            "rssi_dbm": tracker.rssi_dbm,
            "radio_received": tracker.received,
            "radio_lost": tracker.lost,
            "firmware": tracker.firmware,
        })
    };
    json!({
        "packets": report.reports,
        "errors": report.errors,
        "first_error": report.first_error,
        "trackers": report.trackers.iter().map(tracker).collect::<Vec<_>>(),
    })
}

pub(super) fn slimevr_text(report: &slimevr::inspect::Report, text: &mut String) {
    packets(
        report.reports,
        report.errors,
        report.first_error.as_deref(),
        text,
    );
    for (number, tracker) in &report.trackers {
        let name = tracker.address.as_deref().unwrap_or("unnamed");
        let _ = write!(
            text,
            "  tracker {number}  {name}: {} motions",
            tracker.motions
        );
        if let Some(hz) = tracker.rate_hz {
            let _ = write!(text, " at {hz:.1} Hz");
        }
        if let Some(charge) = tracker.charge {
            let _ = write!(text, ", battery {:.0}%", 100.0 * charge);
        }
        if let Some(dbm) = tracker.rssi_dbm {
            let _ = write!(text, ", {dbm:.0} dBm");
        }
        let _ = writeln!(
            text,
            ", {} of {} packets lost",
            tracker.lost,
            tracker.lost + tracker.received
        );
    }
}

pub(super) fn joycon_json(report: &joycon::inspect::Report) -> Value {
    let [unknown, off, raw, packed] = report.by_mode;
    json!({
        "model": report.model,
        "serial": report.serial,
        "packets": report.reports,
        "errors": report.errors,
        "first_error": report.first_error,
        "full_reports": report.full_reports,
        "rate_hz": report.rate_hz,
        "reports_by_imu_mode": {"unknown": unknown, "off": off, "raw": raw, "packed": packed},
        "imu_samples": report.imu_samples,
        "median_accel_g": report.median_accel_g,
        "median_gyro_dps": report.median_gyro_dps,
        "calibration": report.calibration.name(),
        "battery": report.charge,
    })
}

pub(super) fn joycon_text(report: &joycon::inspect::Report, text: &mut String) {
    packets(
        report.reports,
        report.errors,
        report.first_error.as_deref(),
        text,
    );
    let _ = write!(text, "  {} with inertial samples", report.full_reports);
    if let Some(hz) = report.rate_hz {
        let _ = write!(text, " at {hz:.1} Hz");
    }
    if let Some(g) = report.median_accel_g {
        let _ = write!(text, ", median |a| {g:.4} g before calibration");
    }
    let [unknown, off, raw, packed] = report.by_mode;
    let _ = writeln!(
        text,
        "\n  sensors: {raw} reports raw, {packed} with packed rotations (no gyroscope), \
         {unknown} of an unknown mode, {off} off"
    );
    let _ = write!(
        text,
        "  {} samples with a gyroscope, {} calibration",
        report.imu_samples,
        report.calibration.name()
    );
    if let Some(dps) = report.median_gyro_dps {
        let _ = write!(text, ", median turn {dps:.2} degrees a second");
    }
    let _ = writeln!(text);
}

fn packets(count: u64, errors: u64, first: Option<&str>, text: &mut String) {
    let _ = write!(text, "  {count} reports");
    if errors > 0 {
        let _ = write!(
            text,
            ", {errors} not decoded (first: {})",
            first.unwrap_or("")
        );
    }
    let _ = writeln!(text);
}
