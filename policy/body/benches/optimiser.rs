//! Costs of one tick: optimiser, its solver alone, retargeting, simulation.

use criterion::{Criterion, criterion_group, criterion_main};
use posed_body::character::{Character, HINGES};
use posed_body::motion::procedural;
use posed_body::optimiser::{Optimiser, Reference, Settings};
use posed_body::qp::Solver;
use posed_body::retarget::Retarget;
use posed_body::scene::{Ground, Scene};
use posed_body::simulation::Model;

fn ticks(c: &mut Criterion) {
    let clip = procedural::timeline(1.75, 4).resampled(60.0);
    let mut frames = clip.frames.iter().cycle();
    let mut optimiser = Optimiser::new(&clip.skeleton, 72.0, 1.0 / 60.0, Settings::default());
    c.bench_function("optimiser tick", |b| {
        b.iter(|| {
            let pose = frames.next().expect("an endless row");
            let reference = Reference {
                pose,
                velocities: None,
                contacts: None,
            };
            optimiser.step(&reference, &Ground::Flat)
        });
    });

    // The clip starts with somebody who stands on both feet.
    optimiser.reset();
    for pose in &clip.frames[..30] {
        let reference = Reference {
            pose,
            velocities: None,
            contacts: None,
        };
        optimiser.step(&reference, &Ground::Flat);
    }
    let problem = optimiser.problem().clone();
    let mut solver = Solver::new(problem.unknowns(), problem.constraints());
    c.bench_function("quadratic program, cold", |b| {
        b.iter(|| solver.solve(&problem, &[]));
    });
    let active = solver.active().to_vec();
    c.bench_function("quadratic program, warm", |b| {
        b.iter(|| solver.solve(&problem, &active));
    });

    let character = Character::new(&clip.skeleton, None).expect("a person's stature");
    let mut retarget = Retarget::new(character.clone());
    c.bench_function("retarget", |b| {
        b.iter(|| retarget.fit(frames.next().expect("an endless row")));
    });

    let model = Model::new(character, Scene::default()).expect("a sound model");
    let mut state = model.state();
    c.bench_function("simulation step of 1/144 s", |b| {
        b.iter(|| state.step(&[0.0; HINGES], 1));
    });
}

criterion_group!(benches, ticks);
criterion_main!(benches);
