//! The generation-2 reprojection model: where a point in a base station's frame is met by its two
//! light planes. The model is libsurvive's (MIT), which found it by comparison with Valve's.
//!
//! A base station looks along -Z, with Y up and X right. Its rotor turns two fan-shaped light
//! planes past the room, tilted by about +30 and -30 degrees; a reading is the rotor angle at
//! which a plane passes the point, less that plane's centre angle.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_6, TAU};

use glam::{DQuat, DVec3};

/// Rotor speed that belongs to each channel of a generation-2 base station, revolutions a second.
pub const ROTOR_HZ: [f64; 16] = [
    50.0521, 50.1567, 50.3673, 50.5796, 50.6864, 50.9014, 51.0096, 51.1182, 51.2273, 51.6685,
    52.2307, 52.6894, 52.9217, 53.2741, 53.7514, 54.1150,
];

/// The rotor angle, counted from the sync pulse, at which each plane looks straight ahead, rad.
pub const PLANE_CENTRE: [f64; 2] = [TAU / 3.0, 2.0 * TAU / 3.0];

/// A light plane's shape, as the base station broadcasts it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct PlaneCalibration {
    /// Offset of the plane's angle, rad.
    pub phase: f64,
    /// Deviation of the plane's tilt from 30 degrees, rad.
    pub tilt: f64,
    /// Curvature of the plane.
    pub curve: f64,
    /// Phase of the first-order rotor wobble, rad.
    pub gibphase: f64,
    /// Magnitude of the first-order rotor wobble, rad.
    pub gibmag: f64,
    /// Phase of the wobble of the curvature, rad.
    pub ogeephase: f64,
    /// Magnitude of the wobble of the curvature.
    pub ogeemag: f64,
}

/// The polynomial that turns elevation into curvature, highest power first.
const CURVATURE: [f64; 6] = [
    -8.010_802_2e-6,
    0.002_867_986_3,
    5.368_525_5e-6,
    0.007_606_979_8,
    0.0,
    0.0,
];

/// The reading of `plane` (0 or 1) for a point in the base station's frame (metres), in rad.
#[must_use]
pub fn reproject(calibration: &PlaneCalibration, plane: usize, point_in_base: DVec3) -> f64 {
    reproject_with_gradient(calibration, plane, point_in_base).0
}

/// As [`reproject`], with the reading's gradient over the point, rad/m.
#[must_use]
pub fn reproject_with_gradient(
    calibration: &PlaneCalibration,
    plane: usize,
    point_in_base: DVec3,
) -> (f64, DVec3) {
    // The model counts its depth forward.
    let (x, y, z) = (point_in_base.x, point_in_base.y, -point_in_base.z);
    let r2 = (x * x + z * z).max(1e-12);
    let r = r2.sqrt();
    let (reading, by_azimuth, by_elevation) = reading(calibration, plane, z.atan2(x), y / r);
    let azimuth = DVec3::new(-z / r2, 0.0, x / r2);
    let elevation = DVec3::new(-y * x / (r2 * r), 1.0 / r, -y * z / (r2 * r));
    let gradient = azimuth * by_azimuth + elevation * by_elevation;
    (reading, DVec3::new(gradient.x, gradient.y, -gradient.z))
}

/// The reading and its derivatives, over the azimuth `b` about the rotor's axis (straight ahead is
/// pi/2) and the tangent `e` of the elevation above the rotor's plane.
fn reading(calibration: &PlaneCalibration, plane: usize, b: f64, e: f64) -> (f64, f64, f64) {
    let tilt = calibration.tilt + if plane == 1 { -FRAC_PI_6 } else { FRAC_PI_6 };
    let (sin_tilt, cos_tilt) = tilt.sin_cos();
    let tan_tilt = sin_tilt / cos_tilt;

    // A flat plane meets the point at b - a; `_e` marks derivatives over the elevation.
    let (a, a_e) = asin(tan_tilt * e, tan_tilt);
    let (ogee_sin, ogee_cos) = (b - a + calibration.ogeephase).sin_cos();
    let curve = calibration.curve + ogee_sin * calibration.ogeemag;
    let curve_b = ogee_cos * calibration.ogeemag;
    let curve_e = -a_e * curve_b;

    // Sine of the elevation as seen along the tilted plane, and its angle.
    let hypotenuse2 = 1.0 + e * e;
    let hypotenuse = hypotenuse2.sqrt();
    let (s, s_e) = asin(
        e / hypotenuse / cos_tilt,
        1.0 / (hypotenuse2 * hypotenuse * cos_tilt),
    );
    let (bend, bend_s, bend_ss) = curvature(s);

    let denominator = cos_tilt - bend_s * curve * sin_tilt;
    let denominator_b = -bend_s * curve_b * sin_tilt;
    let denominator_e = -(bend_ss * s_e * curve + bend_s * curve_e) * sin_tilt;
    let shift = bend * curve / denominator;
    let shift_b = (bend * curve_b - shift * denominator_b) / denominator;
    let shift_e = (bend_s * s_e * curve + bend * curve_e - shift * denominator_e) / denominator;

    let sine = tan_tilt * e + shift;
    let (bent, bent_sine) = asin(sine, 1.0);
    let (bent_b, bent_e) = (bent_sine * shift_b, bent_sine * (tan_tilt + shift_e));

    let (gib_sin, gib_cos) = (b - bent + calibration.gibphase).sin_cos();
    let gain = 1.0 + gib_cos * calibration.gibmag;
    let reading = b - bent + gib_sin * calibration.gibmag - calibration.phase - FRAC_PI_2;
    (reading, (1.0 - bent_b) * gain, -bent_e * gain)
}

