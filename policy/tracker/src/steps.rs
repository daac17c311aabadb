//! When a network that was trained at 60 Hz makes its steps, whatever the tracker's ticks.
//!
//! A tick that comes about 1/60 s after the last step makes one step at its own time, so that at
//! 60 Hz nothing is delayed. At other rates steps are made on a 60 Hz grid.

use posed_signal::HostTime;

/// One step's time, nanoseconds.
pub(crate) const STEP_NS: i64 = 16_666_667;
/// How far off the grid a step may be made at the tick's own time.
const SLACK_NS: i64 = STEP_NS / 8;
/// After a gap longer than this the network starts anew.
pub(crate) const GAP_NS: i64 = 15 * STEP_NS;

/// When the step after the one at `last` has to be made, if that is not after `now`.
pub(crate) fn due(last: Option<HostTime>, now: HostTime) -> Option<HostTime> {
    let Some(last) = last else {
        return Some(now);
    };
    let late = now.since_ns(last.plus_ns(STEP_NS));
    if late < -SLACK_NS {
        return None;
    }
    Some(if late <= SLACK_NS {
        now
    } else {
        last.plus_ns(STEP_NS)
    })
}

/// Time in steps.
pub(crate) fn steps_between(earlier: HostTime, later: HostTime) -> f32 {
    later.since_ns(earlier) as f32 / STEP_NS as f32
}
