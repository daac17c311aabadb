//! Bytes of a capture, inflated on the way if they are gzip'd.

use std::{
    io::{self, BufRead, BufReader, Read},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
};

use flate2::bufread::GzDecoder;

use super::Warning;

/// What an inflating read asks for at once. When the stream turns out to be damaged, flate2 loses
/// what it had made for that one call: small calls lose little.
const INFLATE_BYTES: usize = 1_024;
/// Bytes that the format is told by.
const PREFIX_BYTES: usize = 1_024;

/// How every gzip stream begins.
const GZIP_MAGIC: [u8; 2] = [0x1f, 0x8b];

type Input<'a> = Box<dyn Read + Send + 'a>;

/// How far the reading has come, seen from outside the [`Source`]; its owner is a parser that
/// does not pass errors on.
#[derive(Debug, Clone, Default)]
pub(super) struct Progress(Arc<AtomicU64>);

impl Progress {
    /// Bytes of the file, as it lies there, taken so far.
    pub(super) fn bytes(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

/// A buffered reader that counts what is taken from it.
struct Counted<'a> {
    inner: BufReader<Input<'a>>,
    taken: Progress,
}

impl Read for Counted<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.inner.read(buffer)?;
        self.taken.0.fetch_add(count as u64, Ordering::Relaxed);
        Ok(count)
    }
}

impl BufRead for Counted<'_> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        self.inner.fill_buf()
    }

    fn consume(&mut self, count: usize) {
        self.inner.consume(count);
        self.taken.0.fetch_add(count as u64, Ordering::Relaxed);
    }
}

enum Stream<'a> {
    Plain(Counted<'a>),
    Gzip(GzDecoder<Counted<'a>>),
}

/// A capture's content. Reading never fails: at damage it ends, and [`Fault`] says why.
pub(super) struct Source<'a> {
    stream: Stream<'a>,
    /// The first bytes of the content, not yet handed out.
    prefix: io::Cursor<Vec<u8>>,
    progress: Progress,
    fault: Fault,
    /// Where a further gzip stream should begin of which nothing has come yet.
    follows_at: Option<u64>,
    ended: bool,
}

/// Why a source ended before its time, if it did.
#[derive(Debug, Clone, Default)]
pub(super) struct Fault(Arc<std::sync::OnceLock<Warning>>);

impl Fault {
    pub(super) fn warning(&self) -> Option<Warning> {
        self.0.get().cloned()
    }

    fn set(&self, warning: Warning) {
        // A source ends at its first fault, so there is no second one to lose.
        let _ = self.0.set(warning);
    }
}

impl<'a> Source<'a> {
    /// Looks at the first bytes of `input` to find out whether it is gzip'd.
    ///
    /// # Errors
    /// Not even the first bytes can be read.
    pub(super) fn new(mut input: Input<'a>) -> io::Result<Self> {
        let magic = read_up_to(&mut input, 2)?;
        let gzip = magic == GZIP_MAGIC;
        let progress = Progress::default();
        let whole: Input<'a> = Box::new(io::Cursor::new(magic).chain(input));
        let counted = Counted {
            inner: BufReader::new(whole),
            taken: progress.clone(),
        };
        let stream = if gzip {
            Stream::Gzip(GzDecoder::new(counted))
        } else {
            Stream::Plain(counted)
        };
        let prefix = io::Cursor::default();
        let mut source = Self {
            stream,
            prefix,
            progress,
            fault: Fault::default(),
            follows_at: None,
            ended: false,
        };
        let mut prefix = vec![0; PREFIX_BYTES];
        let count = source.fill(&mut prefix);
        prefix.truncate(count);
        source.prefix = io::Cursor::new(prefix);
        Ok(source)
    }

    /// The first bytes of the content, up to [`PREFIX_BYTES`].
    pub(super) fn prefix(&self) -> &[u8] {
        self.prefix.get_ref()
    }

    pub(super) fn progress(&self) -> Progress {
        self.progress.clone()
    }

    pub(super) fn fault(&self) -> Fault {
        self.fault.clone()
    }

    /// Fills `buffer` as far as the content goes.
    fn fill(&mut self, buffer: &mut [u8]) -> usize {
        let mut filled = 0;
        while filled < buffer.len() && !self.ended {
            let rest = &mut buffer[filled..];
            let result = match &mut self.stream {
                Stream::Plain(stream) => stream.read(rest),
                Stream::Gzip(stream) => {
                    let length = rest.len().min(INFLATE_BYTES);
                    stream.read(&mut rest[..length])
                }
            };
            match result {
                Ok(0) => self.end_of_stream(),
                Ok(count) => {
                    self.follows_at = None;
                    filled += count;
                }
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => self.end_at_fault(error.kind()),
            }
        }
        filled
    }

