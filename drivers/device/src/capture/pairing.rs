//! Control transfers come in pieces: the set-up packet is kept until the data has come.

use std::collections::HashMap;

use super::Statistics;
use crate::usb::{Packet, Port, Setup};

/// Control transfers that may be under way at once. A capture that begins more and never ends
/// them is missing records.
pub const PENDING_CONTROLS_MAX: usize = 1_024;

/// A transfer under way: its port, and the id that its records share.
pub(super) type Key = (Port, u64);

/// Control transfers under way, and the counts of what the records held.
#[derive(Debug, Default)]
pub(super) struct Pairing {
    pending: HashMap<Key, Setup>,
    pub(super) statistics: Statistics,
    /// A record had the header of another link type.
    pub(super) misheaded: bool,
    /// Transfers under way were forgotten.
    pub(super) overflowed: bool,
}

impl Pairing {
    /// A control transfer begins. An older one of the same key never ended.
    pub(super) fn begin(&mut self, key: Key, setup: Setup) {
        if self.pending.len() >= PENDING_CONTROLS_MAX && !self.pending.contains_key(&key) {
            self.overflowed = true;
            self.pending.clear();
        }
        self.pending.insert(key, setup);
    }

    /// The transfer of `key`, which goes on.
    pub(super) fn open(&self, key: Key) -> Option<Setup> {
        self.pending.get(&key).copied()
    }

    /// The transfer of `key`, which ends.
    pub(super) fn end(&mut self, key: Key) -> Option<Setup> {
        self.pending.remove(&key)
    }

    /// A piece of a control transfer whose beginning is not in the capture: without its set-up
    /// packet nobody can tell what the data is.
    pub(super) fn unpaired(&mut self, with_data: bool) -> Option<Packet> {
        self.statistics.unpaired += u64::from(with_data);
        None
    }
}
