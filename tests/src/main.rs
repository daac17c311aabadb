//! The integration tests of posed, in one binary so that they link once.

mod allocation;
mod layering;
mod shared;
mod tidy;
