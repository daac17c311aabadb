//! Where the feet stand: planted until the body has left them behind, then a step.
//!
//! A foot stays exactly where it is while it bears the body. It is lifted when the gait says that
//! it swings, or when it has fallen too far behind where it ought to be under the moving body, and
//! put down where the body will then need it. Cadence follows the walking ratio, which is the same
//! over speeds and people of one size (Sekiya et al. 1996); the other constants were chosen by the
//! error on the training clips of the motion sets.

use glam::{Quat, Vec3};

use crate::geometry::{gain, min_jerk, wrap};

/// Step length over cadence, metres per (step a minute).
const WALKING_RATIO: f32 = 0.0064;
/// Bounds of a step's time and of a swing's, seconds.
const STEP_S: (f32, f32) = (0.28, 0.75);
const SWING_S: (f32, f32) = (0.22, 0.5);
/// Share of the stride that a foot is in the air.
const SWING_SHARE: f32 = 0.42;
/// A standing foot may be this far off its place, over leg length, and turned by so much, radians.
const SLACK: f32 = 0.16;
const SLACK_YAW: f32 = 0.6;
/// Share of the slack that is taken up when the body has come to rest for so long, seconds.
const TIDY: f32 = 0.65;
const TIDY_S: f32 = 0.5;
/// A difference of the feet's speeds that tells which one swings, head heights a second.
const SURE: f32 = 0.15;
/// Where a foot is put down ahead of its place, over the way that the body makes while it stands.
const LEAD: f32 = 0.46;
/// How much faster a swing ends once the gait says that it is the other foot's turn.
const HURRY: f32 = 2.5;
/// Time constant of that, seconds.
const HURRY_S: f32 = 0.05;
/// Share of a swing after which the other foot may begin its own.
const SWUNG: f32 = 0.5;
/// How much farther off a foot may be while the gait says that it stands.
const PATIENCE: f32 = 3.0;
/// Toes point outward by this much, radians.
const TOE_OUT: f32 = 0.14;
/// Time constant of the body's velocity, seconds.
const VELOCITY_S: f32 = 0.15;
/// Farther than this from their place, over leg length, both feet are simply put there.
const LOST: f32 = 1.2;

/// A place on the floor for a foot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Ground {
    /// Below the middle of the foot, at height zero.
    pub position: Vec3,
    /// Heading of the toes, radians about +Y.
    pub yaw: f32,
}

/// A foot now.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Footing {
    /// Over which place.
    pub ground: Ground,
    /// Height above standing, metres.
    pub lift: f32,
    /// Heel over toes, radians; negative in the last part of a swing.
    pub pitch: f32,
    /// Whether it bears the body.
    pub planted: bool,
}

#[derive(Debug, Clone, Copy)]
struct Swing {
    from: Ground,
    elapsed: f32,
    span: f32,
    /// Speed of its time.
    rate: f32,
}

#[derive(Debug, Clone, Copy)]
struct Foot {
    ground: Ground,
    swing: Option<Swing>,
}

/// What the feet carry.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Load {
    /// The middle of the support that the body wants, on the floor.
    pub center: Vec3,
    /// The body's heading, radians.
    pub yaw: f32,
    /// Leg length, metres.
    pub leg: f32,
    /// Half the distance between the feet, metres.
    pub half_width: f32,
    /// How fast the left foot is thought to move forward against the right one, head heights a
    /// second; zero for a body that does not walk.
    pub swinging: f32,
    /// How far each leg is stretched beyond its length, metres; not positive while it reaches.
    pub overstretch: [f32; 2],
}

/// Both feet over ticks.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Steps {
    feet: [Foot; 2],
    velocity: Vec3,
    center: Vec3,
    still_s: f32,
    started: bool,
}

/// How the feet move at one walking speed.
#[derive(Debug, Clone, Copy)]
struct Gait {
    swing_s: f32,
    /// The body's way while a foot stands, metres.
    stance: Vec3,
}

impl Gait {
    fn at(velocity: Vec3) -> Self {
        let speed = velocity.length();
        let cadence = (60.0 * speed / WALKING_RATIO).sqrt();
        let step = (60.0 / cadence.max(1.0)).clamp(STEP_S.0, STEP_S.1);
        let swing_s = (2.0 * step * SWING_SHARE).clamp(SWING_S.0, SWING_S.1);
        Self {
            swing_s,
            stance: velocity * (2.0 * step - swing_s),
        }
    }
}

impl Steps {
    pub(crate) const NEW: Self = {
        let ground = Ground {
            position: Vec3::ZERO,
            yaw: 0.0,
        };
        let foot = Foot {
            ground,
            swing: None,
        };
        Self {
            feet: [foot; 2],
            velocity: Vec3::ZERO,
            center: Vec3::ZERO,
            still_s: 0.0,
            started: false,
        }
    };

