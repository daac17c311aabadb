//! Trackers of a wearer whose bones are known, strapped on askew, with worlds of their own.

use glam::{Quat, Vec3};
use posed_signal::{HostTime, Lookup, Orientation, Pose, PoseHow, Role};
use proptest::prelude::*;

use super::*;
use crate::{geometry::wrap, tracker::NO_INERTIAL};

const WORN: [Role; 6] = [
    Role::Head,
    Role::Waist,
    Role::LeftKnee,
    Role::RightKnee,
    Role::LeftWrist,
    Role::RightWrist,
];

/// A tracker's mistakes: how it is strapped on, and where its world points.
#[derive(Debug, Clone, Copy)]
struct Strap {
    askew: Quat,
    world: f32,
}

impl Strap {
    /// What the tracker says when its bone does this, in posed's world.
    fn says(&self, role: Role, bone: Quat, at: HostTime) -> Orientation {
        let device = bone * conventional(role) * self.askew;
        let own = Quat::from_rotation_y(-self.world);
        Orientation {
            at,
            rotation: (own * device).normalize(),
            accel: own * Vec3::new(1.0, 2.0, 3.0),
            angular_velocity: Vec3::ZERO,
        }
    }
}

/// The bone in a posture, for a wearer who faces `facing`.
fn stance(posture: Stance, role: Role, facing: f32) -> Quat {
    let lean = if matches!(role, Role::Head | Role::LeftWrist | Role::RightWrist) {
        0.0
    } else {
        -0.5
    };
    let bone = posture
        .bone(role)
        .unwrap_or_else(|| Quat::from_rotation_x(lean));
    Quat::from_rotation_y(facing) * bone
}

struct Wearer {
    straps: [Strap; Role::COUNT],
    fitting: Fitting,
    ms: u64,
}

impl Wearer {
    fn new(straps: [Strap; Role::COUNT]) -> Self {
        Self {
            straps,
            fitting: Fitting::default(),
            ms: 1_000,
        }
    }

    fn tick(
        &mut self,
        bone: impl Fn(Role) -> Quat,
        head: Lookup<Pose>,
    ) -> [Lookup<Orientation>; Role::COUNT] {
        self.ms += 10;
        let at = HostTime(self.ms * 1_000_000);
        let mut devices = NO_INERTIAL;
        for role in WORN {
            let said = self.straps[role as usize].says(role, bone(role), at);
            devices[role as usize] = Lookup::Exact(said);
        }
        self.fitting.tick(at, &devices, &head)
    }

    fn hold(&mut self, posture: Stance, facing: f32, head: Lookup<Pose>) {
        self.fitting.calibrate(posture);
        for _ in 0..120 {
            self.tick(|role| stance(posture, role, facing), head);
        }
        assert_eq!(self.fitting.report().phase, Phase::Done);
    }
}

fn headset(yaw: f32) -> Lookup<Pose> {
    Lookup::Exact(Pose {
        rotation: Quat::from_rotation_y(yaw),
        how: PoseHow::Optical,
        ..Pose::unknown(HostTime(0))
    })
}

