//! The tracker thread does not allocate after its start: shown by an allocator that counts.

use std::{
    alloc::{GlobalAlloc, Layout, System},
    cell::Cell,
};

thread_local! {
    static ARMED: Cell<bool> = const { Cell::new(false) };
    static COUNT: Cell<u64> = const { Cell::new(0) };
}

/// The system's allocator; it counts what a thread allocates or frees between [`armed`]'s ends.
struct Counting;

fn count() {
    // During a thread's end its locals are gone; nothing is armed then.
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

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count();
        // SAFETY: the caller's promise is passed on.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Runs `work` and says how often this thread allocated or freed meanwhile.
pub(crate) fn armed<R>(work: impl FnOnce() -> R) -> (R, u64) {
    COUNT.set(0);
    ARMED.set(true);
    let result = work();
    ARMED.set(false);
    (result, COUNT.get())
}

#[test]
fn the_guard_sees_allocations() {
    assert_eq!(armed(|| drop(vec![1u8; 100])).1, 2);
    assert_eq!(armed(|| 1 + 1), (2, 0));
}
