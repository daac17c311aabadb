//! Any bytes as a capture.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    posed_device::capture::fuzz_entry(data);
});
