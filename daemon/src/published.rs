//! What the daemon publishes: the wearer's pose at every tick, and the state of the devices.
//! Everything that leaves the daemon (gRPC, files, other protocols) is made from these.

use posed_body::{BodyPose, Joints};
use posed_device::trouble::Trouble;
use posed_signal::{Battery, DeviceId, HostTime, Lookup, Pose, Radio, Role, Serial};
use posed_tracker::{Forces, ObjectPose, Objects, Quality, Recoveries, TrackerKind, worn};
use serde::{Serialize, Serializer, ser::SerializeStruct as _};

/// One tick's result. It is `Copy`, so that it passes from the tracker thread without allocation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PublishedPose {
    /// One more with every pose published; a step of more than one means that poses were lost on
    /// the way.
    pub sequence: u64,
    /// When the newest measurement behind the pose was taken.
    pub sample_at: HostTime,
    /// The time that the pose is valid for.
    pub target_at: HostTime,
    /// When the pose was published.
    pub publish_at: HostTime,
    /// How far to trust it.
    pub quality: Quality,
    /// The tracker that made it.
    pub kind: TrackerKind,
    /// Root and local rotations.
    pub pose: BodyPose,
    /// The same pose's joints in the world.
    pub joints: Joints,
    /// Torques and ground forces, of a tracker with physics.
    pub forces: Option<Forces>,
    /// What the tracker was given: each body part's pose at `target_at` and how it was made;
    /// indexed by [`Role`] as a number.
    pub parts: [Lookup<Pose>; Role::COUNT],
    /// How well the wearer's inertial trackers are calibrated, and how their headings wander.
    pub worn: worn::Report,
    /// The things in the scene, of a tracker that simulates one.
    pub objects: Objects,
    /// How often a simulated body had to be put back on its feet since the start.
    pub recoveries: Option<Recoveries>,
    /// The wearer's height, metres, once it was measured.
    pub measured_m: Option<f32>,
}

impl PublishedPose {
    /// Whether the pose follows a headset, or is only held.
    #[must_use]
    pub fn has_input(&self) -> bool {
        self.quality > Quality::Held
    }

    /// Whether every number that leaves the daemon with this pose is finite, and every rotation
    /// unit.
    #[must_use]
    pub fn is_sound(&self) -> bool {
        self.pose.is_sound()
            && self
                .joints
                .positions
                .iter()
                .all(|position| position.is_finite())
            && self
                .parts
                .iter()
                .all(|part| part.value().is_none_or(|pose| pose.is_sound()))
            && self.forces.as_ref().is_none_or(Forces::is_sound)
            && self.objects.is_sound()
    }
}

/// Forces in the line of a pose: N and N m.
#[derive(Serialize)]
struct ForcesLine {
    torques: Vec<[f32; 3]>,
    ground: [f32; 3],
    feet: [FootLine; 2],
}

#[derive(Serialize)]
struct FootLine {
    force: [f32; 3],
    centre: [f32; 3],
    contact: f32,
}

impl ForcesLine {
    fn of(forces: &Forces) -> Self {
        Self {
            torques: forces.torques.map(|torque| torque.to_array()).to_vec(),
            ground: forces.ground.to_array(),
            feet: forces.feet.map(|foot| FootLine {
                force: foot.force.to_array(),
                centre: foot.centre.to_array(),
                contact: foot.contact,
            }),
        }
    }
}

#[derive(Serialize)]
struct ObjectLine {
    position: [f32; 3],
    rotation: [f32; 4],
    touched: bool,
}

impl ObjectLine {
    fn of(object: &ObjectPose) -> Self {
        Self {
            position: object.position.to_array(),
            rotation: object.rotation.to_array(),
            touched: object.touched,
        }
    }
}

/// The line of `--poses` and of `posed follow --json`: times in ns, metres, quaternions x, y, z, w.
/// `forces` is there when the tracker has physics: joint torques in the joints' own frames, the
/// force of the ground on the body, and for the left and the right foot its force, its centre of
/// pressure and the probability that the foot stands. Of a tracker that simulates a body,
/// `recoveries` are the falls, drifts and faults after which it was put back on its feet, and
/// `objects` the things in the scene.
impl Serialize for PublishedPose {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let objects: Vec<_> = self.objects.iter().map(ObjectLine::of).collect();
        let optional = [
            self.forces.is_some(),
            self.recoveries.is_some(),
            !objects.is_empty(),
        ];
        let fields = 8 + optional.into_iter().filter(|there| *there).count();
        let mut line = serializer.serialize_struct("PublishedPose", fields)?;
        line.serialize_field("sample_ns", &self.sample_at.0)?;
        line.serialize_field("target_ns", &self.target_at.0)?;
        line.serialize_field("publish_ns", &self.publish_at.0)?;
        line.serialize_field("quality", self.quality.name())?;
        line.serialize_field("tracker", self.kind.name())?;
        line.serialize_field("root", &self.pose.root.to_array())?;
        line.serialize_field(
            "joints",
            &self.joints.positions.map(|position| position.to_array()),
        )?;
        line.serialize_field(
            "rotations",
            &self.pose.rotations.map(|turn| turn.to_array()),
        )?;
        if let Some(forces) = &self.forces {
            line.serialize_field("forces", &ForcesLine::of(forces))?;
        }
        if let Some(Recoveries {
            falls,
            drifts,
            faults,
        }) = self.recoveries
        {
            line.serialize_field("recoveries", &[falls, drifts, faults])?;
        }
        if !objects.is_empty() {
            line.serialize_field("objects", &objects)?;
        }
        line.end()
    }
}

