//! The poses of the last seconds, and the three ways to ask for one: the newest, the next in
//! order, that of a time.

use std::collections::VecDeque;

use glam::Quat;
use posed_body::Skeleton;
use posed_signal::{
    HostTime, Lookup,
    history::{EXTRAPOLATE_NS_MAX, STALE_NS},
    time::MILLISECOND_NS,
};

use crate::published::PublishedPose;

/// Poses remembered: 11 s at 90 Hz, 3 MB.
pub(super) const POSES_MAX: usize = 1024;
/// Poses are carried on by their mean velocity over this time: over one tick it would be mostly
/// noise.
const VELOCITY_SPAN_NS: i64 = 30 * MILLISECOND_NS as i64;

/// The last [`POSES_MAX`] poses, in the order of their sequence numbers and target times.
#[derive(Debug)]
pub(super) struct Window {
    poses: VecDeque<PublishedPose>,
}

impl Default for Window {
    fn default() -> Self {
        Self {
            poses: VecDeque::with_capacity(POSES_MAX),
        }
    }
}

/// How a reader that has fallen behind goes on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Behind {
    /// With the next pose in order if it is at most so many behind the newest, else the newest.
    CatchUp(usize),
    /// With the oldest pose that is still there.
    InOrder,
}

impl Window {
    /// Takes the next pose. If its sequence number or target time went back, time started anew
    /// (a replay was wound back), and the past is forgotten.
    pub(super) fn push(&mut self, pose: PublishedPose) {
        let goes_on = |last: &PublishedPose| {
            pose.sequence > last.sequence && pose.target_at >= last.target_at
        };
        if !self.poses.back().is_none_or(goes_on) {
            self.poses.clear();
        }
        if self.poses.len() == POSES_MAX {
            self.poses.pop_front();
        }
        self.poses.push_back(pose);
    }

    /// The newest pose.
    pub(super) fn newest(&self) -> Option<&PublishedPose> {
        self.poses.back()
    }

    /// The pose to hand to a reader whose last one had the sequence number `after` (`None`: it had
    /// none yet, and gets the newest), with the number of poses passed over in between.
    pub(super) fn next(&self, after: Option<u64>, behind: Behind) -> Option<(&PublishedPose, u64)> {
        let newest = self.poses.back()?;
        let Some(after) = after.filter(|after| *after <= newest.sequence) else {
            return Some((newest, 0));
        };
        let first = self.poses.partition_point(|pose| pose.sequence <= after);
        let waiting = self.poses.len() - first;
        let pose = match behind {
            Behind::CatchUp(most) if waiting > most.saturating_add(1) => newest,
            Behind::CatchUp(_) | Behind::InOrder => self.poses.get(first)?,
        };
        Some((pose, pose.sequence - after - 1))
    }

    /// The pose at `target`: exact, between two, or carried on from the newest, by
    /// [`EXTRAPOLATE_NS_MAX`] at most and no longer than [`STALE_NS`]. `None` for a time before
    /// the oldest pose. Joints are those of `skeleton`.
    pub(super) fn at(
        &self,
        target: HostTime,
        skeleton: &Skeleton,
    ) -> Option<Lookup<PublishedPose>> {
        let later = self.poses.partition_point(|pose| pose.target_at < target);
        let Some(after) = self.poses.get(later) else {
            return Some(self.beyond_newest(target, skeleton));
        };
        if after.target_at == target {
            return Some(Lookup::Exact(*after));
        }
        let before = self.poses.get(later.checked_sub(1)?)?;
        let span = after.target_at.since_ns(before.target_at) as f32;
        let fraction = target.since_ns(before.target_at) as f32 / span;
        let near = if fraction < 0.5 { before } else { after };
        let mut made = moved(before, after, fraction, skeleton);
        made.quality = before.quality.min(after.quality);
        let made = PublishedPose {
            sequence: near.sequence,
            parts: near.parts,
            ..made
        };
        Some(Lookup::Interpolated(PublishedPose {
            target_at: target,
            ..made
        }))
    }

    fn beyond_newest(&self, target: HostTime, skeleton: &Skeleton) -> Lookup<PublishedPose> {
        let Some(newest) = self.poses.back() else {
            return Lookup::Empty;
        };
        let by_ns = target.since_ns(newest.target_at);
        if by_ns > STALE_NS {
            return Lookup::Stale {
                value: *newest,
                age_ns: by_ns,
            };
        }
        let from = newest.target_at.plus_ns(-VELOCITY_SPAN_NS);
        let index = self.poses.partition_point(|pose| pose.target_at < from);
        let earlier = self.poses.get(index).unwrap_or(newest);
        let span = newest.target_at.since_ns(earlier.target_at);
        let value = if span > 0 {
            let reach = by_ns.min(EXTRAPOLATE_NS_MAX);
            moved(earlier, newest, 1.0 + reach as f32 / span as f32, skeleton)
        } else {
            *newest
        };
        Lookup::Extrapolated {
            value: PublishedPose {
                target_at: target,
                ..value
            },
            by_ns,
        }
    }
}

/// `to`, moved to `fraction` of the way from `from` (0) to `to` (1) and beyond.
fn moved(
    from: &PublishedPose,
    to: &PublishedPose,
    fraction: f32,
    skeleton: &Skeleton,
) -> PublishedPose {
    let mut made = *to;
    made.pose.root = from.pose.root + (to.pose.root - from.pose.root) * fraction;
    for (made, from) in made.pose.rotations.iter_mut().zip(&from.pose.rotations) {
        let turn = *made * from.inverse();
        let shorter = if turn.w < 0.0 { -turn } else { turn };
        let turned = Quat::from_scaled_axis(shorter.to_scaled_axis() * fraction) * *from;
        *made = turned.normalize();
    }
    made.joints = skeleton.forward(&made.pose);
    made.objects = from.objects.between(&to.objects, fraction.clamp(0.0, 1.0));
    made
}

