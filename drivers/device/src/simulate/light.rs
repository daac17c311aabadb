//! What a device sees of the light planes: which sensors, when, as words of its light stream.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use glam::DVec3;

use super::blueprint::{Blueprint, Shade};
use super::clock::DeviceClock;
use super::device::{Path, Placement};
use super::options::LightNoise;
use super::pulses::Pulse;
use super::random::Random;
use super::rotor::Rotation;
use crate::lighthouse::base_station::{BaseStation, Generation};
use crate::lighthouse::reproject::PLANE_CENTRE;
use crate::lighthouse::wire::TICKS_PER_SECOND;

/// A sensor sees everything whose direction has this cosine to its normal, or a larger one.
const SURE_COSINE: f64 = 0.5;
/// Below this cosine it sees nothing; between the two, ever less.
const LEAST_COSINE: f64 = 0.15;
/// Half the opening of a base station's light, rad: 150 by 110 degrees.
const HALF_WIDTH: f64 = 75.0 / 360.0 * TAU;
const HALF_HEIGHT: f64 = 55.0 / 360.0 * TAU;
/// A base station reaches this far, metres.
const REACH_M: f64 = 7.0;
/// Two times of a crossing that are this close are one, seconds.
const SETTLED_S: f64 = 1e-10;
/// Reflections are at most this far from the true time, seconds.
const REFLECTION_S: f64 = 1e-3;

/// Length of a flash without flags, and what each unit of its flags adds, ticks.
const FLASH_TICKS: f64 = 3_000.0;
const FLASH_STEP: f64 = 500.0;

/// A word of the light stream.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Word {
    /// When the device has what the word says, seconds after the start.
    pub(super) seen_s: f64,
    /// Channel of the base station.
    pub(super) channel: u8,
    /// The word on the wire.
    pub(super) bits: u32,
}

/// The word for the begin of a rotation: time in bits 2 to 25, OOTX bit 26.
fn sync_word(ticks: f64, ootx: bool) -> u32 {
    (ticks.round() as u64 as u32 & 0xff_ffff) << 2 | u32::from(ootx) << 26
}

/// The word for a hit: bit 1, half a tick in bit 2, time in bits 3 to 26, sensor above.
fn sweep_word(ticks: f64, sensor: u8) -> u32 {
    let halves = (ticks * 2.0).round() as u64 as u32;
    u32::from(sensor) << 27 | (halves >> 1 & 0xff_ffff) << 3 | (halves & 1) << 2 | 0b10
}

/// Something opaque in the world at one time: a capsule.
#[derive(Debug, Clone, Copy)]
pub(super) struct Capsule {
    pub(super) axis: [DVec3; 2],
    pub(super) radius: f64,
}

impl Capsule {
    /// Whether it stands between two points.
    fn blocks(&self, from: DVec3, to: DVec3) -> bool {
        segment_distance([from, to], self.axis) < self.radius
    }
}

/// Smallest distance between two line segments.
fn segment_distance([p, p_end]: [DVec3; 2], [q, q_end]: [DVec3; 2]) -> f64 {
    let (u, v, between) = (p_end - p, q_end - q, p - q);
    let (uu, vv, uv) = (u.length_squared(), v.length_squared(), u.dot(v));
    let (ub, vb) = (u.dot(between), v.dot(between));
    let determinant = uu * vv - uv * uv;
    let free = if determinant > 1e-12 {
        (uv * vb - vv * ub) / determinant
    } else {
        0.0
    };
    let s = free.clamp(0.0, 1.0);
    let t = if vv > 0.0 {
        ((uv * s + vb) / vv).clamp(0.0, 1.0)
    } else {
        0.0
    };
    let s = if uu > 0.0 {
        ((uv * t - ub) / uu).clamp(0.0, 1.0)
    } else {
        0.0
    };
    (between + u * s - v * t).length()
}

/// A sensor in the tracking frame.
#[derive(Debug, Clone, Copy)]
struct Eye {
    channel: u8,
    position: DVec3,
    normal: DVec3,
}

