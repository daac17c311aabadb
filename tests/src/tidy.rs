//! What a reader may count on in every source file.

use crate::layering::sources;

/// Longer files are no rooms that a reader can name.
const FILE_LINES_MAX: usize = 800;

#[test]
fn files_are_short() {
    for (path, text) in sources() {
        let lines = text.lines().count();
        assert!(lines <= FILE_LINES_MAX, "{path} has {lines} lines");
    }
}

#[test]
fn lines_fit_and_nothing_is_left_to_do() {
    for (path, text) in sources() {
        for (number, line) in text.lines().enumerate() {
            let place = format!("{path}:{}", number + 1);
            assert!(
                line.chars().count() <= 110,
                "{place} is longer than 110 columns"
            );
            if path != "tests/src/tidy.rs" {
                for mark in ["TODO", "FIXME", "unimplemented!(", "todo!("] {
                    assert!(!line.contains(mark), "{place} holds {mark}");
                }
            }
        }
    }
}