#[cfg(test)]
mod tests {
    use posed_body::Joint;

    use super::*;
    use crate::published::tests::pose_at;

    const PERIOD_NS: u64 = 10 * MILLISECOND_NS;

    fn filled(sequences: std::ops::RangeInclusive<u64>) -> Window {
        let mut window = Window::default();
        for sequence in sequences {
            window.push(pose_at(sequence, HostTime(sequence * PERIOD_NS)));
        }
        window
    }

    fn next(window: &Window, after: Option<u64>, behind: Behind) -> Option<(u64, u64)> {
        window
            .next(after, behind)
            .map(|(pose, gap)| (pose.sequence, gap))
    }

    #[test]
    fn a_reader_gets_the_newest_or_the_next_and_the_gap() {
        let window = filled(1..=50);
        let newest_only = Behind::CatchUp(0);
        assert_eq!(next(&Window::default(), None, newest_only), None);
        assert_eq!(next(&window, None, Behind::CatchUp(9)), Some((50, 0)));
        assert_eq!(next(&window, Some(50), newest_only), None);
        assert_eq!(next(&window, Some(49), newest_only), Some((50, 0)));
        assert_eq!(next(&window, Some(40), newest_only), Some((50, 9)));
        // 42 is eight behind 50.
        assert_eq!(next(&window, Some(41), Behind::CatchUp(8)), Some((42, 0)));
        assert_eq!(next(&window, Some(41), Behind::CatchUp(7)), Some((50, 8)));
        assert_eq!(next(&window, Some(3), Behind::InOrder), Some((4, 0)));
        assert_eq!(
            next(&window, Some(u64::MAX), Behind::InOrder),
            Some((50, 0))
        );
    }

    #[test]
    fn the_oldest_poses_go_and_are_counted() {
        let all = POSES_MAX as u64 + 6;
        let window = filled(1..=all);
        assert_eq!(window.poses.len(), POSES_MAX);
        assert_eq!(next(&window, Some(2), Behind::InOrder), Some((7, 4)));
        assert_eq!(
            window.at(HostTime(6 * PERIOD_NS), &Skeleton::of_height(1.75)),
            None
        );
    }

    #[test]
    fn a_replay_wound_back_starts_anew() {
        let mut window = filled(1..=50);
        window.push(pose_at(51, HostTime(7)));
        assert_eq!(window.poses.len(), 1);
        assert_eq!(next(&window, Some(40), Behind::InOrder), Some((51, 10)));
        window.push(pose_at(1, HostTime(8)));
        assert_eq!(next(&window, Some(51), Behind::InOrder), Some((1, 0)));
    }

    #[test]
    fn a_pose_at_a_time_says_how_it_was_made() {
        let (window, skeleton) = (filled(1..=20), Skeleton::of_height(1.75));
        let at = |ns| window.at(HostTime(ns), &skeleton).unwrap();
        let exact = at(7 * PERIOD_NS);
        assert_eq!(exact, Lookup::Exact(pose_at(7, HostTime(7 * PERIOD_NS))));

        let Lookup::Interpolated(between) = at(7 * PERIOD_NS + PERIOD_NS / 4) else {
            panic!("between two poses is interpolated");
        };
        assert_eq!((between.sequence, between.target_at.0), (7, 72_500_000));
        assert!((between.pose.root.z - 0.0725).abs() < 1e-6);
        let (turn, expected) = (
            between.pose.rotations[3],
            Quat::from_rotation_y(0.0725 + 0.06),
        );
        assert!(turn.angle_between(expected) < 1e-3);
        assert_eq!(between.joints.position(Joint::Pelvis), between.pose.root);

        let Lookup::Extrapolated {
            value: ahead,
            by_ns,
        } = at(22 * PERIOD_NS)
        else {
            panic!("beyond the newest is extrapolated");
        };
        assert_eq!((by_ns, ahead.target_at.0), (20_000_000, 220_000_000));
        assert!((ahead.pose.root.z - 0.22).abs() < 1e-5);
        assert!(ahead.pose.rotations[0].angle_between(Quat::from_rotation_y(0.22)) < 1e-3);
    }

    #[test]
    fn the_future_is_bounded() {
        let (window, skeleton) = (filled(1..=20), Skeleton::of_height(1.75));
        let newest = HostTime(20 * PERIOD_NS);
        let far = window.at(newest.plus_ns(400_000_000), &skeleton).unwrap();
        let Lookup::Extrapolated {
            value,
            by_ns: 400_000_000,
        } = far
        else {
            panic!("0.4 s beyond the newest is held");
        };
        assert!(
            (value.pose.root.z - 0.26).abs() < 1e-4,
            "carried on by 60 ms only"
        );
        let stale = window.at(newest.plus_ns(600_000_000), &skeleton);
        assert!(
            matches!(stale, Some(Lookup::Stale { value, age_ns: 600_000_000 })
            if value.target_at == newest)
        );
        assert_eq!(Window::default().at(newest, &skeleton), Some(Lookup::Empty));
        let one = filled(5..=5)
            .at(newest, &skeleton)
            .unwrap()
            .value()
            .unwrap();
        assert!(one.is_sound() && (one.pose.root.z - 0.05).abs() < 1e-6);
    }
}
