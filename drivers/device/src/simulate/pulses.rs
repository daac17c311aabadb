//! Light of generation 1 on its way out: pulses as wired reports hold them, and as radio packets of
//! version 1 pack them.

use std::collections::VecDeque;

/// A light pulse that a sensor saw.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Pulse {
    /// When the device has it, seconds after the start.
    pub(super) seen_s: f64,
    /// The sensor's hardware channel.
    pub(super) sensor: u8,
    /// Device time of its begin, ticks.
    pub(super) begin: f64,
    /// Ticks.
    pub(super) length: u16,
}

/// Pulses between sensors and reports.
#[derive(Debug, Default)]
pub(super) struct PulseQueue {
    seen: Vec<Pulse>,
    ready: VecDeque<Pulse>,
}

/// Sensors that there are in radio packets.
const SENSORS: u8 = 24;

impl PulseQueue {
    /// More pulses do not wait; what comes then is lost.
    const WAITING_MAX: usize = 128;
    /// A device reports a pulse so long after it, seconds.
    const PROCESSING_S: f64 = 1e-3;
    /// A packet's light is made of at most so many pulses.
    const PACKET_MAX: usize = 5;

    /// Takes what the device sees.
    pub(super) fn extend(&mut self, pulses: Vec<Pulse>) {
        self.seen.extend(pulses);
    }

    /// Makes ready what has been processed by `now` (seconds), in the order of time.
    pub(super) fn process(&mut self, now: f64) {
        let until = now - Self::PROCESSING_S;
        let mut batch: Vec<Pulse> = self
            .seen
            .extract_if(.., |pulse| pulse.seen_s <= until)
            .collect();
        batch.sort_by(|a, b| a.begin.total_cmp(&b.begin));
        let room = Self::WAITING_MAX - self.ready.len();
        self.ready.extend(batch.into_iter().take(room));
    }

    /// Whether there are any.
    pub(super) fn is_empty(&self) -> bool {
        self.ready.is_empty()
    }

    /// A headset's report 0x25 of up to nine pulses.
    pub(super) fn report(&mut self) -> Vec<u8> {
        let mut report = vec![0x25];
        for pulse in self.ready.drain(..self.ready.len().min(9)) {
            report.push(pulse.sensor);
            report.extend(pulse.length.to_le_bytes());
            report.extend((pulse.begin.round() as u64 as u32).to_le_bytes());
        }
        report.resize(64, 0xff);
        report
    }

    /// Light of a radio packet of at most `bytes_max` bytes: as many pulses as there is room for.
    pub(super) fn pack(&mut self, bytes_max: usize) -> Vec<u8> {
        let mut packed = Vec::new();
        let mut count = 0;
        while count < self.ready.len().min(Self::PACKET_MAX) {
            let next = encode(
                &self
                    .ready
                    .iter()
                    .take(count + 1)
                    .copied()
                    .collect::<Vec<_>>(),
            );
            match next {
                Some(next) if next.len() <= bytes_max => (packed, count) = (next, count + 1),
                _ => break,
            }
        }
        if count == 0 {
            // It cannot be sent.
            self.ready.pop_front();
        }
        self.ready.drain(..count);
        packed
    }
}

/// Sensors, then steps between times from the oldest to the newest, then the newest time. `None` for
/// sensors that radio packets have no place for: their first byte would be an event's.
fn encode(pulses: &[Pulse]) -> Option<Vec<u8>> {
    if pulses.iter().any(|pulse| pulse.sensor >= SENSORS) {
        return None;
    }
    let ends = |pulse: &Pulse| {
        let begin = pulse.begin.round() as u64;
        (begin + u64::from(pulse.length), begin)
    };
    let mut order: Vec<(u64, u64, u8)> = pulses
        .iter()
        .map(|pulse| (ends(pulse).0, ends(pulse).1, pulse.sensor))
        .collect();
    order.sort_by_key(|&(end, begin, sensor)| std::cmp::Reverse((end, begin, sensor)));
    // Each time with the pulse that it is the begin of, if it is one; of equal times ends first.
    let mut times: Vec<(u64, Option<usize>)> = Vec::new();
    for (index, &(end, begin, _)) in order.iter().enumerate() {
        times.extend([(end, None), (begin, Some(index))]);
    }
    times.sort_by_key(|&(time, begin)| (std::cmp::Reverse(time), begin));
    let mut bytes = Vec::new();
    let mut ends = times
        .iter()
        .enumerate()
        .filter(|(_, (_, begin))| begin.is_none())
        .map(|(at, _)| at);
    for (index, &(_, _, sensor)) in order.iter().enumerate() {
        let end = ends.next()?;
        let begin = times.iter().position(|(_, begin)| *begin == Some(index))?;
        let between = begin.checked_sub(end + 1).filter(|between| *between < 8)?;
        bytes.push(sensor << 3 | between as u8);
    }
    let mut steps = Vec::new();
    for pair in times.windows(2) {
        let step = pair[0].0 - pair[1].0;
        let groups = (1..4).take_while(|group| step >> (7 * group) != 0).count();
        for group in (1..=groups).rev() {
            steps.push((step >> (7 * group)) as u8 & 0x7f);
        }
        steps.push(step as u8 & 0x7f | 0x80);
    }
    bytes.extend(steps.iter().rev());
    bytes.extend(&(times.first()?.0 as u32).to_le_bytes()[..3]);
    Some(bytes)
}
