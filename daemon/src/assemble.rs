//! Where the parts are put together: one function for live, replay and tests.

use posed_device::{
    rig::{self, Rig},
    transport::Transport,
};
use posed_signal::{latest::latest, ring::ring};
use posed_tracker::{Tracker, TrackerKind};

use crate::{
    control::Requests,
    heights::Heights,
    pipeline::{
        source::Source,
        tracking::{Inputs, Setup, TrackerLoop},
    },
};

/// Requests that may wait for the tracker's next tick.
const REQUESTS_MAX: usize = 64;
/// Buzzes that may wait for the thread that owns the devices.
const BUZZES_MAX: usize = 16;

/// What the parts are told.
pub struct Options {
    /// For the devices.
    pub rig: rig::Settings,
    /// Trackers that can be chosen besides `ik`.
    pub trackers: Vec<Box<dyn Tracker>>,
    /// The tracker to begin with.
    pub tracker: TrackerKind,
    /// How tall the wearer is, and the body shown.
    pub heights: Heights,
    /// Whether the wearer's first seconds upright tell the height.
    pub measure_height: bool,
    /// How far beyond the tick poses are made for, ns.
    pub horizon_ns: i64,
}

impl Options {
    /// The trackers that can be chosen.
    #[must_use]
    pub fn choices(&self) -> Vec<TrackerKind> {
        let mut kinds: Vec<_> = self.trackers.iter().map(|tracker| tracker.kind()).collect();
        if !kinds.contains(&TrackerKind::Ik) {
            kinds.push(TrackerKind::Ik);
        }
        kinds
    }
}

impl Default for Options {
    fn default() -> Self {
        Self {
            rig: rig::Settings::default(),
            trackers: Vec::new(),
            tracker: TrackerKind::Ik,
            heights: Heights::of(1.75),
            measure_height: false,
            horizon_ns: 0,
        }
    }
}

/// The parts, joined.
pub struct Assembly {
    /// Transport and rig: one thread's.
    pub source: Source,
    /// The tracker loop: another's.
    pub tracker: TrackerLoop,
    /// The ways of requests to both.
    pub requests: Requests,
}

/// Joins a transport, a rig and a tracker loop.
#[must_use]
pub fn assemble(transport: Box<dyn Transport>, options: Options) -> Assembly {
    let setup = Setup {
        trackers: options.trackers,
        choice: options.tracker,
        heights: options.heights,
        measure_height: options.measure_height,
        wearer: options.heights.body(),
        horizon_ns: options.horizon_ns,
    };
    assemble_with(transport, options.rig, setup)
}

/// Joins a transport, a rig and a tracker loop that goes on with what another one had.
#[must_use]
pub fn assemble_with(transport: Box<dyn Transport>, rig: rig::Settings, setup: Setup) -> Assembly {
    let (rig, rings) = Rig::new(rig);
    let (roles_writer, roles) = latest();
    let (requests, requests_in) = ring(REQUESTS_MAX);
    let (buzzes, buzzes_in) = ring(BUZZES_MAX);
    let inputs = Inputs {
        rings,
        roles,
        requests: requests_in,
    };
    Assembly {
        source: Source::new(transport, rig, roles_writer, buzzes_in),
        tracker: TrackerLoop::new(inputs, setup),
        requests: Requests {
            tracker: requests,
            buzzes,
        },
    }
}
