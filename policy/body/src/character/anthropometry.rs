//! Masses, centres of mass and inertias of the sixteen body segments.
//!
//! Source: P. de Leva, "Adjustments to Zatsiorsky-Seluyanov's segment inertia parameters",
//! J. Biomechanics 29(9), 1996, table 4; here the mean of its men and women. Ankle height:
//! D. A. Winter, "Biomechanics and Motor Control of Human Movement", figure 4.1 (0.039 of
//! stature).

use glam::DVec3;

use super::{LINKS, Link};
use crate::skeleton::{BodyPose, Joint, Joints, Skeleton};

/// Mass of a person 1.75 m tall, kilograms: between de Leva's men (73.0 kg at 1.741 m) and women
/// (61.9 kg at 1.735 m), both brought to 1.75 m, and today's adult means.
pub const REFERENCE_MASS: f64 = 72.0;
/// The stature that [`REFERENCE_MASS`] belongs to, metres.
pub const REFERENCE_STATURE: f64 = 1.75;
/// Height of the ankle joint above the sole over stature (Winter).
pub const ANKLE_OVER_STATURE: f64 = 0.039;
/// Foot length, heel to toe tip, over stature (de Leva, mean of both sexes).
pub const FOOT_OVER_STATURE: f64 = 0.1399;
/// How far the heel lies behind the ankle joint, over the foot's length.
pub const HEEL_BEHIND_ANKLE: f64 = 0.24;

/// One segment of table 4, men then women.
struct Row {
    /// Share of the body's mass.
    mass: [f64; 2],
    /// Segment length, metres.
    length: [f64; 2],
    /// Centre of mass from the proximal end (trunk parts: from the upper end) over the length.
    com: [f64; 2],
    /// Radii of gyration over the length: about the antero-posterior, the medio-lateral and the
    /// long axis ("sagittal", "transverse" and "longitudinal" in the paper).
    gyration: [[f64; 3]; 2],
}

/// Statures of the paper's subjects, metres.
const STATURE: [f64; 2] = [1.741, 1.735];
/// Trunk length, suprasternale to mid-hip, metres.
const TRUNK: [f64; 2] = [0.5319, 0.5293];

/// Vertex to cervicale.
const HEAD: Row = Row {
    mass: [0.0694, 0.0668],
    length: [0.2429, 0.2437],
    com: [0.5002, 0.4841],
    gyration: [[0.303, 0.315, 0.261], [0.271, 0.295, 0.261]],
};
/// Suprasternale to xiphion.
const UPPER_TRUNK: Row = Row {
    mass: [0.1596, 0.1545],
    length: [0.1707, 0.1425],
    com: [0.2999, 0.2077],
    gyration: [[0.716, 0.454, 0.659], [0.746, 0.502, 0.718]],
};
/// Xiphion to omphalion.
const MIDDLE_TRUNK: Row = Row {
    mass: [0.1633, 0.1465],
    length: [0.2155, 0.2053],
    com: [0.4502, 0.4512],
    gyration: [[0.482, 0.383, 0.468], [0.433, 0.354, 0.415]],
};
/// Omphalion to mid-hip.
const LOWER_TRUNK: Row = Row {
    mass: [0.1117, 0.1247],
    length: [0.1457, 0.1815],
    com: [0.6115, 0.4920],
    gyration: [[0.615, 0.551, 0.587], [0.433, 0.402, 0.444]],
};
const UPPER_ARM: Row = Row {
    mass: [0.0271, 0.0255],
    length: [0.2817, 0.2751],
    com: [0.5772, 0.5754],
    gyration: [[0.285, 0.269, 0.158], [0.278, 0.260, 0.148]],
};
const FOREARM: Row = Row {
    mass: [0.0162, 0.0138],
    length: [0.2689, 0.2643],
    com: [0.4574, 0.4559],
    gyration: [[0.276, 0.265, 0.121], [0.261, 0.257, 0.094]],
};
/// Wrist to third metacarpale.
const HAND: Row = Row {
    mass: [0.0061, 0.0056],
    length: [0.0862, 0.0780],
    com: [0.7900, 0.7474],
    gyration: [[0.628, 0.513, 0.401], [0.531, 0.454, 0.335]],
};
const THIGH: Row = Row {
    mass: [0.1416, 0.1478],
    length: [0.4222, 0.3685],
    com: [0.4095, 0.3612],
    gyration: [[0.329, 0.329, 0.149], [0.369, 0.364, 0.162]],
};
const SHANK: Row = Row {
    mass: [0.0433, 0.0481],
    length: [0.4340, 0.4323],
    com: [0.4459, 0.4416],
    gyration: [[0.255, 0.249, 0.103], [0.271, 0.267, 0.093]],
};
/// Heel to toe tip.
const FOOT: Row = Row {
    mass: [0.0137, 0.0129],
    length: [0.2581, 0.2283],
    com: [0.4415, 0.4014],
    gyration: [[0.257, 0.245, 0.124], [0.299, 0.279, 0.139]],
};

