//! Between the domain and `posed.v1`. No other file knows both.

use glam::{Quat, Vec3};
use posed_body::{BodyPose, JOINTS, Joints, optimiser::FootForce, skeleton};
use posed_device::{
    haptic::{Haptic, HapticError},
    trouble::Trouble,
};
use posed_proto::v1;
use posed_signal::{Battery, DeviceId, HostTime, Lookup, Pose, PoseHow, Role};
use posed_tracker::{
    Forces, ObjectMove, ObjectPose, Objects, Quality, Recoveries, Stance, TrackerKind, Wearer,
};

use crate::{
    heights::{Avatar, Heights},
    output::{
        export,
        names::Names,
        record::{Format, Recording, Wish},
    },
    pipeline::source::Buzz,
    published::{DeviceState, PublishedPose},
};

/// A buzz unless told otherwise: seconds, Hz, strength.
const BUZZ: [f32; 3] = [0.1, 160.0, 1.0];

/// A message does not hold what the interface says.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the server sent a pose whose {field} {problem}: are its version and this one the same?")]
pub struct ConvertError {
    /// The field.
    pub field: &'static str,
    /// What is wrong with it.
    pub problem: &'static str,
}

type Result<T> = std::result::Result<T, ConvertError>;

fn missing(field: &'static str) -> ConvertError {
    ConvertError {
        field,
        problem: "is missing",
    }
}

fn unknown(field: &'static str) -> ConvertError {
    ConvertError {
        field,
        problem: "has a value that is not known",
    }
}

// --- numbers ---

fn vector(v: Vec3) -> v1::Vector3 {
    v1::Vector3 {
        x: v.x,
        y: v.y,
        z: v.z,
    }
}

fn quaternion(q: Quat) -> v1::Quaternion {
    v1::Quaternion {
        x: q.x,
        y: q.y,
        z: q.z,
        w: q.w,
    }
}

fn to_vec3(v: &v1::Vector3) -> Vec3 {
    Vec3::new(v.x, v.y, v.z)
}

fn to_quat(q: &v1::Quaternion) -> Quat {
    Quat::from_xyzw(q.x, q.y, q.z, q.w)
}

// --- words ---

fn role(role: Role) -> v1::Role {
    match role {
        Role::None => v1::Role::Unspecified,
        Role::Head => v1::Role::Head,
        Role::LeftHand => v1::Role::LeftHand,
        Role::RightHand => v1::Role::RightHand,
        Role::Waist => v1::Role::Waist,
        Role::Chest => v1::Role::Chest,
        Role::LeftFoot => v1::Role::LeftFoot,
        Role::RightFoot => v1::Role::RightFoot,
        Role::LeftKnee => v1::Role::LeftKnee,
        Role::RightKnee => v1::Role::RightKnee,
        Role::LeftElbow => v1::Role::LeftElbow,
        Role::RightElbow => v1::Role::RightElbow,
        Role::LeftWrist => v1::Role::LeftWrist,
        Role::RightWrist => v1::Role::RightWrist,
    }
}

fn quality(quality: Quality) -> v1::Quality {
    match quality {
        Quality::Held => v1::Quality::Held,
        Quality::Degraded => v1::Quality::Degraded,
        Quality::Partial => v1::Quality::Partial,
        Quality::Full => v1::Quality::Full,
    }
}

pub(crate) fn tracker(kind: TrackerKind) -> v1::Tracker {
    match kind {
        TrackerKind::Ik => v1::Tracker::Ik,
        TrackerKind::HmdNemo => v1::Tracker::HmdNemo,
        TrackerKind::Pip => v1::Tracker::Pip,
        TrackerKind::QuestSim => v1::Tracker::Questsim,
    }
}

fn tracking(how: PoseHow) -> v1::Tracking {
    match how {
        PoseHow::Lost => v1::Tracking::Lost,
        PoseHow::Inertial => v1::Tracking::Inertial,
        PoseHow::Optical => v1::Tracking::Optical,
    }
}

