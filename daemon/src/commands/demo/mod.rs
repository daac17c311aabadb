//! `posed demo`.

pub mod figure;