/// The direction, in a base station's frame, in which both planes' readings meet, as if the
/// planes were flat.
#[must_use]
pub fn bearing(calibration: &[PlaneCalibration; 2], angles: [f64; 2]) -> DVec3 {
    let normal = |plane: usize, sign: f64| {
        let lean = calibration[plane].tilt + sign * FRAC_PI_6;
        let turn = DQuat::from_rotation_y(angles[plane] + calibration[plane].phase);
        turn * DVec3::new(lean.cos(), lean.sin(), 0.0)
    };
    let direction = normal(1, -1.0)
        .cross(normal(0, 1.0))
        .normalize_or(DVec3::NEG_Z);
    if direction.z > 0.0 {
        -direction
    } else {
        direction
    }
}

/// The curvature polynomial with its first and second derivatives.
fn curvature(s: f64) -> (f64, f64, f64) {
    let (mut value, mut first, mut half_second) = (0.0, 0.0, 0.0);
    for coefficient in CURVATURE {
        half_second = half_second * s + first;
        first = first * s + value;
        value = value * s + coefficient;
    }
    (value, first, 2.0 * half_second)
}

/// `asin` of a value with the derivative `slope`; outside its domain it stays at the edge.
fn asin(value: f64, slope: f64) -> (f64, f64) {
    // Points right above or below a base station, which no plane reaches, end here.
    const EDGE: f64 = 1.0 - 1e-9;
    if value.abs() >= EDGE {
        return (value.clamp(-EDGE, EDGE).asin(), 0.0);
    }
    (value.asin(), slope / (1.0 - value * value).sqrt())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const FLAT: PlaneCalibration = PlaneCalibration {
        phase: 0.0,
        tilt: 0.0,
        curve: 0.0,
        gibphase: 0.0,
        gibmag: 0.0,
        ogeephase: 0.0,
        ogeemag: 0.0,
    };

    #[test]
    fn a_flat_plane_is_a_plane() {
        assert!(reproject(&FLAT, 0, DVec3::new(0.0, 0.0, -2.0)).abs() < 1e-12);
        // The rotor turns counter-clockwise seen from above. Turned back by the reading, the point
        // lies in the plane that leans by 30 degrees about the line of sight.
        for (plane, lean) in [(0, FRAC_PI_6), (1, -FRAC_PI_6)] {
            let point = DVec3::new(0.7, -0.4, -2.1);
            let angle = reproject(&FLAT, plane, point);
            let back = glam::DQuat::from_rotation_y(-angle) * point;
            let off = back.dot(DVec3::new(lean.cos(), lean.sin(), 0.0));
            assert!(off.abs() < 1e-12, "plane {plane}: {off} m off");
        }
    }

    #[test]
    fn the_first_derivative_of_the_curvature_is_one() {
        let (value, first, _) = curvature(0.4);
        let (above, _, _) = curvature(0.4 + 1e-6);
        assert!((above - value - first * 1e-6).abs() < 1e-13);
    }

    proptest! {
        #[test]
        fn the_gradient_is_that_of_the_reading(
            x in -2.0f64..2.0, y in -1.0f64..1.0, z in -5.0f64..-1.0,
            plane in 0usize..2, curve in -0.4f64..0.4, ogeemag in -0.4f64..0.4,
            gibmag in -0.01f64..0.01, ogeephase in 0.0f64..6.0, gibphase in 0.0f64..6.0,
        ) {
            let calibration = PlaneCalibration {
                phase: 0.01, tilt: 0.05, curve, gibphase, gibmag, ogeephase, ogeemag,
            };
            let point = DVec3::new(x, y, z);
            let (_, gradient) = reproject_with_gradient(&calibration, plane, point);
            for axis in 0..3 {
                let mut step = DVec3::ZERO;
                step[axis] = 1e-6;
                let numeric = (reproject(&calibration, plane, point + step)
                    - reproject(&calibration, plane, point - step)) / 2e-6;
                prop_assert!((numeric - gradient[axis]).abs() < 1e-6);
            }
        }

        #[test]
        fn every_point_has_a_finite_reading(
            x in -1e3f64..1e3, y in -1e3f64..1e3, z in -1e3f64..1e3, plane in 0usize..2,
        ) {
            let (reading, gradient) =
                reproject_with_gradient(&FLAT, plane, DVec3::new(x, y, z));
            prop_assert!(reading.is_finite() && gradient.is_finite());
        }
    }
}
