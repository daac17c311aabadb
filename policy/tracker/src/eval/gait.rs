//! Kinds of motion by how the mover moves, where names do not tell.

use posed_body::{Joint, Joints, motion::Clip};

/// Speeds are taken over this time, seconds: a sway is no walk.
const SPAN_S: f64 = 1.0;
/// Somebody whose pelvis goes faster than this over the floor walks, m/s.
const WALKS: f64 = 0.4;
/// A foot is off the floor when its toe joint is this much higher than when it stands, over the
/// stature (3.5 cm at 1.75 m).
const OFF: f32 = 0.02;
/// Somebody jogs who has both feet off the floor in more than this share of a walk's frames.
const FLIGHT: f64 = 0.1;
/// Somebody is low (sits, kneels, crawls, lies) whose pelvis is below this share of its height in
/// the clip's own highest tenth.
const LOW: f32 = 0.75;
/// A clip is of the kind that more than this share of its frames is of.
const MOST: f64 = 0.5;

/// The kind of a clip: `stand`, `walk`, `jog` or `other`. What is none of the first three for most
/// of the time (dances, kicks, sitting, lying) is `other`.
#[must_use]
pub fn gait(clip: &Clip) -> &'static str {
    let frames = clip.frames.len();
    if frames < 2 {
        return "other";
    }
    let poses: Vec<Joints> = clip
        .frames
        .iter()
        .map(|pose| clip.skeleton.forward(pose))
        .collect();
    let pelvis = |frame: usize| poses[frame].position(Joint::Pelvis);
    let toes = [Joint::LeftFoot, Joint::RightFoot];
    let toe = |frame: usize| toes.map(|toe| poses[frame].position(toe).y);
    let mut lower: Vec<f32> = (0..frames)
        .map(|frame| toe(frame)[0].min(toe(frame)[1]))
        .collect();
    let floor = quantile(&mut lower, 0.1);
    let mut heights: Vec<f32> = (0..frames).map(|frame| pelvis(frame).y - floor).collect();
    let upright = quantile(&mut heights, 0.9);
    let off = floor + OFF * clip.skeleton.stature();
    let half = ((SPAN_S * clip.fps / 2.0) as usize).max(1);
    let (mut standing, mut walking, mut flying) = (0, 0, 0);
    for frame in 0..frames {
        let (from, to) = (frame.saturating_sub(half), (frame + half).min(frames - 1));
        let way = (pelvis(to) - pelvis(from)).with_y(0.0).length();
        let speed = f64::from(way) * clip.fps / (to - from) as f64;
        if pelvis(frame).y - floor < LOW * upright {
            continue;
        }
        let [left, right] = toe(frame);
        let flies = left > off && right > off;
        if speed > WALKS {
            walking += 1;
            flying += usize::from(flies);
        } else {
            standing += usize::from(!flies);
        }
    }
    let share = |count: usize, of: usize| count as f64 / of.max(1) as f64;
    match () {
        () if share(walking, frames) > MOST && share(flying, walking) > FLIGHT => "jog",
        () if share(walking, frames) > MOST => "walk",
        () if share(standing, frames) > MOST => "stand",
        () => "other",
    }
}

/// The value below which `share` of them lie; there is at least one.
fn quantile(values: &mut [f32], share: f32) -> f32 {
    values.sort_by(f32::total_cmp);
    values[((values.len() - 1) as f32 * share) as usize]
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use posed_body::motion::procedural;

    use super::*;

    /// A stretch of the made-up human, seconds.
    fn stretch(from: f64, to: f64) -> Clip {
        let mut clip = procedural::timeline(1.75, 1);
        let index = |seconds: f64| (seconds * clip.fps) as usize;
        clip.frames = clip.frames[index(from)..index(to)].to_vec();
        clip
    }

    #[test]
    fn somebody_stands_walks_jogs_or_does_something_else() {
        let standing = stretch(0.0, 2.5);
        assert_eq!(gait(&standing), "stand");
        // Carried over the floor at a walk's pace, with the feet on it; then with them off it for a
        // third of the time; then on the spot and mostly in the air.
        let moved = |speed: f32, lift: f32| {
            let mut clip = standing.clone();
            for (frame, pose) in clip.frames.iter_mut().enumerate() {
                let seconds = frame as f32 / 60.0;
                let up = if frame % 30 < 10 { lift } else { 0.0 };
                pose.root += Vec3::new(0.0, up, -speed * seconds);
            }
            clip
        };
        assert_eq!(gait(&moved(1.2, 0.0)), "walk");
        assert_eq!(gait(&moved(2.5, 0.1)), "jog");
        let mut low = standing.clone();
        for (frame, pose) in low.frames.iter_mut().enumerate() {
            pose.root.y -= if frame > 20 { 0.5 } else { 0.0 };
        }
        assert_eq!(gait(&low), "other");
    }
}
