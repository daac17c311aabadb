//! What physics puts on the tracker thread does not touch the heap either.

use posed_body::character::{Character, HINGES};
use posed_body::motion::procedural;
use posed_body::optimiser::{Optimiser, Reference, Settings};
use posed_body::retarget::Retarget;
use posed_body::scene::{Ground, Scene};
use posed_body::simulation::Model;

use crate::allocation::armed;

#[test]
fn neither_optimiser_nor_retarget_nor_simulation_allocates() {
    let clip = procedural::timeline(1.75, 4).resampled(60.0);
    let frames = &clip.frames[..900.min(clip.frames.len())];
    let mut optimiser = Optimiser::new(&clip.skeleton, 72.0, 1.0 / 60.0, Settings::default());
    let ground = Ground::Rough {
        amplitude: 0.1,
        hills: 1.0,
        seed: 1,
    };
    let ((), ticks) = armed(|| {
        for pose in frames {
            let reference = Reference {
                pose,
                velocities: None,
                contacts: None,
            };
            optimiser.step(&reference, &ground);
        }
    });
    assert_eq!(ticks, 0, "the optimiser");

    let character = Character::new(&clip.skeleton, None).expect("a person's stature");
    let mut retarget = Retarget::new(character.clone());
    let ((), fits) = armed(|| {
        for pose in &frames[..300] {
            retarget.fit(pose);
        }
    });
    assert_eq!(fits, 0, "the retargeter");

    let model = Model::new(character, Scene::default()).expect("a sound model");
    let mut state = model.state();
    let ((), steps) = armed(|| {
        for step in 0..100 {
            state.step(&[f64::from(step % 7); HINGES], 4);
            assert!(state.feet()[0].force.is_finite() && state.energy()[1].is_finite());
        }
    });
    assert_eq!(steps, 0, "the simulation");
}
