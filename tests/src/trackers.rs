//! Six simulated SlimeVR trackers over one receiver: from USB bytes to calibrated bones.

use std::{
    io::Cursor,
    sync::{Arc, Mutex},
};

use posed::{
    assemble::{Options, assemble},
    control::Requests,
    pipeline::{
        replay::{Watcher, replay},
        source::Source,
        tracking::Request,
    },
    postures,
    published::PublishedPose,
    simulated::{self, Person},
};
use posed_body::{Joint, motion::Trajectory};
use posed_device::{
    capture::{HidRecorderWriter, UsbmonOptions, UsbmonWriter, open},
    simulate::slimevr::{self, RECEIVER},
    transport::{Merge, Recording, Replay},
    usb::{Packet, Port},
};
use posed_signal::{DeviceId, HostTime, Lookup, Orientation, Role, Sample, Serial};
use posed_tracker::{Ik, Input, Tracked, Tracker, TrackerKind, worn::Stance};

pub(crate) const WORN: [(Role, Joint); 6] = [
    (Role::Waist, Joint::Pelvis),
    (Role::LeftKnee, Joint::LeftKnee),
    (Role::RightKnee, Joint::RightKnee),
    (Role::LeftWrist, Joint::LeftElbow),
    (Role::RightWrist, Joint::RightElbow),
    (Role::Head, Joint::Head),
];
pub(crate) const PORT: Port = Port { bus: 1, address: 7 };
const SECONDS: f64 = 40.0;

type Heard = Arc<Mutex<Vec<(HostTime, [Lookup<Orientation>; Role::COUNT])>>>;

/// Keeps what trackers are given.
struct Listener(Heard, Ik);

impl Tracker for Listener {
    fn kind(&self) -> TrackerKind {
        TrackerKind::Pip
    }

    fn reset(&mut self) {}

    fn track(&mut self, input: &Input<'_>) -> Tracked {
        let mut heard = self.0.lock().expect("nobody panicked");
        heard.push((input.target, *input.inertial));
        self.1.track(input)
    }
}

/// Holds the three postures when the wearer does, and keeps the poses.
pub(crate) struct Calibrating {
    requests: Requests,
    start: Option<HostTime>,
    asked: usize,
    pub(crate) poses: Vec<PublishedPose>,
}

impl Calibrating {
    pub(crate) fn new(requests: Requests) -> Self {
        Self {
            requests,
            start: None,
            asked: 0,
            poses: Vec::new(),
        }
    }
}

impl Watcher for Calibrating {
    fn pace(&mut self, time: HostTime) -> bool {
        let start = *self.start.get_or_insert(time);
        if let Some(&posture) = Stance::ALL.get(self.asked)
            && time.since_secs(start) >= postures::middle(posture) - 0.5
        {
            self.requests.tracker.push(Request::Calibrate(posture));
            self.asked += 1;
        }
        true
    }

    fn sample(&mut self, _device: DeviceId, _sample: &Sample) {}

    fn pose(&mut self, pose: &PublishedPose, _source: &Source) {
        self.poses.push(*pose);
    }

    fn warning(&mut self, text: &str) {
        panic!("{text}");
    }
}

struct Run {
    /// Mean error of each role's bone, degrees, and of its acceleration, m/s^2.
    errors: [(f64, f64); 6],
    lost: u64,
    received: u64,
    calibrated: u8,
}

fn packets(person: &Person, loss: f64) -> impl Iterator<Item = Packet> {
    let options = slimevr::Options {
        duration_s: SECONDS,
        loss,
        ..slimevr::Options::default()
    };
    let trackers = person.trackers(&WORN.map(|(role, _)| role), 3);
    slimevr::Receiver::new(options, PORT, trackers).expect("six trackers are not too many")
}

pub(crate) fn usbmon(packets: impl Iterator<Item = Packet>) -> Vec<u8> {
    let mut writer = UsbmonWriter::new(Vec::new(), UsbmonOptions::default()).expect("a Vec");
    packets.for_each(|packet| writer.packet(&packet).expect("a Vec takes everything"));
    writer.finish().expect("a Vec")
}