/// Mean of men and women.
fn mean(of: impl Fn(usize) -> f64) -> f64 {
    f64::midpoint(of(0), of(1))
}

/// A rigid segment of a person standing in the rest pose, in the world's axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Segment {
    /// Mass, kilograms.
    pub mass: f64,
    /// Centre of mass in the rest pose, metres, with the pelvis joint at the origin.
    pub com: DVec3,
    /// Principal moments of inertia about the centre of mass along x, y and z, kg m².
    pub inertia: DVec3,
}

/// Mass of an average person of this stature: it grows with the cube (QuestSim, section 3.5).
#[must_use]
pub fn average_mass(stature: f64) -> f64 {
    REFERENCE_MASS * (stature / REFERENCE_STATURE).powi(3)
}

/// The sixteen segments of a person, in [`Link`]'s order. Masses follow `mass` and de Leva's
/// shares, centres of mass follow the skeleton's bones where a bone carries the segment and the
/// stature where none does; radii of gyration follow the stature.
#[must_use]
pub fn segments(skeleton: &Skeleton, mass: f64) -> [Segment; LINKS] {
    let frame = Frame {
        joints: skeleton.forward(&BodyPose::rest(glam::Vec3::ZERO)),
        stature: f64::from(skeleton.stature()),
        // The shares of the mean person add up to a little less than one.
        mass: mass / total_share(),
    };
    let mut segments = [Segment {
        mass: 0.0,
        com: DVec3::ZERO,
        inertia: DVec3::ZERO,
    }; LINKS];
    for (link, segment) in Link::ALL.into_iter().zip(&mut segments) {
        *segment = frame.segment(link);
    }
    segments
}

fn row(link: Link) -> &'static Row {
    match link {
        Link::Pelvis => &LOWER_TRUNK,
        Link::Spine => &MIDDLE_TRUNK,
        Link::Chest => &UPPER_TRUNK,
        Link::Head => &HEAD,
        Link::LeftUpperArm | Link::RightUpperArm => &UPPER_ARM,
        Link::LeftForearm | Link::RightForearm => &FOREARM,
        Link::LeftHand | Link::RightHand => &HAND,
        Link::LeftThigh | Link::RightThigh => &THIGH,
        Link::LeftShank | Link::RightShank => &SHANK,
        Link::LeftFoot | Link::RightFoot => &FOOT,
    }
}

fn total_share() -> f64 {
    Link::ALL
        .into_iter()
        .map(|link| mean(|sex| row(link).mass[sex]))
        .sum()
}

/// A person in the rest pose.
struct Frame {
    joints: Joints,
    stature: f64,
    mass: f64,
}

impl Frame {
    fn joint(&self, joint: Joint) -> DVec3 {
        self.joints.position(joint).as_dvec3()
    }

    fn segment(&self, link: Link) -> Segment {
        let row = row(link);
        let mass = self.mass * mean(|sex| row.mass[sex]);
        let radius = |axis: usize| {
            let over = |sex: usize| row.gyration[sex][axis] * row.length[sex] / STATURE[sex];
            self.stature * mean(over)
        };
        // About the antero-posterior (z), medio-lateral (x) and long (y) axis of an upright
        // segment; the arms lie along x in the rest pose, the feet along z.
        let [sagittal, transverse, long] = [0, 1, 2].map(|axis| mass * radius(axis).powi(2));
        let inertia = match link {
            Link::LeftUpperArm
            | Link::RightUpperArm
            | Link::LeftForearm
            | Link::RightForearm
            | Link::LeftHand
            | Link::RightHand => DVec3::new(long, transverse, sagittal),
            Link::LeftFoot | Link::RightFoot => DVec3::new(sagittal, transverse, long),
            _ => DVec3::new(transverse, long, sagittal),
        };
        Segment {
            mass,
            com: self.com(link),
            inertia,
        }
    }

    /// The point at the table's share of the bone from `from` to `to`.
    fn along(&self, link: Link, from: Joint, to: Joint) -> DVec3 {
        self.joint(from)
            .lerp(self.joint(to), mean(|sex| row(link).com[sex]))
    }

    /// A trunk segment's centre of mass, on the line from the middle of the hips to the middle of
    /// the shoulders; `upper` is the distance of its upper end from the suprasternale for each
    /// sex.
    fn trunk(&self, link: Link, upper: [f64; 2]) -> DVec3 {
        let row = row(link);
        let down = |sex: usize| upper[sex] + row.com[sex] * row.length[sex];
        let above_hips = mean(|sex| (TRUNK[sex] - down(sex)) / STATURE[sex]) * self.stature;
        let middle = |left, right| (self.joint(left) + self.joint(right)) / 2.0;
        let hips = middle(Joint::LeftHip, Joint::RightHip);
        let axis = middle(Joint::LeftShoulder, Joint::RightShoulder) - hips;
        hips + axis * (above_hips / axis.y.max(1e-3))
    }