    /// The middle between the feet, at height zero.
    pub(crate) fn middle(&self) -> Vec3 {
        (self.feet[0].ground.position + self.feet[1].ground.position) * 0.5
    }

    /// Whether the feet stand somewhere yet.
    pub(crate) fn started(&self) -> bool {
        self.started
    }

    /// The feet after `dt` seconds, left and right.
    pub(crate) fn update(&mut self, load: &Load, dt: f32) -> [Footing; 2] {
        self.follow(load, dt);
        let gait = Gait::at(self.velocity);
        for side in 0..2 {
            self.swing(side, load, &gait, dt);
        }
        if let Some(side) = self.due(load, &gait) {
            let foot = &mut self.feet[side];
            foot.swing = Some(Swing {
                from: foot.ground,
                elapsed: 0.0,
                span: gait.swing_s,
                rate: 1.0,
            });
            self.still_s = 0.0;
        }
        [self.footing(0, load), self.footing(1, load)]
    }

    /// Takes note of the body's motion; puts the feet below it at the start and after a jump.
    fn follow(&mut self, load: &Load, dt: f32) {
        let away = (self.middle() - load.center).length() > LOST * load.leg;
        if !self.started || away {
            for side in 0..2 {
                self.feet[side] = Foot {
                    ground: home(side, load),
                    swing: None,
                };
            }
            (self.velocity, self.center, self.started) = (Vec3::ZERO, load.center, true);
        } else if dt > 0.0 {
            let velocity = (load.center - self.center) / dt;
            self.velocity += (velocity - self.velocity) * gain(dt, VELOCITY_S);
            self.center = load.center;
        }
        let still = self.velocity.length() < 0.1;
        self.still_s = if still { self.still_s + dt } else { 0.0 };
    }

    fn swing(&mut self, side: usize, load: &Load, gait: &Gait, dt: f32) {
        let foot = &mut self.feet[side];
        let Some(swing) = &mut foot.swing else { return };
        let for_this_foot = if side == 0 {
            load.swinging
        } else {
            -load.swinging
        };
        let over = for_this_foot < -SURE;
        let rate = if over { HURRY } else { 1.0 };
        swing.rate += (rate - swing.rate) * gain(dt, HURRY_S);
        swing.elapsed += swing.rate * dt;
        let left = (swing.span - swing.elapsed).max(0.0);
        let mut goal = home(side, load);
        let ahead = self.velocity * left + gait.stance * LEAD;
        goal.position += ahead.clamp_length_max(0.6 * load.leg);
        let share = min_jerk(swing.elapsed / swing.span);
        foot.ground = Ground {
            position: swing.from.position.lerp(goal.position, share),
            yaw: wrap(swing.from.yaw + wrap(goal.yaw - swing.from.yaw) * share),
        };
        if left <= 0.0 {
            foot.swing = None;
        }
    }

    /// The foot that has to be lifted now.
    fn due(&self, load: &Load, gait: &Gait) -> Option<usize> {
        let bears = |side: usize| {
            let nearly_down = |swing: Swing| swing.elapsed > SWUNG * swing.span;
            self.feet[side].swing.is_none_or(nearly_down)
        };
        let sure = load.swinging.abs() > SURE;
        if sure {
            let side = usize::from(load.swinging < 0.0);
            let foot = &self.feet[side];
            let off = foot.ground.position - home(side, load).position;
            let behind = -off.dot(self.velocity.normalize_or_zero());
            if foot.swing.is_none() && bears(1 - side) && behind > 0.0 {
                return Some(side);
            }
        }
        let urgency = [self.urgency(0, load, gait), self.urgency(1, load, gait)];
        let side = usize::from(urgency[1] > urgency[0]);
        let limit = if sure { PATIENCE } else { 1.0 };
        // A leg that no longer reaches lets go, also if that means to run.
        let torn = load.overstretch[side] > 0.08 * load.leg;
        (urgency[side] > limit && (bears(1 - side) || torn)).then_some(side)
    }

    /// How badly a foot needs to step; above 1 it does. Zero while it is in the air.
    fn urgency(&self, side: usize, load: &Load, gait: &Gait) -> f32 {
        let foot = &self.feet[side];
        if foot.swing.is_some() {
            return 0.0;
        }
        let home = home(side, load);
        let off = foot.ground.position - home.position;
        let slack = SLACK * load.leg;
        let half = gait.stance.length() * 0.5;
        let travel = self.velocity.normalize_or_zero();
        let along = off.dot(travel);
        let aside = (off - travel * along).length();
        // A foot ahead of a moving body will be passed; one behind has to follow.
        let along = if along > 0.0 {
            along / (slack + 1.5 * half)
        } else {
            along / slack.max(half)
        };
        let turned = wrap(foot.ground.yaw - home.yaw).abs() / SLACK_YAW;
        let placed = (along * along + (aside / slack).powi(2) + turned * turned).sqrt();
        let tidy = if self.still_s > TIDY_S { TIDY } else { 1.0 };
        let torn = if load.overstretch[side] > 0.02 * load.leg {
            1.01
        } else {
            0.0
        };
        placed / tidy + torn
    }

