//! What those who watch a replay may ask of it, and what they see of it.

use std::sync::{Mutex, MutexGuard, PoisonError};

use posed_signal::HostTime;
use serde::Serialize;

/// Nobody is sent nearer to a capture's end, seconds.
const END_S: f64 = 0.5;

/// Where a replay stands.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Position {
    /// Seconds from the capture's first packet.
    pub position_s: f64,
    /// Seconds from the capture's first packet to its last; 0 while that is not known.
    pub length_s: f64,
    /// Whether it stands still.
    pub paused: bool,
    /// Whether it is on its way, as fast as it can, to where it was sent.
    pub seeking: bool,
}

/// A replay's remote control: the page and the replay's thread share it.
#[derive(Debug, Default)]
pub struct Playback {
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    position: Position,
    start: Option<HostTime>,
    goal_s: Option<f64>,
}

/// What a replay does next.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Next {
    /// Shows the present time.
    Show,
    /// Goes on without showing anything: its goal lies ahead.
    Skip,
    /// Stands still.
    Wait,
    /// Begins again at the capture's start: its goal lies behind.
    Rewind,
}

impl Playback {
    /// Where the replay stands.
    #[must_use]
    pub fn position(&self) -> Position {
        self.lock().position
    }

    /// Stops the replay, or lets it go on.
    pub fn pause(&self, paused: bool) {
        self.lock().position.paused = paused;
    }

    /// Sends the replay to another time, seconds from the capture's start; a time that is no
    /// number, or before the start, is the start. The end itself cannot be gone to: the replay
    /// would be over.
    pub fn seek(&self, seconds: f64) {
        let mut state = self.lock();
        let length_s = state.position.length_s;
        let last_s = if length_s > 0.0 {
            length_s - END_S
        } else {
            f64::MAX
        };
        state.goal_s = Some(seconds.max(0.0).min(last_s));
    }

    /// Tells the capture's length, seconds.
    pub fn set_length(&self, seconds: f64) {
        self.lock().position.length_s = seconds;
    }

    /// What to do now that the capture's `time` is due.
    pub fn next(&self, time: HostTime) -> Next {
        let mut state = self.lock();
        let start = *state.start.get_or_insert(time);
        let now_s = time.since_secs(start);
        match state.goal_s {
            Some(goal) if goal < state.position.position_s && goal < now_s => return Next::Rewind,
            Some(goal) if goal > now_s => {
                state.position.position_s = now_s;
                state.position.seeking = true;
                return Next::Skip;
            }
            None if state.position.paused => return Next::Wait,
            _ => {}
        }
        state.goal_s = None;
        state.position.position_s = now_s;
        state.position.seeking = false;
        Next::Show
    }

    /// The replay begins at the capture's start; to go on to its goal, or with `again` to play.
    pub fn rewound(&self, again: bool) {
        let mut state = self.lock();
        state.position.position_s = 0.0;
        state.start = None;
        if again {
            state.goal_s = None;
        }
    }

    /// Nothing half-done can be left behind.
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(seconds: f64) -> HostTime {
        HostTime(7_000_000_000).plus_secs(seconds)
    }

    #[test]
    fn a_replay_is_paused_and_sent_to_and_fro() {
        let playback = Playback::default();
        assert_eq!(playback.next(at(0.0)), Next::Show);
        playback.set_length(10.0);
        playback.pause(true);
        assert_eq!(playback.next(at(0.1)), Next::Wait);
        assert!(playback.position().paused);

        // Forward, also while it stands still: the goal is shown, then it stands again.
        playback.seek(5.0);
        assert_eq!(playback.next(at(0.1)), Next::Skip);
        assert!(playback.position().seeking);
        assert_eq!(playback.next(at(4.99)), Next::Skip);
        assert_eq!(playback.next(at(5.0)), Next::Show);
        assert_eq!(playback.next(at(5.1)), Next::Wait);
        assert_eq!(playback.position().position_s, 5.0);

        // Backward, from the start again.
        playback.seek(2.0);
        assert_eq!(playback.next(at(5.1)), Next::Rewind);
        playback.rewound(false);
        assert_eq!(playback.next(at(0.0)), Next::Skip);
        assert_eq!(playback.next(at(2.0)), Next::Show);
        playback.pause(false);
        assert_eq!(playback.next(at(2.1)), Next::Show);
        playback.rewound(true);
        assert_eq!(playback.next(at(0.0)), Next::Show);
        assert_eq!(playback.position().length_s, 10.0);
    }

    #[test]
    fn goals_that_are_no_time_are_the_start() {
        let playback = Playback::default();
        for goal in [f64::NAN, -3.0] {
            playback.next(at(0.0));
            playback.next(at(1.0));
            playback.seek(goal);
            assert_eq!(playback.next(at(1.1)), Next::Rewind);
            playback.rewound(false);
            assert_eq!(playback.next(at(0.0)), Next::Show);
        }
    }
}
