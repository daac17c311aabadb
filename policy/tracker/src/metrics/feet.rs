//! Feet and floor.

use posed_body::Joint;

use super::{Pair, Track, mean};

const FEET: [Joint; 4] = [
    Joint::LeftAnkle,
    Joint::RightAnkle,
    Joint::LeftFoot,
    Joint::RightFoot,
];

/// A true foot joint that moves no farther in a frame stands, metres.
const STANDS: f64 = 0.01;
/// Share of the frames whose lowest joint may lie below the floor.
const FLOOR_SHARE: f64 = 0.05;

fn stands(pair: &Pair<'_>, frame: usize, joint: Joint) -> bool {
    pair.t
        .at(frame, joint)
        .distance(pair.t.at(frame - 1, joint))
        <= STANDS
}

/// AvatarJLM's skating error, centimetres.
pub(super) fn skate(pair: &Pair<'_>) -> Option<f64> {
    let components = (1..pair.frames).flat_map(|frame| {
        FEET.into_iter().flat_map(move |joint| {
            let moved = pair.p.at(frame, joint) - pair.p.at(frame - 1, joint);
            let counts = if stands(pair, frame, joint) { 1.0 } else { 0.0 };
            (moved * counts).abs().to_array()
        })
    });
    mean(components).map(|metres| 100.0 * metres)
}

/// Mean level speed of `track`'s foot joints while the true ones stand, cm/s.
pub(super) fn slide(pair: &Pair<'_>, track: &Track) -> Option<f64> {
    let speeds = (1..pair.frames).flat_map(|frame| {
        let standing = FEET
            .into_iter()
            .filter(move |&joint| stands(pair, frame, joint));
        standing.map(move |joint| {
            let moved = track.at(frame, joint) - track.at(frame - 1, joint);
            moved.x.hypot(moved.z)
        })
    });
    mean(speeds).map(|metres| 100.0 * metres * track.fps)
}

fn lowest(track: &Track, frame: usize) -> f64 {
    let heights = Joint::ALL.into_iter().map(|joint| track.at(frame, joint).y);
    heights.fold(f64::INFINITY, f64::min)
}

/// Mean depth below and height above the floor of the lowest joint, centimetres.
pub(super) fn gap(pair: &Pair<'_>) -> Option<(f64, f64)> {
    let mut heights: Vec<f64> = (0..pair.frames)
        .map(|frame| lowest(pair.t, frame))
        .collect();
    heights.sort_unstable_by(f64::total_cmp);
    let floor = *heights.get((FLOOR_SHARE * pair.frames as f64) as usize)?;
    let gaps = || (0..pair.frames).map(|frame| lowest(pair.p, frame) - floor);
    let below = mean(gaps().map(|gap| (-gap).max(0.0)))?;
    let above = mean(gaps().map(|gap| gap.max(0.0)))?;
    Some((100.0 * below, 100.0 * above))
}
