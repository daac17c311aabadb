//! What runs on the tracker thread does not touch the heap: shown by an allocator that counts.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use posed_body::character::{Character, HINGES};
use posed_body::motion::procedural;
use posed_body::optimiser::{Optimiser, Reference, Settings};
use posed_body::retarget::Retarget;
use posed_body::scene::{Ground, Scene};
use posed_body::simulation::Model;

thread_local! {
    static ARMED: Cell<bool> = const { Cell::new(false) };
    static COUNT: Cell<u64> = const { Cell::new(0) };
}

struct Counting;

fn count() {
    // At a thread's end its locals are gone; nothing is armed then.
    let _ = ARMED.try_with(|armed| {
        if armed.get() {
            let _ = COUNT.try_with(|count| count.set(count.get() + 1));
        }
    });
}

// SAFETY: every call goes on to the system's allocator unchanged.
#[expect(unsafe_code, reason = "an allocator is unsafe by its trait")]
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count();
        // SAFETY: the caller's promise is passed on.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        count();
        // SAFETY: the caller's promise is passed on.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// How often this thread allocates or frees in `work`.
fn allocations(work: impl FnOnce()) -> u64 {
    COUNT.set(0);
    ARMED.set(true);
    work();
    ARMED.set(false);
    COUNT.get()
}

#[test]
fn the_counter_counts() {
    assert_eq!(
        allocations(|| drop(std::hint::black_box(Box::new(1_u8)))),
        2
    );
}

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
    let ticks = allocations(|| {
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
    let fits = allocations(|| {
        for pose in &frames[..300] {
            retarget.fit(pose);
        }
    });
    assert_eq!(fits, 0, "the retargeter");

    let model = Model::new(character, Scene::default()).expect("a sound model");
    let mut state = model.state();
    let steps = allocations(|| {
        for step in 0..100 {
            state.step(&[f64::from(step % 7); HINGES], 4);
            assert!(state.feet()[0].force.is_finite() && state.energy()[1].is_finite());
        }
    });
    assert_eq!(steps, 0, "the simulation");
}
