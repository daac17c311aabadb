//! What `posed run` and `posed record` share: the devices that are plugged in, and Ctrl-C.

use std::{
    sync::{Arc, atomic::AtomicBool},
    thread,
};

use posed_device::transport::{Backend, Hidraw, Live, Spawn, Transport, Usb};

use super::CommandError;
use crate::clock::Monotonic;

/// The live transport, and a flag that Ctrl-C or SIGTERM sets.
///
/// # Errors
/// A thread or the signal handler cannot be had.
pub fn transport() -> Result<(Box<dyn Transport>, Arc<AtomicBool>), CommandError> {
    let mut backends: Vec<Box<dyn Backend>> = vec![Box::new(Hidraw::new())];
    let usb = Usb::new();
    if usb.is_wanted() {
        backends.push(Box::new(usb));
    }
    let spawn: Spawn = Box::new(|name, job| {
        thread::Builder::new()
            .name(name.to_owned())
            .spawn(job)
            .map(drop)
    });
    let transport = Live::new(backends, Arc::new(Monotonic), spawn)?;
    Ok((Box::new(transport), stop_flag()?))
}

/// A flag that Ctrl-C or SIGTERM sets.
///
/// # Errors
/// The handler cannot be installed.
pub fn stop_flag() -> Result<Arc<AtomicBool>, CommandError> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
        // The second time, the signal ends the process in the usual way.
        signal_hook::flag::register_conditional_default(signal, Arc::clone(&stop))?;
        signal_hook::flag::register(signal, Arc::clone(&stop))?;
    }
    Ok(stop)
}
