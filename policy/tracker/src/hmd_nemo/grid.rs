//! From the tracker's ticks to the network's steps of 1/60 s, and back.
//!
//! A step made at a tick's own time answers that tick. At other rates steps are made on a 60 Hz grid
//! with inputs interpolated between ticks, and the answers become one smooth motion that comes a
//! step later.

use posed_signal::HostTime;

use super::{
    features::{Builder, Seen},
    mirror::Pair,
    network::Answer,
};
use crate::{
    carry::Carry,
    steps::{GAP_NS, due, steps_between},
};

/// What is carried from tick to tick.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Grid {
    /// The last tick and what was seen at it.
    tick: Option<(HostTime, Seen)>,
    /// The last step, what was seen and what was answered.
    step: Option<(HostTime, Seen, Answer)>,
    /// The answer of the step before.
    earlier: Option<Answer>,
    /// The motion shown between steps, and when its curve began.
    carry: Option<(HostTime, Carry)>,
}

impl Grid {
    /// Takes the tick at `now` and makes the steps that are due. The answer at `now`; `None` while
    /// the network gives none.
    pub(super) fn advance(
        &mut self,
        now: HostTime,
        seen: &Seen,
        height: f32,
        network: &mut Pair,
    ) -> Option<Answer> {
        let gap = self
            .tick
            .is_none_or(|(last, _)| now.since_ns(last) > GAP_NS);
        if gap {
            *self = Self::default();
            network.reset();
        }
        let last_tick = self.tick.replace((now, *seen)).unwrap_or((now, *seen));
        let last_step = self.step.map(|(at, ..)| at);
        while let Some(at) = due(self.step.map(|(at, ..)| at), now) {
            let there = if at == now {
                *seen
            } else {
                between(&last_tick, now, seen, at)
            };
            let before = self.step.as_ref().map(|(_, seen, _)| seen);
            let since = self.step.map_or(0, |(last, ..)| at.since_ns(last));
            let features = Builder::new(&there, before, since as f32 * 1e-9, height);
            let visible = there.hands.map(|hand| hand.is_some());
            let Some(answer) = network.run(&features, visible) else {
                *self = Self::default();
                return None;
            };
            self.earlier = self.step.map(|(.., answer)| answer);
            self.step = Some((at, there, answer));
        }
        // A tick between steps means that the motion has to be carried from here on.
        let between_steps = last_step.is_some_and(|at| last_tick.0 > at)
            || self.step.is_some_and(|(at, ..)| now > at);
        if !between_steps {
            self.carry = None;
        } else if self.step.map(|(at, ..)| at) != last_step || self.carry.is_none() {
            self.lead_over(now);
        }
        let (.., mut answer) = self.step?;
        if let Some((since, carry)) = &self.carry {
            answer.rotations = carry.at(steps_between(*since, now));
        }
        Some(answer)
    }

    /// Starts a new curve at `now` towards where the last two steps lead.
    fn lead_over(&mut self, now: HostTime) {
        let (Some((at, _, last)), Some(earlier)) = (self.step, self.earlier) else {
            return;
        };
        let ahead = steps_between(at, now);
        let shown = self
            .carry
            .as_ref()
            .map(|(since, carry)| (carry, steps_between(*since, now)));
        let carry = Carry::new(shown, &earlier.rotations, &last.rotations, ahead);
        self.carry = Some((now, carry));
    }

    /// Forgets everything.
    pub(super) fn reset(&mut self) {
        *self = Self::default();
    }
}

fn between(last: &(HostTime, Seen), now: HostTime, seen: &Seen, at: HostTime) -> Seen {
    let span = now.since_ns(last.0).max(1) as f32;
    let fraction = (at.since_ns(last.0) as f32 / span).clamp(0.0, 1.0);
    last.1.interpolate(seen, fraction)
}
