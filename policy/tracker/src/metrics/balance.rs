//! Balance: the zero-moment point, and losing the wearer altogether.

use glam::{DVec2, DVec3};
use posed_body::{
    JOINTS, Joint, Skeleton,
    character::{Link, average_mass, segments},
    skeleton::BodyPose,
};

use super::{Pair, Track, mean};

const GRAVITY: f64 = 9.81;
/// Size of a foot, metres, which a zero-moment point within does not count as an error (PIP).
const FOOT_RADIUS: f64 = 0.1;
/// A foot stands up to this height above the mean of the feet in the first frames, metres.
const STANDS: f64 = 0.01;
/// Those frames (PIP).
const FIRST: std::ops::Range<usize> = 2..30;
/// A body this far off in the mean has lost the wearer; below the second it has found back, metres.
const LOST: f64 = 0.5;
const FOUND: f64 = 0.25;

/// A part of the body's mass.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PointMass {
    /// The joint whose frame it moves with.
    pub joint: Joint,
    /// Its place in that frame, metres.
    pub offset: DVec3,
    /// Kilograms.
    pub mass: f64,
}

/// The centres of mass of a person's segments (de Leva 1996).
#[must_use]
pub fn point_masses(skeleton: &Skeleton) -> Vec<PointMass> {
    let rest = skeleton.forward(&BodyPose::rest(glam::Vec3::ZERO));
    let segments = segments(skeleton, average_mass(f64::from(skeleton.stature())));
    let place = |(link, segment): (Link, posed_body::character::Segment)| {
        let joint = carrier(link);
        let offset = segment.com - rest.position(joint).as_dvec3();
        PointMass {
            joint,
            offset,
            mass: segment.mass,
        }
    };
    Link::ALL.into_iter().zip(segments).map(place).collect()
}

/// The joint that a segment hangs on.
fn carrier(link: Link) -> Joint {
    match link {
        Link::Pelvis => Joint::Pelvis,
        Link::Spine => Joint::Spine1,
        Link::Chest => Joint::Spine3,
        Link::Head => Joint::Head,
        Link::LeftUpperArm => Joint::LeftShoulder,
        Link::LeftForearm => Joint::LeftElbow,
        Link::LeftHand => Joint::LeftWrist,
        Link::RightUpperArm => Joint::RightShoulder,
        Link::RightForearm => Joint::RightElbow,
        Link::RightHand => Joint::RightWrist,
        Link::LeftThigh => Joint::LeftHip,
        Link::LeftShank => Joint::LeftKnee,
        Link::LeftFoot => Joint::LeftAnkle,
        Link::RightThigh => Joint::RightHip,
        Link::RightShank => Joint::RightKnee,
        Link::RightFoot => Joint::RightAnkle,
    }
}

fn place(track: &Track, frame: usize, part: &PointMass) -> DVec3 {
    let turn = track.world[frame][part.joint as usize].as_dquat();
    track.at(frame, part.joint) + turn * part.offset
}

/// The zero-moment point on the floor at `height`; `None` where nothing presses on the floor.
fn zero_moment_point(
    track: &Track,
    frame: usize,
    masses: &[PointMass],
    height: f64,
) -> Option<DVec2> {
    let (mut force, mut moment) = (0.0, DVec2::ZERO);
    for part in masses {
        let at = |back: usize| place(track, frame - back, part);
        let accel = (at(0) - 2.0 * at(1) + at(2)) * track.fps * track.fps;
        let down = part.mass * (accel.y + GRAVITY);
        let here = at(0);
        let lever = DVec2::new(accel.x, accel.z) * (part.mass * (here.y - height));
        force += down;
        moment += DVec2::new(here.x, here.z) * down - lever;
    }
    (force > 1.0).then(|| moment / force)
}

/// Mean distance of the zero-moment point from the standing feet less their size, metres.
pub(super) fn zmp_distance(track: &Track, frames: usize, masses: &[PointMass]) -> Option<f64> {
    let toes = [Joint::LeftFoot, Joint::RightFoot];
    let first = FIRST.start.min(frames)..FIRST.end.min(frames);
    let heights = first.flat_map(|frame| toes.map(|toe| track.at(frame, toe).y));
    let floor = mean(heights)? + STANDS;
    let distances = (2..frames).filter_map(|frame| {
        let feet = toes.map(|toe| track.at(frame, toe));
        let standing = feet.map(|foot| foot.y <= floor);
        if standing == [false, false] {
            return None;
        }
        let zmp = zero_moment_point(track, frame, masses, floor)?;
        let [left, right] = feet.map(|foot| DVec2::new(foot.x, foot.z));
        let distance = match standing {
            [true, true] => from_segment(zmp, left, right),
            [true, false] => zmp.distance(left),
            _ => zmp.distance(right),
        };
        Some((distance - FOOT_RADIUS).max(0.0))
    });
    mean(distances)
}

fn from_segment(point: DVec2, a: DVec2, b: DVec2) -> f64 {
    let along = b - a;
    let share = (point - a).dot(along) / along.length_squared().max(1e-12);
    point.distance(a + along * share.clamp(0.0, 1.0))
}

/// Share of frames in which the wearer is lost, per cent, and how often a minute it happens.
pub(super) fn lost(pair: &Pair<'_>) -> Option<(f64, f64)> {
    let (mut frames_lost, mut falls, mut fallen) = (0u64, 0u64, false);
    for frame in 0..pair.frames {
        let distance = |joint| pair.p.at(frame, joint).distance(pair.t.at(frame, joint));
        let error = Joint::ALL.into_iter().map(distance).sum::<f64>() / JOINTS as f64;
        if error > LOST {
            frames_lost += 1;
            falls += u64::from(!fallen);
            fallen = true;
        } else if error < FOUND {
            fallen = false;
        }
    }
    let frames = pair.frames as f64;
    let minutes = frames / pair.t.fps / 60.0;
    (pair.frames > 0).then(|| (100.0 * frames_lost as f64 / frames, falls as f64 / minutes))
}