/// The word, the nanoseconds that go with it, and the value.
fn lookup<T: Copy>(lookup: &Lookup<T>) -> Option<(v1::Lookup, i64, T)> {
    match *lookup {
        Lookup::Exact(value) => Some((v1::Lookup::Exact, 0, value)),
        Lookup::Interpolated(value) => Some((v1::Lookup::Interpolated, 0, value)),
        Lookup::Extrapolated { value, by_ns } => Some((v1::Lookup::Extrapolated, by_ns, value)),
        Lookup::Stale { value, age_ns } => Some((v1::Lookup::Stale, age_ns, value)),
        Lookup::Empty => None,
    }
}

fn to_role(wire: v1::Role) -> Role {
    Role::ALL
        .into_iter()
        .find(|known| role(*known) == wire)
        .unwrap_or_default()
}

fn to_quality(wire: v1::Quality) -> Result<Quality> {
    [
        Quality::Held,
        Quality::Degraded,
        Quality::Partial,
        Quality::Full,
    ]
    .into_iter()
    .find(|known| quality(*known) == wire)
    .ok_or(unknown("quality"))
}

pub(super) fn to_tracker(wire: v1::Tracker) -> Result<TrackerKind> {
    let mut all = TrackerKind::ALL.into_iter();
    all.find(|known| tracker(*known) == wire)
        .ok_or(unknown("tracker"))
}

fn to_tracking(wire: v1::Tracking) -> Result<PoseHow> {
    [PoseHow::Lost, PoseHow::Inertial, PoseHow::Optical]
        .into_iter()
        .find(|known| tracking(*known) == wire)
        .ok_or(unknown("parts"))
}

fn to_lookup<T>(wire: v1::Lookup, ns: i64, value: T) -> Result<Lookup<T>> {
    match wire {
        v1::Lookup::Exact => Ok(Lookup::Exact(value)),
        v1::Lookup::Interpolated => Ok(Lookup::Interpolated(value)),
        v1::Lookup::Extrapolated => Ok(Lookup::Extrapolated { value, by_ns: ns }),
        v1::Lookup::Stale => Ok(Lookup::Stale { value, age_ns: ns }),
        v1::Lookup::Unspecified => Err(unknown("parts")),
    }
}

// --- messages ---

fn rigid_pose(pose: &Pose) -> v1::RigidPose {
    v1::RigidPose {
        time_ns: pose.at.0,
        position: Some(vector(pose.position)),
        rotation: Some(quaternion(pose.rotation)),
        velocity: Some(vector(pose.velocity)),
        angular_velocity: Some(vector(pose.angular_velocity)),
        residual_rad: pose.residual_rad,
        tracking: tracking(pose.how).into(),
    }
}

fn to_rigid_pose(wire: &v1::RigidPose) -> Result<Pose> {
    let field = missing("parts");
    Ok(Pose {
        at: HostTime(wire.time_ns),
        position: wire.position.as_ref().map(to_vec3).ok_or(field.clone())?,
        rotation: wire.rotation.as_ref().map(to_quat).ok_or(field.clone())?,
        velocity: wire.velocity.as_ref().map(to_vec3).ok_or(field.clone())?,
        angular_velocity: wire.angular_velocity.as_ref().map(to_vec3).ok_or(field)?,
        residual_rad: wire.residual_rad,
        how: to_tracking(wire.tracking())?,
    })
}

/// The body parts that were ever measured.
fn parts(parts: &[Lookup<Pose>; Role::COUNT]) -> Vec<v1::Part> {
    let part = |(part, of): (&Lookup<Pose>, Role)| {
        let (word, offset_ns, pose) = lookup(part)?;
        Some(v1::Part {
            role: role(of).into(),
            lookup: word.into(),
            offset_ns,
            pose: Some(rigid_pose(&pose)),
        })
    };
    parts.iter().zip(Role::ALL).filter_map(part).collect()
}

