//! The ruler: how far a predicted motion is from the true one, as the literature measures it.
//!
//! Every metric is a number for one clip; tables are means over clips, each clip counting once,
//! and leave out clips for which a metric has no value. Predictions and truths are compared frame
//! by frame; the first frame, which has no past, is left out by the caller. "World", "head-aligned"
//! and "root-aligned" say what was moved (never turned) before comparing: nothing, the prediction
//! so that its head joint is the true one, or so that its pelvis is.
//!
//! Sources: AvatarPoser (Jiang et al. 2022) and AGRoL (Du et al. 2023) for positions, velocities
//! and local rotations; TransPose and PIP (Yi et al. 2021, 2022) for SIP, jitter, zero-moment point
//! and translation; AvatarJLM (Zheng et al. 2023) for the feet; QuestSim (Winkler et al. 2022) for
//! the root and the tracked parts; PHC (Luo et al. 2023) for falls.

mod balance;
mod feet;
mod position;
mod reduced;
mod rotation;

use glam::{DVec3, Quat, Vec3};
use posed_body::{BodyPose, JOINTS, Joint, Skeleton, skeleton::PARENTS};

pub use balance::{PointMass, point_masses};

/// A motion in the form that the metrics need.
#[derive(Debug, Clone, PartialEq)]
pub struct Track {
    /// Frames a second.
    pub fps: f64,
    /// Joint positions in the world, metres.
    pub positions: Vec<[Vec3; JOINTS]>,
    /// Local rotations; the pelvis's to the world.
    pub local: Vec<[Quat; JOINTS]>,
    /// Rotations to the world.
    pub world: Vec<[Quat; JOINTS]>,
}

impl Track {
    /// Poses of one skeleton at a constant rate.
    #[must_use]
    pub fn new(fps: f64, skeleton: &Skeleton, poses: &[BodyPose]) -> Self {
        let joints: Vec<_> = poses.iter().map(|pose| skeleton.forward(pose)).collect();
        Self {
            fps,
            positions: joints.iter().map(|joints| joints.positions).collect(),
            local: poses.iter().map(|pose| pose.rotations).collect(),
            world: joints.iter().map(|joints| joints.rotations).collect(),
        }
    }

    /// From joint positions and local rotations, which need not fit any bones.
    #[must_use]
    pub fn from_parts(
        fps: f64,
        positions: Vec<[Vec3; JOINTS]>,
        local: Vec<[Quat; JOINTS]>,
    ) -> Self {
        let turn = |local: &[Quat; JOINTS]| {
            let mut world = *local;
            for (index, parent) in PARENTS.into_iter().enumerate() {
                if let Some(parent) = parent {
                    world[index] = world[parent] * local[index];
                }
            }
            world
        };
        let world = local.iter().map(turn).collect();
        Self {
            fps,
            positions,
            local,
            world,
        }
    }

    /// Number of frames.
    #[must_use]
    pub fn len(&self) -> usize {
        self.positions.len()
    }

    /// Whether there is no frame.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.positions.is_empty()
    }

    /// A joint's position.
    fn at(&self, frame: usize, joint: Joint) -> DVec3 {
        self.positions[frame][joint as usize].as_dvec3()
    }
}

