//! Any bytes as the reports of a SlimeVR receiver.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    posed_device::slimevr::fuzz_entry(data);
});