fn foot_force(foot: &FootForce) -> v1::FootForce {
    v1::FootForce {
        force: Some(vector(foot.force)),
        centre: Some(vector(foot.centre)),
        contact: foot.contact,
    }
}

fn to_foot_force(wire: Option<&v1::FootForce>) -> Result<FootForce> {
    let wire = wire.ok_or(missing("forces"))?;
    let required = |v: &Option<v1::Vector3>| v.as_ref().map(to_vec3).ok_or(missing("forces"));
    Ok(FootForce {
        force: required(&wire.force)?,
        centre: required(&wire.centre)?,
        contact: wire.contact,
    })
}

fn forces(forces: &Forces) -> v1::Forces {
    let [left, right] = &forces.feet;
    v1::Forces {
        joint_torques: forces.torques.map(vector).to_vec(),
        ground: Some(vector(forces.ground)),
        left_foot: Some(foot_force(left)),
        right_foot: Some(foot_force(right)),
    }
}

fn to_forces(wire: &v1::Forces) -> Result<Forces> {
    let torques: Vec<Vec3> = wire.joint_torques.iter().map(to_vec3).collect();
    Ok(Forces {
        torques: torques.try_into().map_err(|_| ConvertError {
            field: "forces",
            problem: "do not have 22 torques",
        })?,
        feet: [
            to_foot_force(wire.left_foot.as_ref())?,
            to_foot_force(wire.right_foot.as_ref())?,
        ],
        ground: wire.ground.as_ref().map(to_vec3).ok_or(missing("forces"))?,
    })
}

/// A published pose as a message.
pub(super) fn pose(pose: &PublishedPose) -> v1::Pose {
    v1::Pose {
        sequence: pose.sequence,
        sample_time_ns: pose.sample_at.0,
        target_time_ns: pose.target_at.0,
        publish_time_ns: pose.publish_at.0,
        quality: quality(pose.quality).into(),
        tracker: tracker(pose.kind).into(),
        root: Some(vector(pose.pose.root)),
        joint_rotations: pose.pose.rotations.map(quaternion).to_vec(),
        joint_positions: pose.joints.positions.map(vector).to_vec(),
        parts: parts(&pose.parts),
        forces: pose.forces.as_ref().map(forces),
        recoveries: pose.recoveries.map(recoveries),
        objects: (0..).zip(pose.objects.iter()).map(object).collect(),
    }
}

fn recoveries(counts: Recoveries) -> v1::Recoveries {
    v1::Recoveries {
        falls: counts.falls,
        drifts: counts.drifts,
        faults: counts.faults,
    }
}

fn object((index, pose): (u32, &ObjectPose)) -> v1::SceneObject {
    v1::SceneObject {
        index,
        position: Some(vector(pose.position)),
        rotation: Some(quaternion(pose.rotation)),
        touched: pose.touched,
    }
}

fn to_objects(wire: &[v1::SceneObject]) -> Result<Objects> {
    let problem = "are out of order or too many";
    let field = "objects";
    let mut objects = Objects::NONE;
    for (index, object) in wire.iter().enumerate() {
        let position = object
            .position
            .as_ref()
            .map(to_vec3)
            .ok_or(missing(field))?;
        let rotation = object
            .rotation
            .as_ref()
            .map(to_quat)
            .ok_or(missing(field))?;
        let touched = object.touched;
        objects.push(ObjectPose {
            position,
            rotation,
            touched,
        });
        if object.index as usize != index || objects.len() != index + 1 {
            return Err(ConvertError { field, problem });
        }
    }
    Ok(objects)
}

