//! What the person does, in order.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use super::person::{HandTrack, Person};
use super::steps::Spot;
use super::track::Random;
use crate::skeleton::Skeleton;

/// Hands in front of the waist, as with controllers in them: x outward, y and z from the shoulder
/// (metres at the reference stature), then the wrist's turns (rad).
pub(super) const HANDS_READY: [f64; 6] = [-0.02, -0.30, -0.24, 0.0, 0.0, 0.0];
/// Hands beside the body, for walking.
const HANDS_DOWN: [f64; 6] = [0.08, -0.42, -0.10, 0.0, 0.0, 0.0];
/// A hand beside the head, about to wave.
const HAND_UP: [f64; 6] = [0.17, 0.22, -0.20, 0.3, 0.0, 0.1];
/// A hand stretched out forward, upward, down.
const REACH_FORWARD: [f64; 6] = [0.0, -0.06, -0.44, 0.0, 0.1, 0.0];
const REACH_HIGH: [f64; 6] = [0.06, 0.32, -0.28, 0.0, -0.2, 0.1];
const REACH_DOWN: [f64; 6] = [0.0, -0.38, -0.22, 0.0, 0.0, 0.2];
/// Both hands out to the sides.
const ARMS_OUT: [f64; 6] = [0.40, -0.08, -0.14, 0.2, 0.0, 0.0];

/// A person with a growing list of things to do.
struct Director<'a> {
    person: Person,
    random: &'a mut Random,
    /// When the next thing begins, seconds.
    now: f64,
}

/// The whole timeline, and its duration in seconds.
pub(super) fn everything(skeleton: &Skeleton, random: &mut Random) -> (Person, f64) {
    let start = Spot {
        x: 0.0,
        z: 0.7,
        heading: 0.0,
    };
    let person = Person::new(skeleton, start, random);
    let mut director = Director {
        person,
        random,
        now: 0.0,
    };
    director.wait(1.2);
    director.look_around();
    director.walk_to(0.0, -0.7);
    director.wave(false, 3);
    director.turn_to(FRAC_PI_2);
    director.walk_to(-0.8, -0.7);
    director.squat();
    director.walk_around(1.15 * PI, -0.6, 0.4, -1.3, 0.2);
    director.reach(true, REACH_HIGH);
    director.reach(false, REACH_FORWARD);
    director.turn_to(1.5 * PI);
    director.walk_to(0.5, 0.4);
    director.arms_out();
    director.turn_to(TAU);
    director.wait(0.8);
    let duration = director.now;
    (director.person, duration)
}

impl Director<'_> {
    /// A duration of about this many seconds; tall people are slower.
    fn about(&mut self, seconds: f64) -> f64 {
        seconds * self.random.between(0.9, 1.15) * self.person.build.scale.sqrt()
    }

    fn wait(&mut self, seconds: f64) {
        self.now += self.about(seconds);
    }

    /// Moves both hands from now on, within `seconds`.
    fn hands(&mut self, seconds: f64, target: [f64; 6]) {
        let end = self.now + seconds;
        self.person.left_hand.to(self.now, end, target);
        self.person.right_hand.to(self.now, end, target);
    }

    fn hand(&mut self, left: bool) -> &mut HandTrack {
        if left {
            &mut self.person.left_hand
        } else {
            &mut self.person.right_hand
        }
    }

    fn look_around(&mut self) {
        for target in [[0.7, 0.05, 0.15], [-0.75, -0.1, -0.2], [0.0; 3]] {
            let duration = self.about(0.8);
            self.person.gaze.to(self.now, self.now + duration, target);
            self.now += duration + 0.1;
        }
    }

    fn walk_to(&mut self, x: f64, z: f64) {
        let from = self.person.walk.last();
        let to = Spot { x, z, ..from };
        self.walk(None, to);
    }

    /// To a place and a heading, on a curve that is drawn towards another place.
    fn walk_around(&mut self, heading: f64, x: f64, z: f64, via_x: f64, via_z: f64) {
        let to = Spot { x, z, heading };
        let via = Spot {
            x: via_x,
            z: via_z,
            heading,
        };
        self.walk(Some(via), to);
    }

    fn walk(&mut self, via: Option<Spot>, to: Spot) {
        self.hands(0.8, HANDS_DOWN);
        self.now = self.person.walk.go(self.now + 0.15, via, to);
        self.hands(0.7, HANDS_READY);
        self.now += 0.3;
    }

    /// Turns to a heading on the spot, the eyes first.
    fn turn_to(&mut self, heading: f64) {
        let from = self.person.walk.last();
        let to = Spot { heading, ..from };
        let ahead = (heading - from.heading).clamp(-0.6, 0.6);
        self.person
            .gaze
            .to(self.now, self.now + 0.5, [ahead, 0.0, 0.4 * ahead]);
        let settled = self.person.walk.go(self.now + 0.15, None, to);
        self.person.gaze.to(settled - 1.0, settled - 0.1, [0.0; 3]);
        self.now = settled + 0.2;
    }

    fn wave(&mut self, left: bool, times: usize) {
        let up = self.about(0.8);
        let begin = self.now;
        self.hand(left).to(begin, begin + up, HAND_UP);
        self.now += up;
        for _ in 0..times {
            for out in [0.09, -0.06] {
                let duration = self.about(0.3);
                let mut target = HAND_UP;
                target[0] += out;
                target[4] = -2.0 * out;
                let begin = self.now;
                self.hand(left).to(begin, begin + duration, target);
                self.now += duration;
            }
        }
        let (begin, down) = (self.now, self.about(0.8));
        self.hand(left).to(begin, begin + down, HANDS_READY);
        self.now += down + 0.2;
    }

    fn squat(&mut self) {
        let (down, up) = (self.about(1.1), self.about(1.2));
        self.person
            .crouch
            .to(self.now, self.now + down, [0.34, 0.13, 0.75]);
        self.hands(down, REACH_DOWN);
        let begin = self.now + down + self.about(0.5);
        self.person.crouch.to(begin, begin + up, [0.0; 3]);
        self.now = begin;
        self.hands(up, HANDS_READY);
        self.now += up + 0.2;
    }

    fn reach(&mut self, left: bool, target: [f64; 6]) {
        let (out, back) = (self.about(0.8), self.about(0.8));
        let side = if left { -1.0 } else { 1.0 };
        let up = 0.6 * target[1].max(0.0);
        let begin = self.now;
        self.hand(left).to(begin, begin + out, target);
        self.person
            .gaze
            .to(begin, begin + out, [0.1 * -side, up, 0.25 * side]);
        let begin = begin + out + self.about(0.4);
        self.hand(left).to(begin, begin + back, HANDS_READY);
        self.person.gaze.to(begin, begin + back, [0.0; 3]);
        self.now = begin + back + 0.1;
    }

    fn arms_out(&mut self) {
        let (out, back) = (self.about(0.9), self.about(0.9));
        self.hands(out, ARMS_OUT);
        self.now += out + self.about(0.5);
        self.hands(back, HANDS_READY);
        self.now += back;
    }
}
