//! Devices under base stations of generation 1, in the shared captures.

use posed_signal::PoseHow;

use super::captures::{captures, tracked};
use super::quantile;

/// A Vive headset on its cable, a Vive tracker by radio (libsurvive-extras-data).
#[test]
fn devices_under_generation_one_are_tracked() {
    let Some(captures) = captures("devices_under_generation_one_are_tracked") else {
        return;
    };
    for (capture, file, serial, share, residual) in [
        (
            "vive_cal.pcap.gz",
            "vive_cal.json",
            "LHR-D8EC5307",
            0.99,
            2e-4,
        ),
        (
            "wireless-tracker.pcap.gz",
            "wireless-tracker.json",
            "LHR-01B7ABC0",
            0.95,
            4e-4,
        ),
    ] {
        let (begin, devices) = tracked(&captures.join(capture), &captures.join(file));
        let device = devices.iter().find(|device| device.serial == serial);
        let device = device.unwrap_or_else(|| panic!("{capture}: no {serial}"));
        let late = device
            .poses
            .iter()
            .filter(|pose| pose.at.as_secs_f64() - begin > 4.0);
        let (all, optical): (Vec<_>, Vec<_>) = (
            late.clone().collect(),
            late.filter(|pose| pose.how == PoseHow::Optical).collect(),
        );
        let found = optical.len() as f64 / all.len().max(1) as f64;
        assert!(found > share, "{capture}: {found} of {} poses", all.len());
        let residuals = optical.iter().map(|pose| f64::from(pose.residual_rad));
        let median = quantile(residuals, 0.5);
        assert!(median < residual, "{capture}: {median} rad");
    }
}
