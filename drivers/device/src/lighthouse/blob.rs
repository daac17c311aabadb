//! The configuration that a device keeps for its driver: zlib'd JSON, read in pieces through the
//! feature reports 0x10 (start) and 0x11 (next piece, until an empty one).

use std::io::Read as _;

use flate2::read::ZlibDecoder;

use super::wire::{Fields, id};
use crate::decode::DecodeError;

/// Pieces hold 62 bytes at most; real configurations are 1 to 4 KB.
const BLOB_BYTES_MAX: usize = 64 * 1024;
/// What inflates to more is not a configuration; real ones are about 10 KB.
const TEXT_BYTES_MAX: u64 = 1024 * 1024;

/// Puts the pieces together.
#[derive(Debug, Clone, Default)]
pub(super) struct BlobReader {
    bytes: Vec<u8>,
    reading: bool,
}

impl BlobReader {
    /// The device answered to 0x10: pieces follow. It answers with an empty packet while it is
    /// not ready.
    pub(super) fn start(&mut self, answer: &[u8]) {
        if !answer.is_empty() {
            self.bytes.clear();
            self.reading = true;
        }
    }

    /// The device answered to 0x11. The JSON text when this was the last piece.
    ///
    /// # Errors
    /// The piece is torn, or the whole is not zlib'd text of a sensible size.
    pub(super) fn piece(&mut self, answer: &[u8]) -> Result<Option<String>, DecodeError> {
        let [_, data @ ..] = answer else {
            return Ok(None);
        };
        if !self.reading {
            return Ok(None);
        }
        let mut fields = Fields::new(id::CONFIGURATION_READ, data);
        let count = fields.u8()?;
        if count == 0 {
            self.reading = false;
            return inflate(&self.bytes).map(Some);
        }
        let piece = fields.slice(usize::from(count));
        match piece {
            Ok(piece) if self.bytes.len() + piece.len() <= BLOB_BYTES_MAX => {
                self.bytes.extend_from_slice(piece);
                Ok(None)
            }
            Ok(_) => {
                self.reading = false;
                Err(fields.malformed("the configuration does not end"))
            }
            Err(error) => {
                self.reading = false;
                Err(error)
            }
        }
    }
}

fn inflate(bytes: &[u8]) -> Result<String, DecodeError> {
    let error = |what: String| DecodeError::Configuration(what);
    let mut text = String::new();
    let read = ZlibDecoder::new(bytes)
        .take(TEXT_BYTES_MAX + 1)
        .read_to_string(&mut text)
        .map_err(|cause| error(format!("{} bytes do not inflate: {cause}", bytes.len())))?;
    if read as u64 > TEXT_BYTES_MAX {
        return Err(error(format!(
            "it inflates to more than {TEXT_BYTES_MAX} bytes"
        )));
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    use std::io::Write as _;

    use flate2::{Compression, write::ZlibEncoder};
    use proptest::prelude::*;

    use super::*;

    fn zlib(text: &[u8]) -> Vec<u8> {
        let mut encoder = ZlibEncoder::new(Vec::new(), Compression::best());
        encoder.write_all(text).unwrap();
        encoder.finish().unwrap()
    }

    fn answers(blob: &[u8]) -> Vec<Vec<u8>> {
        let piece = |chunk: &[u8]| [&[0x11, chunk.len() as u8], chunk].concat();
        blob.chunks(62).map(piece).chain([vec![0x11, 0]]).collect()
    }

    fn read(answers: &[Vec<u8>]) -> Result<Option<String>, DecodeError> {
        let mut reader = BlobReader::default();
        reader.start(&[0x10, 6]);
        let mut text = None;
        for answer in answers {
            text = text.or(reader.piece(answer)?);
        }
        Ok(text)
    }

    #[test]
    fn pieces_become_text() {
        let text = r#"{"device_class":"hmd"}"#.repeat(40);
        assert_eq!(
            read(&answers(&zlib(text.as_bytes()))).unwrap(),
            Some(text.clone())
        );
        let mut stalled = answers(&zlib(text.as_bytes()));
        stalled.insert(1, Vec::new());
        assert_eq!(
            read(&stalled).unwrap(),
            Some(text),
            "a stalled read is tried again"
        );
    }

    #[test]
    fn pieces_without_a_start_are_nothing() {
        assert_eq!(BlobReader::default().piece(&[0x11, 1, 2]), Ok(None));
        let mut reader = BlobReader::default();
        reader.start(&[]);
        assert_eq!(reader.piece(&[0x11, 0]), Ok(None));
    }

    #[test]
    fn a_bomb_is_refused() {
        let bomb = zlib(&vec![b' '; 2 << 20]);
        let error = read(&answers(&bomb)).unwrap_err().to_string();
        assert!(error.contains("inflates to more"), "{error}");
    }

    #[test]
    fn a_blob_without_an_end_is_refused() {
        let endless = vec![vec![0x11; 64]; 4_000];
        assert!(read(&endless).is_err());
    }

    proptest! {
        #[test]
        fn any_answers_are_survived(
            answers in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..66), 0..20)
        ) {
            let mut reader = BlobReader::default();
            for answer in answers {
                if answer.first() == Some(&0x10) { reader.start(&answer) }
                let _ = reader.piece(&answer);
            }
        }
    }
}