/// The pose that a message holds.
///
/// # Errors
/// A field is missing, has the wrong number of joints, or a number is not finite.
pub(crate) fn to_pose(wire: &v1::Pose) -> Result<PublishedPose> {
    let joints = |field| ConvertError {
        field,
        problem: "does not have 22 entries",
    };
    let rotations: Vec<Quat> = wire.joint_rotations.iter().map(to_quat).collect();
    let rotations: [Quat; JOINTS] = rotations
        .try_into()
        .map_err(|_| joints("joint_rotations"))?;
    let positions: Vec<Vec3> = wire.joint_positions.iter().map(to_vec3).collect();
    let positions = positions
        .try_into()
        .map_err(|_| joints("joint_positions"))?;
    let mut in_world = rotations;
    for (index, parent) in skeleton::PARENTS.into_iter().enumerate() {
        if let Some(parent) = parent {
            in_world[index] = in_world[parent] * rotations[index];
        }
    }
    let root = wire.root.as_ref().map(to_vec3).ok_or(missing("root"))?;
    let mut parts = [Lookup::Empty; Role::COUNT];
    for part in &wire.parts {
        let pose = to_rigid_pose(part.pose.as_ref().ok_or(missing("parts"))?)?;
        let slot = &mut parts[to_role(part.role()) as usize];
        *slot = to_lookup(part.lookup(), part.offset_ns, pose)?;
    }
    let pose = PublishedPose {
        sequence: wire.sequence,
        sample_at: HostTime(wire.sample_time_ns),
        target_at: HostTime(wire.target_time_ns),
        publish_at: HostTime(wire.publish_time_ns),
        quality: to_quality(wire.quality())?,
        kind: to_tracker(wire.tracker())?,
        pose: BodyPose { root, rotations },
        joints: Joints {
            positions,
            rotations: in_world,
        },
        forces: wire.forces.as_ref().map(to_forces).transpose()?,
        parts,
        worn: Default::default(),
        objects: to_objects(&wire.objects)?,
        recoveries: wire.recoveries.as_ref().map(|counts| Recoveries {
            falls: counts.falls,
            drifts: counts.drifts,
            faults: counts.faults,
        }),
        measured_m: None,
    };
    let problem = "holds numbers that are not finite or rotations that are not unit";
    if pose.is_sound() {
        Ok(pose)
    } else {
        Err(ConvertError {
            field: "content",
            problem,
        })
    }
}

/// The answer to `GetPose`; `None` while there is no pose.
pub(super) fn pose_at(found: &Lookup<PublishedPose>) -> Option<v1::GetPoseResponse> {
    let (word, offset_ns, value) = lookup(found)?;
    Some(v1::GetPoseResponse {
        pose: Some(pose(&value)),
        lookup: word.into(),
        offset_ns,
    })
}

fn battery(battery: &Battery) -> v1::Battery {
    v1::Battery {
        time_ns: battery.at.0,
        charge: battery.charge,
        charging: battery.charging,
    }
}

/// A device as a message.
pub(super) fn device(device: &DeviceState) -> v1::Device {
    v1::Device {
        id: device.id.0.into(),
        serial: device.serial.to_string(),
        model: device.model.clone(),
        role: role(device.role).into(),
        connected: device.connected,
        battery: device.battery.as_ref().map(battery),
        rate_hz: device.rate_hz,
        tracked_share: device.tracked_share,
        packets: device.packets,
        errors: device.errors,
        dropped: device.dropped,
        has_haptics: device.has_haptics,
        haptics: device.haptics,
        haptics_dropped: device.haptics_dropped,
        troubles: device.troubles.iter().map(trouble).collect(),
        pose: device.pose.as_ref().map(rigid_pose),
    }
}

fn trouble(trouble: &Trouble) -> v1::DeviceTrouble {
    use v1::device_trouble::Kind;
    let kind = match trouble {
        Trouble::Dark => Kind::Dark,
        Trouble::Unmeasured => Kind::Unmeasured,
        Trouble::Alone(_) => Kind::Alone,
        Trouble::New(_) => Kind::New,
        Trouble::Moved(_) => Kind::Moved,
        Trouble::Shared(_) => Kind::Shared,
        Trouble::Unlisted(_) => Kind::Unlisted,
        Trouble::Misplaced(_) => Kind::Misplaced,
        Trouble::Contradicted => Kind::Contradicted,
    };
    let base_station = trouble.source().map(|source| source.to_string());
    v1::DeviceTrouble {
        kind: kind.into(),
        base_station: base_station.unwrap_or_default(),
        advice: trouble.to_string(),
    }
}

