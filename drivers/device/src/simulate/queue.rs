//! A device's light words on their way out: held back as the device's processing does, grouped
//! by channel, packed into streams.

use std::collections::VecDeque;

use super::light::Word;

/// Words between sensors and reports.
#[derive(Debug)]
pub(super) struct LightQueue {
    /// The device reports a hit this long after it, seconds.
    processing_s: f64,
    /// More words than this do not wait; what comes then is lost.
    waiting_max: usize,
    seen: Vec<Word>,
    ready: VecDeque<Word>,
    lost: u64,
}

impl LightQueue {
    pub(super) fn new(processing_s: f64, waiting_max: usize) -> Self {
        Self {
            processing_s,
            waiting_max,
            seen: Vec::new(),
            ready: VecDeque::new(),
            lost: 0,
        }
    }

    /// Takes what the device sees of a rotation.
    pub(super) fn extend(&mut self, words: Vec<Word>) {
        self.seen.extend(words);
    }

    /// Makes ready what has been processed by `now` (seconds), channel by channel.
    pub(super) fn process(&mut self, now: f64) {
        let until = now - self.processing_s;
        let mut batch: Vec<Word> = self
            .seen
            .extract_if(.., |word| word.seen_s <= until)
            .collect();
        // The sort is stable: a sync stays before the hits of its rotation.
        batch.sort_by(|a, b| {
            (a.channel, a.seen_s)
                .partial_cmp(&(b.channel, b.seen_s))
                .unwrap_or(std::cmp::Ordering::Equal)
        });
        for word in batch {
            if self.ready.len() < self.waiting_max {
                self.ready.push_back(word);
            } else {
                self.lost += 1;
            }
        }
    }

    /// Words that can be sent.
    pub(super) fn ready(&self) -> usize {
        self.ready.len()
    }

    /// Takes up to `words_max` words as a stream of at most `bytes_max` bytes: a marker byte for
    /// each change of channel, then its words.
    pub(super) fn pack(&mut self, words_max: usize, bytes_max: usize) -> Vec<u8> {
        let (mut stream, mut channel) = (Vec::new(), None);
        for _ in 0..words_max {
            let Some(word) = self.ready.front() else {
                break;
            };
            let marker = channel != Some(word.channel);
            if stream.len() + usize::from(marker) + 4 > bytes_max {
                break;
            }
            if marker {
                channel = Some(word.channel);
                stream.push(word.channel << 4 | 1);
            }
            stream.extend(word.bits.to_le_bytes());
            self.ready.pop_front();
        }
        stream
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn word(seen_s: f64, channel: u8) -> Word {
        Word {
            seen_s,
            channel,
            bits: 0x1234_5670,
        }
    }

    #[test]
    fn words_wait_and_are_grouped() {
        let mut queue = LightQueue::new(3e-3, 256);
        queue.extend(vec![
            word(0.010, 8),
            word(0.011, 2),
            word(0.0111, 8),
            word(0.020, 2),
        ]);
        queue.process(0.012);
        assert_eq!(queue.ready(), 0);
        queue.process(0.0145);
        assert_eq!(queue.ready(), 3);
        let stream = queue.pack(14, 62);
        assert_eq!(stream.len(), 2 + 3 * 4);
        assert_eq!((stream[0], stream[5]), (0x21, 0x81));
    }

    #[test]
    fn streams_stay_within_their_bounds() {
        let mut queue = LightQueue::new(3e-3, 256);
        queue.extend(
            (0..400)
                .map(|n| word(f64::from(n) * 1e-5, (n % 2) as u8))
                .collect(),
        );
        queue.process(1.0);
        assert_eq!(queue.ready() as u64 + queue.lost, 400);
        let mut words = 0;
        while queue.ready() > 0 {
            let stream = queue.pack(6, 25);
            assert!(stream.len() <= 25);
            words += stream.len() / 4;
        }
        assert_eq!(words, 256);
    }
}
