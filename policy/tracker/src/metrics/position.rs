//! Positions, velocities and their derivatives.

use glam::DVec3;
use posed_body::{JOINTS, Joint};

use super::{Pair, Track, mean};

/// What is moved onto the truth before positions are compared.
#[derive(Clone, Copy)]
pub(super) enum Align {
    World,
    Head,
    Root,
}

impl Align {
    /// What has to be added to the prediction.
    fn shift(self, pair: &Pair<'_>, frame: usize) -> DVec3 {
        let onto = |joint| pair.t.at(frame, joint) - pair.p.at(frame, joint);
        match self {
            Self::World => DVec3::ZERO,
            Self::Head => onto(Joint::Head),
            Self::Root => onto(Joint::Pelvis),
        }
    }
}

/// AGRoL's upper body.
pub(super) const UPPER: [Joint; 13] = [
    Joint::Spine1,
    Joint::Spine2,
    Joint::Spine3,
    Joint::Neck,
    Joint::LeftCollar,
    Joint::RightCollar,
    Joint::Head,
    Joint::LeftShoulder,
    Joint::RightShoulder,
    Joint::LeftElbow,
    Joint::RightElbow,
    Joint::LeftWrist,
    Joint::RightWrist,
];

/// AGRoL's lower body.
pub(super) const LOWER: [Joint; 9] = [
    Joint::Pelvis,
    Joint::LeftHip,
    Joint::RightHip,
    Joint::LeftKnee,
    Joint::RightKnee,
    Joint::LeftAnkle,
    Joint::RightAnkle,
    Joint::LeftFoot,
    Joint::RightFoot,
];

pub(super) const HANDS: [Joint; 2] = [Joint::LeftWrist, Joint::RightWrist];

/// The parts that a headset and two controllers measure.
pub(super) const TRACKED: [Joint; 3] = [Joint::Head, Joint::LeftWrist, Joint::RightWrist];

/// Mean distance, centimetres.
pub(super) fn mean_error(pair: &Pair<'_>, align: Align, joints: &[Joint]) -> Option<f64> {
    let frame_errors = (0..pair.frames).flat_map(|frame| {
        let shift = align.shift(pair, frame);
        let error = move |&joint: &Joint| {
            (pair.p.at(frame, joint) + shift).distance(pair.t.at(frame, joint))
        };
        joints.iter().map(error)
    });
    mean(frame_errors).map(|metres| 100.0 * metres)
}

/// Mean length of the difference of velocities, head-aligned, cm/s.
pub(super) fn velocity_error(pair: &Pair<'_>) -> Option<f64> {
    let errors = (1..pair.frames).flat_map(|frame| {
        let turn = Align::Head.shift(pair, frame) - Align::Head.shift(pair, frame - 1);
        let error = move |joint: Joint| {
            let predicted = pair.p.at(frame, joint) - pair.p.at(frame - 1, joint) + turn;
            let truth = pair.t.at(frame, joint) - pair.t.at(frame - 1, joint);
            predicted.distance(truth)
        };
        Joint::ALL.into_iter().map(error)
    });
    mean(errors).map(|metres| 100.0 * metres * pair.t.fps)
}

/// Mean length of the jerk, km/s³.
pub(super) fn jitter(track: &Track, frames: usize) -> Option<f64> {
    let jerks = (3..frames).flat_map(|frame| {
        (0..JOINTS).map(move |index| {
            let at = |back: usize| track.positions[frame - back][index].as_dvec3();
            (at(0) - 3.0 * at(1) + 3.0 * at(2) - at(3)).length()
        })
    });
    mean(jerks).map(|metres| metres * track.fps.powi(3) / 1000.0)
}

/// Error of the pelvis' displacement, centimetres, over stretches on which the truth travelled
/// `metres`: from every frame to the first one that is so far along the path, scaled to it.
pub(super) fn translation(pair: &Pair<'_>, metres: f64) -> Option<f64> {
    let mut path = Vec::with_capacity(pair.frames);
    let mut travelled = 0.0;
    for frame in 0..pair.frames {
        if frame > 0 {
            let step = pair.t.at(frame, Joint::Pelvis) - pair.t.at(frame - 1, Joint::Pelvis);
            travelled += step.length();
        }
        path.push(travelled);
    }
    let (mut start, mut last_end) = (0, None);
    let mut errors = Vec::new();
    let mut end = 1;
    while end < pair.frames {
        let way = path[end] - path[start];
        if way < metres {
            end += 1;
            continue;
        }
        if last_end != Some(end) {
            let moved =
                |track: &Track| track.at(end, Joint::Pelvis) - track.at(start, Joint::Pelvis);
            errors.push((moved(pair.t) - moved(pair.p)).length() / way * metres);
            last_end = Some(end);
        }
        start += 1;
    }
    mean(errors.into_iter()).map(|metres| 100.0 * metres)
}
