//! The integration tests of posed, in one binary so that they link once.

mod layering;
mod shared;
mod tidy;
