//! Live: the source and the tracker loop each on a thread of its own.
//!
//! The tracker's thread wakes on its own tick and touches nothing but rings, its own memory and
//! the sink. The source's thread waits for the transport.

use std::{
    io,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    thread,
};

use posed_device::rig::DeviceInfo;
use posed_signal::{
    Clock as _, HostTime,
    time::{MILLISECOND_NS, SECOND_NS},
};

use super::{
    source::{Source, Taken},
    tracking::TrackerLoop,
};
use crate::{
    clock::{Monotonic, sleep_until},
    published::PublishedPose,
};

/// The longest that the source waits for its transport: commands and listings go out this often.
const SOURCE_WAIT_NS: u64 = 5 * MILLISECOND_NS;
/// Device listings are renewed this often.
const LISTING_NS: i64 = 100 * MILLISECOND_NS as i64;
/// Priority asked of the scheduler, `SCHED_FIFO`; low, but above everything that is not real-time.
const FIFO_PRIORITY: u8 = 10;

/// What the threads share with those who watch them. All counters only grow.
#[derive(Debug, Default)]
pub struct Shared {
    /// Set to end both threads.
    pub stop: AtomicBool,
    /// Ticks done: what the watchdog is fed by.
    pub ticks: AtomicU64,
    /// Ticks that began more than half a period late.
    pub late_ticks: AtomicU64,
    /// The latest that a tick ever began, ns.
    pub lateness_max_ns: AtomicU64,
    /// Whether the scheduler granted real-time priority.
    pub real_time: AtomicBool,
}

/// Starts the source's thread. `listing` is called ten times a second with the devices, `warn` with
/// whatever people should know.
///
/// # Errors
/// The thread cannot be started.
pub fn spawn_source(
    mut source: Source,
    shared: Arc<Shared>,
    mut listing: impl FnMut(&[DeviceInfo]) + Send + 'static,
    mut warn: impl FnMut(&str) + Send + 'static,
) -> io::Result<thread::JoinHandle<()>> {
    let work = move || {
        let mut next_listing = HostTime(0);
        while !shared.stop.load(Ordering::Relaxed) {
            let event = source.next(SOURCE_WAIT_NS);
            match source.take(event) {
                Taken::Warning(text) => warn(&text),
                Taken::End => break,
                Taken::Something | Taken::Nothing => {}
            }
            let now = Monotonic.now();
            source.tick(now);
            if now >= next_listing {
                next_listing = now.plus_ns(LISTING_NS);
                listing(source.rig().devices());
            }
        }
        listing(source.rig().devices());
    };
    thread::Builder::new().name("source".into()).spawn(work)
}

/// Starts the tracker's thread: `rate_hz` ticks a second, each handed to `publish`, which may
/// neither wait, lock nor allocate.
///
/// # Errors
/// The thread cannot be started.
pub fn spawn_tracker(
    mut tracker: TrackerLoop,
    rate_hz: f64,
    shared: Arc<Shared>,
    mut publish: impl FnMut(&PublishedPose) + Send + 'static,
) -> io::Result<thread::JoinHandle<()>> {
    let period_ns = (SECOND_NS as f64 / rate_hz) as i64;
    let work = move || {
        shared.real_time.store(promote(), Ordering::Relaxed);
        let mut due = Monotonic.now();
        while !shared.stop.load(Ordering::Relaxed) {
            sleep_until(&Monotonic, due);
            let late = Monotonic.now().since_ns(due);
            shared
                .lateness_max_ns
                .fetch_max(late.unsigned_abs(), Ordering::Relaxed);
            if late > period_ns / 2 {
                shared.late_ticks.fetch_add(1, Ordering::Relaxed);
            }
            let pose = tracker.tick(&Monotonic, &mut |_, _| {});
            publish(&pose);
            shared.ticks.fetch_add(1, Ordering::Release);
            due = next_due(due, period_ns, Monotonic.now());
        }
    };
    thread::Builder::new().name("tracker".into()).spawn(work)
}

/// The next tick on the grid that has not passed: after a stall, ticks are left out, not made up.
fn next_due(due: HostTime, period_ns: i64, now: HostTime) -> HostTime {
    let behind = now.since_ns(due).max(0) / period_ns;
    due.plus_ns((behind + 1) * period_ns)
}

/// Asks for real-time scheduling of this thread; a refusal is no failure, but is reported.
fn promote() -> bool {
    use thread_priority::{
        RealtimeThreadSchedulePolicy, ThreadPriority, ThreadSchedulePolicy,
        set_thread_priority_and_policy, thread_native_id,
    };
    let Ok(priority) = FIFO_PRIORITY.try_into() else {
        return false;
    };
    set_thread_priority_and_policy(
        thread_native_id(),
        ThreadPriority::Crossplatform(priority),
        ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo),
    )
    .is_ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_stay_on_their_grid_and_stalls_are_skipped() {
        let due = HostTime(1_000);
        assert_eq!(next_due(due, 100, HostTime(1_010)), HostTime(1_100));
        assert_eq!(next_due(due, 100, HostTime(1_250)), HostTime(1_300));
        assert_eq!(next_due(due, 100, HostTime(900)), HostTime(1_100));
    }
}