    fn com(&self, link: Link) -> DVec3 {
        let upper_end = |rows: &[&Row]| [0, 1].map(|sex| rows.iter().map(|r| r.length[sex]).sum());
        match link {
            Link::Pelvis => self.trunk(link, upper_end(&[&UPPER_TRUNK, &MIDDLE_TRUNK])),
            Link::Spine => self.trunk(link, upper_end(&[&UPPER_TRUNK])),
            Link::Chest => self.trunk(link, [0.0; 2]),
            Link::Head => self.head(),
            Link::LeftUpperArm => self.along(link, Joint::LeftShoulder, Joint::LeftElbow),
            Link::RightUpperArm => self.along(link, Joint::RightShoulder, Joint::RightElbow),
            Link::LeftForearm => self.along(link, Joint::LeftElbow, Joint::LeftWrist),
            Link::RightForearm => self.along(link, Joint::RightElbow, Joint::RightWrist),
            Link::LeftHand => self.hand(Joint::LeftElbow, Joint::LeftWrist),
            Link::RightHand => self.hand(Joint::RightElbow, Joint::RightWrist),
            Link::LeftThigh => self.along(link, Joint::LeftHip, Joint::LeftKnee),
            Link::RightThigh => self.along(link, Joint::RightHip, Joint::RightKnee),
            Link::LeftShank => self.along(link, Joint::LeftKnee, Joint::LeftAnkle),
            Link::RightShank => self.along(link, Joint::RightKnee, Joint::RightAnkle),
            Link::LeftFoot => self.foot(Joint::LeftAnkle),
            Link::RightFoot => self.foot(Joint::RightAnkle),
        }
    }

    fn head(&self) -> DVec3 {
        let toe = self
            .joint(Joint::LeftFoot)
            .y
            .min(self.joint(Joint::RightFoot).y);
        let below_vertex = mean(|sex| HEAD.com[sex] * HEAD.length[sex] / STATURE[sex]);
        let head = self.joint(Joint::Head);
        // The vertex is one stature above the ground, which the toe joints are close to.
        DVec3::new(head.x, toe + (1.0 - below_vertex) * self.stature, head.z)
    }

    fn hand(&self, elbow: Joint, wrist: Joint) -> DVec3 {
        let reach = mean(|sex| HAND.com[sex] * HAND.length[sex] / STATURE[sex]) * self.stature;
        let wrist = self.joint(wrist);
        wrist + (wrist - self.joint(elbow)).normalize_or_zero() * reach
    }

    fn foot(&self, ankle: Joint) -> DVec3 {
        let ankle = self.joint(ankle);
        let length = FOOT_OVER_STATURE * self.stature;
        let forward = (mean(|sex| FOOT.com[sex]) - HEEL_BEHIND_ANKLE) * length;
        let down = ANKLE_OVER_STATURE * self.stature / 2.0;
        DVec3::new(ankle.x, ankle.y - down, ankle.z - forward)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masses_add_up_and_mirror() {
        let skeleton = Skeleton::of_height(1.75);
        let segments = segments(&skeleton, average_mass(1.75));
        let total: f64 = segments.iter().map(|segment| segment.mass).sum();
        assert!((total - 72.0).abs() < 1e-9, "{total}");
        for link in [Link::LeftThigh, Link::LeftForearm, Link::LeftFoot] {
            let (left, right) = (segments[link as usize], segments[link.mirrored() as usize]);
            assert!((left.com * DVec3::new(-1.0, 1.0, 1.0)).abs_diff_eq(right.com, 1e-6));
            assert_eq!(left.inertia, right.inertia);
        }
    }

    #[test]
    fn the_centre_of_mass_is_at_waist_height() {
        let skeleton = Skeleton::of_height(1.75);
        let segments = segments(&skeleton, 72.0);
        let com = segments.iter().map(|s| s.com * s.mass).sum::<DVec3>() / 72.0;
        let rest = skeleton.forward(&BodyPose::rest(glam::Vec3::ZERO));
        let sole = f64::from(rest.position(Joint::LeftAnkle).y) - ANKLE_OVER_STATURE * 1.75;
        // Standing with lowered arms it is at 55-57 % of stature; raised arms add about 4 %.
        let share = (com.y - sole) / 1.75;
        assert!((0.55..0.62).contains(&share), "{share}");
        assert!(com.x.abs() < 1e-6 && com.z.abs() < 0.05, "{com}");
    }

    #[test]
    fn scaling_follows_the_third_and_fifth_power() {
        let [small, tall] = [1.4_f32, 2.0].map(|height| {
            segments(
                &Skeleton::of_height(height),
                average_mass(f64::from(height)),
            )
        });
        let s: f64 = 2.0 / 1.4;
        for (a, b) in small.iter().zip(&tall) {
            assert!((b.mass / a.mass / s.powi(3) - 1.0).abs() < 1e-5);
            assert!(
                (b.inertia / a.inertia / s.powi(5) - 1.0)
                    .abs()
                    .max_element()
                    < 1e-5
            );
            assert!((a.com * s).abs_diff_eq(b.com, 1e-5));
        }
    }
}
