//! Any bytes as the traffic of a Joy-Con.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    posed_device::joycon::fuzz_entry(data);
});
