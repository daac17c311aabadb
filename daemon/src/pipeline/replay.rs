//! Replay: the same source and the same tracker loop as live, stepped by the capture's own time.
//!
//! Packets up to a tick's time are taken, then the tick is done, whatever the speed: waiting for
//! real time changes when things happen, never what comes of them.

use posed_device::transport::Event;
use posed_signal::{Clock as _, DeviceId, HostTime, Sample, VirtualClock, time::SECOND_NS};

use super::{
    source::{Source, Taken},
    tracking::TrackerLoop,
};
use crate::published::PublishedPose;

/// What a replay tells those who watch it.
pub trait Watcher {
    /// A tick at `time` is about to be done: whoever wants real speed waits here. `false` ends
    /// the replay.
    fn pace(&mut self, time: HostTime) -> bool;
    /// A sample went into the tracker.
    fn sample(&mut self, device: DeviceId, sample: &Sample);
    /// A tick was done.
    fn pose(&mut self, pose: &PublishedPose, source: &Source);
    /// A warning about the capture.
    fn warning(&mut self, text: &str);
}

/// What a replay went through.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Span {
    /// Time of the first packet.
    pub start: HostTime,
    /// Time of the last packet.
    pub end: HostTime,
    /// Ticks done.
    pub ticks: u64,
}

impl Span {
    /// Seconds from the first packet to the last.
    #[must_use]
    pub fn seconds(&self) -> f64 {
        self.end.since_secs(self.start)
    }
}

/// Replays everything that `source` has at `rate_hz` ticks a second.
pub fn replay(
    source: &mut Source,
    tracker: &mut TrackerLoop,
    rate_hz: f64,
    watcher: &mut dyn Watcher,
) -> Span {
    let mut steps = Steps {
        clock: VirtualClock::default(),
        span: Span::default(),
        rate_hz,
    };
    let mut started = false;
    loop {
        let event = source.next(0);
        if let Event::Packet(packet) = &event {
            if !started {
                started = true;
                steps.span.start = packet.at;
            }
            steps.span.end = steps.span.end.max(packet.at);
            if !steps.up_to(packet.at, source, tracker, watcher) {
                return steps.span;
            }
        }
        match source.take(event) {
            Taken::End => break,
            Taken::Warning(text) => watcher.warning(&text),
            Taken::Something | Taken::Nothing => {}
        }
    }
    if started {
        let end = steps.span.end.plus_ns(1);
        steps.up_to(end, source, tracker, watcher);
    }
    steps.span
}

struct Steps {
    clock: VirtualClock,
    span: Span,
    rate_hz: f64,
}

impl Steps {
    /// The time of the next tick. Multiplied out, so that rounding does not add up.
    fn next(&self) -> HostTime {
        let ns = (self.span.ticks + 1) as f64 * SECOND_NS as f64 / self.rate_hz;
        self.span.start.plus_ns(ns as i64)
    }

    /// Does every tick before `time`; `false` when the watcher wants no more.
    fn up_to(
        &mut self,
        time: HostTime,
        source: &mut Source,
        tracker: &mut TrackerLoop,
        watcher: &mut dyn Watcher,
    ) -> bool {
        while self.next() < time {
            let now = self.next();
            if !watcher.pace(now) {
                return false;
            }
            self.clock.advance_to(now);
            source.tick(self.clock.now());
            let pose = tracker.tick(&self.clock, &mut |id, sample| watcher.sample(id, sample));
            self.span.ticks += 1;
            watcher.pose(&pose, source);
        }
        true
    }
}
