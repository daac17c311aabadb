//! The integration tests of posed, in one binary so that they link once.

mod allocation;
mod body;
mod captures;
mod demo;
mod layering;
mod naming;
mod pip;
mod questsim;
mod shared;
mod sitting;
mod stage;
mod tidy;
mod trackers;
