//! Where the person goes, and the steps that this takes: a foot on the ground stays where it is.

use super::track::{bump, cruise, minimum_jerk};

/// A place on the floor with a heading: x, z in metres, and the angle about Y, rad.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Spot {
    pub(super) x: f64,
    pub(super) z: f64,
    pub(super) heading: f64,
}

impl Spot {
    /// A point that is `right` and `back` of here, at the same heading.
    pub(super) fn offset(self, right: f64, back: f64) -> Self {
        let (sin, cos) = self.heading.sin_cos();
        Self {
            x: self.x + right * cos + back * sin,
            z: self.z - right * sin + back * cos,
            ..self
        }
    }

    fn lerp(self, other: Self, share: f64) -> Self {
        Self {
            x: self.x + (other.x - self.x) * share,
            z: self.z + (other.z - self.z) * share,
            heading: self.heading + (other.heading - self.heading) * share,
        }
    }

    fn distance(self, other: Self) -> f64 {
        (self.x - other.x).hypot(self.z - other.z)
    }
}

/// One walk or turn.
#[derive(Debug, Clone)]
struct Move {
    begin: f64,
    end: f64,
    ramp: f64,
    from: Spot,
    /// Attracts the path, which is a quadratic Bezier curve.
    via: Spot,
    to: Spot,
    /// When its last step has landed.
    settled: f64,
    step_s: f64,
    left_first: bool,
    /// How much the body swings along: 1 for a walk.
    vigour: f64,
}

impl Move {
    fn at(&self, t: f64) -> Spot {
        let share = cruise(t - self.begin, self.end - self.begin, self.ramp);
        let bent = self
            .from
            .lerp(self.via, share)
            .lerp(self.via.lerp(self.to, share), share);
        Spot {
            heading: self.from.lerp(self.to, share).heading,
            ..bent
        }
    }
}

/// One step of one foot.
#[derive(Debug, Clone)]
struct Step {
    left: bool,
    lift: f64,
    land: f64,
    from: Spot,
    to: Spot,
}

/// A foot at a time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Foot {
    /// Where it is over the floor.
    pub(super) spot: Spot,
    /// How far its toes are raised off the floor, 1 in the middle of a long step.
    pub(super) lift: f64,
    /// Heel above toes, rad.
    pub(super) pitch: f64,
}

/// The swing of a gait at a time.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Gait {
    /// 1 with the left side back and the right one forward, -1 the other way round.
    pub(super) wave: f64,
    /// 1 with the weight on the right foot in the middle of a left step, -1 the other way round.
    pub(super) sway: f64,
    /// 1 while the gait goes on.
    pub(super) going: f64,
}

/// How a body walks.
#[derive(Debug, Clone, Copy)]
pub(super) struct Style {
    /// Sideways distance of a foot from the middle, metres.
    pub(super) half_width: f64,
    /// How far the feet stand in front of the body's middle, metres.
    pub(super) forward: f64,
    /// m/s.
    pub(super) speed: f64,
    /// rad/s.
    pub(super) turn_speed: f64,
    /// Seconds.
    pub(super) step_s: f64,
}

/// A floor plan over time.
#[derive(Debug, Clone)]
pub(super) struct Walk {
    style: Style,
    start: Spot,
    moves: Vec<Move>,
    steps: Vec<Step>,
}

impl Walk {
    /// Share of a step's time in which both feet stand.
    const BOTH_STAND: f64 = 0.14;
    const RAMP_S: f64 = 0.7;
    /// Heel pitch at the end of a long stance, and toe pitch at the end of a long swing, rad.
    const HEEL_OFF: f64 = 0.65;
    const TOES_UP: f64 = 0.25;
    /// A step of this many metres is a long one.
    const LONG_STEP: f64 = 0.6;

    pub(super) fn new(start: Spot, style: Style) -> Self {
        Self {
            style,
            start,
            moves: Vec::new(),
            steps: Vec::new(),
        }
    }

    /// Where the last move leads.
    pub(super) fn last(&self) -> Spot {
        self.moves.last().map_or(self.start, |last| last.to)
    }

    /// Goes to `to`, starting at `begin`, straight or on a path attracted by `via`. Returns when
    /// the last foot has landed.
    pub(super) fn go(&mut self, begin: f64, via: Option<Spot>, to: Spot) -> f64 {
        let from = self.last();
        let via = via.unwrap_or(from.lerp(to, 0.5));
        let length = from.distance(via) + via.distance(to);
        let turn = to.heading - from.heading;
        let at_speed = (length / self.style.speed).max(turn.abs() / self.style.turn_speed);
        let end = begin + at_speed + Self::RAMP_S;
        let step_s = self.style.step_s;
        let count = ((end - begin) / step_s).ceil() as usize + 1;
        let one = Move {
            begin,
            end,
            ramp: Self::RAMP_S,
            from,
            via,
            to,
            settled: begin + count as f64 * step_s,
            step_s,
            left_first: turn > 0.0,
            vigour: (length / 1.0).clamp(0.25, 1.0),
        };
        let settled = one.settled;
        self.moves.push(one.clone());
        for index in 0..count {
            let left = one.left_first == index.is_multiple_of(2);
            let land = begin + (index + 1) as f64 * step_s;
            // The foot goes to where it will be under the body in the middle of its stance.
            let target = self.under(self.body(land + 0.5 * step_s), left);
            self.steps.push(Step {
                left,
                lift: land - (1.0 - Self::BOTH_STAND) * step_s,
                land,
                from: self.standing(left),
                to: target,
            });
        }
        settled
    }

