//! The ground as a function: height and normal at any place.

use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};

use super::{EXTENT_MAX, SceneError, check};

/// The ground.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub enum Ground {
    /// The plane y = 0.
    #[default]
    Flat,
    /// A plane through the origin.
    Slope {
        /// Inclination, degrees.
        degrees: f64,
        /// Which way is up: 0 is -Z, 90 is -X; degrees.
        #[serde(default)]
        heading: f64,
    },
    /// Uneven ground: a square height field about the origin, flat beyond it and within 0.5 m
    /// of the middle.
    Rough {
        /// Height from the deepest to the highest place, metres.
        amplitude: f64,
        /// Distance between two hills, metres.
        #[serde(default = "default_hills")]
        hills: f64,
        /// Chooses the field.
        #[serde(default)]
        seed: u32,
    },
    /// A flight of steps up along -Z, as wide as the scene.
    Steps {
        /// Distance of the first riser from the origin, metres.
        start: f64,
        /// Height of a step, metres.
        rise: f64,
        /// Depth of a step, metres.
        run: f64,
        /// Number of steps; the ground stays at the top after the last.
        count: u32,
    },
}

fn default_hills() -> f64 {
    1.0
}

/// The ground at a place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Surface {
    /// Height, metres.
    pub height: f64,
    /// Unit normal, upwards.
    pub normal: DVec3,
}

/// Rows and columns of the height field.
pub(super) const FIELD_CELLS: usize = 96;
/// Half the edge of the height field, metres.
pub(super) const FIELD_HALF: f64 = 6.0;
/// Half a step of somebody who walks, metres.
const STEP: f64 = 0.3;
/// Within this distance of the middle the height field is flat, metres.
const FLAT_RADIUS: f64 = 0.5;

impl Ground {
    pub(super) fn validate(&self) -> Result<(), SceneError> {
        let part = "ground";
        match *self {
            Self::Flat => Ok(()),
            Self::Slope { degrees, heading } => {
                check(part, degrees.abs() <= 45.0, "slopes more than 45°")?;
                check(part, heading.abs() <= 360.0, "has a heading outside ±360°")
            }
            Self::Rough {
                amplitude, hills, ..
            } => {
                check(
                    part,
                    (0.0..=1.0).contains(&amplitude),
                    "has an amplitude outside 0 to 1 m",
                )?;
                check(
                    part,
                    (0.3..=10.0).contains(&hills),
                    "has hills closer than 0.3 m or wider \
                    than 10 m apart",
                )
            }
            Self::Steps {
                start,
                rise,
                run,
                count,
            } => {
                check(
                    part,
                    (0.0..=EXTENT_MAX).contains(&start),
                    "has steps that start outside 0 \
                    to 100 m",
                )?;
                check(
                    part,
                    (0.01..=1.0).contains(&rise),
                    "has a rise outside 0.01 to 1 m",
                )?;
                check(
                    part,
                    (0.1..=5.0).contains(&run),
                    "has a run outside 0.1 to 5 m",
                )?;
                check(
                    part,
                    (1..=50).contains(&count),
                    "has no steps or more than 50",
                )
            }
        }
    }

    /// Height and normal under (x, z).
    #[must_use]
    pub fn at(&self, x: f64, z: f64) -> Surface {
        match *self {
            Self::Flat => Surface {
                height: 0.0,
                normal: DVec3::Y,
            },
            Self::Slope { .. } => {
                let normal = self.slope_normal();
                Surface {
                    height: -(normal.x * x + normal.z * z) / normal.y,
                    normal,
                }
            }
            Self::Rough { .. } => self.field_at(x, z),
            Self::Steps {
                start,
                rise,
                run,
                count,
            } => {
                let steps = ((-z - start) / run).floor() + 1.0;
                Surface {
                    height: rise * steps.clamp(0.0, f64::from(count)),
                    normal: DVec3::Y,
                }
            }
        }
    }

    /// Mean height within a step of (x, z), metres: what somebody stands on, without the jumps of
    /// risers and furrows.
    #[must_use]
    pub fn around(&self, x: f64, z: f64) -> f64 {
        if let Self::Flat | Self::Slope { .. } = self {
            return self.at(x, z).height;
        }
        let near = |dx: f64, dz: f64| self.at(x + dx * STEP, z + dz * STEP).height;
        let diagonal = std::f64::consts::FRAC_1_SQRT_2;
        let ring: f64 = [
            (1.0, 0.0),
            (0.0, 1.0),
            (diagonal, diagonal),
            (diagonal, -diagonal),
        ]
        .iter()
        .map(|&(dx, dz)| near(dx, dz) + near(-dx, -dz))
        .sum();
        (near(0.0, 0.0) + ring) / 9.0
    }

    /// Normal of a slope; +Y for any other ground.
    pub(super) fn slope_normal(&self) -> DVec3 {
        let Self::Slope { degrees, heading } = *self else {
            return DVec3::Y;
        };
        let turn = DMat3::from_rotation_y(heading.to_radians())
            * DMat3::from_rotation_x(degrees.to_radians());
        turn * DVec3::Y
    }

    /// Height of a node of the height field; row along z, column along x.
    pub(super) fn node(&self, row: usize, column: usize) -> f64 {
        let Self::Rough {
            amplitude,
            hills,
            seed,
        } = *self
        else {
            return 0.0;
        };
        let place = |index: usize| 2.0 * index as f64 / (FIELD_CELLS - 1) as f64 - 1.0;
        let (x, z) = (place(column) * FIELD_HALF, place(row) * FIELD_HALF);
        let edge = FIELD_HALF - x.abs().max(z.abs());
        let middle = x.hypot(z) - FLAT_RADIUS;
        let fade = smooth(edge.min(middle).clamp(0.0, 1.0));
        let octave = |scale: f64, salt: u32| value_noise(x / scale, z / scale, seed ^ salt);
        let noise = 0.75 * octave(hills, 0) + 0.25 * octave(hills / 2.0, 0x9e37);
        amplitude * fade * noise
    }