/// What the daemon knows about one device.
#[derive(Debug, Clone, PartialEq)]
pub struct DeviceState {
    /// Stable while the daemon runs.
    pub id: DeviceId,
    /// Serial number; empty while it is not known.
    pub serial: Serial,
    /// Product name.
    pub model: String,
    /// What it stands for on the wearer's body.
    pub role: Role,
    /// Whether it is plugged in (or paired and in reach) now.
    pub connected: bool,
    /// The last battery report, where the device has one.
    pub battery: Option<Battery>,
    /// How well its radio is heard, where it has one.
    pub radio: Option<Radio>,
    /// Samples a second that arrived lately.
    pub rate_hz: f32,
    /// Share of the time, 0 to 1, for which the device was tracked optically.
    pub tracked_share: f32,
    /// Packets decoded.
    pub packets: u64,
    /// Packets that could not be decoded.
    pub errors: u64,
    /// Samples lost because a queue was full.
    pub dropped: u64,
    /// Whether it can buzz.
    pub has_haptics: bool,
    /// Buzzes sent to it.
    pub haptics: u64,
    /// Buzzes that it could not be sent.
    pub haptics_dropped: u64,
    /// What keeps it from being tracked well, now.
    pub troubles: Vec<Trouble>,
    /// The last pose solved; its residual and how it came about are in it.
    pub pose: Option<Pose>,
}

#[cfg(test)]
pub(crate) mod tests {
    use glam::{Quat, Vec3};
    use posed_body::{Skeleton, optimiser::FootForce};

    use super::*;

    /// A pose that differs in every number from that of another sequence number.
    pub(crate) fn pose_at(sequence: u64, target_at: HostTime) -> PublishedPose {
        let turn = 0.01 * (sequence % 100) as f32;
        let mut pose = BodyPose::rest(Vec3::new(0.02 * turn, 0.9, turn));
        for (index, rotation) in pose.rotations.iter_mut().enumerate() {
            *rotation = Quat::from_rotation_y(turn + 0.02 * index as f32);
        }
        let mut parts = [Lookup::Empty; Role::COUNT];
        let head = Pose {
            position: Vec3::new(0.0, 1.6, turn),
            ..Pose::unknown(target_at)
        };
        parts[Role::Head as usize] = Lookup::Extrapolated {
            value: head,
            by_ns: 4_000_000,
        };
        parts[Role::LeftHand as usize] = Lookup::Exact(head);
        parts[Role::RightHand as usize] = Lookup::Stale {
            value: head,
            age_ns: 700_000_000,
        };
        PublishedPose {
            sequence,
            sample_at: target_at.plus_ns(-4_000_000),
            target_at,
            publish_at: target_at.plus_ns(500_000),
            quality: Quality::Full,
            kind: TrackerKind::Ik,
            pose,
            joints: Skeleton::of_height(1.75).forward(&pose),
            forces: (sequence % 2 == 1).then(|| forces_at(turn)),
            parts,
            worn: worn::Report::default(),
            objects: (0..sequence % 3).map(object_at).collect(),
            recoveries: (sequence % 2 == 1).then_some(Recoveries {
                falls: sequence,
                drifts: 2,
                faults: 1,
            }),
            measured_m: None,
        }
    }

    fn object_at(index: u64) -> ObjectPose {
        ObjectPose {
            position: Vec3::new(index as f32, 0.1, -1.0),
            rotation: Quat::from_rotation_z(0.2 * index as f32),
            touched: index == 1,
        }
    }

    fn forces_at(number: f32) -> Forces {
        let foot = |side: f32| FootForce {
            force: Vec3::new(side, 350.0 + number, 2.0),
            centre: Vec3::new(side, 0.0, number),
            contact: 0.5 + number,
        };
        Forces {
            torques: std::array::from_fn(|joint| Vec3::new(joint as f32, number, -1.0)),
            feet: [foot(-0.1), foot(0.1)],
            ground: Vec3::new(0.0, 700.0, number),
        }
    }

    /// A pose that follows no headset.
    pub(crate) fn held_pose_at(sequence: u64, target_at: HostTime) -> PublishedPose {
        PublishedPose {
            quality: Quality::Held,
            ..pose_at(sequence, target_at)
        }
    }

    #[test]
    fn a_line_of_json_holds_times_and_all_joints() {
        let line = serde_json::to_value(pose_at(7, HostTime(9_000_000))).unwrap();
        assert_eq!(line["sample_ns"], 5_000_000);
        assert_eq!(line["publish_ns"], 9_500_000);
        assert_eq!(
            (&line["quality"], &line["tracker"]),
            (&"full".into(), &"ik".into())
        );
        assert_eq!(line["joints"].as_array().map(Vec::len), Some(22));
        assert_eq!(line["rotations"][21].as_array().map(Vec::len), Some(4));
        assert_eq!(line["joints"][0], line["root"]);
        assert_eq!(line["recoveries"], serde_json::json!([7, 2, 1]));
        assert_eq!(line["objects"].as_array().map(Vec::len), Some(1));
        let line = serde_json::to_value(pose_at(6, HostTime(9_000_000))).unwrap();
        assert!(line.get("recoveries").is_none() && line.get("objects").is_none());
    }

    #[test]
    fn numbers_that_are_not_finite_are_seen() {
        let sound = pose_at(1, HostTime(1));
        assert!(sound.is_sound());
        let mut broken = sound;
        broken.joints.positions[4].x = f32::NAN;
        assert!(!broken.is_sound());
    }
}
