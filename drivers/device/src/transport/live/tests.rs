use std::{
    sync::{Mutex, mpsc::Sender},
    thread,
};

use posed_signal::HostTime;

use super::*;
use crate::{catalog, transport::scan::InputReader, usb::UsbId};

const ID: UsbId = UsbId::new(0x28de, 0x2101);
const PORT: Port = Port { bus: 1, address: 9 };
/// Long enough for a loaded machine; the tests wait as long as they have to, not longer.
const PATIENCE_NS: u64 = 20_000_000_000;

/// A bench with one socket: what is plugged into it, and what it sends.
#[derive(Clone, Default)]
struct Bench(Arc<Mutex<State>>);

#[derive(Default)]
struct State {
    plugged: bool,
    /// Why opening fails.
    refusal: Option<Warning>,
    /// Feeds the open reader; dropped means unplugged.
    reports: Option<Sender<Vec<u8>>>,
    features: Vec<Vec<u8>>,
}

impl Bench {
    fn change(&self, change: impl FnOnce(&mut State)) {
        change(&mut self.0.lock().unwrap());
    }

    fn report(&self, data: &[u8]) {
        self.0
            .lock()
            .unwrap()
            .reports
            .as_ref()
            .unwrap()
            .send(data.to_vec())
            .unwrap();
    }
}

impl Backend for Bench {
    fn name(&self) -> &'static str {
        "bench"
    }

    fn scan(&mut self) -> Result<Vec<Found>, Warning> {
        let entry = catalog::find(ID).unwrap();
        let plugged = self.0.lock().unwrap().plugged;
        Ok(plugged
            .then_some(Found {
                port: PORT,
                id: ID,
                entry,
            })
            .into_iter()
            .collect())
    }

    fn open(&mut self, _found: &Found) -> Result<Opened, Warning> {
        let mut state = self.0.lock().unwrap();
        if let Some(refusal) = &state.refusal {
            return Err(refusal.clone());
        }
        let (sender, receiver) = mpsc::channel();
        state.reports = Some(sender);
        let inputs = vec![Input {
            endpoint: 0x81,
            reader: Box::new(BenchReader(receiver)),
        }];
        Ok(Opened {
            control: Box::new(self.clone()),
            inputs,
        })
    }
}

struct BenchReader(Receiver<Vec<u8>>);

impl InputReader for BenchReader {
    fn read(&mut self, buffer: &mut [u8], timeout: Duration) -> io::Result<usize> {
        match self.0.recv_timeout(timeout) {
            Ok(report) => {
                buffer[..report.len()].copy_from_slice(&report);
                Ok(report.len())
            }
            Err(mpsc::RecvTimeoutError::Timeout) => Ok(0),
            Err(mpsc::RecvTimeoutError::Disconnected) => Err(io::ErrorKind::NotConnected.into()),
        }
    }
}

impl Control for Bench {
    fn set_feature(&mut self, _interface: u8, data: &[u8]) -> io::Result<()> {
        self.0.lock().unwrap().features.push(data.to_vec());
        Ok(())
    }

    fn output(&mut self, _interface: u8, data: &[u8]) -> io::Result<()> {
        self.0.lock().unwrap().features.push(data.to_vec());
        Ok(())
    }

    fn get_feature(&mut self, _interface: u8, data: &mut [u8]) -> io::Result<usize> {
        if data[0] == 0xee {
            return Err(io::ErrorKind::BrokenPipe.into());
        }
        data[1] = 42;
        Ok(2)
    }
}

fn live(bench: &Bench) -> Live {
    let spawn: Spawn = Box::new(|name, job| {
        thread::Builder::new()
            .name(name.to_owned())
            .spawn(job)
            .map(|_| ())
    });
    Live::new(vec![Box::new(bench.clone())], Arc::new(HostTime(77)), spawn).unwrap()
}

fn waiting() -> Event {
    Event::Warning(Warning::Waiting { access: "bench" })
}