/// A buzz asked for; absent numbers are those of a short, firm one.
pub(super) fn to_buzz(wire: &v1::ApplyHapticsRequest) -> std::result::Result<Buzz, HapticError> {
    let [seconds, hertz, strength] = BUZZ;
    let device = u8::try_from(wire.device).unwrap_or(u8::MAX);
    Ok(Buzz {
        device: DeviceId(device),
        haptic: Haptic::new(
            wire.duration_s.unwrap_or(seconds),
            wire.frequency_hz.unwrap_or(hertz),
            wire.amplitude.unwrap_or(strength),
        )?,
    })
}

/// The wearer's skeleton as a message.
pub(super) fn skeleton(wearer: &Wearer) -> v1::Skeleton {
    let joint = |index: usize| v1::SkeletonJoint {
        name: skeleton::NAMES[index].into(),
        parent: skeleton::PARENTS[index].map(|parent| parent as u32),
        offset: Some(vector(wearer.skeleton.offsets[index])),
    };
    v1::Skeleton {
        height_m: wearer.height,
        joints: (0..JOINTS).map(joint).collect(),
    }
}

// --- control ---

/// The word for a tracker that a server names, also where this program does not know it.
pub(crate) fn tracker_name(wire: v1::Tracker) -> &'static str {
    to_tracker(wire).map_or(wire.as_str_name(), TrackerKind::name)
}

/// A role's name, as the command line has it.
pub(crate) fn role_name(wire: v1::Role) -> &'static str {
    to_role(wire).name()
}

/// Stances, as `Calibrate` names them; `None` where none is named.
pub(super) fn to_stance(wire: v1::Stance) -> Option<Stance> {
    match wire {
        v1::Stance::Unspecified => None,
        v1::Stance::TPose => Some(Stance::TPose),
        v1::Stance::Straight => Some(Stance::Straight),
        v1::Stance::Crouch => Some(Stance::Crouch),
    }
}

/// The inverse of [`to_stance`].
pub(crate) fn stance(stance: Stance) -> v1::Stance {
    match stance {
        Stance::TPose => v1::Stance::TPose,
        Stance::Straight => v1::Stance::Straight,
        Stance::Crouch => v1::Stance::Crouch,
    }
}

/// Where a thing is to go; `None` without a position. Whether it can go there is not asked here.
pub(super) fn to_object_move(wire: &v1::MoveObjectRequest) -> Option<ObjectMove> {
    let or_zero = |v: &Option<v1::Vector3>| v.as_ref().map_or(Vec3::ZERO, to_vec3);
    Some(ObjectMove {
        index: wire.index as usize,
        position: wire.position.as_ref().map(to_vec3)?,
        rotation: wire.rotation.as_ref().map_or(Quat::IDENTITY, to_quat),
        velocity: or_zero(&wire.velocity),
        angular_velocity: or_zero(&wire.angular_velocity),
    })
}

/// What becomes of the avatar's height, as `SetHeight` says it.
pub(super) fn to_avatar(wire: Option<f32>) -> Avatar {
    match wire {
        None => Avatar::Keep,
        Some(0.0) => Avatar::Own,
        Some(metres) => Avatar::Metres(metres),
    }
}

/// The inverse of [`to_avatar`].
pub(crate) fn avatar(avatar: Avatar) -> Option<f32> {
    match avatar {
        Avatar::Keep => None,
        Avatar::Own => Some(0.0),
        Avatar::Metres(metres) => Some(metres),
    }
}

fn format(format: Format) -> v1::RecordingFormat {
    match format {
        Format::Poses => v1::RecordingFormat::Poses,
        Format::Motion(export::Format::Bvh) => v1::RecordingFormat::Bvh,
        Format::Motion(export::Format::Glb) => v1::RecordingFormat::Glb,
    }
}