fn run(capture: Vec<u8>, trajectory: &Trajectory, person: &Person) -> Run {
    let recording = Recording {
        name: "simulated".into(),
        reader: open(Cursor::new(capture)).expect("a capture"),
        devices: Vec::new(),
    };
    let heard = Heard::default();
    let mut options = Options {
        trackers: vec![Box::new(Listener(Arc::clone(&heard), Ik::default()))],
        tracker: TrackerKind::Pip,
        ..Options::default()
    };
    options.rig.roles = WORN
        .iter()
        .enumerate()
        .map(|(index, (role, _))| (Serial::new(&simulated::tracker_serial(index)), *role))
        .collect();
    let transport = Replay::new(vec![recording], Merge::OneSession);
    let mut parts = assemble(Box::new(transport), options);
    let mut watcher = Calibrating::new(parts.requests);
    replay(&mut parts.source, &mut parts.tracker, 60.0, &mut watcher);
    let start = slimevr::Options::default().start;
    let heard = heard.lock().expect("nobody panicked");
    let errors = WORN.map(|(role, joint)| {
        let (mut turned, mut pushed, mut count) = (0.0, 0.0, 0usize);
        for (target, bones) in heard.iter() {
            let seconds = target.since_secs(start);
            if seconds < postures::LEAD_IN_S {
                continue;
            }
            let bone = bones[role as usize]
                .fresh()
                .expect("no tracker falls silent");
            let truth = trajectory.joint(joint, seconds);
            let error = bone.rotation.angle_between(truth.rotation.as_quat());
            turned += f64::from(error).to_degrees();
            pushed += bone.accel.as_dvec3().distance(truth.acceleration);
            count += 1;
        }
        let count = count.max(1) as f64;
        (turned / count, pushed / count)
    });
    let devices = parts.source.rig().devices();
    assert_eq!(devices.len(), 6);
    assert!(devices.iter().all(|device| device.battery.is_some()));
    assert_eq!(person.wearer().height, 1.75);
    let radio = |of: fn(&posed_signal::Radio) -> u64| {
        devices
            .iter()
            .filter_map(|d| d.radio.as_ref())
            .map(of)
            .sum()
    };
    Run {
        errors,
        lost: radio(|radio| radio.lost),
        received: radio(|radio| radio.received),
        calibrated: watcher.poses.last().expect("poses came").worn.calibrated,
    }
}

#[test]
fn six_trackers_come_through_with_five_percent_of_their_packets_lost() {
    let clip = postures::before(&simulated::built_in(1.75, 1));
    let person = Person::new(&clip);
    let trajectory = Trajectory::new(&clip);
    let whole = run(usbmon(packets(&person, 0.0)), &trajectory, &person);
    let lossy = run(usbmon(packets(&person, 0.05)), &trajectory, &person);
    assert_eq!((whole.calibrated, lossy.calibrated, whole.lost), (6, 6, 0));
    let share = lossy.lost as f64 / (lossy.lost + lossy.received) as f64;
    assert!((share - 0.05).abs() < 0.01, "{share} of the packets lost");
    for (index, (role, _)) in WORN.iter().enumerate() {
        let (turned, pushed) = whole.errors[index];
        println!(
            "{role}: {turned:.2} degrees, {pushed:.2} m/s^2; {:?}",
            lossy.errors[index]
        );
        // Nothing but a headset tells which way a head faces: it stays as askew as it sits.
        let limit = if *role == Role::Head { 25.0 } else { 6.0 };
        assert!(turned < limit, "{role}: {turned} degrees");
        let worse = lossy.errors[index].0 - turned;
        assert!(worse < 0.5, "{role}: {worse} degrees worse with losses");
    }
}

#[test]
fn hid_recorder_text_holds_the_same_traffic() {
    let clip = simulated::built_in(1.75, 1);
    let person = Person::new(&clip);
    let sent: Vec<Packet> = packets(&person, 0.0).take(500).collect();
    let mut writer = HidRecorderWriter::new(Vec::new());
    writer.device(PORT, RECEIVER);
    sent.iter()
        .for_each(|packet| writer.packet(packet).expect("a Vec takes everything"));
    let text = writer.finish().expect("a Vec");
    let read: Vec<Packet> = open(&text[..])
        .expect("a recording")
        .filter_map(|item| match item {
            posed_device::capture::Item::Packet(packet) => Some(packet),
            _ => None,
        })
        .collect();
    let data = |packets: &[Packet]| -> Vec<Vec<u8>> {
        packets.iter().map(|packet| packet.data.clone()).collect()
    };
    assert_eq!(data(&read), data(&sent));
}
