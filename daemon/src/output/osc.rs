//! Open Sound Control over UDP, as VMC and VRChat's trackers use it: bundles, Unity's axes, and
//! the task that sends.

use std::{
    io,
    net::{Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
};

use glam::{Quat, Vec3};
use posed_signal::{HostTime, time::SECOND_NS};
use rosc::{OscBundle, OscMessage, OscPacket, OscTime, OscType, encoder};
use tokio::sync::watch;
use tracing::warn;

use crate::{grpc::Hub, published::PublishedPose};

/// Bytes of a datagram that fits an Ethernet frame: 1500 less the headers of IPv4 and UDP. VMC
/// allows 1500 for a bundle.
pub const DATAGRAM_BYTES_MAX: usize = 1472;
/// "Immediately" (OSC 1.0, time tags).
const IMMEDIATELY: OscTime = OscTime {
    seconds: 0,
    fractional: 1,
};

/// A position in Unity's world: left-handed, Y up, +Z forward. posed's world looks along -Z, so
/// that this is a mirror image in the plane z = 0.
#[must_use]
pub fn unity_position(position: Vec3) -> Vec3 {
    Vec3::new(position.x, position.y, -position.z)
}

/// A rotation in Unity's world. A mirror turns the sense of rotation round, and the axis's z with
/// the plane: a turn by `a` about (x, y, z) becomes one by `-a` about (x, y, -z).
#[must_use]
pub fn unity_rotation(rotation: Quat) -> Quat {
    Quat::from_xyzw(-rotation.x, -rotation.y, rotation.z, rotation.w)
}

/// A message with room for `numbers` after its other arguments.
pub(super) fn message(address: &str, leading: &[OscType], numbers: usize) -> OscMessage {
    let mut args = leading.to_vec();
    args.resize(leading.len() + numbers, OscType::Float(0.0));
    OscMessage {
        addr: address.into(),
        args,
    }
}

/// Overwrites a message's arguments from the one at `first` on.
pub(super) fn set(message: &mut OscMessage, first: usize, numbers: &[f32]) {
    for (arg, number) in message.args.iter_mut().skip(first).zip(numbers) {
        *arg = OscType::Float(*number);
    }
}

/// A bundle whose messages stay and whose numbers change from pose to pose, so that encoding it
/// again allocates nothing.
#[derive(Debug)]
pub(super) struct Bundle {
    packet: OscPacket,
    bytes: Vec<u8>,
}

impl Bundle {
    pub(super) fn new(messages: Vec<OscMessage>) -> Self {
        let content = messages.into_iter().map(OscPacket::Message).collect();
        let packet = OscPacket::Bundle(OscBundle {
            timetag: IMMEDIATELY,
            content,
        });
        Self {
            packet,
            bytes: Vec::with_capacity(DATAGRAM_BYTES_MAX),
        }
    }

    /// Shares `messages` out over as few bundles as fit [`DATAGRAM_BYTES_MAX`], in order.
    pub(super) fn split(messages: Vec<OscMessage>) -> Vec<Self> {
        let mut bundles = Vec::new();
        let mut waiting: Vec<OscMessage> = Vec::new();
        for message in messages {
            waiting.push(message);
            if Self::new(waiting.clone()).encode().len() > DATAGRAM_BYTES_MAX
                && let Some(beyond) = waiting.pop()
            {
                bundles.push(Self::new(std::mem::replace(&mut waiting, vec![beyond])));
            }
        }
        bundles.push(Self::new(waiting));
        bundles
    }

    pub(super) fn messages(&mut self) -> impl Iterator<Item = &mut OscMessage> {
        let content = match &mut self.packet {
            OscPacket::Bundle(bundle) => bundle.content.as_mut_slice(),
            OscPacket::Message(_) => &mut [],
        };
        content.iter_mut().filter_map(|packet| match packet {
            OscPacket::Message(message) => Some(message),
            OscPacket::Bundle(_) => None,
        })
    }

    pub(super) fn encode(&mut self) -> &[u8] {
        self.bytes.clear();
        match encoder::encode_into(&self.packet, &mut self.bytes) {
            Ok(_) => &self.bytes,
            Err(never) => match never {},
        }
    }
}

/// Turns poses into datagrams.
pub trait Encode {
    /// Calls `send` with each datagram that `pose` takes; there may be none.
    fn encode(&mut self, pose: &PublishedPose, send: &mut dyn FnMut(&[u8]));

    /// The wearer was reset: receivers may have to find out again where forward is.
    fn reset(&mut self) {}
}

/// Lets through at most so many poses a second, evenly, by the poses' own time.
#[derive(Debug, Clone, Copy)]
struct Throttle {
    period_ns: i64,
    due: Option<HostTime>,
}

impl Throttle {
    fn new(rate_hz: f64) -> Self {
        Self {
            period_ns: (SECOND_NS as f64 / rate_hz) as i64,
            due: None,
        }
    }

    fn lets_through(&mut self, at: HostTime) -> bool {
        let period = self.period_ns;
        let early = self.due.map_or(0, |due| due.since_ns(at));
        // A quarter of a period is the ticks' own jitter; more than one is a replay wound back.
        if early > period / 4 && early <= period {
            return false;
        }
        let on_time = self.due.filter(|_| early.abs() <= period);
        self.due = Some(on_time.unwrap_or(at).plus_ns(period));
        true
    }
}

/// What an output has done; the counters only grow.
#[derive(Debug, Default)]
pub struct Counters {
    /// Datagrams sent.
    pub sent: AtomicU64,
    /// Datagrams that the system did not take.
    pub failed: AtomicU64,
}

/// Where datagrams go: one socket for each receiver.
#[derive(Debug)]
pub struct Targets {
    sockets: Vec<(SocketAddr, UdpSocket)>,
    counters: Arc<Counters>,
}

impl Targets {
    /// Opens a socket for each address.
    ///
    /// # Errors
    /// The system has no socket, or no route to an address; the message names it.
    pub fn open(addrs: &[SocketAddr]) -> io::Result<Self> {
        let open = |addr: &SocketAddr| {
            let any: SocketAddr = match addr {
                SocketAddr::V4(_) => (Ipv4Addr::UNSPECIFIED, 0).into(),
                SocketAddr::V6(_) => (Ipv6Addr::UNSPECIFIED, 0).into(),
            };
            let socket = UdpSocket::bind(any)?;
            socket.set_nonblocking(true)?;
            socket.connect(addr)?;
            Ok((*addr, socket))
        };
        let named = |addr: &SocketAddr| {
            open(addr).map_err(|error: io::Error| {
                io::Error::new(error.kind(), format!("cannot send to {addr}: {error}"))
            })
        };
        let sockets = addrs.iter().map(named).collect::<io::Result<_>>()?;
        Ok(Self {
            sockets,
            counters: Arc::default(),
        })
    }

    /// What was sent.
    #[must_use]
    pub fn counters(&self) -> Arc<Counters> {
        Arc::clone(&self.counters)
    }

    fn send(&self, bytes: &[u8]) {
        for (addr, socket) in &self.sockets {
            let counter = match socket.send(bytes) {
                Ok(_) => &self.counters.sent,
                // Nobody listens there yet: the answer to the datagram before this one.
                Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => {
                    &self.counters.failed
                }
                Err(error) => {
                    if self.counters.failed.load(Ordering::Relaxed) == 0 {
                        warn!("poses for {addr} are lost: {error}");
                    }
                    &self.counters.failed
                }
            };
            counter.fetch_add(1, Ordering::Relaxed);
        }
    }
}

/// Sends every pose that `rate_hz` lets through until there are no more. `resets` changes when the
/// wearer is reset. A receiver that is slow or away costs its own datagrams and nothing else.
pub async fn send(
    mut encoder: impl Encode,
    targets: Targets,
    rate_hz: f64,
    hub: Hub,
    mut resets: watch::Receiver<u64>,
) {
    let mut throttle = Throttle::new(rate_hz);
    let mut changes = hub.changes();
    let mut last = None;
    loop {
        tokio::select! {
            changed = changes.changed() => if changed.is_err() { return },
            Ok(()) = resets.changed() => {
                encoder.reset();
                continue;
            }
        }
        let Some(pose) = hub.latest().filter(|pose| last != Some(pose.sequence)) else {
            continue;
        };
        last = Some(pose.sequence);
        if throttle.lets_through(pose.target_at) {
            encoder.encode(&pose, &mut |bytes| targets.send(bytes));
        }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use std::time::Duration;

    use open_sound_control::{OscArgument, OscBundle, OscMessage};
    use posed_signal::time::MILLISECOND_NS;

    use super::*;
    use crate::{output::vmc::Vmc, published::tests::pose_at};

    /// The messages of a bundle, read by a library that had no part in writing them.
    pub(in crate::output) fn decode(bytes: &[u8]) -> Vec<OscMessage> {
        assert!(bytes.len() <= DATAGRAM_BYTES_MAX, "{} bytes", bytes.len());
        let bundle = OscBundle::from_bytes(bytes).expect("a bundle");
        assert_eq!(
            (bundle.time_tag.seconds, bundle.time_tag.fractional),
            (0, 1)
        );
        bundle.messages
    }

    /// A message's arguments from `first` on, which must all be 32-bit floats.
    pub(in crate::output) fn floats(message: &OscMessage, first: usize) -> Vec<f32> {
        let float = |argument: &OscArgument| match argument {
            OscArgument::Float32(number) => *number,
            other => panic!("{}: {other:?} is no float", message.address),
        };
        message.arguments[first..].iter().map(float).collect()
    }

    /// The datagrams of one pose.
    pub(in crate::output) fn encoded(
        encoder: &mut impl Encode,
        pose: &PublishedPose,
    ) -> Vec<Vec<u8>> {
        let mut datagrams = Vec::new();
        encoder.encode(pose, &mut |bytes| datagrams.push(bytes.to_vec()));
        datagrams
    }

    // Unity is left-handed with Y up; a model that looks along +Z has its left hand at -X. posed is
    // right-handed with Y up; a wearer who looks along -Z has the left hand at -X. Right and up
    // agree, forward is +Z there and -Z here. Hence positions are mirrored in z. A rotation R
    // becomes M R M with M = diag(1, 1, -1), and must take mirrored points where R takes the
    // points themselves.
    #[test]
    fn unity_sees_the_same_wearer() {
        assert_eq!(unity_position(Vec3::NEG_Z), Vec3::Z, "forward");
        assert_eq!(unity_position(Vec3::NEG_X), Vec3::NEG_X, "left");
        let turns = [
            Quat::from_rotation_x(0.7),
            Quat::from_rotation_y(-1.1),
            Quat::from_rotation_z(2.0),
            Quat::from_xyzw(0.5, -0.1, 0.3, 0.8).normalize(),
        ];
        for turn in turns {
            for point in [Vec3::X, Vec3::Y, Vec3::Z] {
                let there = unity_position(turn * point);
                let error = unity_rotation(turn) * unity_position(point) - there;
                assert!(error.length() < 1e-6, "{turn} {point}");
            }
        }
        // Turning to the left is +Y for a right-handed world and -Y for a left-handed one.
        let left = unity_rotation(Quat::from_rotation_y(0.5));
        assert!(left.angle_between(Quat::from_rotation_y(-0.5)) < 1e-3);
    }

    #[test]
    fn the_throttle_keeps_the_rate_and_nothing_else() {
        let let_through = |pose_hz: f64, rate_hz: f64, jitter_ns: i64| {
            let mut throttle = Throttle::new(rate_hz);
            let at = |index: i64| {
                let even = (index as f64 * SECOND_NS as f64 / pose_hz) as i64;
                HostTime(SECOND_NS).plus_ns(even + if index % 2 == 0 { jitter_ns } else { 0 })
            };
            let poses = (10.0 * pose_hz) as i64;
            (0..poses)
                .filter(|index| throttle.lets_through(at(*index)))
                .count()
        };
        assert_eq!(let_through(90.0, 90.0, 0), 900);
        assert_eq!(
            let_through(90.0, 90.0, 2_000_000),
            900,
            "jitter costs no pose"
        );
        assert_eq!(let_through(90.0, 1000.0, 0), 900);
        assert!((599..=601).contains(&let_through(90.0, 60.0, 1_000_000)));
        assert!((299..=301).contains(&let_through(90.0, 30.0, 0)));
        let mut throttle = Throttle::new(10.0);
        assert!(throttle.lets_through(HostTime(9 * SECOND_NS)));
        assert!(!throttle.lets_through(HostTime(9 * SECOND_NS + MILLISECOND_NS)));
        assert!(throttle.lets_through(HostTime(SECOND_NS)), "time went back");
        assert!(
            throttle.lets_through(HostTime(5 * SECOND_NS)),
            "after a gap"
        );
        assert!(!throttle.lets_through(HostTime(5 * SECOND_NS + MILLISECOND_NS)));
    }

    #[tokio::test]
    async fn every_receiver_hears_every_pose_and_a_deaf_one_harms_nobody() {
        let ears = [0, 1].map(|_| UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap());
        let deaf = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))
            .unwrap()
            .local_addr()
            .unwrap();
        let mut addrs = vec![deaf];
        for ear in &ears {
            ear.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
            addrs.push(ear.local_addr().unwrap());
        }
        let targets = Targets::open(&addrs).unwrap();
        let counters = targets.counters();
        let (mut sink, hub) = Hub::new().unwrap();
        let (_resets, resets) = watch::channel(0);
        let sending = tokio::spawn(send(Vmc::new(), targets, 1000.0, hub.clone(), resets));
        let per_pose = encoded(&mut Vmc::new(), &pose_at(1, HostTime(1))).len() as u64;
        const POSES: u64 = 20;
        for sequence in 1..=POSES {
            sink.publish(&pose_at(sequence, HostTime(sequence * 11 * MILLISECOND_NS)));
            let heard =
                || counters.sent.load(Ordering::Relaxed) + counters.failed.load(Ordering::Relaxed);
            while heard() < sequence * per_pose * 3 {
                tokio::task::yield_now().await;
            }
        }
        drop(sink);
        sending.await.unwrap();
        for ear in ears {
            let mut buffer = [0; 2048];
            for _ in 0..POSES * per_pose {
                let length = ear.recv(&mut buffer).unwrap();
                assert!(!decode(&buffer[..length]).is_empty());
            }
        }
    }

    #[test]
    fn an_address_without_a_route_is_named() {
        // A multicast address cannot be connected to over IPv6 without a scope; where the system
        // allows it, sending fails and is counted instead.
        let addr = "[ff02::1]:9".parse().unwrap();
        match Targets::open(&[addr]) {
            Err(error) => assert!(error.to_string().contains("[ff02::1]:9"), "{error}"),
            Ok(targets) => {
                targets.send(b"x");
                let counters = targets.counters();
                let all =
                    counters.sent.load(Ordering::Relaxed) + counters.failed.load(Ordering::Relaxed);
                assert_eq!(all, 1);
            }
        }
    }
}
