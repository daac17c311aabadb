//! `posed run`.

use std::{
    sync::{Arc, atomic::Ordering},
    thread,
    time::Duration,
};

use posed_signal::Clock as _;

use super::{CommandError, live, settings};
use crate::{
    assemble::{Assembly, Options, assemble},
    cli::RunArgs,
    clock::Monotonic,
    notify::Notifier,
    pipeline::live::{Shared, spawn_source, spawn_tracker},
    room::{self, Keeper},
    serving::Listing,
};

/// How often the main thread looks after the others.
const LOOK: Duration = Duration::from_millis(100);
/// How long the first tick may take before the start counts as failed.
const FIRST_TICK: Duration = Duration::from_secs(5);

/// Tracks and serves until Ctrl-C or SIGTERM.
///
/// # Errors
/// The configuration does not hold, or a socket or thread cannot be had.
pub fn run(args: &RunArgs) -> Result<(), CommandError> {
    let config = settings::configuration(&args.body)?;
    let options = settings::options(&config)?;
    let room = options.rig.devices.lighthouse.room.clone();
    let mut keeper = keeper(&options);
    let (transport, stop) = live::transport()?;
    let trackers = options.choices();
    let Assembly {
        source,
        tracker,
        requests,
    } = assemble(transport, options);
    let (mut sink, serving) = settings::serve(&config, requests, trackers)?;

    let shared = Arc::new(Shared::default());
    let watched = settings::Watched::Live(Arc::clone(&shared));
    let outputs = settings::outputs(&config, &serving, watched, room)?;
    let (devices, mut listing) = (serving.devices(), Listing::default());
    let list = move |infos: &[posed_device::rig::DeviceInfo]| {
        devices.send_replace(listing.states(infos, Monotonic.now()));
    };
    let warn = |text: &str| tracing::warn!("{text}");
    let source = spawn_source(source, Arc::clone(&shared), list, warn)?;
    let publish = move |pose: &crate::published::PublishedPose| sink.publish(pose);
    let tracker = spawn_tracker(
        tracker,
        config.tracker.rate_hz,
        Arc::clone(&shared),
        publish,
    )?;

    let mut notifier = Notifier::from_env();
    wait_for_first_tick(&shared)?;
    notifier.ready(&format!("tracking, {} Hz", config.tracker.rate_hz));
    for name in serving.names().iter().chain(&outputs) {
        tracing::info!("serving on {name}");
    }
    let real_time = shared.real_time.load(Ordering::Relaxed);
    tracing::info!(real_time, "tracking at {} Hz", config.tracker.rate_hz);
    while !stop.load(Ordering::Relaxed) && !tracker.is_finished() {
        thread::sleep(LOOK);
        notifier.ticks(shared.ticks.load(Ordering::Acquire), Monotonic.now());
        if let Some(Err(error)) = keeper.as_mut().map(|keeper| keeper.look(Monotonic.now())) {
            tracing::warn!("the room cannot be kept: {error}");
        }
    }
    if let Some(Err(error)) = keeper.as_mut().map(Keeper::keep) {
        tracing::warn!("the room cannot be kept: {error}");
    }
    notifier.stopping();
    shared.stop.store(true, Ordering::Relaxed);
    let ended = [tracker.join(), source.join()]
        .into_iter()
        .all(|thread| thread.is_ok());
    serving.stop(async {});
    if ended {
        Ok(())
    } else {
        Err(CommandError::Input(
            "a thread of the tracker failed; this is a bug".into(),
        ))
    }
}

/// Takes the kept room over, and keeps it from now on; `None` where base stations are given.
fn keeper(options: &Options) -> Option<Keeper> {
    let lighthouse = &options.rig.devices.lighthouse;
    if !lighthouse.base_stations.is_empty() {
        return None;
    }
    let Some(path) = room::path() else {
        tracing::warn!("neither XDG_STATE_HOME nor HOME is set: the room will not be kept");
        return None;
    };
    settings::take_kept_room(&lighthouse.room, &path);
    Some(Keeper::new(lighthouse.room.clone(), path))
}

fn wait_for_first_tick(shared: &Shared) -> Result<(), CommandError> {
    let begun = Monotonic.now();
    while shared.ticks.load(Ordering::Acquire) == 0 {
        if Monotonic.now().since_secs(begun) > FIRST_TICK.as_secs_f64() {
            let seconds = FIRST_TICK.as_secs();
            return Err(CommandError::Input(format!(
                "the tracker did not finish its first tick within {seconds} s"
            )));
        }
        thread::sleep(Duration::from_millis(1));
    }
    Ok(())
}
