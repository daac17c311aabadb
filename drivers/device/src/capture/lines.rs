//! Text formats' lines, with a limit on their length.

use std::io::{BufRead, BufReader, Read};

use super::{
    Warning,
    pairing::Pairing,
    reader::Found,
    records::Step,
    source::{Fault, Source},
};

/// Longer lines are skipped; the kernel's longest report, 16 KiB, takes three characters a byte.
pub const LINE_BYTES_MAX: usize = 64 << 10;

/// A line that is not what its beginning says.
pub(super) struct BadLine;

/// Reads a text line by line.
pub(super) struct Lines<'a> {
    source: BufReader<Source<'a>>,
    fault: Fault,
    line: Vec<u8>,
    number: u64,
}

impl<'a> Lines<'a> {
    pub(super) fn new(source: Source<'a>) -> Self {
        let fault = source.fault();
        Self {
            source: BufReader::new(source),
            fault,
            line: Vec::new(),
            number: 0,
        }
    }

    /// Reads on to the next line, and makes of it what `parse` does.
    pub(super) fn step(
        &mut self,
        pairing: &mut Pairing,
        parse: impl FnOnce(&str) -> Result<Found, BadLine>,
    ) -> Step<Found> {
        self.line.clear();
        let limit = LINE_BYTES_MAX as u64 + 1;
        let read = self
            .source
            .by_ref()
            .take(limit)
            .read_until(b'\n', &mut self.line);
        self.number += 1;
        if !matches!(read, Ok(count) if count > 0) {
            return Step::End(self.fault.warning());
        }
        if self.line.len() > LINE_BYTES_MAX {
            pairing.statistics.malformed += 1;
            self.skip_line();
            return Step::Warning(Warning::LineTooLong { line: self.number });
        }
        let found = std::str::from_utf8(&self.line)
            .map_err(|_| BadLine)
            .and_then(|line| parse(line.trim()));
        match found {
            Ok(found) => {
                pairing.statistics.records += u64::from(found.packet.is_some());
                Step::Record(found)
            }
            Err(BadLine) => {
                pairing.statistics.malformed += 1;
                Step::Warning(Warning::Line { line: self.number })
            }
        }
    }

    fn skip_line(&mut self) {
        loop {
            let (used, done) = match self.source.fill_buf() {
                Ok([]) | Err(_) => return,
                Ok(bytes) => match bytes.iter().position(|&byte| byte == b'\n') {
                    Some(end) => (end + 1, true),
                    None => (bytes.len(), false),
                },
            };
            self.source.consume(used);
            if done {
                return;
            }
        }
    }
}
