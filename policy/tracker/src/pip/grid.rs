//! From the tracker's ticks to steps of 1/60 s, and back.

use glam::Vec3;
use posed_body::BodyPose;
use posed_signal::HostTime;

use super::{
    dynamics::Dynamics,
    features::{leaves, stance},
    network::Step,
    sensors::Seen,
};
use crate::{
    carry::{Carry, Curve},
    steps::{GAP_NS, due, steps_between},
    tracker::{Forces, Wearer},
};

/// What is carried from tick to tick.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Grid {
    /// The last tick and what was heard at it.
    tick: Option<(HostTime, Seen)>,
    /// The last step and its pose.
    step: Option<(HostTime, BodyPose)>,
    /// The pose of the step before.
    earlier: Option<BodyPose>,
    forces: Option<Forces>,
    contact: [f32; 2],
    /// The motion shown between steps, and when its curves began.
    carry: Option<(HostTime, Carry, Curve<Vec3>)>,
}

/// What a tick gives to the grid.
pub(super) struct Tick<'a> {
    pub now: HostTime,
    pub seen: Seen,
    pub wearer: &'a Wearer,
    /// The head joint's position where a headset tells it.
    pub head: Option<Vec3>,
    /// The wearer's pose when the memory begins, if it is known.
    pub known: Option<BodyPose>,
}

impl Grid {
    /// Makes the steps that are due and gives the pose at the tick; `None` while there is none.
    pub(super) fn advance(
        &mut self,
        tick: &Tick<'_>,
        network: &mut Step,
        body: &mut Dynamics,
    ) -> Option<BodyPose> {
        let now = tick.now;
        if self
            .tick
            .is_none_or(|(last, _)| now.since_ns(last) > GAP_NS)
        {
            self.begin(tick, network, body);
        }
        let last_tick = self
            .tick
            .replace((now, tick.seen))
            .unwrap_or((now, tick.seen));
        let last_step = self.step.map(|(at, _)| at);
        let height = tick.wearer.skeleton.head_height().max(0.1);
        while let Some(at) = due(self.step.map(|(at, _)| at), now) {
            let seen = between(&last_tick, tick, at);
            let Some(answer) = network.run(&seen, height) else {
                *self = Self::default();
                return None;
            };
            let first = tick.known.map(|pose| pose.root);
            let (pose, forces) = body.step(&answer, first, tick.head);
            self.earlier = self.step.map(|(_, pose)| pose);
            self.step = Some((at, pose));
            (self.forces, self.contact) = (forces, answer.contact);
        }
        self.shown(now, last_tick.0, last_step)
    }

    /// Torques and ground forces of the last step.
    pub(super) fn forces(&self) -> Option<Forces> {
        self.forces
    }

    /// Probabilities of the last step that the left and the right foot stand.
    pub(super) fn contact(&self) -> Option<[f32; 2]> {
        self.step.map(|_| self.contact)
    }

    /// Forgets everything.
    pub(super) fn reset(&mut self) {
        *self = Self::default();
    }

    fn begin(&mut self, tick: &Tick<'_>, network: &mut Step, body: &mut Dynamics) {
        *self = Self::default();
        let skeleton = &tick.wearer.skeleton;
        let first = tick.known.unwrap_or_else(|| stance(&tick.seen, skeleton));
        let height = skeleton.head_height().max(0.1);
        network.begin(leaves(&first, skeleton, height));
        body.reset();
    }

    fn shown(
        &mut self,
        now: HostTime,
        last_tick: HostTime,
        last_step: Option<HostTime>,
    ) -> Option<BodyPose> {
        let (at, last) = self.step?;
        // A tick between steps means that the motion has to be carried from here on.
        let between_steps = last_step.is_some_and(|at| last_tick > at) || now > at;
        if !between_steps {
            self.carry = None;
        } else if Some(at) != last_step || self.carry.is_none() {
            self.lead_over(now, at, &last);
        }
        let mut pose = last;
        if let Some((since, turns, root)) = &self.carry {
            let passed = steps_between(*since, now);
            pose.rotations = turns.at(passed);
            pose.root = root.at(passed);
        }
        Some(pose)
    }

    /// Starts new curves at `now` towards where the last two steps lead.
    fn lead_over(&mut self, now: HostTime, at: HostTime, last: &BodyPose) {
        let Some(earlier) = &self.earlier else { return };
        let ahead = steps_between(at, now);
        let shown = self
            .carry
            .as_ref()
            .map(|(since, turns, root)| (turns, root, steps_between(*since, now)));
        let turns = Carry::new(
            shown.map(|(turns, _, passed)| (turns, passed)),
            &earlier.rotations,
            &last.rotations,
            ahead,
        );
        let root = Curve::new(
            shown.map(|(_, root, passed)| (root.at(passed), root.rate(passed))),
            earlier.root,
            last.root,
            ahead,
        );
        self.carry = Some((now, turns, root));
    }
}

/// What was heard at the time of a step between two ticks.
fn between(last: &(HostTime, Seen), tick: &Tick<'_>, at: HostTime) -> Seen {
    if at == tick.now {
        return tick.seen;
    }
    let span = tick.now.since_ns(last.0).max(1) as f32;
    let fraction = (at.since_ns(last.0) as f32 / span).clamp(0.0, 1.0);
    last.1.interpolate(&tick.seen, fraction)
}
