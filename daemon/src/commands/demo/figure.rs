//! The skeleton as characters on a terminal, seen from the front and from the left.

use glam::Vec3;
use posed_body::{JOINTS, Joint, Joints, skeleton::PARENTS};

/// Columns of one view.
pub const WIDTH: usize = 30;
/// Rows of a view.
pub const HEIGHT: usize = 19;
/// Metres from the floor to the top row.
const TOP: f32 = 2.1;
/// A character is about twice as high as it is wide.
const ASPECT: f32 = 2.0;

/// Which way a view looks at the wearer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum View {
    Front,
    Side,
}

/// Rows of text that show the skeleton from the front (left) and from its left side (right).
#[must_use]
pub fn draw(joints: &Joints) -> Vec<String> {
    let front = grid(joints, View::Front);
    let side = grid(joints, View::Side);
    let row = |cells: &[char]| cells.iter().collect::<String>();
    front
        .iter()
        .zip(&side)
        .map(|(front, side)| format!("{}  {}", row(front), row(side)))
        .collect()
}

fn grid(joints: &Joints, view: View) -> [[char; WIDTH]; HEIGHT] {
    let mut cells = [[' '; WIDTH]; HEIGHT];
    cells[HEIGHT - 1] = ['_'; WIDTH];
    let forward = joints.rotation(Joint::Pelvis) * Vec3::NEG_Z;
    let forward = Vec3::new(forward.x, 0.0, forward.z).normalize_or(Vec3::NEG_Z);
    let across = match view {
        // Seen from the front, the wearer's left is on the right.
        View::Front => forward.cross(Vec3::NEG_Y),
        // Seen from the left, forward is to the left.
        View::Side => -forward,
    };
    let pelvis = joints.position(Joint::Pelvis);
    let place = |point: Vec3| {
        let scale = HEIGHT as f32 / TOP;
        let x = WIDTH as f32 / 2.0 + (point - pelvis).dot(across) * scale * ASPECT;
        let y = (HEIGHT as f32 - 0.5) - point.y * scale;
        (x, y)
    };
    for index in 1..JOINTS {
        let Some(parent) = PARENTS[index] else {
            continue;
        };
        let mark = mark(index, view);
        line(
            &mut cells,
            place(joints.positions[parent]),
            place(joints.positions[index]),
            mark,
        );
    }
    let crown = joints.position(Joint::Head) + joints.rotation(Joint::Head) * (Vec3::Y * 0.14);
    line(&mut cells, place(crown), place(crown), 'O');
    cells
}

/// Left limbs and right ones look different, so that one sees which leg steps.
fn mark(index: usize, view: View) -> char {
    match (Joint::ALL[index].name().split('_').next(), view) {
        (Some("left"), View::Front) => 'l',
        (Some("right"), View::Front) => 'r',
        (Some("left"), View::Side) => '#',
        (Some("right"), View::Side) => '.',
        _ => '|',
    }
}

fn line(
    cells: &mut [[char; WIDTH]; HEIGHT],
    (x0, y0): (f32, f32),
    (x1, y1): (f32, f32),
    mark: char,
) {
    let steps = ((x1 - x0).abs().max((y1 - y0).abs()).min(200.0) as usize + 1) * 2;
    for step in 0..=steps {
        let t = step as f32 / steps as f32;
        let (x, y) = (x0 + (x1 - x0) * t, y0 + (y1 - y0) * t);
        let inside = x >= 0.0 && y >= 0.0 && x < WIDTH as f32 && y < HEIGHT as f32;
        if inside {
            cells[y as usize][x as usize] = mark;
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::Quat;
    use posed_body::{BodyPose, Skeleton};

    use super::*;

    #[test]
    fn a_standing_body_fills_the_rows_and_its_left_is_on_the_right() {
        let skeleton = Skeleton::of_height(1.75);
        let mut pose = BodyPose::rest(Vec3::new(3.0, 0.99, -2.0));
        pose.rotations[0] = Quat::from_rotation_y(1.0);
        let rows = draw(&skeleton.forward(&pose));
        assert_eq!(rows.len(), HEIGHT);
        let arms = rows.iter().find(|row| row[..WIDTH].contains('l')).unwrap();
        assert!(arms[..WIDTH].find('r') < arms[..WIDTH].find('l'), "{arms}");
        let drawn = rows.iter().filter(|row| row[..WIDTH].trim() != "").count();
        assert!(drawn > HEIGHT - 5, "{rows:#?}");
    }

    #[test]
    fn far_or_broken_positions_draw_nothing_and_do_not_panic() {
        let mut joints = Skeleton::of_height(1.75).forward(&BodyPose::rest(Vec3::ZERO));
        joints.positions[3] = Vec3::splat(f32::NAN);
        joints.positions[5] = Vec3::splat(1e30);
        assert_eq!(draw(&joints).len(), HEIGHT);
    }
}