macro_rules! metrics {
    ($($(#[doc = $doc:expr])+ $variant:ident $name:literal $unit:literal,)+) => {
        /// What can be measured.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[repr(u8)]
        pub enum Metric {
            $($(#[doc = $doc])+ $variant,)+
        }

        impl Metric {
            /// Every metric, in the order of tables.
            pub const ALL: &[Self] = &[$(Self::$variant,)+];
            /// Their number.
            pub const COUNT: usize = Self::ALL.len();

            /// The name in tables and JSON, unit last.
            #[must_use]
            pub fn name(self) -> &'static str {
                match self { $(Self::$variant => $name,)+ }
            }

            /// The unit, as printed.
            #[must_use]
            pub fn unit(self) -> &'static str {
                match self { $(Self::$variant => $unit,)+ }
            }
        }
    };
}

metrics! {
    /// Mean per joint position error, head-aligned, over all 22 joints: the MPJPE of AvatarPoser,
    /// AGRoL, HMD-Poser and HMD-NeMo.
    MpjpeHead "mpjpe_head_cm" "cm",
    /// The same in the world.
    MpjpeWorld "mpjpe_world_cm" "cm",
    /// The same root-aligned (TransPose's joint error, which also undoes the root's rotation).
    MpjpeRoot "mpjpe_root_cm" "cm",
    /// The head-aligned error of the joints above the waist (AGRoL: 3, 6, 9 and 12 to 21).
    UpperPe "upper_pe_cm" "cm",
    /// The head-aligned error of the others (AGRoL).
    LowerPe "lower_pe_cm" "cm",
    /// The head-aligned error of the wrists (AGRoL's hand error).
    HandPe "hand_pe_cm" "cm",
    /// Mean per joint velocity error: length of the difference of frame-to-frame velocities of
    /// head-aligned positions (AGRoL).
    Mpjve "mpjve_cm_s" "cm/s",
    /// Mean angle between true and predicted local rotations, the root left out.
    MpjreGeodesic "mpjre_geodesic_deg" "deg",
    /// Mean absolute difference of the components of the local axis-angle vectors, wrapped at half
    /// a turn, the root left out: the MPJRE of AvatarPoser and AGRoL, about half of the geodesic.
    MpjreComponent "mpjre_component_deg" "deg",
    /// Distance of the pelvises in the world (QuestSim's root error).
    RootPosition "root_position_cm" "cm",
    /// Angle between the pelvises' rotations.
    RootRotation "root_rotation_deg" "deg",
    /// Mean angle between the world rotations of hips and shoulders (TransPose, PIP), the root's
    /// error with them.
    Sip "sip_deg" "deg",
    /// The same without the root's own rotation, which PIP's sensor tells and its evaluation leaves
    /// out: pelvis, ankles, toes and wrists do not turn in either motion.
    PipSip "pip_sip_deg" "deg",
    /// PIP's angle error: mean angle between world rotations after the same, over SMPL's 24 joints;
    /// the hands, which posed lacks, count as what they hang on.
    PipAngle "pip_angle_deg" "deg",
    /// PIP's joint error: mean distance from the pelvis's joint on, after the same, over all 22
    /// joints.
    PipJoint "pip_joint_cm" "cm",
    /// Mean length of the third difference of the predicted positions in the world (PIP's absolute
    /// jitter). Compare it with the truth's.
    Jitter "jitter_km_s3" "km/s3",
    /// The same of the truth.
    TrueJitter "true_jitter_km_s3" "km/s3",
    /// Mean distance of head and wrists from the truth in the world (QuestSim's MHPE, taken at the
    /// joints).
    Mhpe "mhpe_cm" "cm",
    /// Mean angle of the same three (QuestSim's MHRE).
    Mhre "mhre_deg" "deg",
    /// Mean absolute component of the predicted frame-to-frame displacement of ankles and toes
    /// where the true one is at most 1 cm, zero elsewhere (AvatarJLM's skating error, over all
    /// frames; its threshold means 60 frames a second).
    FootSkate "foot_skate_cm" "cm",
    /// Mean level speed of predicted ankles and toes in those frames only.
    FootSlide "foot_slide_cm_s" "cm/s",
    /// The same of the truth.
    TrueFootSlide "true_foot_slide_cm_s" "cm/s",
    /// Mean depth of the lowest joint below the lowest true one of the clip (AvatarJLM's
    /// penetration, with joints for vertices; the lowest is the 5th percentile over frames).
    Penetration "penetration_cm" "cm",
    /// Mean height of the lowest joint above the same (AvatarJLM's floating).
    Floating "floating_cm" "cm",
    /// Mean distance of the zero-moment point from the standing feet, less 10 cm for their size,
    /// metres; a foot stands while its toe joint is at most 1 cm above the mean of the first frames
    /// (PIP). Point masses at the segments' centres stand for PIP's rigid bodies.
    Zmp "zmp_m" "m",
    /// The same of the truth.
    TrueZmp "true_zmp_m" "m",
    /// Error of the pelvis' displacement over stretches on which the truth travelled 2 m (PIP's
    /// cumulative translation error, which is drawn over 1 to 7 m).
    Translation "translation_2m_cm" "cm",
    /// Share of frames whose mean world joint error is above 0.5 m (PHC counts a clip in which that
    /// happens as failed).
    Lost "lost_percent" "%",
    /// How often a minute that begins; it has to fall below 0.25 m to count again.
    Falls "falls_per_min" "1/min",
}

/// The metrics of one clip, or means over clips. `None`: the clip says nothing about it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scores {
    values: [Option<f64>; Metric::COUNT],
    /// Error of the pelvis' displacement, centimetres, over stretches on which the truth travelled
    /// 1, 2 .. 7 m (PIP's cumulative translation error).
    pub translation_cm: [Option<f64>; 7],
}

impl Scores {
    /// No value for anything.
    pub const EMPTY: Self = Self {
        values: [None; Metric::COUNT],
        translation_cm: [None; 7],
    };

    /// A metric's value.
    #[must_use]
    pub fn get(&self, metric: Metric) -> Option<f64> {
        self.values[metric as usize]
    }

    /// Measures `predicted` against `truth`, which have the same rate and number of frames; where
    /// one is longer, its end is left out. `masses` are the wearer's.
    #[must_use]
    pub fn measure(predicted: &Track, truth: &Track, masses: &[PointMass]) -> Self {
        let mut scores = Self::EMPTY;
        let pair = Pair {
            p: predicted,
            t: truth,
            frames: predicted.len().min(truth.len()),
        };
        for &metric in Metric::ALL {
            let value = pair.value(metric, masses).filter(|value| value.is_finite());
            scores.values[metric as usize] = value;
        }
        for (metres, slot) in (1u8..).zip(&mut scores.translation_cm) {
            *slot = position::translation(&pair, f64::from(metres));
        }
        scores
    }

    /// Means over clips, each metric over those that have it.
    #[must_use]
    pub fn mean<'a>(scores: impl Iterator<Item = &'a Self> + Clone) -> Self {
        let over = |value: &dyn Fn(&Self) -> Option<f64>| mean(scores.clone().filter_map(value));
        Self {
            values: std::array::from_fn(|index| over(&|scores: &Self| scores.values[index])),
            translation_cm: std::array::from_fn(|index| {
                over(&|scores: &Self| scores.translation_cm[index])
            }),
        }
    }
}

