//! A replay that people watch: paced, served, and under their control.

use std::{sync::Arc, thread, time::Duration};

use posed_device::{
    rig,
    transport::{Event, Transport},
};
use posed_signal::{Clock as _, HostTime, Pose};
use tokio::sync::watch;

use super::CommandError;
use crate::{
    assemble::{Assembly, assemble_with},
    clock::{Monotonic, sleep_until},
    control::Control,
    grpc::PoseSink,
    pipeline::{
        playback::{Next, Playback},
        source::Source,
        tracking::TrackerLoop,
    },
    published::{DeviceState, PublishedPose},
    serving::{Listing, Serving},
};

/// Devices are listed once in so many poses.
const LISTING_POSES: u64 = 9;
/// How soon a replay that stands still notices that it is to go on.
const PAUSE_LOOK: Duration = Duration::from_millis(20);

/// Opens the capture from its start.
pub(super) type Open = Arc<dyn Fn() -> Result<Box<dyn Transport>, CommandError> + Send + Sync>;

/// Holds a replay back to real time.
#[derive(Debug, Clone, Copy)]
pub(super) struct Pacer {
    speed: f64,
    /// Capture time and real time of the start.
    origin: Option<(HostTime, HostTime)>,
}

impl Pacer {
    /// `speed` times real time.
    pub(super) fn new(speed: f64) -> Self {
        Self {
            speed,
            origin: None,
        }
    }

    /// Times real time.
    pub(super) fn speed(self) -> f64 {
        self.speed
    }

    /// The real time that belongs to a time of the capture; the first one asked for is now.
    fn real(&mut self, time: HostTime) -> HostTime {
        let (from, start) = *self.origin.get_or_insert_with(|| (time, Monotonic.now()));
        start.plus_secs(time.since_secs(from) / self.speed)
    }

    /// Waits for that time.
    pub(super) fn wait(&mut self, time: HostTime) {
        let real = self.real(time);
        sleep_until(&Monotonic, real);
    }
}

/// Serves a replay: its poses go out with the real clock's times, so that clients can tell how
/// old they are, and under numbers that rise also when the replay is wound back.
pub(super) struct Broadcast {
    /// Absent where the replay goes as fast as it can.
    pacer: Option<Pacer>,
    sink: PoseSink,
    devices: watch::Sender<Vec<DeviceState>>,
    listing: Listing,
    playback: Arc<Playback>,
    is_skipping: bool,
    rewinds: bool,
    sequence: u64,
}

impl Broadcast {
    /// `speed` times real time; as fast as it can be where there is none.
    pub(super) fn new(
        speed: Option<f64>,
        sink: PoseSink,
        serving: &Serving,
        playback: Arc<Playback>,
    ) -> Self {
        Self {
            pacer: speed.map(Pacer::new),
            sink,
            devices: serving.devices(),
            listing: Listing::default(),
            playback,
            is_skipping: false,
            rewinds: false,
            sequence: 0,
        }
    }

    /// Waits until a time of the capture is due, which may be never: `stop` is asked meanwhile.
    /// `false` ends this pass over the capture.
    pub(super) fn wait(&mut self, time: HostTime, stop: impl Fn() -> bool) -> bool {
        loop {
            let next = self.playback.next(time);
            self.is_skipping = next == Next::Skip;
            match next {
                Next::Show => break,
                Next::Skip => {
                    self.interrupted();
                    return !stop();
                }
                Next::Rewind => {
                    self.rewinds = true;
                    return false;
                }
                Next::Wait if stop() => return false,
                Next::Wait => {
                    self.interrupted();
                    thread::sleep(PAUSE_LOOK);
                }
            }
        }
        if let Some(pacer) = &mut self.pacer {
            pacer.wait(time);
        }
        !stop()
    }

    /// Real time went on while the capture's did not, or the other way round.
    fn interrupted(&mut self) {
        if let Some(pacer) = &mut self.pacer {
            pacer.origin = None;
        }
    }

    /// Serves a pose, and now and then the devices.
    pub(super) fn pose(&mut self, pose: &PublishedPose, source: &Source) {
        if self.is_skipping {
            return;
        }
        self.sequence += 1;
        let mut served = *pose;
        served.sequence = self.sequence;
        let pacer = self.pacer.get_or_insert_with(|| Pacer::new(1.0));
        served.target_at = pacer.real(pose.target_at);
        // Zero says that there is no headset yet; that is no time.
        if pose.sample_at > HostTime(0) {
            served.sample_at = pacer.real(pose.sample_at);
        }
        for part in &mut served.parts {
            *part = part.map(|part| Pose {
                at: pacer.real(part.at),
                ..part
            });
        }
        served.publish_at = Monotonic.now();
        self.sink.publish(&served);
        if self.sequence.is_multiple_of(LISTING_POSES) {
            let devices = source.rig().devices();
            self.devices
                .send_replace(self.listing.states(devices, pose.target_at));
        }
    }

    /// After a pass over the capture: whether there is another one, because somebody wants to see
    /// an earlier time, or with `again` in any case.
    pub(super) fn rewind(&mut self, again: bool) -> bool {
        let rewinds = std::mem::take(&mut self.rewinds);
        if !rewinds && !again {
            return false;
        }
        self.interrupted();
        self.playback.rewound(!rewinds);
        true
    }
}

/// The parts for another pass over a capture, with the trackers and the wearer of the last.
pub(super) fn renew(
    open: &Open,
    rig: rig::Settings,
    last: TrackerLoop,
    control: &Control,
) -> Result<(Source, TrackerLoop), CommandError> {
    let Assembly {
        source,
        tracker,
        requests,
    } = assemble_with(open()?, rig, last.into_setup());
    control.renew(requests);
    Ok((source, tracker))
}

/// Reads the capture on a thread of its own to learn how long it is.
///
/// # Errors
/// The thread cannot be started.
pub(super) fn measure(open: &Open, playback: &Arc<Playback>) -> Result<(), CommandError> {
    let (open, playback) = (Arc::clone(open), Arc::clone(playback));
    let work = move || {
        // What is wrong with the capture, the replay itself tells.
        let Ok(mut transport) = open() else { return };
        let mut span: Option<(HostTime, HostTime)> = None;
        loop {
            match transport.next(0) {
                Event::Packet(packet) => {
                    let (start, end) = span.unwrap_or((packet.at, packet.at));
                    span = Some((start, end.max(packet.at)));
                }
                Event::End => break,
                _ => {}
            }
        }
        if let Some((start, end)) = span {
            playback.set_length(end.since_secs(start));
        }
    };
    thread::Builder::new().name("measure".into()).spawn(work)?;
    Ok(())
}
