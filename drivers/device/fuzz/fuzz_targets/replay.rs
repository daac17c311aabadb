//! Any bytes as a capture, replayed into a rig: every decoder behind every reader.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    posed_device::rig::fuzz_entry(data);
});
