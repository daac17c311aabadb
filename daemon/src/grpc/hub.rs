//! From the tracker thread to everybody who wants poses.
//!
//! The tracker thread puts each pose into a latest-value cell and a ring, and wakes the bridge
//! thread; it never waits for anybody. The bridge moves poses from the ring into the [`Window`],
//! which readers share under a lock that the tracker thread never sees, and tells them.

use std::{
    io,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, Thread},
};

use posed_body::Skeleton;
use posed_signal::{
    HostTime, Lookup,
    latest::{Reader, Writer, latest},
    ring::{Consumer, Producer, ring},
};
use tokio::sync::watch;

use super::window::{Behind, Window};
use crate::published::PublishedPose;

/// Poses that may wait for the bridge thread: 0.7 s at 90 Hz.
const RING_POSES: usize = 64;

/// The tracker thread's end. When it is dropped, streams of poses end.
#[derive(Debug)]
pub struct PoseSink {
    latest: Writer<PublishedPose>,
    ring: Producer<PublishedPose>,
    bridge: Thread,
    closed: Arc<AtomicBool>,
}

impl PoseSink {
    /// Publishes a pose. Never waits and never allocates; a pose that the bridge thread has no
    /// room for is dropped and counted, and a step in the sequence numbers tells readers.
    pub fn publish(&mut self, pose: &PublishedPose) {
        // Refused only while more than `READERS_MAX` readers copy at the same instant; the next
        // pose replaces it.
        self.latest.publish(*pose);
        self.ring.push(*pose);
        self.bridge.unpark();
    }

    /// Poses dropped so far because the bridge thread was late.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.ring.dropped()
    }
}

impl Drop for PoseSink {
    fn drop(&mut self) {
        self.closed.store(true, Ordering::Release);
        self.bridge.unpark();
    }
}

/// The readers' end. Clones share everything.
#[derive(Debug, Clone)]
pub struct Hub {
    latest: Reader<PublishedPose>,
    window: Arc<Mutex<Window>>,
    changed: watch::Receiver<()>,
}

impl Hub {
    /// The two ends, and the bridge thread between them.
    ///
    /// # Errors
    /// The thread cannot be started.
    pub fn new() -> io::Result<(PoseSink, Self)> {
        let (latest_writer, latest_reader) = latest();
        let (producer, consumer) = ring(RING_POSES);
        let (changed_sender, changed) = watch::channel(());
        let window = Arc::new(Mutex::new(Window::default()));
        let closed = Arc::new(AtomicBool::new(false));
        let bridge = Bridge {
            ring: consumer,
            window: Arc::clone(&window),
            changed: changed_sender,
            closed: Arc::clone(&closed),
        };
        let thread = thread::Builder::new()
            .name("bridge".into())
            .spawn(move || bridge.run())?;
        let bridge = thread.thread().clone();
        let sink = PoseSink {
            latest: latest_writer,
            ring: producer,
            bridge,
            closed,
        };
        Ok((
            sink,
            Self {
                latest: latest_reader,
                window,
                changed,
            },
        ))
    }

    /// The newest pose published, as soon as it is; `None` before the first.
    #[must_use]
    pub fn latest(&self) -> Option<PublishedPose> {
        self.latest.get().map(|(_, pose)| pose)
    }

    /// A receiver that changes whenever there are new poses to read, and closes after the last.
    pub(crate) fn changes(&self) -> watch::Receiver<()> {
        self.changed.clone()
    }

    /// Sequence number of the newest pose that [`Hub::next`] knows.
    pub(crate) fn newest(&self) -> Option<u64> {
        lock(&self.window).newest().map(|pose| pose.sequence)
    }

    /// See [`Window::next`].
    pub(crate) fn next(&self, after: Option<u64>, behind: Behind) -> Option<(PublishedPose, u64)> {
        lock(&self.window)
            .next(after, behind)
            .map(|(pose, gap)| (*pose, gap))
    }

    /// See [`Window::at`].
    pub(super) fn at(&self, at: HostTime, skeleton: &Skeleton) -> Option<Lookup<PublishedPose>> {
        lock(&self.window).at(at, skeleton)
    }
}

#[cfg(test)]
impl Hub {
    /// How many there are, this one and the bridge included: every open stream holds one.
    pub(super) fn clones(&self) -> usize {
        Arc::strong_count(&self.window)
    }
}

/// The window is whole after every operation, so that a reader's panic does not spoil it.
fn lock(window: &Mutex<Window>) -> MutexGuard<'_, Window> {
    window.lock().unwrap_or_else(PoisonError::into_inner)
}

struct Bridge {
    ring: Consumer<PublishedPose>,
    window: Arc<Mutex<Window>>,
    changed: watch::Sender<()>,
    closed: Arc<AtomicBool>,
}

impl Bridge {
    fn run(mut self) {
        loop {
            // Read before the ring is emptied, so that the last poses are not missed.
            let closed = self.closed.load(Ordering::Acquire);
            let mut moved = false;
            while let Some(pose) = self.ring.pop() {
                lock(&self.window).push(pose);
                moved = true;
            }
            if moved {
                self.changed.send_replace(());
            }
            if closed {
                return;
            }
            if !moved {
                thread::park();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::published::tests::pose_at;

    #[tokio::test]
    async fn every_pose_comes_out_in_order_and_the_end_is_seen() {
        let (mut sink, hub) = Hub::new().unwrap();
        let mut changes = hub.changes();
        assert_eq!(hub.latest(), None);
        let mut after = Some(0);
        for sequence in 1..=200 {
            sink.publish(&pose_at(sequence, HostTime(sequence)));
            assert_eq!(hub.latest().map(|pose| pose.sequence), Some(sequence));
            while hub.newest() < Some(sequence) {
                changes.changed().await.unwrap();
            }
            let (pose, gap) = hub.next(after, Behind::InOrder).unwrap();
            assert_eq!((pose.sequence, gap), (sequence, 0));
            after = Some(sequence);
        }
        sink.publish(&pose_at(201, HostTime(201)));
        assert_eq!(sink.dropped(), 0);
        drop(sink);
        while changes.changed().await.is_ok() {}
        assert_eq!(hub.newest(), Some(201));
    }

    #[test]
    fn a_bridge_that_is_held_up_costs_poses_and_never_the_publisher() {
        let (mut sink, hub) = Hub::new().unwrap();
        let held = lock(&hub.window);
        let count = 3 * RING_POSES as u64;
        for sequence in 1..=count {
            sink.publish(&pose_at(sequence, HostTime(sequence)));
        }
        // The bridge may hold one pose in its hand.
        let lost = sink.dropped();
        assert!((count - RING_POSES as u64 - 1..=count - RING_POSES as u64).contains(&lost));
        drop(held);
        assert_eq!(hub.latest().map(|pose| pose.sequence), Some(count));
    }
}