    /// The place under a body's foot.
    fn under(&self, body: Spot, left: bool) -> Spot {
        let side = if left { -1.0 } else { 1.0 };
        body.offset(side * self.style.half_width, -self.style.forward)
    }

    /// Where a foot stands after its last step.
    fn standing(&self, left: bool) -> Spot {
        let last = self.steps.iter().rev().find(|step| step.left == left);
        last.map_or_else(|| self.under(self.start, left), |step| step.to)
    }

    /// Where the body's middle is.
    pub(super) fn body(&self, t: f64) -> Spot {
        let current = self.moves.iter().rev().find(|one| one.begin <= t);
        current.map_or(self.start, |one| one.at(t))
    }

    /// Where a foot is.
    pub(super) fn foot(&self, t: f64, left: bool) -> Foot {
        let mut foot = Foot {
            spot: self.under(self.start, left),
            lift: 0.0,
            pitch: 0.0,
        };
        for step in self.steps.iter().filter(|step| step.left == left) {
            let swing = step.land - step.lift;
            let length = step.from.distance(step.to);
            let long = (length / Self::LONG_STEP).min(1.0);
            // The heel leaves the floor before the toes do.
            let heel_off = bump((t - step.lift + 0.8 * swing) / (1.25 * swing));
            let toes_up = bump((t - step.lift - 0.4 * swing) / (0.6 * swing));
            foot.pitch += long * (Self::HEEL_OFF * heel_off - Self::TOES_UP * toes_up);
            foot.lift += (0.4 + 0.6 * long) * bump((t - step.lift) / swing);
            if t >= step.lift {
                foot.spot = step
                    .from
                    .lerp(step.to, minimum_jerk((t - step.lift) / swing));
            }
        }
        foot
    }

    /// How the gait swings.
    pub(super) fn gait(&self, t: f64) -> Gait {
        let mut gait = Gait::default();
        for one in &self.moves {
            let since = (t - one.begin) / one.step_s;
            let until = (one.settled - t) / one.step_s;
            if since <= 0.0 || until <= 0.0 {
                continue;
            }
            let swing = minimum_jerk(since) * minimum_jerk(until) * one.vigour;
            let side = if one.left_first { 1.0 } else { -1.0 };
            let (sin, cos) = (std::f64::consts::PI * since).sin_cos();
            gait.wave += swing * side * cos;
            gait.sway += swing * side * sin;
            gait.going += swing;
        }
        gait
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn walk() -> (Walk, f64) {
        let style = Style {
            half_width: 0.1,
            forward: 0.03,
            speed: 0.8,
            turn_speed: 1.5,
            step_s: 0.55,
        };
        let start = Spot {
            x: 0.0,
            z: 0.5,
            heading: 0.0,
        };
        let mut walk = Walk::new(start, style);
        let ahead = Spot { z: -1.0, ..start };
        let settled = walk.go(1.0, None, ahead);
        let turned = Spot {
            heading: 1.5,
            ..ahead
        };
        let settled = walk.go(settled + 0.2, None, turned);
        (walk, settled)
    }

    #[test]
    fn feet_end_under_the_body() {
        let (walk, settled) = walk();
        let body = walk.body(settled);
        assert_eq!(body, walk.last());
        for left in [true, false] {
            let foot = walk.foot(settled, left);
            assert_eq!((foot.lift, foot.pitch), (0.0, 0.0));
            let spot = walk.under(body, left);
            assert!(foot.spot.distance(spot) < 1e-12);
            assert!((foot.spot.heading - 1.5).abs() < 1e-12);
        }
        assert_eq!(walk.gait(settled), Gait::default());
    }

    #[test]
    fn a_foot_on_the_floor_stays_and_one_foot_always_stands() {
        let (walk, settled) = walk();
        let h = 1e-3;
        let (mut standing, mut moving) = (0, 0);
        let mut t = 0.0;
        while t < settled {
            let still = [true, false].map(|left| {
                let (now, next) = (walk.foot(t, left), walk.foot(t + h, left));
                let slides = now.spot.distance(next.spot) > 1e-9;
                assert!(!slides || now.lift + next.lift > 0.0, "slides at {t}");
                !slides
            });
            assert!(still[0] || still[1], "both feet move at {t}");
            standing += i32::from(still[0] && still[1]);
            moving += i32::from(!(still[0] && still[1]));
            t += h;
        }
        assert!(standing > 500 && moving > 2_000);
    }
}
