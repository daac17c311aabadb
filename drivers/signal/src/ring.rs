//! A bounded single-producer single-consumer ring for `Copy` values.
//!
//! Neither side waits, locks or allocates. A full ring refuses the new value and counts it: the
//! producer is a device's thread, and a late tracker must not hold it up. Both sides keep a copy
//! of the other's index and read the shared one only when that copy says full or empty.

use std::{mem::MaybeUninit, sync::Arc};

use crate::sync::{AtomicU64, AtomicUsize, Ordering, UnsafeCell};

/// A cache line to itself, so that the two indices do not share one.
#[repr(align(64))]
#[derive(Debug)]
struct Line<T>(T);

#[derive(Debug)]
struct Shared<T> {
    slots: Box<[UnsafeCell<MaybeUninit<T>>]>,
    /// Number of values ever written; written by the producer only.
    tail: Line<AtomicUsize>,
    /// Number of values ever read; written by the consumer only.
    head: Line<AtomicUsize>,
    dropped: Line<AtomicU64>,
}

// SAFETY: a slot is touched by the producer only while `tail - head < capacity` says that the
// consumer has left it, and by the consumer only once `tail` says that the producer has; the
// release stores and acquire loads of the indices order those accesses.
unsafe impl<T: Send> Sync for Shared<T> {}
// SAFETY: the values move between threads, which `T: Send` allows.
unsafe impl<T: Send> Send for Shared<T> {}

/// The writing end.
#[derive(Debug)]
pub struct Producer<T> {
    shared: Arc<Shared<T>>,
    tail: usize,
    head_seen: usize,
}

/// The reading end.
#[derive(Debug)]
pub struct Consumer<T> {
    shared: Arc<Shared<T>>,
    head: usize,
    tail_seen: usize,
}

/// A ring for `capacity` values, rounded up to a power of two and at least 2.
#[must_use]
pub fn ring<T: Copy + Send>(capacity: usize) -> (Producer<T>, Consumer<T>) {
    let capacity = capacity.max(2).next_power_of_two();
    let slots = (0..capacity)
        .map(|_| UnsafeCell::new(MaybeUninit::uninit()))
        .collect();
    let shared = Arc::new(Shared {
        slots,
        tail: Line(AtomicUsize::new(0)),
        head: Line(AtomicUsize::new(0)),
        dropped: Line(AtomicU64::new(0)),
    });
    let producer = Producer {
        shared: Arc::clone(&shared),
        tail: 0,
        head_seen: 0,
    };
    (
        producer,
        Consumer {
            shared,
            head: 0,
            tail_seen: 0,
        },
    )
}

impl<T> Shared<T> {
    fn slot(&self, index: usize) -> &UnsafeCell<MaybeUninit<T>> {
        &self.slots[index & (self.slots.len() - 1)]
    }
}

impl<T: Copy + Send> Producer<T> {
    /// Appends `value`; `false` means the ring was full and the value was dropped and counted.
    pub fn push(&mut self, value: T) -> bool {
        let capacity = self.shared.slots.len();
        if self.tail.wrapping_sub(self.head_seen) == capacity {
            self.head_seen = self.shared.head.0.load(Ordering::Acquire);
            if self.tail.wrapping_sub(self.head_seen) == capacity {
                self.shared.dropped.0.fetch_add(1, Ordering::Relaxed);
                return false;
            }
        }
        self.shared.slot(self.tail).with_mut(|slot| {
            // SAFETY: the check above says that the consumer has left this slot.
            unsafe { (*slot).write(value) };
        });
        self.tail = self.tail.wrapping_add(1);
        self.shared.tail.0.store(self.tail, Ordering::Release);
        true
    }

    /// Values refused so far because the ring was full.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.shared.dropped.0.load(Ordering::Relaxed)
    }
}

impl<T: Copy + Send> Consumer<T> {
    /// Takes the oldest value, if there is one.
    pub fn pop(&mut self) -> Option<T> {
        if self.head == self.tail_seen {
            self.tail_seen = self.shared.tail.0.load(Ordering::Acquire);
            if self.head == self.tail_seen {
                return None;
            }
        }
        let value = self.shared.slot(self.head).with(|slot| {
            // SAFETY: `tail` says that the producer has filled this slot, and it does not return
            // to it before `head` moves on below.
            unsafe { (*slot).assume_init() }
        });
        self.head = self.head.wrapping_add(1);
        self.shared.head.0.store(self.head, Ordering::Release);
        Some(value)
    }

    /// Values refused so far because the ring was full.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.shared.dropped.0.load(Ordering::Relaxed)
    }

    /// Values that wait.
    #[must_use]
    pub fn waiting(&self) -> usize {
        self.shared
            .tail
            .0
            .load(Ordering::Acquire)
            .wrapping_sub(self.head)
    }
}

#[cfg(all(test, not(loom)))]
mod tests {
    use std::collections::VecDeque;

    use proptest::prelude::*;

    use super::*;

    #[derive(Debug, Clone)]
    enum Operation {
        Push(u32),
        Pop,
    }

    fn operations() -> impl Strategy<Value = Vec<Operation>> {
        let one = prop_oneof![any::<u32>().prop_map(Operation::Push), Just(Operation::Pop)];
        prop::collection::vec(one, 0..200)
    }

    proptest! {
        #[test]
        fn behaves_like_a_bounded_deque(capacity in 1usize..20, operations in operations()) {
            let (mut producer, mut consumer) = ring(capacity);
            let bound = capacity.max(2).next_power_of_two();
            let (mut oracle, mut dropped) = (VecDeque::new(), 0u64);
            for operation in operations {
                match operation {
                    Operation::Push(value) => {
                        let fits = oracle.len() < bound;
                        prop_assert_eq!(producer.push(value), fits);
                        if fits { oracle.push_back(value) } else { dropped += 1 }
                    }
                    Operation::Pop => prop_assert_eq!(consumer.pop(), oracle.pop_front()),
                }
                prop_assert_eq!(consumer.waiting(), oracle.len());
                prop_assert_eq!(consumer.dropped(), dropped);
                prop_assert_eq!(producer.dropped(), dropped);
            }
        }
    }

    #[test]
    fn keeps_order_between_threads() {
        const COUNT: u64 = 100_000;
        let (mut producer, mut consumer) = ring(64);
        let writer = std::thread::spawn(move || {
            for value in 0..COUNT {
                while !producer.push(value) {
                    std::hint::spin_loop();
                }
            }
        });
        for expected in 0..COUNT {
            let value = loop {
                if let Some(value) = consumer.pop() {
                    break value;
                }
                std::hint::spin_loop();
            };
            assert_eq!(value, expected);
        }
        writer.join().unwrap();
    }
}

#[cfg(all(test, loom))]
mod loom_tests {
    use super::*;

    #[test]
    fn every_interleaving_keeps_order_and_counts_drops() {
        loom::model(|| {
            let (mut producer, mut consumer) = ring(2);
            let writer = loom::thread::spawn(move || {
                (0..3u8)
                    .filter(|&value| producer.push(value))
                    .collect::<Vec<_>>()
            });
            let mut read: Vec<u8> = (0..2).filter_map(|_| consumer.pop()).collect();
            let written = writer.join().unwrap();
            while let Some(value) = consumer.pop() {
                read.push(value);
            }
            assert_eq!(read, written);
            assert_eq!(consumer.dropped(), 3 - written.len() as u64);
        });
    }
}
