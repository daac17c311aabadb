//! One scene of each kind.

use super::{Ground, Object, Scene};

/// A scene of each kind of ground and each kind of object within reach of who stands at the
/// origin, with their names: what any character must bear.
#[must_use]
pub fn samples() -> Vec<(&'static str, Scene)> {
    let ground = |ground| Scene {
        ground,
        ..Scene::default()
    };
    let with = |object| Scene {
        objects: vec![object],
        ..Scene::default()
    };
    let (position, yaw) = ([0.1, 0.15, -0.4], 20.0);
    let block = Object::Box {
        size: [0.4, 0.3, 0.4],
        position,
        yaw,
        mass: Some(6.0),
    };
    let ball = Object::Ball {
        radius: 0.2,
        position: [0.1, 0.2, -0.4],
        mass: 0.6,
    };
    let chair = Object::Chair {
        position: [0.0, 0.0, 0.35],
        yaw: 0.0,
        seat: 0.45,
    };
    vec![
        ("floor", Scene::default()),
        (
            "slope",
            ground(Ground::Slope {
                degrees: 10.0,
                heading: 30.0,
            }),
        ),
        (
            "rough",
            ground(Ground::Rough {
                amplitude: 0.15,
                hills: 1.0,
                seed: 3,
            }),
        ),
        (
            "steps",
            ground(Ground::Steps {
                start: 0.3,
                rise: 0.15,
                run: 0.3,
                count: 5,
            }),
        ),
        ("box", with(block)),
        ("ball", with(ball)),
        ("chair", with(chair)),
    ]
}
