//! `posed record`.

use std::{
    fs::File,
    io::{self, BufWriter, Write},
    path::Path,
    sync::atomic::Ordering,
};

use indicatif::ProgressBar;
use posed_device::{
    capture::{HidRecorderWriter, UsbmonOptions, UsbmonWriter},
    transport::{Event, Transport},
    usb::{Packet, Port, UsbId},
};
use posed_signal::{Clock as _, HostTime};

use super::{CommandError, live};
use crate::{
    assemble::{Assembly, Options, assemble},
    cli::{CaptureFormat, RecordArgs},
    clock::Monotonic,
    pipeline::source::Taken,
};

/// The longest wait for a packet: Ctrl-C is noticed this soon.
const WAIT_NS: u64 = 50_000_000;

/// Records until Ctrl-C or the time given.
///
/// # Errors
/// The devices cannot be reached or the capture cannot be written.
pub fn run(args: &RecordArgs) -> Result<(), CommandError> {
    let Some(out) = &args.out else {
        return Err(CommandError::Input("name the capture by --out".into()));
    };
    let (transport, stop) = live::transport()?;
    let tap = Tap {
        inner: transport,
        output: Output::create(out, args.format)?,
        written: 0,
    };
    // The rig is there to start the devices: without their start-up requests they send nothing.
    let Assembly { mut source, .. } = assemble(Box::new(tap), Options::default());
    let progress = ProgressBar::new_spinner();
    let begun = Monotonic.now();
    let end = args.seconds.map(|seconds| begun.plus_secs(seconds));
    while !stop.load(Ordering::Relaxed) && end.is_none_or(|end| Monotonic.now() < end) {
        let event = source.next(WAIT_NS);
        match source.take(event) {
            Taken::Warning(text) => progress.suspend(|| eprintln!("warning: {text}")),
            Taken::End => break,
            Taken::Something | Taken::Nothing => {}
        }
        source.tick(Monotonic.now());
        let devices = source
            .rig()
            .devices()
            .iter()
            .filter(|device| device.connected)
            .count();
        let packets: u64 = source
            .rig()
            .devices()
            .iter()
            .map(|d| d.counters.packets)
            .sum();
        progress.set_message(format!("{devices} devices, {packets} packets"));
        progress.tick();
    }
    progress.finish_and_clear();
    let seconds = Monotonic.now().since_secs(begun);
    println!("{}: {seconds:.1} s recorded", out.display());
    Ok(())
}

/// A transport that writes every packet down on its way.
struct Tap {
    inner: Box<dyn Transport>,
    output: Output,
    written: u64,
}

impl Transport for Tap {
    fn next(&mut self, wait_ns: u64) -> Event {
        let event = self.inner.next(wait_ns);
        let done = match &event {
            Event::Attached { port, id } => self.output.device(Monotonic.now(), *port, *id),
            Event::Packet(packet) => self.output.packet(packet),
            _ => Ok(()),
        };
        match done {
            Ok(()) => {
                self.written += 1;
                event
            }
            // The tap is all that this command is for: without it there is nothing to go on with.
            Err(error) => {
                eprintln!(
                    "error: the capture ends after {} packets: {error}",
                    self.written
                );
                Event::End
            }
        }
    }

    fn send(
        &mut self,
        port: Port,
        command: &posed_device::decode::Command,
    ) -> Result<(), posed_device::transport::TransportError> {
        self.inner.send(port, command)
    }
}

/// The capture being written; finished when dropped, so that Ctrl-C leaves a whole file.
struct Output {
    writer: Option<Writer>,
}

enum Writer {
    Pcap(UsbmonWriter<BufWriter<File>>),
    HidRecorder(HidRecorderWriter<BufWriter<File>>),
}

impl Output {
    fn create(path: &Path, format: CaptureFormat) -> Result<Self, CommandError> {
        let fail = |error| CommandError::file(path, error);
        let file = BufWriter::with_capacity(1 << 16, File::create(path).map_err(fail)?);
        let gzip = path.extension().is_some_and(|extension| extension == "gz");
        let options = UsbmonOptions {
            gzip,
            ..UsbmonOptions::default()
        };
        let writer = match format {
            CaptureFormat::Pcap => Writer::Pcap(UsbmonWriter::new(file, options).map_err(fail)?),
            CaptureFormat::HidRecorder => Writer::HidRecorder(HidRecorderWriter::new(file)),
        };
        Ok(Self {
            writer: Some(writer),
        })
    }

    fn device(&mut self, at: HostTime, port: Port, id: UsbId) -> io::Result<()> {
        match &mut self.writer {
            Some(Writer::Pcap(writer)) => writer.device(at, port, id),
            Some(Writer::HidRecorder(writer)) => {
                writer.device(port, id);
                Ok(())
            }
            None => Ok(()),
        }
    }

    fn packet(&mut self, packet: &Packet) -> io::Result<()> {
        match &mut self.writer {
            Some(Writer::Pcap(writer)) => writer.packet(packet),
            Some(Writer::HidRecorder(writer)) => writer.packet(packet),
            None => Ok(()),
        }
    }

    fn finish(&mut self) -> io::Result<()> {
        let mut file = match self.writer.take() {
            Some(Writer::Pcap(writer)) => writer.finish()?,
            Some(Writer::HidRecorder(writer)) => writer.finish()?,
            None => return Ok(()),
        };
        file.flush()
    }
}

impl Drop for Output {
    fn drop(&mut self) {
        if let Err(error) = self.finish() {
            eprintln!("error: the end of the capture could not be written: {error}");
        }
    }
}