/// A device's light sensors.
pub(super) struct Optics {
    eyes: Vec<Eye>,
    shades: Vec<Shade>,
    noise: LightNoise,
    random: Random,
}

impl Optics {
    pub(super) fn new(blueprint: &Blueprint, noise: LightNoise, random: Random) -> Self {
        let model_in_head = blueprint.head.inverse();
        let eyes = blueprint.sensors.iter().map(|sensor| Eye {
            channel: sensor.channel,
            position: model_in_head.point(sensor.position),
            normal: model_in_head.rotation * sensor.normal,
        });
        let shades = blueprint.shades.iter().map(|shade| Shade {
            axis: shade.axis.map(|end| model_in_head.point(end)),
            radius: shade.radius,
        });
        Self {
            eyes: eyes.collect(),
            shades: shades.collect(),
            noise,
            random,
        }
    }

    /// What the device sees of one rotation, in the order in which it sees it: the sync first.
    pub(super) fn watch(
        &mut self,
        path: &dyn Path,
        clock: &DeviceClock,
        station: &BaseStation,
        rotation: &Rotation,
        obstacles: &[Capsule],
    ) -> Vec<Word> {
        let mut words = Vec::new();
        for plane in 0..2 {
            let centre_s = passes(station, plane, rotation, 0.0);
            let about = path.at(centre_s);
            for index in 0..self.eyes.len() {
                let eye = self.eyes[index];
                if !self.faces(&about, &eye, station) {
                    continue;
                }
                let crossing = crossing(path, &eye, station, plane, rotation, &about);
                let Some((seconds, placement)) = crossing else {
                    continue;
                };
                if !self.sees(&placement, &eye, station, obstacles) {
                    continue;
                }
                let bits = sweep_word(clock.ticks(self.disturbed(seconds)), eye.channel);
                words.push(Word {
                    seen_s: seconds,
                    channel: station.source.index() as u8,
                    bits,
                });
            }
        }
        words.sort_by(|a, b| a.seen_s.total_cmp(&b.seen_s));
        if let Some(first) = words.first().copied() {
            let sync_s = rotation.sync_s + self.random.normal(self.noise.sync_s);
            let bits = sync_word(clock.ticks(sync_s), rotation.ootx);
            words.insert(0, Word { bits, ..first });
        }
        words
    }

    /// What the device sees of one half turn of a base station of generation 1: its flash, and its
    /// plane where it does not skip. Of the flash a device by radio reports only two sensors'.
    pub(super) fn watch_pulses(
        &mut self,
        path: &dyn Path,
        clock: &DeviceClock,
        station: &BaseStation,
        rotation: &Rotation,
        obstacles: &[Capsule],
        flashes_max: usize,
    ) -> Vec<Pulse> {
        let turn = rotation.turn;
        let flash = FLASH_TICKS
            + FLASH_STEP
                * f64::from(turn.rotor | u8::from(rotation.ootx) << 1 | u8::from(turn.skips) << 2);
        let about = path.at(rotation.sync_s);
        let mut pulses = Vec::new();
        for index in 0..self.eyes.len() {
            let eye = self.eyes[index];
            if !self.sees(&about, &eye, station, obstacles)
                || !in_light(station.to_local(about.point(eye.position)))
            {
                continue;
            }
            // Sensors that look away see less of it, at both ends.
            let faint = 250.0 * (1.0 - cosine(&about, &eye, station)).powi(2);
            let begin_s = rotation.sync_s + self.random.normal(self.noise.sync_s);
            pulses.push(Pulse {
                seen_s: begin_s + flash / TICKS_PER_SECOND,
                sensor: eye.channel,
                begin: clock.ticks(begin_s) + faint / 2.0,
                length: (flash - faint) as u16,
            });
        }
        pulses.sort_by_key(|pulse| std::cmp::Reverse(pulse.length));
        pulses.truncate(flashes_max);
        let plane = usize::from(turn.rotor);
        for index in 0..self.eyes.len() {
            let eye = self.eyes[index];
            if turn.skips || pulses.is_empty() || !self.faces(&about, &eye, station) {
                continue;
            }
            let crossing = crossing(path, &eye, station, plane, rotation, &about);
            let Some((seconds, placement)) = crossing else {
                continue;
            };
            if !self.sees(&placement, &eye, station, obstacles) {
                continue;
            }
            let length = 80 + (160.0 * cosine(&placement, &eye, station)) as u16;
            let middle = clock.ticks(self.disturbed(seconds));
            pulses.push(Pulse {
                seen_s: seconds,
                sensor: eye.channel,
                begin: middle - f64::from(length) / 2.0,
                length,
            });
        }
        pulses
    }

