//! Which tracker is worn where, where nobody has said: the wearer moves one limb after the other.
//!
//! How a tracker sits on its bone and where its world points are unknown then, so nothing counts
//! but how far each turned while the others hardly did. Left and right are mirror images of each
//! other in everything that such a tracker measures: only the order of the movements tells them
//! apart.

use glam::Quat;
use posed_signal::{HostTime, Role};

/// Where six trackers are worn, in the order in which the wearer moves them; the last stays.
pub const ORDER: [Role; 6] = [
    Role::LeftWrist,
    Role::RightWrist,
    Role::LeftKnee,
    Role::RightKnee,
    Role::Head,
    Role::Waist,
];

/// Whoever turns a tracker faster than this moves, rad/s.
const MOVES_RAD_S: f32 = 0.35;
/// A movement is over when all have held still for this long, seconds.
const REST_S: f64 = 0.5;
/// The tracker of the moved limb turns by this at least, radians (35 degrees).
const TURN_MIN: f32 = 0.6;
/// Less is swaying, and no movement at all, radians (15 degrees).
const SWAY_MAX: f32 = 0.26;
/// No other turns by more than this share of it.
const OTHER_MAX: f32 = 0.5;
/// Who rests longer than this has given up, seconds.
const PATIENCE_S: f64 = 20.0;
/// After a longer silence nothing is known of what happened, seconds.
const GAP_S: f64 = 0.5;

/// Why the trackers cannot be told apart so far.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Ambiguous {
    /// More than one tracker turned.
    #[error("several trackers turned at once; begin again, and move one limb at a time")]
    Together,
    /// A tracker turned for the second time.
    #[error("a tracker was moved twice; begin again, and move each limb once")]
    Twice,
    /// None turned far enough. What was found before still holds.
    #[error("no tracker turned far enough; move the same limb again, and further")]
    Little,
}

/// What the last tick told.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Progress {
    /// Nothing new.
    Waiting,
    /// One more tracker is known: the role that it has.
    Found(Role),
    /// A movement did not tell which tracker it was.
    Refused(Ambiguous),
    /// All are known: the role of each, in the order of the trackers.
    Done(Vec<Role>),
}

/// Watches some trackers until it is known which is worn where.
#[derive(Debug, Clone)]
pub struct Naming {
    /// What is to be given away, in the order of the movements.
    roles: Vec<Role>,
    found: Vec<Option<Role>>,
    /// Rotations at the last tick, and when it was.
    last: Option<(HostTime, Vec<Quat>)>,
    /// Rotations before the movement; empty until everybody has held still once.
    rest: Vec<Quat>,
    /// How far each has turned away from there, radians.
    turned: Vec<f32>,
    still_s: f64,
    moving: bool,
}

impl Naming {
    /// For as many trackers as `roles`, whose order is that of the movements; the last of them
    /// goes to the tracker that has not moved.
    #[must_use]
    pub fn new(roles: &[Role]) -> Self {
        Self {
            roles: roles.to_vec(),
            found: vec![None; roles.len()],
            last: None,
            rest: Vec::new(),
            turned: vec![0.0; roles.len()],
            still_s: 0.0,
            moving: false,
        }
    }

    /// Number of trackers that are known.
    #[must_use]
    pub fn known(&self) -> usize {
        self.found.iter().flatten().count()
    }

    /// Takes every tracker's rotation in its own world at `now`; ten times a second or more.
    ///
    /// # Panics
    /// There are not as many as there are roles.
    pub fn tick(&mut self, now: HostTime, rotations: &[Quat]) -> Progress {
        assert_eq!(rotations.len(), self.roles.len(), "one rotation a tracker");
        let Some((before, last)) = self.last.replace((now, rotations.to_vec())) else {
            return Progress::Waiting;
        };
        let dt = now.since_secs(before);
        if dt <= 0.0 || dt > GAP_S {
            self.start_over();
            return Progress::Waiting;
        }
        let fastest = last.iter().zip(rotations).map(|(a, b)| between(*a, *b));
        if fastest.fold(0.0, f32::max) > MOVES_RAD_S * dt as f32 {
            (self.still_s, self.moving) = (0.0, true);
        } else {
            self.still_s += dt;
        }
        for (turned, (rest, now)) in self.turned.iter_mut().zip(self.rest.iter().zip(rotations)) {
            *turned = turned.max(between(*rest, *now));
        }
        if self.still_s > PATIENCE_S {
            self.found.fill(None);
        }
        if self.still_s < REST_S {
            return Progress::Waiting;
        }
        let progress = if self.moving && !self.rest.is_empty() {
            self.judge()
        } else {
            Progress::Waiting
        };
        self.rest = rotations.to_vec();
        self.turned.fill(0.0);
        self.moving = false;
        progress
    }

    fn start_over(&mut self) {
        self.found.fill(None);
        self.rest.clear();
        (self.still_s, self.moving) = (0.0, false);
    }

    /// A movement is over.
    fn judge(&mut self) -> Progress {
        let mut order: Vec<usize> = (0..self.turned.len()).collect();
        order.sort_by(|&a, &b| self.turned[b].total_cmp(&self.turned[a]));
        let most = order[0];
        let second = order.get(1).map_or(0.0, |&index| self.turned[index]);
        if self.turned[most] < SWAY_MAX {
            return Progress::Waiting;
        }
        let refusal = if second > OTHER_MAX * self.turned[most] {
            Ambiguous::Together
        } else if self.turned[most] < TURN_MIN {
            return Progress::Refused(Ambiguous::Little);
        } else if self.found[most].is_some() {
            Ambiguous::Twice
        } else {
            return self.name(most);
        };
        self.found.fill(None);
        Progress::Refused(refusal)
    }