fn names(names: Option<Names>) -> v1::JointNames {
    match names {
        None => v1::JointNames::Unspecified,
        Some(Names::Smpl) => v1::JointNames::Smpl,
        Some(Names::Unity) => v1::JointNames::Unity,
        Some(Names::Vrm) => v1::JointNames::Vrm,
        Some(Names::Mixamo) => v1::JointNames::Mixamo,
        Some(Names::OpenXr) => v1::JointNames::Openxr,
    }
}

/// What is to be recorded; `None` where format or names are not known.
pub(super) fn to_wish(wire: v1::StartRecordingRequest) -> Option<Wish> {
    let known = |known: &Format| format(*known) as i32 == wire.format;
    let mut all = Names::ALL.into_iter().map(Some).chain([None]);
    Some(Wish {
        format: Format::ALL.into_iter().find(known)?,
        names: all.find(|known| names(*known) as i32 == wire.names)?,
        name: wire.name,
    })
}

/// A wish to record as a message.
pub(crate) fn wish(wish: &Wish) -> v1::StartRecordingRequest {
    v1::StartRecordingRequest {
        format: format(wish.format).into(),
        name: wish.name.clone(),
        names: names(wish.names).into(),
    }
}

/// A recording as a message.
pub(super) fn recording(recording: &Recording) -> v1::Recording {
    v1::Recording {
        path: recording.path.display().to_string(),
        format: format(recording.format).into(),
        poses: recording.poses,
        lost: recording.lost,
        error: recording.error.clone().unwrap_or_default(),
    }
}

/// The answer to `GetControlState`.
pub(super) fn control_state(
    heights: &Heights,
    chosen: TrackerKind,
    trackers: &[TrackerKind],
    recorded: Option<&Recording>,
) -> v1::GetControlStateResponse {
    v1::GetControlStateResponse {
        height_m: heights.wearer,
        avatar_height_m: heights.avatar,
        tracker: tracker(chosen).into(),
        trackers: trackers.iter().map(|kind| tracker(*kind).into()).collect(),
        recording: recorded.map(recording),
    }
}

#[cfg(test)]
mod tests {
    use posed_signal::{DeviceId, Serial};

    use super::*;
    use crate::published::tests::pose_at;

    #[test]
    fn a_pose_survives_the_way_there_and_back() {
        for sequence in 0..200 {
            let mut before = pose_at(sequence, HostTime(1_000_000_000 + sequence));
            before.kind = TrackerKind::ALL[sequence as usize % 4];
            let after = to_pose(&pose(&before)).unwrap();
            assert_eq!(after, before);
        }
    }

    #[test]
    fn every_word_survives_the_way_there_and_back() {
        for known in Role::ALL {
            assert_eq!(to_role(role(known)), known);
            assert_eq!(role(known) as i32, known as i32, "the numbers are the same");
        }
        for known in [PoseHow::Lost, PoseHow::Inertial, PoseHow::Optical] {
            assert_eq!(to_tracking(tracking(known)), Ok(known));
        }
        for known in [
            Quality::Held,
            Quality::Degraded,
            Quality::Partial,
            Quality::Full,
        ] {
            assert_eq!(to_quality(quality(known)), Ok(known));
        }
    }

    #[test]
    fn wishes_to_record_survive_the_way_there_and_back() {
        let all_names = Names::ALL.into_iter().map(Some).chain([None]);
        for (format, names) in Format::ALL.into_iter().cycle().zip(all_names) {
            let before = Wish {
                format,
                name: "walk".into(),
                names,
            };
            assert_eq!(to_wish(wish(&before)), Some(before));
        }
        assert_eq!(to_wish(v1::StartRecordingRequest::default()), None);
        for known in [Avatar::Keep, Avatar::Own, Avatar::Metres(1.9)] {
            assert_eq!(to_avatar(avatar(known)), known);
        }
        for known in Stance::ALL {
            assert_eq!(to_stance(stance(known)), Some(known));
        }
    }

