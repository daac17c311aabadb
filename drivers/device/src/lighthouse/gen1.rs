//! The generation-1 reprojection model: where a point in a base station's frame is met by its two
//! light planes. The model is libsurvive's (MIT).
//!
//! A base station looks along -Z, with Y up and X right. Two rotors turn one upright light plane
//! each: plane 0 about the vertical, plane 1 about the horizontal. A reading is the angle of a plane
//! from straight ahead, positive to the left and upwards.

use glam::DVec3;

use super::reproject::PlaneCalibration;

/// The reading of `plane` (0 or 1) for a point in the base station's frame (metres), in rad, and its
/// gradient over the point, rad/m. `tilt` is a slope here: the tangent of what is broadcast.
#[must_use]
pub fn reproject(
    calibration: &PlaneCalibration,
    plane: usize,
    point_in_base: DVec3,
) -> (f64, DVec3) {
    let depth = -point_in_base.z;
    // Across the plane, and along it.
    let (across, along) = if plane == 0 {
        (point_in_base.x, point_in_base.y)
    } else {
        (-point_in_base.y, point_in_base.x)
    };
    let r2 = (across * across + depth * depth).max(1e-12);
    let r = r2.sqrt();
    let (lean, lean_slope) = asin(calibration.tilt * along / r);
    let angle = -across.atan2(depth) - calibration.phase - lean;
    let lean_slope = lean_slope * calibration.tilt / r;
    // Gradients over (across, along, depth).
    let angle_g = DVec3::new(-depth / r2, 0.0, across / r2)
        - lean_slope * DVec3::new(-along * across / r2, 1.0, -along * depth / r2);
    let (gib_sin, gib_cos) = (angle + calibration.gibphase).sin_cos();
    let elevation = along.atan2(depth);
    let e2 = (along * along + depth * depth).max(1e-12);
    let elevation_g = DVec3::new(0.0, depth / e2, -along / e2);
    let reading = angle + gib_sin * calibration.gibmag + calibration.curve * elevation * elevation;
    let gradient = angle_g * (1.0 + gib_cos * calibration.gibmag)
        + elevation_g * (2.0 * calibration.curve * elevation);
    let gradient = if plane == 0 {
        DVec3::new(gradient.x, gradient.y, -gradient.z)
    } else {
        DVec3::new(gradient.y, -gradient.x, -gradient.z)
    };
    (reading, gradient)
}

/// The direction in which both planes' readings meet, as if the planes were flat; unit.
#[must_use]
pub fn bearing(calibration: &[PlaneCalibration; 2], angles: [f64; 2]) -> DVec3 {
    let left = angles[0] + calibration[0].phase;
    let up = angles[1] + calibration[1].phase;
    DVec3::new(-left.tan(), up.tan(), -1.0).normalize_or(DVec3::NEG_Z)
}

/// `asin` and its slope; outside its domain it stays at the edge.
fn asin(value: f64) -> (f64, f64) {
    const EDGE: f64 = 1.0 - 1e-9;
    if value.abs() >= EDGE {
        return (value.clamp(-EDGE, EDGE).asin(), 0.0);
    }
    (value.asin(), 1.0 / (1.0 - value * value).sqrt())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn flat_planes_are_planes() {
        let flat = PlaneCalibration::default();
        let point = DVec3::new(0.7, -0.4, -2.1);
        for (plane, across) in [(0, 0.7f64), (1, 0.4)] {
            let expected = -(across / 2.1).atan();
            assert!((reproject(&flat, plane, point).0 - expected).abs() < 1e-12);
        }
    }

    proptest! {
        #[test]
        fn the_gradient_is_that_of_the_reading(
            x in -2.0f64..2.0, y in -1.5f64..1.5, z in -5.0f64..-1.0, plane in 0usize..2,
            tilt in -0.02f64..0.02, curve in -0.01f64..0.01, gibphase in 0.0f64..6.0,
        ) {
            let gibmag = 0.02;
            let calibration =
                PlaneCalibration { phase: 0.05, tilt, curve, gibphase, gibmag, ..Default::default() };
            let point = DVec3::new(x, y, z);
            let (_, gradient) = reproject(&calibration, plane, point);
            for axis in 0..3 {
                let mut step = DVec3::ZERO;
                step[axis] = 1e-6;
                let numeric = (reproject(&calibration, plane, point + step).0
                    - reproject(&calibration, plane, point - step).0) / 2e-6;
                prop_assert!((numeric - gradient[axis]).abs() < 1e-7);
            }
        }

        #[test]
        fn readings_give_their_bearing_back(
            x in -2.0f64..2.0, y in -1.5f64..1.5, z in -5.0f64..-1.0, phase in -0.06f64..0.06,
        ) {
            let calibration = [PlaneCalibration { phase, ..Default::default() }; 2];
            let point = DVec3::new(x, y, z);
            let angles = [0, 1].map(|plane| reproject(&calibration[plane], plane, point).0);
            prop_assert!((bearing(&calibration, angles) - point.normalize()).length() < 1e-9);
        }

        #[test]
        fn every_point_has_a_finite_reading(
            x in -1e3f64..1e3, y in -1e3f64..1e3, z in -1e3f64..1e3, plane in 0usize..2,
        ) {
            let calibration = PlaneCalibration { tilt: 0.02, ..Default::default() };
            let (reading, gradient) = reproject(&calibration, plane, DVec3::new(x, y, z));
            prop_assert!(reading.is_finite() && gradient.is_finite());
        }
    }
}