    fn name(&mut self, tracker: usize) -> Progress {
        let role = self.roles[self.known()];
        self.found[tracker] = Some(role);
        if self.known() + 1 < self.roles.len() {
            return Progress::Found(role);
        }
        let last = self.roles[self.known()];
        let found = self.found.iter().map(|role| role.unwrap_or(last));
        let done = Progress::Done(found.collect());
        self.start_over();
        done
    }
}

/// The angle between two rotations, radians; right for small ones too.
fn between(a: Quat, b: Quat) -> f32 {
    let turn = a.inverse() * b;
    2.0 * turn.xyz().length().atan2(turn.w.abs())
}

#[cfg(test)]
mod tests {
    use glam::Vec3;
    use proptest::prelude::*;

    use super::*;

    /// Trackers that sit and whose worlds point any way, ticked twenty times a second.
    struct Wearer {
        naming: Naming,
        sits: Vec<(Quat, Quat)>,
        ms: u64,
        said: Vec<Progress>,
    }

    impl Wearer {
        fn new(sits: Vec<(Quat, Quat)>) -> Self {
            Self {
                naming: Naming::new(&ORDER[ORDER.len() - sits.len()..]),
                sits,
                ms: 1_000,
                said: Vec::new(),
            }
        }

        /// Bones turn to and fro within a second by these angles, radians; then rest.
        fn move_bones(&mut self, angles: &[f32], rest_s: f64) {
            for step in 0..20 + (20.0 * rest_s) as u16 {
                self.ms += 50;
                let share = (std::f32::consts::PI * f32::from(step.min(20)) / 20.0).sin();
                let sits = self.sits.iter().zip(angles);
                let rotations: Vec<Quat> = sits
                    .map(|((world, mount), angle)| {
                        (*world * Quat::from_rotation_x(share * angle) * *mount).normalize()
                    })
                    .collect();
                let now = HostTime(self.ms * 1_000_000);
                match self.naming.tick(now, &rotations) {
                    Progress::Waiting => {}
                    progress => self.said.push(progress),
                }
            }
        }

        fn alone(&mut self, tracker: usize, angle: f32) {
            let mut angles = vec![0.05; self.sits.len()];
            angles[tracker] = angle;
            self.move_bones(&angles, 1.0);
        }
    }

    fn sits() -> impl Strategy<Value = Vec<(Quat, Quat)>> {
        let turn = prop::array::uniform3(-2.0f32..2.0)
            .prop_map(|axis| Quat::from_scaled_axis(Vec3::from_array(axis)));
        let world = (-3.0f32..3.0).prop_map(Quat::from_rotation_y);
        prop::collection::vec((world, turn), ORDER.len())
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(32))]
        #[test]
        fn each_is_known_by_when_it_moved_however_it_sits(
            sits in sits(),
            shuffled in Just([0usize, 1, 2, 3, 4, 5]).prop_shuffle(),
            angle in 0.8f32..2.2,
        ) {
            let mut wearer = Wearer::new(sits);
            wearer.move_bones(&[0.0; 6], 1.0);
            for &tracker in &shuffled[..5] {
                wearer.alone(tracker, angle);
            }
            let mut expected = vec![Role::None; 6];
            for (&tracker, role) in shuffled.iter().zip(ORDER) {
                expected[tracker] = role;
            }
            let found = ORDER[..4].iter().map(|&role| Progress::Found(role));
            let said: Vec<_> = found.chain([Progress::Done(expected)]).collect();
            prop_assert_eq!(wearer.said, said);
        }
    }

    fn straight() -> Wearer {
        let mut wearer = Wearer::new(vec![(Quat::IDENTITY, Quat::IDENTITY); 6]);
        wearer.move_bones(&[0.0; 6], 1.0);
        wearer
    }

    #[test]
    fn what_moves_together_or_twice_is_refused_and_begins_again() {
        let mut wearer = straight();
        wearer.alone(2, 1.0);
        wearer.move_bones(&[1.0, 0.7, 0.0, 0.0, 0.0, 0.0], 1.0);
        assert_eq!(
            wearer.said.pop(),
            Some(Progress::Refused(Ambiguous::Together))
        );
        assert_eq!(wearer.naming.known(), 0);
        wearer.alone(2, 1.0);
        wearer.alone(2, 1.0);
        assert_eq!(wearer.said.pop(), Some(Progress::Refused(Ambiguous::Twice)));
        assert_eq!(wearer.naming.known(), 0);
    }

    #[test]
    fn small_movements_are_asked_for_again_and_swaying_is_none() {
        let mut wearer = straight();
        wearer.alone(2, 1.0);
        wearer.alone(3, 0.45);
        assert_eq!(
            wearer.said.pop(),
            Some(Progress::Refused(Ambiguous::Little))
        );
        wearer.alone(3, 0.2);
        assert_eq!(wearer.said, [Progress::Found(Role::LeftWrist)]);
        wearer.alone(3, 1.0);
        assert_eq!(wearer.said.pop(), Some(Progress::Found(Role::RightWrist)));
    }

    #[test]
    fn who_gives_up_begins_at_the_first_limb() {
        let mut wearer = straight();
        wearer.alone(2, 1.0);
        wearer.move_bones(&[0.0; 6], PATIENCE_S + 1.0);
        wearer.alone(3, 1.0);
        assert_eq!(wearer.said.pop(), Some(Progress::Found(Role::LeftWrist)));
    }

    #[test]
    fn fewer_trackers_take_fewer_movements() {
        let mut wearer = Wearer::new(vec![(Quat::IDENTITY, Quat::IDENTITY); 2]);
        wearer.move_bones(&[0.0; 2], 1.0);
        wearer.alone(1, 1.0);
        let done = Progress::Done(vec![Role::Waist, Role::Head]);
        assert_eq!(wearer.said, [done]);
    }
}
