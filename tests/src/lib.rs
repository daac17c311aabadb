//! Holds nothing: the tests are one binary, `src/main.rs`.
