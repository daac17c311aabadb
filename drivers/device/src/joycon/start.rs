//! What is asked of a device until it reports as posed needs it.

use posed_signal::HostTime;

use super::{
    calibration::{FACTORY, USER},
    wire::{self, DEVICE_INFO, FLASH_READ, SET_IMU, SET_REPORT, subcommand},
};
use crate::decode::Command;

/// The device gets this long for an answer.
const ANSWER_NS: i64 = 150_000_000;
/// A device that says nothing this long hangs on a cable, and waits to be greeted.
const SILENCE_NS: i64 = 600_000_000;
/// Requests in all: one that does not answer is left in peace.
const REQUESTS_MAX: u32 = 60;

/// What the device is still to be asked.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Missing {
    pub(super) identity: bool,
    pub(super) factory: bool,
    pub(super) user: bool,
    pub(super) imu: bool,
    pub(super) reports: bool,
}

/// Asks one thing after the other.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Start {
    first: Option<HostTime>,
    last: Option<HostTime>,
    asked: u32,
}

impl Start {
    /// What to send now; `heard` is whether any report has come.
    pub(super) fn tick(
        &mut self,
        now: HostTime,
        heard: bool,
        missing: Missing,
        commands: &mut Vec<Command>,
    ) {
        let first = *self.first.get_or_insert(now);
        let waits = self
            .last
            .is_some_and(|last| (0..ANSWER_NS).contains(&now.since_ns(last)));
        if waits || self.asked >= REQUESTS_MAX {
            return;
        }
        let mut send = |data: Vec<u8>| commands.push(Command::Output { interface: 0, data });
        if !heard {
            if now.since_ns(first) < SILENCE_NS {
                return;
            }
            // Over USB: shake hands, then speak HID only.
            send(vec![0x80, 0x02]);
            send(vec![0x80, 0x04]);
        } else if let Some((number, arguments)) = next(missing) {
            send(subcommand(self.asked as u8, number, &arguments));
        } else {
            return;
        }
        self.asked += 1;
        self.last = Some(now);
    }
}

fn next(missing: Missing) -> Option<(u8, Vec<u8>)> {
    let read = |(address, length): (u32, u8)| {
        let mut arguments = address.to_le_bytes().to_vec();
        arguments.push(length);
        (FLASH_READ, arguments)
    };
    match missing {
        Missing { identity: true, .. } => Some((DEVICE_INFO, Vec::new())),
        Missing { factory: true, .. } => Some(read(FACTORY)),
        Missing { user: true, .. } => Some(read(USER)),
        Missing { imu: true, .. } => Some((SET_IMU, vec![1])),
        Missing { reports: true, .. } => Some((SET_REPORT, vec![wire::FULL[0]])),
        _ => None,
    }
}