#[test]
fn plugged_read_unplugged_and_plugged_again() {
    let bench = Bench::default();
    let mut live = live(&bench);
    assert_eq!(live.next(PATIENCE_NS), waiting());
    bench.change(|state| state.plugged = true);
    assert_eq!(
        live.next(PATIENCE_NS),
        Event::Attached { port: PORT, id: ID }
    );
    bench.report(&[0x23, 1]);
    let Event::Packet(packet) = live.next(PATIENCE_NS) else {
        panic!("no packet")
    };
    assert_eq!(
        (packet.at, packet.port, packet.endpoint),
        (HostTime(77), PORT, 0x81)
    );
    assert_eq!(
        (packet.transfer, packet.data),
        (Transfer::Interrupt, vec![0x23, 1])
    );

    bench.change(|state| (state.plugged, state.reports) = (false, None));
    assert_eq!(live.next(PATIENCE_NS), Event::Detached { port: PORT });
    assert_eq!(
        live.send(PORT, &get(1)),
        Err(TransportError::NoDevice(PORT))
    );
    assert_eq!(live.next(PATIENCE_NS), waiting());
    bench.change(|state| state.plugged = true);
    assert_eq!(
        live.next(PATIENCE_NS),
        Event::Attached { port: PORT, id: ID }
    );
    assert_eq!(live.next(0), Event::Idle);
}

fn get(id: u8) -> Command {
    Command::GetFeature {
        interface: 0,
        id,
        length: 64,
    }
}

#[test]
fn control_transfers_come_back_as_captures_hold_them() {
    let bench = Bench::default();
    bench.change(|state| state.plugged = true);
    let mut live = live(&bench);
    assert_eq!(
        live.next(PATIENCE_NS),
        Event::Attached { port: PORT, id: ID }
    );
    live.send(
        PORT,
        &Command::SetFeature {
            interface: 0,
            data: vec![4, 1],
        },
    )
    .unwrap();
    live.send(PORT, &get(0xee)).unwrap();
    live.send(PORT, &get(0x10)).unwrap();

    let control = |event| match event {
        Event::Packet(Packet {
            transfer: Transfer::Control(setup),
            data,
            endpoint,
            ..
        }) => (setup, data, endpoint),
        event => panic!("{event:?}"),
    };
    let (setup, data, endpoint) = control(live.next(PATIENCE_NS));
    assert_eq!(
        (setup.feature_write(), data, endpoint),
        (Some(4), vec![4, 1], 0)
    );
    let (setup, data, endpoint) = control(live.next(PATIENCE_NS));
    assert_eq!(
        (setup.feature_read(), data, endpoint),
        (Some(0x10), vec![0x10, 42], 0x80)
    );
    assert_eq!(live.refused(), 1, "the stalled read gives no packet");
    assert_eq!(bench.0.lock().unwrap().features, [[4, 1]]);
}

#[test]
fn a_device_that_may_not_be_opened_is_said_once_and_tried_again() {
    let bench = Bench::default();
    let refusal = Warning::Permission {
        name: "bench",
        port: PORT,
    };
    bench.change(|state| (state.plugged, state.refusal) = (true, Some(refusal.clone())));
    let mut live = live(&bench);
    assert_eq!(live.next(PATIENCE_NS), Event::Warning(refusal));
    // Two more looks find the same.
    assert_eq!(live.next(2_500_000_000), Event::Idle);
    bench.change(|state| state.refusal = None);
    assert_eq!(
        live.next(PATIENCE_NS),
        Event::Attached { port: PORT, id: ID }
    );
}

#[test]
fn a_full_queue_drops_reports_and_counts_them() {
    let bench = Bench::default();
    bench.change(|state| state.plugged = true);
    let mut live = live(&bench);
    assert_eq!(
        live.next(PATIENCE_NS),
        Event::Attached { port: PORT, id: ID }
    );
    let total = MESSAGES_MAX as u64 + 100;
    (0..total).for_each(|n| bench.report(&n.to_le_bytes()));
    // Nothing is taken until everything has been sent.
    while live.dropped() < 100 {
        thread::yield_now();
    }
    let mut received = 0;
    while let Event::Packet(packet) = live.next(500_000_000) {
        assert_eq!(packet.data, u64::to_le_bytes(received));
        received += 1;
    }
    assert_eq!(received + live.dropped(), total);
    assert_eq!(received, MESSAGES_MAX as u64);
}