    fn footing(&self, side: usize, load: &Load) -> Footing {
        let foot = &self.feet[side];
        let Some(swing) = &foot.swing else {
            return Footing {
                ground: foot.ground,
                lift: 0.0,
                pitch: 0.0,
                planted: true,
            };
        };
        let fraction = (swing.elapsed / swing.span).clamp(0.0, 1.0);
        let way = (foot.ground.position - swing.from.position).length() / load.leg;
        let arc = (std::f32::consts::PI * fraction).sin();
        let height = load.leg * (0.05 + 0.1 * way.min(1.0));
        let heel = (0.8 * way.min(1.0)) * arc * (1.0 - 1.6 * fraction);
        Footing {
            ground: foot.ground,
            lift: height * arc * arc,
            pitch: heel,
            planted: false,
        }
    }
}

/// Where a foot stands under a body at rest.
fn home(side: usize, load: &Load) -> Ground {
    let sign = if side == 0 { -1.0 } else { 1.0 };
    let out = Quat::from_rotation_y(load.yaw) * Vec3::new(sign * load.half_width, 0.0, 0.0);
    Ground {
        position: load.center + out,
        yaw: wrap(load.yaw - sign * TOE_OUT),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn load(z: f32) -> Load {
        Load {
            center: Vec3::new(0.0, 0.0, z),
            yaw: 0.0,
            leg: 0.85,
            half_width: 0.1,
            swinging: 0.0,
            overstretch: [-0.1; 2],
        }
    }

    /// Walks forward at `speed` for 6 s; what the feet did.
    fn walk(speed: f32, hz: f32) -> (u32, f32, f32) {
        let mut steps = Steps::NEW;
        let (mut landed, mut slid, mut behind) = (0, 0.0f32, 0.0f32);
        let mut last = steps.update(&load(0.0), 0.0);
        for n in 1..(6.0 * hz) as usize {
            let now = steps.update(&load(-speed * n as f32 / hz), 1.0 / hz);
            for side in 0..2 {
                landed += u32::from(now[side].planted && !last[side].planted);
                if now[side].planted && last[side].planted {
                    slid = slid.max(
                        now[side]
                            .ground
                            .position
                            .distance(last[side].ground.position),
                    );
                }
            }
            behind = behind.max((steps.middle() - steps.center).length());
            last = now;
        }
        (landed, slid, behind)
    }

    #[test]
    fn a_still_body_does_not_step_and_a_small_sway_neither() {
        let mut steps = Steps::NEW;
        for n in 0..600 {
            let sway = 0.04 * (n as f32 / 60.0).sin();
            let feet = steps.update(&load(sway), 1.0 / 60.0);
            assert!(feet.iter().all(|foot| foot.planted && foot.lift == 0.0));
        }
    }

    #[test]
    fn feet_step_at_walking_cadence_and_never_slide() {
        for (speed, least, most) in [(0.6, 5, 9), (1.3, 8, 13), (2.5, 12, 19)] {
            for hz in [30.0, 60.0, 120.0] {
                let (landed, slid, behind) = walk(speed, hz);
                assert!(
                    (least..=most).contains(&landed),
                    "{speed} m/s, {hz} Hz: {landed} steps"
                );
                assert_eq!(slid, 0.0);
                assert!(
                    behind < 0.3 + 0.2 * speed,
                    "{speed} m/s, {hz} Hz: feet {behind} m behind"
                );
            }
        }
    }

    #[test]
    fn turning_on_the_spot_steps_around() {
        let mut steps = Steps::NEW;
        let mut turned = load(0.0);
        steps.update(&turned, 0.0);
        for n in 0..240 {
            turned.yaw = wrap(1.5 * (n as f32 / 120.0).min(1.0));
            steps.update(&turned, 1.0 / 60.0);
        }
        for foot in steps.feet {
            assert!(wrap(foot.ground.yaw - turned.yaw).abs() < 0.5);
        }
    }

    #[test]
    fn a_jump_of_the_body_takes_the_feet_along() {
        let mut steps = Steps::NEW;
        steps.update(&load(0.0), 0.0);
        steps.update(&load(-5.0), 1.0 / 60.0);
        assert!((steps.middle() - Vec3::new(0.0, 0.0, -5.0)).length() < 1e-5);
    }
}
