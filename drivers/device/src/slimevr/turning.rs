//! How fast something turns, from its orientations alone: trackers do not send their gyroscope.

use glam::{Quat, Vec3};
use posed_signal::HostTime;

/// Orientations remembered.
const REMEMBERED: usize = 16;
/// Orientations in full precision resolve 0.004 degrees: 15 ms suffice.
const SPAN_FINE_NS: i64 = 15_000_000;
/// Packed ones resolve 0.35 degrees: over 50 ms their steps make 7 degrees a second.
const SPAN_COARSE_NS: i64 = 50_000_000;
/// Orientations further back than this say nothing about the present.
const OLD_NS: i64 = 120_000_000;

#[derive(Debug, Clone, Copy)]
struct Seen {
    at: HostTime,
    rotation: Quat,
    coarse: bool,
}

/// The last orientations of a tracker.
#[derive(Debug, Clone, Default)]
pub(super) struct Turning {
    seen: [Option<Seen>; REMEMBERED],
    count: usize,
}

impl Turning {
    /// Takes the orientation at a time and answers with the angular velocity, rad/s, in the
    /// world's axes: the mean over a span long enough for the orientations' precision.
    pub(super) fn update(&mut self, at: HostTime, rotation: Quat, coarse: bool) -> Vec3 {
        let now = Seen {
            at,
            rotation,
            coarse,
        };
        let velocity = self.earlier(now).map_or(Vec3::ZERO, |before| {
            let turn = rotation * before.rotation.inverse();
            let short = if turn.w < 0.0 { -turn } else { turn };
            short.to_scaled_axis() / at.since_secs(before.at) as f32
        });
        self.seen[self.count % REMEMBERED] = Some(now);
        self.count += 1;
        velocity
    }

    /// The newest orientation that lies far enough back.
    fn earlier(&self, now: Seen) -> Option<Seen> {
        let held = self.count.min(REMEMBERED);
        let newest_first = (1..=held).map(|back| self.seen[(self.count - back) % REMEMBERED]);
        newest_first.flatten().find(|seen| {
            let span = if seen.coarse || now.coarse {
                SPAN_COARSE_NS
            } else {
                SPAN_FINE_NS
            };
            (span..OLD_NS).contains(&now.at.since_ns(seen.at))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_steady_turn_is_found_at_any_rate_and_over_gaps() {
        let spin = Vec3::new(0.3, -2.0, 0.5);
        for step_ms in [4u64, 10, 30] {
            let mut turning = Turning::default();
            let mut last = Vec3::ZERO;
            for step in 0..40 {
                let ms = step * step_ms;
                if step % 7 == 3 {
                    continue;
                }
                let rotation = Quat::from_scaled_axis(spin * (ms as f32 * 1e-3));
                last = turning.update(HostTime(1_000_000 * ms), rotation, step % 2 == 0);
            }
            assert!(last.distance(spin) < 0.02, "{step_ms} ms: {last}");
        }
    }

    #[test]
    fn a_first_orientation_and_one_after_a_long_silence_are_at_rest() {
        let mut turning = Turning::default();
        let still = turning.update(HostTime(1), Quat::IDENTITY, false);
        let after = turning.update(HostTime(900_000_000), Quat::from_rotation_y(1.0), false);
        assert_eq!((still, after), (Vec3::ZERO, Vec3::ZERO));
    }
}