fn strap() -> impl Strategy<Value = Strap> {
    let askew = prop::array::uniform3(-0.6f32..0.6);
    (askew, -3.1f32..3.1).prop_map(|(axis, world)| Strap {
        askew: Quat::from_scaled_axis(Vec3::from_array(axis)),
        world,
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    /// With all postures nothing depends on how the trackers are strapped on, but for the head,
    /// whose heading no posture shows: it has to sit straight.
    #[test]
    fn three_postures_fit_trackers_however_they_sit(
        straps in prop::collection::vec(strap(), Role::COUNT),
        facing in -3.0f32..3.0,
    ) {
        let mut straps: [Strap; Role::COUNT] = straps.try_into().unwrap();
        straps[Role::Head as usize].askew = Quat::from_rotation_x(0.2);
        let mut wearer = Wearer::new(straps);
        for posture in [Stance::Straight, Stance::TPose, Stance::Crouch] {
            wearer.hold(posture, facing, headset(facing));
        }
        prop_assert_eq!(wearer.fitting.report().calibrated, 6);
        let moved = |role: Role| {
            let turn = Quat::from_scaled_axis(Vec3::new(0.4, -0.3, 0.6 * f32::from(role as u8) / 13.0));
            turn * stance(Stance::Straight, role, facing)
        };
        let bones = wearer.tick(moved, headset(facing));
        for role in WORN {
            let bone = bones[role as usize].fresh().unwrap();
            let error = bone.rotation.angle_between(moved(role)).to_degrees();
            prop_assert!(error < 0.5, "{role}: {error} degrees");
            prop_assert!(bone.accel.distance(Vec3::new(1.0, 2.0, 3.0)) < 0.05, "{role}");
        }
    }
}

fn straight_straps(world: f32) -> [Strap; Role::COUNT] {
    std::array::from_fn(|role| Strap {
        askew: Quat::IDENTITY,
        world: wrap(world + role as f32),
    })
}

#[test]
fn a_straight_stance_alone_does_for_trackers_that_sit_as_meant_and_nobody_has_to_ask() {
    let mut wearer = Wearer::new(straight_straps(0.7));
    let standing = |role| stance(Stance::Straight, role, 0.0);
    assert!(wearer.tick(standing, Lookup::Empty)[Role::Waist as usize] == Lookup::Empty);
    for _ in 0..120 {
        wearer.tick(standing, Lookup::Empty);
    }
    let stretched = |role| stance(Stance::TPose, role, 0.0);
    let bones = wearer.tick(stretched, Lookup::Empty);
    for role in WORN {
        let bone = bones[role as usize].fresh().unwrap();
        assert!(
            bone.rotation.angle_between(stretched(role)) < 2e-3,
            "{role}"
        );
    }
    assert_eq!(wearer.fitting.report().phase, Phase::Idle);
}

#[test]
fn who_does_not_hold_still_is_not_calibrated() {
    let mut wearer = Wearer::new(straight_straps(0.0));
    wearer.fitting.calibrate(Stance::TPose);
    for _ in 0..1_700 {
        wearer.ms += 10;
        let at = HostTime(wearer.ms * 1_000_000);
        let mut devices = NO_INERTIAL;
        devices[Role::Waist as usize] = Lookup::Exact(Orientation {
            angular_velocity: Vec3::X,
            ..wearer.straps[0].says(Role::Waist, Quat::IDENTITY, at)
        });
        wearer.fitting.tick(at, &devices, &Lookup::Empty);
    }
    assert_eq!(wearer.fitting.report().phase, Phase::Failed);
    assert_eq!(wearer.fitting.fit(Role::Waist), None);
}

/// The waist's world turns at 3 degrees a minute.
fn drifting(with_headset: bool) -> (Option<f32>, f32) {
    let mut wearer = Wearer::new(straight_straps(0.0));
    let head = if with_headset {
        headset(0.0)
    } else {
        Lookup::Empty
    };
    wearer.hold(Stance::Straight, 0.0, head);
    let mut last = 0.0;
    for step in 0..12_000 {
        wearer.straps[Role::Waist as usize].world -= 3f32.to_radians() / 6_000.0;
        // Whoever looks aside now and then does not pull the trackers along.
        let glance = if step % 3_000 < 600 { 0.9 } else { 0.0 };
        let head = if with_headset { headset(glance) } else { head };
        let bones = wearer.tick(|role| stance(Stance::Straight, role, 0.0), head);
        let waist = bones[Role::Waist as usize].fresh().unwrap();
        last = crate::geometry::yaw_of(waist.rotation).to_degrees();
    }
    (wearer.fitting.report().drift[Role::Waist as usize], last)
}

#[test]
fn drift_is_told_in_degrees_a_minute_and_the_headset_holds_it() {
    let (drift, off) = drifting(false);
    let drift = drift.unwrap();
    assert!((drift - 3.0).abs() < 0.3, "{drift} degrees a minute");
    assert!(
        (off - 6.0).abs() < 0.5,
        "nothing to hold on to: {off} degrees"
    );
    let (drift, off) = drifting(true);
    let drift = drift.unwrap();
    assert!((drift - 3.0).abs() < 0.6, "{drift} degrees a minute");
    assert!(off.abs() < 4.0, "held by the headset: {off} degrees");
}
