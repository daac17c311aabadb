//! The scene in MuJoCo's XML.

use glam::{DQuat, DVec3};

use super::ground::{FIELD_CELLS, FIELD_HALF};
use super::{Ground, Object, Scene};
use crate::character::{put, triple};

/// Thickness of what lies under the surface of steps and height field, metres.
const UNDERGROUND: f64 = 1.0;
/// Height of the plane that goes on beyond the height field, metres: so little lower that nothing
/// touches both.
const AROUND: f64 = -0.005;
/// Half the width of a flight of steps, metres.
const STEPS_HALF_WIDTH: f64 = 20.0;

/// Writes the assets that the ground needs.
pub fn write_assets(scene: &Scene, xml: &mut String) {
    let Ground::Rough { .. } = scene.ground else {
        return;
    };
    let nodes = || (0..FIELD_CELLS * FIELD_CELLS).map(|n| (n / FIELD_CELLS, n % FIELD_CELLS));
    let highest = nodes().map(|(row, column)| scene.ground.node(row, column));
    let top = highest.fold(1e-3, f64::max);
    put(
        xml,
        format_args!(
            "<asset><hfield name=\"ground\" nrow=\"{FIELD_CELLS}\" ncol=\"{FIELD_CELLS}\" \
             size=\"{FIELD_HALF} {FIELD_HALF} {top:.8} {UNDERGROUND}\" elevation=\""
        ),
    );
    // In the geom's frame rows run along +y, which is the world's -Z. The compiler stretches
    // the data so that they span 0 to 1, so their own span goes into the geom's size.
    for row in 0..FIELD_CELLS {
        for column in 0..FIELD_CELLS {
            put(xml, format_args!("{:.6} ", scene.ground.node(row, column)));
        }
    }
    xml.push_str("\"/></asset>\n");
}

/// Writes ground and objects into the world body.
pub fn write_world(scene: &Scene, xml: &mut String) {
    match scene.ground {
        Ground::Flat | Ground::Slope { .. } => {
            let up = DQuat::from_rotation_arc(DVec3::Z, scene.ground.slope_normal());
            put(
                xml,
                format_args!(
                    "<geom name=\"ground\" class=\"scene\" type=\"plane\" size=\"0 0 1\" \
                     quat=\"{}\"/>\n",
                    quat(up)
                ),
            );
        }
        Ground::Rough { .. } => put(
            xml,
            format_args!(
                "<geom name=\"ground\" class=\"scene\" type=\"hfield\" hfield=\"ground\" \
                 quat=\"{0}\"/>\n<geom name=\"around\" class=\"scene\" type=\"plane\" \
                 size=\"0 0 1\" pos=\"0 {AROUND} 0\" quat=\"{0}\"/>\n",
                quat(DQuat::from_rotation_arc(DVec3::Z, DVec3::Y))
            ),
        ),
        Ground::Steps {
            start,
            rise,
            run,
            count,
        } => write_steps(xml, start, rise, run, count),
    }
    for (index, object) in scene.objects.iter().enumerate() {
        write_object(object, index, xml);
    }
}

fn quat(q: DQuat) -> String {
    format!("{:.8} {:.8} {:.8} {:.8}", q.w, q.x, q.y, q.z)
}

fn write_steps(xml: &mut String, start: f64, rise: f64, run: f64, count: u32) {
    put(
        xml,
        format_args!(
            "<geom name=\"ground\" class=\"scene\" type=\"plane\" size=\"0 0 1\" \
             quat=\"{}\"/>\n",
            quat(DQuat::from_rotation_arc(DVec3::Z, DVec3::Y))
        ),
    );
    let far = start + run * f64::from(count) + 20.0;
    for step in 0..count {
        let near = start + run * f64::from(step);
        let top = rise * f64::from(step + 1);
        let half = DVec3::new(
            STEPS_HALF_WIDTH,
            (top + UNDERGROUND) / 2.0,
            (far - near) / 2.0,
        );
        let centre = DVec3::new(0.0, (top - UNDERGROUND) / 2.0, -(near + far) / 2.0);
        write_box(xml, &format!("step_{step}"), centre, half);
    }
}

fn write_box(xml: &mut String, name: &str, centre: DVec3, half: DVec3) {
    put(
        xml,
        format_args!(
            "<geom name=\"{name}\" class=\"scene\" type=\"box\" pos=\"{}\" size=\"{}\"/>\n",
            triple(centre),
            triple(half)
        ),
    );
}

fn write_object(object: &Object, index: usize, xml: &mut String) {
    let place = object.place();
    // What does not move by itself can still be put elsewhere.
    let kind = if object.is_loose() {
        ""
    } else {
        " mocap=\"true\""
    };
    put(
        xml,
        format_args!(
            "<body name=\"object_{index}\"{kind} pos=\"{}\" quat=\"{}\">\n",
            triple(place.position),
            quat(place.rotation)
        ),
    );
    match object {
        Object::Box { size, mass, .. } => {
            let half = triple(DVec3::from_array(*size) / 2.0);
            match mass {
                Some(mass) => put(
                    xml,
                    format_args!(
                        "<freejoint/><geom name=\"object_{index}\" class=\"movable\" \
                         type=\"box\" size=\"{half}\" mass=\"{mass:.8}\"/>\n"
                    ),
                ),
                None => put(
                    xml,
                    format_args!(
                        "<geom name=\"object_{index}\" class=\"scene\" type=\"box\" \
                         size=\"{half}\"/>\n"
                    ),
                ),
            }
        }
        Object::Ball { radius, mass, .. } => put(
            xml,
            format_args!(
                "<freejoint/><geom name=\"object_{index}\" class=\"movable\" \
                 type=\"sphere\" size=\"{radius:.8}\" mass=\"{mass:.8}\"/>\n"
            ),
        ),
        Object::Chair { seat, .. } => write_chair(xml, index, *seat),
    }
    xml.push_str("</body>\n");
}

/// A chair 44 cm wide and deep with a back 45 cm high.
fn write_chair(xml: &mut String, index: usize, seat: f64) {
    let part = |xml: &mut String, name: &str, centre: [f64; 3], half: [f64; 3]| {
        let name = format!("object_{index}_{name}");
        write_box(
            xml,
            &name,
            DVec3::from_array(centre),
            DVec3::from_array(half),
        );
    };
    part(xml, "seat", [0.0, seat - 0.02, 0.0], [0.22, 0.02, 0.22]);
    part(xml, "back", [0.0, seat + 0.225, 0.21], [0.22, 0.225, 0.015]);
    let leg = (seat - 0.04) / 2.0;
    for (name, x, z) in [
        ("a", -0.2, -0.2),
        ("b", 0.2, -0.2),
        ("c", -0.2, 0.2),
        ("d", 0.2, 0.2),
    ] {
        part(xml, name, [x, leg, z], [0.02, leg, 0.02]);
    }
}
