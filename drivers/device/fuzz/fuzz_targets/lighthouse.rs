//! Any bytes as base stations, a configuration, and the traffic of a Lighthouse device.
#![no_main]

libfuzzer_sys::fuzz_target!(|data: &[u8]| {
    posed_device::lighthouse::fuzz_entry(data);
});