    /// Whether the sensor looks towards the base station at all.
    fn faces(&self, placement: &Placement, eye: &Eye, station: &BaseStation) -> bool {
        // Half the least cosine leaves room for how the device turns until the plane comes.
        cosine(placement, eye, station) > LEAST_COSINE / 2.0
    }

    /// Whether the sensor sees the base station from this placement: by its direction, by what
    /// stands between, and by luck.
    fn sees(
        &mut self,
        placement: &Placement,
        eye: &Eye,
        station: &BaseStation,
        obstacles: &[Capsule],
    ) -> bool {
        let grazing =
            (cosine(placement, eye, station) - LEAST_COSINE) / (SURE_COSINE - LEAST_COSINE);
        if !self
            .random
            .chance(grazing.clamp(0.0, 1.0) * (1.0 - self.noise.drop))
        {
            return false;
        }
        let sensor = placement.point(eye.position);
        let shaded = self.shades.iter().any(|shade| {
            let axis = shade.axis.map(|end| placement.point(end));
            let radius = shade.radius;
            Capsule { axis, radius }.blocks(station.position, sensor)
        });
        !shaded
            && !obstacles
                .iter()
                .any(|one| one.blocks(station.position, sensor))
    }

    /// The time that the device takes for a crossing at `seconds`.
    fn disturbed(&mut self, seconds: f64) -> f64 {
        if self.random.chance(self.noise.reflection) {
            return seconds + (2.0 * self.random.unit() - 1.0) * REFLECTION_S;
        }
        seconds + self.random.normal(self.noise.sweep_s)
    }
}

fn cosine(placement: &Placement, eye: &Eye, station: &BaseStation) -> f64 {
    let towards = station.position - placement.point(eye.position);
    (placement.rotation * eye.normal).dot(towards.normalize())
}

/// When the plane passes the sensor, and where the device then is: the device moves while the
/// plane comes, so that time and reading have to be solved for together.
fn crossing(
    path: &dyn Path,
    eye: &Eye,
    station: &BaseStation,
    plane: usize,
    rotation: &Rotation,
    about: &Placement,
) -> Option<(f64, Placement)> {
    const STEPS_MAX: usize = 10;
    let (mut placement, mut seconds) = (*about, f64::NAN);
    for _ in 0..STEPS_MAX {
        let local = station.to_local(placement.point(eye.position));
        if !in_light(local) {
            return None;
        }
        let next = passes(station, plane, rotation, station.reading(plane, local).0);
        if (next - seconds).abs() < SETTLED_S {
            return Some((next, placement));
        }
        seconds = next;
        placement = path.at(seconds);
    }
    None
}

/// When a plane stands at an angle from its centre.
fn passes(station: &BaseStation, plane: usize, rotation: &Rotation, angle: f64) -> f64 {
    let share = match station.source.generation() {
        Generation::One => (FRAC_PI_2 + angle) / PI,
        Generation::Two => (PLANE_CENTRE[plane] + angle) / TAU,
    };
    rotation.sync_s + rotation.period_s * share
}

/// Whether a point in the base station's frame lies in its light.
fn in_light(local: DVec3) -> bool {
    let depth = -local.z;
    depth > 0.1
        && local.length() < REACH_M
        && local.x.atan2(depth).abs() < HALF_WIDTH
        && local.y.atan2(depth.hypot(local.x)).abs() < HALF_HEIGHT
}
