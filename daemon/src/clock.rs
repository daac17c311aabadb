//! The operating system's clock, behind [`Clock`]. Nothing else in posed reads it.

use posed_signal::{Clock, HostTime};

/// `CLOCK_MONOTONIC`, in nanoseconds since its own origin (the boot), so that times can be
/// compared with those of other processes.
#[derive(Debug, Clone, Copy, Default)]
pub struct Monotonic;

impl Clock for Monotonic {
    fn now(&self) -> HostTime {
        let now = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
        let (seconds, nanoseconds) = (now.tv_sec.max(0) as u64, now.tv_nsec.max(0) as u64);
        HostTime(seconds * posed_signal::time::SECOND_NS + nanoseconds)
    }
}

/// Sleeps until `time`; returns at once where it has passed.
pub fn sleep_until(clock: &impl Clock, time: HostTime) {
    let wait = time.since_ns(clock.now());
    if wait > 0 {
        std::thread::sleep(std::time::Duration::from_nanos(wait.unsigned_abs()));
    }
}