    /// A gzip file may be several streams, one behind the other, with zeros as padding.
    fn end_of_stream(&mut self) {
        self.ended = true;
        let Stream::Gzip(stream) = &mut self.stream else {
            return;
        };
        let counted = stream.get_mut();
        let more = loop {
            let zeros = match counted.fill_buf() {
                Ok([]) | Err(_) => break false,
                Ok(bytes) => bytes.iter().take_while(|&&byte| byte == 0).count(),
            };
            if zeros == 0 {
                break true;
            }
            counted.consume(zeros);
        };
        if more {
            let empty: Input<'_> = Box::new(io::empty());
            let nothing = Counted {
                inner: BufReader::new(empty),
                taken: counted.taken.clone(),
            };
            let rest = std::mem::replace(counted, nothing);
            // A decoder reads its header as soon as it is made.
            self.follows_at = Some(self.progress.bytes());
            self.stream = Stream::Gzip(GzDecoder::new(rest));
            self.ended = false;
        }
    }

    fn end_at_fault(&mut self, kind: io::ErrorKind) {
        let at_byte = self.progress.bytes();
        self.ended = true;
        // What did not even begin as another stream is none.
        if let Some(at_byte) = self.follows_at {
            return self.fault.set(Warning::TrailingBytes { at_byte });
        }
        self.fault.set(match kind {
            io::ErrorKind::UnexpectedEof => Warning::CutOff { at_byte },
            io::ErrorKind::InvalidInput | io::ErrorKind::InvalidData => {
                Warning::Corrupt { at_byte }
            }
            kind => Warning::Unreadable { at_byte, kind },
        });
    }
}

impl Read for Source<'_> {
    /// Fills the whole buffer unless the content ends: parsers may rely on it.
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let before = self.prefix.read(buffer)?;
        Ok(before + self.fill(&mut buffer[before..]))
    }
}

fn read_up_to(input: &mut impl Read, count: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    input.by_ref().take(count).read_to_end(&mut bytes)?;
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use flate2::{Compression, write::GzEncoder};

    use super::*;

    fn gzip(content: &[u8]) -> Vec<u8> {
        let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
        encoder.write_all(content).unwrap();
        encoder.finish().unwrap()
    }

    fn read_all(bytes: &[u8]) -> (Vec<u8>, Option<Warning>) {
        let mut source = Source::new(Box::new(bytes)).unwrap();
        let mut content = Vec::new();
        source.read_to_end(&mut content).unwrap();
        (content, source.fault().warning())
    }

    fn noise(length: usize) -> Vec<u8> {
        let mut state = 1u32;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 27) as u8
        };
        (0..length).map(|_| next()).collect()
    }

    #[test]
    fn plain_and_gzip_give_the_same_content() {
        let content = noise(10_000);
        assert_eq!(read_all(&content), (content.clone(), None));
        assert_eq!(read_all(&gzip(&content)), (content.clone(), None));
        let two_members = [gzip(&content), gzip(b"more")].concat();
        assert_eq!(
            read_all(&two_members),
            ([content, b"more".to_vec()].concat(), None)
        );
    }

    #[test]
    fn bytes_behind_a_complete_stream_are_left_alone() {
        let whole = gzip(b"content");
        let padded = [&whole[..], &[0; 20]].concat();
        assert_eq!(read_all(&padded), (b"content".to_vec(), None));
        let trailing = Warning::TrailingBytes {
            at_byte: whole.len() as u64,
        };
        let followed = [&whole[..], b"something"].concat();
        assert_eq!(read_all(&followed), (b"content".to_vec(), Some(trailing)));
    }

    #[test]
    fn a_cut_stream_is_read_up_to_the_cut() {
        let content = noise(100_000);
        let whole = gzip(&content);
        let cut = &whole[..whole.len() / 2];
        let (read, warning) = read_all(cut);
        assert_eq!(
            warning,
            Some(Warning::CutOff {
                at_byte: cut.len() as u64
            })
        );
        assert!(content.starts_with(&read));
        assert!(read.len() > 40_000, "only {} bytes were read", read.len());
    }

    #[test]
    fn a_corrupt_stream_is_read_up_to_the_damage() {
        let content = noise(100_000);
        let mut whole = gzip(&content);
        let middle = whole.len() / 2;
        whole[middle..middle + 64].fill(0xff);
        let (read, warning) = read_all(&whole);
        let Some(Warning::Corrupt { at_byte }) = warning else {
            panic!("{warning:?}")
        };
        assert!(at_byte >= middle as u64);
        let good = read
            .iter()
            .zip(&content)
            .take_while(|(a, b)| a == b)
            .count();
        assert!(good > 40_000, "only {good} bytes were read");
    }

    #[test]
    fn empty_and_tiny_files_are_just_short() {
        assert_eq!(read_all(b""), (Vec::new(), None));
        assert_eq!(read_all(b"x"), (b"x".to_vec(), None));
        assert_eq!(
            read_all(&[0x1f, 0x8b]).1,
            Some(Warning::CutOff { at_byte: 2 })
        );
    }
}
