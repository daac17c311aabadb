//! The figure that a glTF file shows: an octahedron for each bone, turned with its joint.

use glam::Vec3;
use posed_body::{BodyPose, JOINTS, Joint, Skeleton, skeleton::PARENTS};

/// Half the thickness of a bone over its length, and its bounds in metres.
const SLENDERNESS: f32 = 0.13;
const RADIUS: std::ops::RangeInclusive<f32> = 0.012..=0.05;
/// Radius of the head, over the stature.
const HEAD_OVER_STATURE: f32 = 0.06;
/// Where along a bone it is thickest.
const WAIST: f32 = 0.25;

/// Triangles: three corners each, every corner with the normal of its triangle and the joint that
/// carries it. Positions are those of the T-pose, in glTF's axes, metres.
#[derive(Debug, Default)]
pub(super) struct Figure {
    pub(super) positions: Vec<[f32; 3]>,
    pub(super) normals: Vec<[f32; 3]>,
    pub(super) bones: Vec<u8>,
}

impl Figure {
    /// The figure of `skeleton`, which is in glTF's axes, standing on the floor.
    pub(super) fn new(skeleton: &Skeleton, floor: f32) -> Self {
        let rest = skeleton.forward(&BodyPose::rest(Vec3::new(0.0, floor, 0.0)));
        let stature = skeleton.stature();
        let mut figure = Self::default();
        for (index, parent) in PARENTS.into_iter().enumerate() {
            if let Some(parent) = parent {
                figure.bone(parent, rest.positions[parent], rest.positions[index]);
            }
        }
        for joint in [
            Joint::LeftWrist,
            Joint::RightWrist,
            Joint::LeftFoot,
            Joint::RightFoot,
        ] {
            let (index, parent) = (joint as usize, PARENTS[joint as usize].unwrap_or(0));
            let way = rest.positions[index] - rest.positions[parent];
            let length = if joint >= Joint::LeftWrist { 0.1 } else { 0.03 } * stature;
            let end = rest.positions[index] + way.normalize_or_zero() * length;
            figure.bone(index, rest.positions[index], end);
        }
        let head = Joint::Head as usize;
        let radius = HEAD_OVER_STATURE * stature;
        let centre = rest.positions[head] + Vec3::Y * radius;
        let reach = Vec3::Y * 1.4 * radius;
        figure.octahedron(head, centre - reach, centre + reach, centre, radius);
        figure
    }

    fn bone(&mut self, joint: usize, from: Vec3, to: Vec3) {
        let radius = (from.distance(to) * SLENDERNESS).clamp(*RADIUS.start(), *RADIUS.end());
        self.octahedron(joint, from, to, from.lerp(to, WAIST), radius);
    }

    fn octahedron(&mut self, joint: usize, from: Vec3, to: Vec3, centre: Vec3, radius: f32) {
        let Some(axis) = (to - from).try_normalize() else {
            return;
        };
        let across = axis.any_orthonormal_vector() * radius;
        let other = axis.cross(across);
        let ring = [across, other, -across, -other].map(|corner| centre + corner);
        for side in 0..4 {
            let (a, b) = (ring[side], ring[(side + 1) % 4]);
            self.triangle(joint, [a, b, to]);
            self.triangle(joint, [b, a, from]);
        }
    }

    /// Corners go round against the clock, seen from outside.
    fn triangle(&mut self, joint: usize, corners: [Vec3; 3]) {
        debug_assert!(joint < JOINTS);
        let [a, b, c] = corners;
        let Some(normal) = (b - a).cross(c - a).try_normalize() else {
            return;
        };
        for corner in corners {
            self.positions.push(corner.to_array());
            self.normals.push(normal.to_array());
            self.bones.push(joint as u8);
        }
    }
}