    #[test]
    fn messages_that_hold_no_pose_are_refused() {
        let good = pose(&pose_at(1, HostTime(1)));
        let field = |wire: &v1::Pose| to_pose(wire).unwrap_err().field;
        assert_eq!(field(&v1::Pose::default()), "joint_rotations");
        assert_eq!(
            field(&v1::Pose {
                root: None,
                ..good.clone()
            }),
            "root"
        );
        let mut short = good.clone();
        short.joint_positions.pop();
        assert_eq!(field(&short), "joint_positions");
        assert_eq!(
            field(&v1::Pose {
                quality: 77,
                ..good.clone()
            }),
            "quality"
        );
        let mut infinite = good.clone();
        infinite.joint_positions[3].y = f32::INFINITY;
        assert_eq!(field(&infinite), "content");
        let object = v1::SceneObject {
            index: 0,
            position: Some(v1::Vector3::default()),
            rotation: Some(quaternion(Quat::IDENTITY)),
            touched: false,
        };
        let number = |index| v1::SceneObject { index, ..object };
        let with = |objects| v1::Pose {
            objects,
            ..good.clone()
        };
        assert_eq!(to_pose(&with(vec![object])).unwrap().objects.len(), 1);
        assert_eq!(field(&with((0..17).map(number).collect())), "objects");
        assert_eq!(field(&with(vec![number(1)])), "objects");
        let placeless = v1::SceneObject {
            position: None,
            ..object
        };
        assert_eq!(field(&with(vec![placeless])), "objects");
        let turnless = v1::SceneObject {
            rotation: Some(v1::Quaternion::default()),
            ..object
        };
        assert_eq!(field(&with(vec![turnless])), "content");
        let mut partless = good.clone();
        partless.parts[0].pose = None;
        assert_eq!(field(&partless), "parts");
    }

    #[test]
    fn devices_and_skeletons_become_messages() {
        let state = DeviceState {
            id: DeviceId(3),
            serial: Serial::new("LHR-DFCF00EE"),
            model: "Index headset".into(),
            role: Role::Head,
            connected: true,
            radio: None,
            battery: Some(Battery {
                at: HostTime(5),
                charge: 0.5,
                charging: true,
            }),
            rate_hz: 250.0,
            tracked_share: 0.99,
            packets: 1,
            errors: 2,
            dropped: 3,
            has_haptics: true,
            haptics: 4,
            haptics_dropped: 5,
            troubles: vec![
                Trouble::Dark,
                Trouble::Shared(posed_device::lighthouse::base_station::Source::Channel(3)),
            ],
            pose: Some(Pose::unknown(HostTime(9))),
        };
        let wire = device(&state);
        assert_eq!(
            (wire.id, wire.role(), wire.serial.as_str()),
            (3, v1::Role::Head, "LHR-DFCF00EE")
        );
        assert_eq!((wire.packets, wire.errors, wire.dropped), (1, 2, 3));
        assert_eq!((wire.haptics, wire.haptics_dropped), (4, 5));
        assert_eq!(wire.troubles[0].kind(), v1::device_trouble::Kind::Dark);
        assert_eq!(wire.troubles[0].base_station, "");
        assert_eq!(wire.troubles[1].kind(), v1::device_trouble::Kind::Shared);
        assert_eq!(wire.troubles[1].base_station, "channel 3");
        assert!(wire.troubles[1].advice.contains("another channel"));
        assert_eq!(wire.pose.unwrap().tracking(), v1::Tracking::Lost);

        let wire = skeleton(&Wearer::of_height(1.8));
        assert_eq!(wire.joints.len(), JOINTS);
        assert_eq!(
            (wire.joints[0].parent, wire.joints[4].parent),
            (None, Some(1))
        );
        assert_eq!(wire.joints[21].name, "right_wrist");
    }
}
