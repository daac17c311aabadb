//! The character in MuJoCo's XML (MJCF). The world's axes are posed's own: Y up, the pelvis's
//! frame is the skeleton's, so no rotation stands between the two.

use std::fmt::Write;

use glam::DVec3;

use super::{Character, Link, Sole, hinges_of};
use crate::skeleton::Joint;

/// Radii of the links' capsules over stature; for contact only, masses and inertias are explicit.
mod radius {
    pub(super) const PELVIS: f64 = 0.050;
    pub(super) const SPINE: f64 = 0.052;
    pub(super) const CHEST: f64 = 0.060;
    pub(super) const HEAD: f64 = 0.058;
    pub(super) const UPPER_ARM: f64 = 0.025;
    pub(super) const FOREARM: f64 = 0.021;
    pub(super) const HAND: f64 = 0.018;
    pub(super) const THIGH: f64 = 0.040;
    pub(super) const SHANK: f64 = 0.028;
    pub(super) const FOOT: f64 = 0.0125;
}

/// Share of the toes' length that is rigid: the foot has no toe hinge, so a foot as long as the
/// real one would lift its ball off the ground as soon as the heel rises.
const RIGID_TOES: f64 = 0.4;

/// Writes the body tree: a free pelvis and its links with inertias, hinges, contact capsules and
/// one site for each joint of the skeleton, named after it. The pelvis stands at its height in
/// the rest pose. Capsules collide with geoms whose `conaffinity` has bit 0 set.
pub fn write_body(character: &Character, xml: &mut String) {
    write_link(character, Link::Pelvis, xml);
}

/// Writes one torque motor for each hinge, in the order of the generalised coordinates; a
/// control is a torque in N m.
pub fn write_actuators(character: &Character, xml: &mut String) {
    xml.push_str("<actuator>\n");
    for hinge in &character.hinges {
        put(
            xml,
            format_args!(
                "<motor name=\"{0}\" joint=\"{0}\" gear=\"1\" ctrlrange=\"{1:.6} {2:.6}\"/>\n",
                hinge.name, -hinge.torque, hinge.torque
            ),
        );
    }
    xml.push_str("</actuator>\n");
}

/// Writing to a string cannot fail.
pub(crate) fn put(xml: &mut String, text: std::fmt::Arguments<'_>) {
    let _ = xml.write_fmt(text);
}

pub(crate) fn triple(v: DVec3) -> String {
    format!("{:.8} {:.8} {:.8}", v.x, v.y, v.z)
}

fn write_link(character: &Character, link: Link, xml: &mut String) {
    let body = &character.links[link as usize];
    let name = link.name();
    let pos = match link.parent() {
        Some(_) => body.offset,
        None => DVec3::Y * character.standing_height(),
    };
    put(
        xml,
        format_args!("<body name=\"{name}\" pos=\"{}\">\n", triple(pos)),
    );
    put(
        xml,
        format_args!(
            "<inertial pos=\"{}\" mass=\"{:.8}\" diaginertia=\"{}\"/>\n",
            triple(body.com),
            body.mass,
            triple(body.inertia)
        ),
    );
    if link.parent().is_none() {
        xml.push_str("<freejoint name=\"root\"/>\n");
    }
    for hinge in &character.hinges[hinges_of(link)] {
        put(
            xml,
            format_args!(
                "<joint name=\"{}\" axis=\"{}\" range=\"{:.8} {:.8}\" damping=\"{:.8}\" \
                 armature=\"{:.8}\"/>\n",
                hinge.name,
                triple(hinge.axis),
                hinge.range[0],
                hinge.range[1],
                hinge.damping,
                character.armature
            ),
        );
    }
    write_geoms(character, link, xml);
    for joint in Joint::ALL {
        let (carrier, offset) = character.joints[joint as usize];
        if carrier == link {
            put(
                xml,
                format_args!(
                    "<site name=\"{}\" pos=\"{}\"/>\n",
                    joint.name(),
                    triple(offset)
                ),
            );
        }
    }
    for child in Link::ALL
        .into_iter()
        .filter(|child| child.parent() == Some(link))
    {
        write_link(character, child, xml);
    }
    xml.push_str("</body>\n");
}

fn capsule(xml: &mut String, name: &str, from: DVec3, to: DVec3, radius: f64) {
    put(
        xml,
        format_args!(
            "<geom name=\"{name}\" class=\"body\" type=\"capsule\" fromto=\"{} {}\" \
             size=\"{radius:.8}\"/>\n",
            triple(from),
            triple(to)
        ),
    );
}

/// Contact shapes: limbs along their bones, trunk parts across the body, the head a ball, each
/// foot a pair of bars along its edges and one across the toes.
fn write_geoms(character: &Character, link: Link, xml: &mut String) {
    let s = character.stature;
    let name = link.name();
    let com = character.links[link as usize].com;
    let across = |xml: &mut String, radius: f64, half: f64| {
        capsule(
            xml,
            name,
            com - DVec3::X * half * s,
            com + DVec3::X * half * s,
            radius * s,
        );
    };
    let limb = |xml: &mut String, child: Link, radius: f64| {
        let end = character.links[child as usize].offset;
        let inset = end.normalize_or_zero() * radius * s * 0.5;
        capsule(xml, name, inset, end - inset, radius * s);
    };
    match link {
        Link::Pelvis => across(xml, radius::PELVIS, 0.045),
        Link::Spine => across(xml, radius::SPINE, 0.035),
        Link::Chest => across(xml, radius::CHEST, 0.045),
        Link::Head => put(
            xml,
            format_args!(
                "<geom name=\"{name}\" class=\"body\" type=\"sphere\" pos=\"{}\" \
                 size=\"{:.8}\"/>\n",
                triple(com),
                radius::HEAD * s
            ),
        ),
        Link::LeftUpperArm => limb(xml, Link::LeftForearm, radius::UPPER_ARM),
        Link::RightUpperArm => limb(xml, Link::RightForearm, radius::UPPER_ARM),
        Link::LeftForearm => limb(xml, Link::LeftHand, radius::FOREARM),
        Link::RightForearm => limb(xml, Link::RightHand, radius::FOREARM),
        Link::LeftThigh => limb(xml, Link::LeftShank, radius::THIGH),
        Link::RightThigh => limb(xml, Link::RightShank, radius::THIGH),
        Link::LeftShank => limb(xml, Link::LeftFoot, radius::SHANK),
        Link::RightShank => limb(xml, Link::RightFoot, radius::SHANK),
        // The centre of mass of the hand lies near the knuckles; the fingers reach as far again.
        Link::LeftHand | Link::RightHand => {
            capsule(xml, name, com * 0.3, com * 1.8, radius::HAND * s);
        }
        Link::LeftFoot => write_foot(xml, name, s, &character.soles[0]),
        Link::RightFoot => write_foot(xml, name, s, &character.soles[1]),
    }
}

fn write_foot(xml: &mut String, name: &str, stature: f64, sole: &Sole) {
    let r = radius::FOOT * stature;
    let x = sole.half_width - r;
    for (side, x) in [("inner", x), ("outer", -x)] {
        let end = |z: f64| DVec3::new(x, sole.y + r, z);
        capsule(
            xml,
            &format!("{name}_{side}"),
            end(sole.heel - r),
            end(sole.ball),
            r,
        );
    }
    let front = sole.ball + RIGID_TOES * (sole.tip - sole.ball);
    let toes = |x: f64| DVec3::new(x, sole.y + 0.8 * r, front + 0.8 * r);
    capsule(xml, &format!("{name}_toes"), toes(x), toes(-x), 0.8 * r);
}