    /// The height field between its nodes: two triangles to a cell, as MuJoCo has them.
    fn field_at(&self, x: f64, z: f64) -> Surface {
        let cell = 2.0 * FIELD_HALF / (FIELD_CELLS - 1) as f64;
        let (u, v) = ((x + FIELD_HALF) / cell, (z + FIELD_HALF) / cell);
        let last = (FIELD_CELLS - 1) as f64;
        if !(0.0..last).contains(&u) || !(0.0..last).contains(&v) {
            return Surface {
                height: 0.0,
                normal: DVec3::Y,
            };
        }
        let (column, row) = (u as usize, v as usize);
        let (fu, fv) = (u - column as f64, v - row as f64);
        let at = |r: usize, c: usize| self.node(row + r, column + c);
        let (near, du, dv) = if fu + fv <= 1.0 {
            let corner = at(0, 0);
            (corner, at(0, 1) - corner, at(1, 0) - corner)
        } else {
            let (corner, a, b) = (at(1, 1), at(1, 0), at(0, 1));
            (b + a - corner, corner - a, corner - b)
        };
        let height = near + fu * du + fv * dv;
        Surface {
            height,
            normal: DVec3::new(-du / cell, 1.0, -dv / cell).normalize(),
        }
    }
}

fn smooth(t: f64) -> f64 {
    t * t * (3.0 - 2.0 * t)
}

/// Smooth noise between 0 and 1 with one random value to each whole-numbered place.
fn value_noise(x: f64, z: f64, seed: u32) -> f64 {
    let (x0, z0) = (x.floor(), z.floor());
    let (u, v) = (smooth(x - x0), smooth(z - z0));
    let at = |dx: i32, dz: i32| hash(x0 as i32 + dx, z0 as i32 + dz, seed);
    let low = at(0, 0) * (1.0 - u) + at(1, 0) * u;
    let high = at(0, 1) * (1.0 - u) + at(1, 1) * u;
    low * (1.0 - v) + high * v
}

/// A number in [0, 1) for a place: the finaliser of MurmurHash3.
fn hash(x: i32, z: i32, seed: u32) -> f64 {
    let mut h = seed ^ (x as u32).wrapping_mul(0x85eb_ca6b) ^ (z as u32).wrapping_mul(0xc2b2_ae35);
    h ^= h >> 16;
    h = h.wrapping_mul(0x85eb_ca6b);
    h ^= h >> 13;
    h = h.wrapping_mul(0xc2b2_ae35);
    h ^= h >> 16;
    f64::from(h) / (f64::from(u32::MAX) + 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slopes_rise_along_their_heading() {
        let ground = Ground::Slope {
            degrees: 10.0,
            heading: 0.0,
        };
        let rise = ground.at(0.0, -1.0).height;
        assert!((rise - 10.0_f64.to_radians().tan()).abs() < 1e-12, "{rise}");
        assert!((ground.at(0.0, -1.0).normal.length() - 1.0).abs() < 1e-12);
        assert!(
            Ground::Slope {
                degrees: 10.0,
                heading: 90.0
            }
            .at(-1.0, 0.0)
            .height
                > 0.17
        );
    }

    #[test]
    fn steps_rise_by_their_riser() {
        let ground = Ground::Steps {
            start: 1.0,
            rise: 0.15,
            run: 0.3,
            count: 3,
        };
        assert_eq!(ground.at(0.0, -0.9).height, 0.0);
        assert!((ground.at(5.0, -1.1).height - 0.15).abs() < 1e-12);
        assert!((ground.at(0.0, -1.5).height - 0.30).abs() < 1e-12);
        assert!((ground.at(0.0, -9.0).height - 0.45).abs() < 1e-12);
    }

    #[test]
    fn rough_ground_is_continuous_and_flat_where_one_starts() {
        let ground = Ground::Rough {
            amplitude: 0.1,
            hills: 1.0,
            seed: 7,
        };
        assert_eq!(ground.at(0.1, 0.2).height, 0.0);
        let mut highest = 0.0_f64;
        for step in 0..4000 {
            let along = f64::from(step) * 0.003 - 6.0;
            let (a, b) = (ground.at(along, 1.3), ground.at(along + 0.003, 1.3));
            assert!((a.height - b.height).abs() < 0.004, "a jump at {along}");
            let slope = -a.normal.x / a.normal.y;
            assert!(
                (b.height - a.height - 0.003 * slope).abs() < 1.5e-3,
                "normal at {along}"
            );
            highest = highest.max(a.height);
        }
        assert!(highest > 0.03 && highest <= 0.1, "{highest}");
    }

    #[test]
    fn what_one_stands_on_has_no_jumps() {
        let steps = Ground::Steps {
            start: 1.0,
            rise: 0.15,
            run: 0.3,
            count: 3,
        };
        assert_eq!(steps.around(0.0, 0.0), 0.0);
        assert!((steps.around(0.0, -5.0) - 0.45).abs() < 1e-12);
        let mut last = 0.0;
        for step in 0..300 {
            let height = steps.around(0.0, -0.01 * f64::from(step));
            assert!((0.0..=0.1).contains(&(height - last)), "{height}");
            last = height;
        }
        let slope = Ground::Slope {
            degrees: 5.0,
            heading: 0.0,
        };
        assert_eq!(slope.around(0.3, -1.0), slope.at(0.3, -1.0).height);
    }
}
