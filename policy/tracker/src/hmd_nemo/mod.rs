//! HMD-NeMo (Aliakbarian et al. 2023): a recurrent network that makes the whole body from the
//! headset and the hands, seen or not.
//!
//! Each tick the parts are taken as they are ([`features`]), the network makes its steps of 1/60 s
//! ([`grid`], [`network`]), and its answer is moved to meet headset and hands ([`refine`]). `ik`
//! runs beside it: it stands in while there is no head or no answer, and both fade into each other.

mod features;
mod grid;
mod mirror;
mod network;
mod plant;
mod refine;

use posed_body::{BodyPose, Skeleton};
use posed_signal::{HostTime, Role};

use crate::{
    fade::{Place, TakeOver},
    geometry::is_human,
    ik::Ik,
    inference::{InferenceError, Runtime},
    presence::{Hand, Head, HeadState, Sensed, quality},
    tracker::{Input, Tracked, Tracker, TrackerKind},
};
use features::Seen;
use grid::Grid;
use mirror::Pair;
use network::Step;
use plant::Feet;
use refine::Draft;

pub use refine::Energy;

/// A lost hand is where the network puts it after this time, seconds.
const LEAVE_S: f32 = 0.3;
/// A returning one is where it is measured after this time, seconds.
const RETURN_S: f32 = 0.2;
/// A network that starts from nothing while a pose is already shown settles for so long before it
/// takes over, seconds.
const WARM_S: f32 = 0.15;
/// A longer gap between ticks counts as this long, seconds.
const GAP_MAX: f32 = 0.5;

/// How the tracker works; the default is what ships.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Options {
    /// Whether the answer is moved to meet headset and hands, standing feet are kept in place and
    /// the pelvis stays above the floor; otherwise it only hangs from the head joint.
    pub refine: bool,
    /// How hands are met.
    pub energy: Energy,
    /// Whether the network is asked of the mirror image too: smoother and more accurate, for
    /// twice the inference.
    pub mirror: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            refine: true,
            energy: Energy::Plain,
            mirror: true,
        }
    }
}

/// The tracker.
pub struct HmdNemo {
    network: Pair,
    grid: Grid,
    options: Options,
    ik: Ik,
    head: Head,
    hands: [Hand; 2],
    last: Option<HostTime>,
    shown: TakeOver,
    contact: [f32; 4],
    feet: Feet,
    /// Seconds since the network started from nothing.
    warm_s: f32,
}

impl HmdNemo {
    /// Loads the model `bytes`; `name` is for errors.
    ///
    /// # Errors
    /// The bytes are no model, or one with other inputs and outputs than this program's.
    pub fn load(
        runtime: &Runtime,
        name: &str,
        bytes: &[u8],
        options: Options,
    ) -> Result<Self, InferenceError> {
        let step = Step::load(runtime, name, bytes)?;
        Ok(Self {
            network: Pair::new(step, options.mirror),
            grid: Grid::default(),
            options,
            ik: Ik::default(),
            head: Head::NEW,
            hands: [Hand::new(LEAVE_S, RETURN_S); 2],
            last: None,
            shown: TakeOver::NONE,
            contact: [0.0; 4],
            feet: Feet::default(),
            warm_s: WARM_S,
        })
    }

    /// Probabilities of the last tick that the ankles (left, right) and toes (left, right) stand.
    #[must_use]
    pub fn contact(&self) -> [f32; 4] {
        self.contact
    }

    /// The network's pose at `now`, refined; `None` while it has none.
    fn predict(
        &mut self,
        now: HostTime,
        head: &Place,
        hands: [Option<Sensed>; 2],
        skeleton: &Skeleton,
        dt: f32,
    ) -> Option<BodyPose> {
        let seen = Seen {
            head: *head,
            hands: hands.map(|hand| Some(hand?.place)),
        };
        let height = skeleton.head_height().max(0.1);
        let Some(answer) = self.grid.advance(now, &seen, height, &mut self.network) else {
            self.warm_s = 0.0;
            self.feet.reset();
            return None;
        };
        self.contact = answer.contact;
        let mut draft = Draft::new(answer.rotations, head, skeleton);
        if self.options.refine {
            draft.clear_floor();
            draft.meet_head(head);
            self.feet.keep(&mut draft, answer.contact, dt);
            for side in 0..2 {
                let base = draft.shoulder(side);
                let otherwise = draft.wrist(side).into_frame(&base);
                let goal = self.hands[side].update(hands[side], &base, &otherwise, dt);
                draft.meet_hand(side, &goal, self.options.energy);
            }
        }
        let pose = *draft.pose();
        pose.is_sound().then_some(pose)
    }
}

impl Tracker for HmdNemo {
    fn kind(&self) -> TrackerKind {
        TrackerKind::HmdNemo
    }

    fn reset(&mut self) {
        self.network.reset();
        self.grid.reset();
        self.ik.reset();
        self.feet.reset();
        self.head = Head::NEW;
        self.hands = [Hand::new(LEAVE_S, RETURN_S); 2];
        (self.last, self.shown) = (None, TakeOver::NONE);
        self.warm_s = WARM_S;
    }

    fn track(&mut self, input: &Input<'_>) -> Tracked {
        let dt = self
            .last
            .map_or(0.0, |last| input.target.since_secs(last) as f32);
        self.last = Some(input.target);
        let dt = dt.clamp(0.0, GAP_MAX);
        let stand_in = self.ik.track(input);
        let sensed = |role| Sensed::from_lookup(&input.part(role));
        // A hand whose position is only held or guessed is no measurement to the network.
        let hands =
            [Role::LeftHand, Role::RightHand].map(|role| sensed(role).filter(|hand| hand.solid));
        let skeleton = &input.wearer.skeleton;
        let (head, state) = self
            .head
            .update(sensed(Role::Head), dt, skeleton.head_height());
        let predicted = match state {
            HeadState::Held => {
                self.grid.reset();
                self.feet.reset();
                self.warm_s = 0.0;
                None
            }
            _ if !is_human(skeleton) => None,
            _ => self.predict(input.target, &head, hands, skeleton, dt),
        };
        self.warm_s += dt;
        let predicted = predicted.filter(|_| self.warm_s >= WARM_S);
        let kind = if predicted.is_some() {
            TrackerKind::HmdNemo
        } else {
            stand_in.kind
        };
        let pose = self
            .shown
            .show(&predicted.unwrap_or(stand_in.pose), kind, skeleton, dt);
        Tracked {
            pose,
            quality: quality(state, hands),
            kind,
            forces: None,
        }
    }

    /// A foot stands while its heel or its toes do.
    fn contacts(&self) -> Option<[f32; 2]> {
        let by = self.shown.by()?;
        let [left, right, left_toe, right_toe] = self.contact;
        (by == TrackerKind::HmdNemo).then_some([left.max(left_toe), right.max(right_toe)])
    }
}

#[cfg(test)]
mod tests;
