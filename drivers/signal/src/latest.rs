//! One value, always the newest: written by one thread that never waits, read by any number.
//!
//! A writer fills a slot that nobody reads and then points to it. A reader pins the slot it was
//! pointed to, copies, and lets go. With `READERS_MAX` readers copying at the same instant there
//! is always a free slot left; beyond that the writer drops its value and counts it.

use std::{mem::MaybeUninit, sync::Arc};

use crate::sync::{AtomicU32, AtomicU64, AtomicUsize, Ordering, UnsafeCell};

/// Readers that may copy at the same instant without the writer having to drop a value.
#[cfg(not(loom))]
pub const READERS_MAX: usize = 14;
#[cfg(loom)]
const READERS_MAX: usize = 1;

/// The newest value, the one being written, and one for each reader.
const SLOTS: usize = READERS_MAX + 2;
const NOTHING_YET: usize = usize::MAX;

#[derive(Debug)]
struct Slot<T> {
    readers: AtomicU32,
    value: UnsafeCell<MaybeUninit<(u64, T)>>,
}

/// A reader that finds this bit set came too late: the writer has claimed the slot.
const CLAIMED: u32 = 1 << 31;

#[derive(Debug)]
struct Shared<T> {
    slots: [Slot<T>; SLOTS],
    newest: AtomicUsize,
    dropped: AtomicU64,
}

// SAFETY: a slot's value is written only while `readers` holds exactly `CLAIMED`, which the writer
// sets by compare-and-swap from zero, and read only between a reader's increment that did not see
// `CLAIMED` and its decrement.
unsafe impl<T: Send> Sync for Shared<T> {}
// SAFETY: the values move between threads, which `T: Send` allows.
unsafe impl<T: Send> Send for Shared<T> {}

/// The only writer of a latest-value cell.
#[derive(Debug)]
pub struct Writer<T> {
    shared: Arc<Shared<T>>,
    count: u64,
    next: usize,
}

/// A reader; clone it for more.
#[derive(Debug)]
pub struct Reader<T> {
    shared: Arc<Shared<T>>,
}

impl<T> Clone for Reader<T> {
    fn clone(&self) -> Self {
        Self {
            shared: Arc::clone(&self.shared),
        }
    }
}

/// An empty cell.
#[must_use]
pub fn latest<T: Copy + Send>() -> (Writer<T>, Reader<T>) {
    let shared = Arc::new(Shared {
        slots: std::array::from_fn(|_| Slot {
            readers: AtomicU32::new(0),
            value: UnsafeCell::new(MaybeUninit::uninit()),
        }),
        newest: AtomicUsize::new(NOTHING_YET),
        dropped: AtomicU64::new(0),
    });
    (
        Writer {
            shared: Arc::clone(&shared),
            count: 0,
            next: 0,
        },
        Reader { shared },
    )
}

impl<T: Copy + Send> Writer<T> {
    /// Publishes `value`. Never waits; `false` means that every other slot was being read, and the
    /// value was dropped and counted.
    pub fn publish(&mut self, value: T) -> bool {
        let newest = self.shared.newest.load(Ordering::Relaxed);
        for _ in 0..SLOTS {
            let index = self.next;
            self.next = (self.next + 1) % SLOTS;
            if index == newest || !self.fill(index, value) {
                continue;
            }
            self.count += 1;
            self.shared.newest.store(index, Ordering::Release);
            return true;
        }
        self.shared.dropped.fetch_add(1, Ordering::Relaxed);
        false
    }

    fn fill(&self, index: usize, value: T) -> bool {
        let slot = &self.shared.slots[index];
        let claim = slot
            .readers
            .compare_exchange(0, CLAIMED, Ordering::Acquire, Ordering::Relaxed);
        if claim.is_err() {
            return false;
        }
        slot.value.with_mut(|cell| {
            // SAFETY: claimed above, so that no reader is inside.
            unsafe { (*cell).write((self.count + 1, value)) };
        });
        // A late reader may have counted itself in meanwhile; it counts itself out again.
        slot.readers.fetch_and(!CLAIMED, Ordering::Release);
        true
    }
}

impl<T: Copy + Send> Reader<T> {
    /// The newest value with its number, counted from 1; `None` before the first.
    #[must_use]
    pub fn get(&self) -> Option<(u64, T)> {
        loop {
            let index = self.shared.newest.load(Ordering::Acquire);
            if index == NOTHING_YET {
                return None;
            }
            let slot = &self.shared.slots[index];
            let before = slot.readers.fetch_add(1, Ordering::Acquire);
            let value = (before & CLAIMED == 0).then(|| {
                slot.value.with(|cell| {
                    // SAFETY: counted in while the slot was not claimed, and a slot that `newest`
                    // has ever pointed to holds a value.
                    unsafe { (*cell).assume_init() }
                })
            });
            slot.readers.fetch_sub(1, Ordering::Release);
            if value.is_some() {
                return value;
            }
            #[cfg(loom)]
            loom::thread::yield_now();
        }
    }

    /// Values dropped because too many readers were copying.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.shared.dropped.load(Ordering::Relaxed)
    }
}

#[cfg(all(test, not(loom)))]
mod tests {
    use super::*;

    #[test]
    fn gives_nothing_then_the_newest() {
        let (mut writer, reader) = latest();
        assert_eq!(reader.get(), None);
        for value in 0..100u32 {
            assert!(writer.publish(value));
            assert_eq!(reader.get(), Some((u64::from(value) + 1, value)));
        }
    }

    #[test]
    fn readers_never_see_a_torn_or_older_value() {
        let (mut writer, reader) = latest::<[u64; 32]>();
        let readers: Vec<_> = (0..4)
            .map(|_| {
                let reader = reader.clone();
                std::thread::spawn(move || {
                    let mut last = 0;
                    while last < 20_000 {
                        let Some((number, value)) = reader.get() else {
                            continue;
                        };
                        assert!(value.iter().all(|&word| word == number));
                        assert!(number >= last);
                        last = number;
                    }
                })
            })
            .collect();
        let mut number = 0;
        while readers.iter().any(|thread| !thread.is_finished()) {
            assert!(writer.publish([number + 1; 32]));
            number += 1;
        }
        for thread in readers {
            thread.join().unwrap();
        }
        assert_eq!(reader.dropped(), 0);
    }
}

#[cfg(all(test, loom))]
mod loom_tests {
    use super::*;

    #[test]
    fn no_interleaving_tears_a_value() {
        loom::model(|| {
            let (mut writer, reader) = latest();
            writer.publish([1u8, 1]);
            let thread = loom::thread::spawn(move || {
                writer.publish([2, 2]);
                writer.publish([3, 3]);
            });
            let (number, value) = reader.get().unwrap();
            assert_eq!(value, [number as u8; 2]);
            thread.join().unwrap();
        });
    }
}