/// Two motions side by side.
struct Pair<'a> {
    p: &'a Track,
    t: &'a Track,
    frames: usize,
}

impl Pair<'_> {
    fn value(&self, metric: Metric, masses: &[PointMass]) -> Option<f64> {
        use position::Align;
        match metric {
            Metric::MpjpeHead => position::mean_error(self, Align::Head, &Joint::ALL),
            Metric::MpjpeWorld => position::mean_error(self, Align::World, &Joint::ALL),
            Metric::MpjpeRoot => position::mean_error(self, Align::Root, &Joint::ALL),
            Metric::UpperPe => position::mean_error(self, Align::Head, &position::UPPER),
            Metric::LowerPe => position::mean_error(self, Align::Head, &position::LOWER),
            Metric::HandPe => position::mean_error(self, Align::Head, &position::HANDS),
            Metric::Mpjve => position::velocity_error(self),
            Metric::MpjreGeodesic => rotation::local_geodesic(self),
            Metric::MpjreComponent => rotation::local_components(self),
            Metric::RootPosition => position::mean_error(self, Align::World, &[Joint::Pelvis]),
            Metric::RootRotation => rotation::world_geodesic(self, &[Joint::Pelvis]),
            Metric::Sip => rotation::world_geodesic(self, &rotation::SIP),
            Metric::PipSip => {
                reduced::angle_error(self, &rotation::SIP.map(|joint| joint as usize))
            }
            Metric::PipAngle => reduced::angle_error(self, &reduced::SMPL),
            Metric::PipJoint => reduced::joint_error(self),
            Metric::Jitter => position::jitter(self.p, self.frames),
            Metric::TrueJitter => position::jitter(self.t, self.frames),
            Metric::Mhpe => position::mean_error(self, Align::World, &position::TRACKED),
            Metric::Mhre => rotation::world_geodesic(self, &position::TRACKED),
            Metric::FootSkate => feet::skate(self),
            Metric::FootSlide => feet::slide(self, self.p),
            Metric::TrueFootSlide => feet::slide(self, self.t),
            Metric::Penetration => feet::gap(self).map(|(below, _)| below),
            Metric::Floating => feet::gap(self).map(|(_, above)| above),
            Metric::Zmp => balance::zmp_distance(self.p, self.frames, masses),
            Metric::TrueZmp => balance::zmp_distance(self.t, self.frames, masses),
            Metric::Translation => position::translation(self, 2.0),
            Metric::Lost => balance::lost(self).map(|(share, _)| share),
            Metric::Falls => balance::lost(self).map(|(_, falls)| falls),
        }
    }
}

/// The mean, if there is anything to take it of.
fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (mut sum, mut count) = (0.0, 0u64);
    for value in values {
        sum += value;
        count += 1;
    }
    (count > 0).then(|| sum / count as f64)
}

#[cfg(test)]
mod tests;
