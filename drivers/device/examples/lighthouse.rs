//! How well a capture's Lighthouse devices are tracked:
//!
//!     cargo run --release -p posed-device --example lighthouse -- CAPTURE [--stations FILE] \
//!         [--compare FILE] [--truth FILE] [--rec FILE DEVICE] [--from SECONDS] [--seconds]
//!
//! Without `--stations` they are found from the light, and compared with those in `--compare`,
//! both files being libsurvive's JSON. `--truth` is what `posed simulate` writes
//! beside a capture, `--rec` a recording of libsurvive's whose pose lines of a device
//! are compared with.
//! `--seconds` adds a line for every second.

use std::{
    collections::BTreeMap,
    env,
    error::Error,
    fs::{self, File},
    io::{BufRead, BufReader},
    time::Instant,
};

use flate2::read::MultiGzDecoder;
use glam::{DQuat, DVec3};
use posed_device::{
    capture,
    lighthouse::{
        base_station::{BaseStation, from_z_up, parse_libsurvive},
        reproject::PlaneCalibration,
    },
    rig::{Rig, Settings},
    transport::{Event, Merge, Recording, Replay, Transport as _},
};
use posed_signal::{HostTime, Imu, Pose, PoseHow, Sample};

type Fallible<T> = Result<T, Box<dyn Error>>;

/// Reference poses: seconds, position, rotation.
type Reference = Vec<(f64, DVec3, DQuat)>;

#[derive(Default)]
struct Arguments {
    capture: String,
    stations: Option<String>,
    compare: Option<String>,
    truth: Option<String>,
    rec: Option<(String, String)>,
    from: f64,
    seconds: bool,
}

fn arguments() -> Fallible<Arguments> {
    let mut found = Arguments::default();
    let mut words = env::args().skip(1);
    while let Some(word) = words.next() {
        let mut value = || {
            words
                .next()
                .ok_or_else(|| format!("{word}: a value is missing"))
        };
        match word.as_str() {
            "--stations" => found.stations = Some(value()?),
            "--compare" => found.compare = Some(value()?),
            "--truth" => found.truth = Some(value()?),
            "--rec" => found.rec = Some((value()?, value()?)),
            "--seconds" => found.seconds = true,
            "--from" => found.from = value()?.parse()?,
            _ => found.capture = word,
        }
    }
    Ok(found)
}

/// One device's samples.
#[derive(Default)]
struct Device {
    poses: Vec<Pose>,
    imu: Vec<Imu>,
}

fn main() -> Fallible<()> {
    let arguments = arguments()?;
    let mut settings = Settings::default();
    if let Some(path) = &arguments.stations {
        settings.devices.lighthouse.base_stations = parse_libsurvive(&fs::read_to_string(path)?)?;
    }
    let room = settings.devices.lighthouse.room.clone();
    let (mut rig, mut rings) = Rig::new(settings);
    let reader = capture::open(BufReader::new(File::open(&arguments.capture)?))?;
    let recording = Recording {
        name: arguments.capture.clone(),
        reader,
        devices: Vec::new(),
    };
    let mut replay = Replay::new(vec![recording], Merge::OneSession);
    let mut devices = BTreeMap::<usize, Device>::new();
    let (mut begin, mut end) = (None, HostTime(0));
    let mut busy = 0.0;
    loop {
        match replay.next(0) {
            Event::Packet(packet) => {
                begin.get_or_insert(packet.at);
                end = packet.at;
                let clock = Instant::now();
                rig.packet(&packet);
                busy += clock.elapsed().as_secs_f64();
            }
            Event::Attached { port, id } => rig.attach(port, id),
            Event::Detached { port } => rig.detach(port),
            Event::Warning(warning) => eprintln!("{warning}"),
            Event::Idle => {}
            Event::End => break,
        }
        for (index, ring) in rings.iter_mut().enumerate() {
            while let Some(sample) = ring.pop() {
                let device = devices.entry(index).or_default();
                match sample {
                    Sample::Pose(pose) => device.poses.push(pose),
                    Sample::Imu(imu) => device.imu.push(imu),
                    _ => {}
                }
            }
        }
    }
    let begin = begin.unwrap_or(HostTime(0));
    let seconds = end.since_secs(begin);
    println!(
        "{}: {seconds:.1} s, {:.0} times real time",
        arguments.capture,
        seconds / busy
    );
    if let Some(path) = &arguments.compare {
        let found: Vec<BaseStation> = room.with(|room| room.stations().copied().collect());
        compare(&found, &parse_libsurvive(&fs::read_to_string(path)?)?);
    }
    for (index, device) in &devices {
        let Some(info) = rig.devices().get(*index) else {
            continue;
        };
        let serial = info.identity.serial.as_str();
        let from = begin.plus_secs(arguments.from);
        let poses: Vec<Pose> = device
            .poses
            .iter()
            .filter(|pose| pose.at >= from)
            .copied()
            .collect();
        println!("{serial} {} ({} poses)", info.identity.model, poses.len());
        if poses.is_empty() {
            continue;
        }
        general(&poses, &device.imu, seconds - arguments.from);
        if arguments.seconds {
            timeline(&poses, begin);
        }
        if let Some(path) = &arguments.truth {
            against(&poses, &truth(path, serial)?, 0.0, false);
        }
        if let Some((path, name)) = &arguments.rec {
            against(
                &poses,
                &survive(path, name)?,
                begin.as_secs_f64(),
                arguments.stations.is_none(),
            );
        }
    }
    Ok(())
}

/// The largest difference between the numbers of two planes' calibrations.
fn apart(a: &PlaneCalibration, b: &PlaneCalibration) -> f64 {
    [
        a.phase - b.phase,
        a.tilt - b.tilt,
        a.curve - b.curve,
        a.gibphase - b.gibphase,
        a.gibmag - b.gibmag,
        a.ogeephase - b.ogeephase,
        a.ogeemag - b.ogeemag,
    ]
    .into_iter()
    .fold(0.0, |largest: f64, off| largest.max(off.abs()))
}

/// Base stations found beside those of a file, pair by pair.
fn compare(found: &[BaseStation], file: &[BaseStation]) {
    // By serial number: what flashes first need not be what a file has first.
    let of_file = |station: &BaseStation| file.iter().find(|other| other.id == station.id);
    for (index, a) in found.iter().enumerate() {
        let Some(file_a) = of_file(a) else {
            println!("  {}: not in the file", a.source);
            continue;
        };
        let calibrations = a.calibration.iter().zip(&file_a.calibration);
        let off = calibrations.map(|(a, b)| apart(a, b)).fold(0.0, f64::max);
        println!(
            "  {}: {:08x} (file {:08x}), calibration {off:.1e} off the file's",
            a.source, a.id, file_a.id
        );
        for b in &found[index + 1..] {
            let Some(file_b) = of_file(b) else { continue };
            let there = |a: &BaseStation, b: &BaseStation| {
                let back = a.rotation.conjugate();
                (back * (b.position - a.position), back * b.rotation)
            };
            let ((place, turn), (file_place, file_turn)) = (there(a, b), there(file_a, file_b));
            println!(
                "  {} from {}: {:.1} mm, {:.3} degrees off the file's; {:.3} m apart, in the file {:.3}",
                b.source,
                a.source,
                1e3 * (place - file_place).length(),
                turn.angle_between(file_turn).to_degrees(),
                place.length(),
                file_place.length(),
            );
        }
    }
}

/// What needs no reference.
fn general(poses: &[Pose], imu: &[Imu], seconds: f64) {
    let share =
        |how| poses.iter().filter(|pose| pose.how == how).count() as f64 / poses.len() as f64;
    let span = poses[poses.len() - 1].at.since_secs(poses[0].at);
    let square: f64 = poses
        .iter()
        .map(|pose| f64::from(pose.residual_rad).powi(2))
        .sum();
    println!(
        "  tracked {:.1} % of {seconds:.1} s, residual {:.2e} rad, first pose after {:.2} s",
        100.0 * share(PoseHow::Optical) * span / seconds,
        (square / poses.len() as f64).sqrt(),
        seconds - span,
    );
    // Noise about the mean of half a second, where the device rests.
    let (mut place, mut turn, mut rest) = (DVec3::ZERO, 0.0, 0usize);
    let mut slow = DVec3::ZERO;
    let all: DVec3 = poses
        .iter()
        .map(|pose| pose.position.as_dvec3())
        .sum::<DVec3>()
        / poses.len() as f64;
    for window in poses.chunk_by(|a, b| (a.at.0 / 500_000_000) == (b.at.0 / 500_000_000)) {
        let count = window.len() as f64;
        let mean = window
            .iter()
            .map(|pose| pose.position.as_dvec3())
            .sum::<DVec3>()
            / count;
        let first = window[0].rotation.as_dquat();
        let turns = window
            .iter()
            .map(|pose| (first.conjugate() * pose.rotation.as_dquat()).to_scaled_axis());
        let turns: Vec<DVec3> = turns
            .map(|turn| {
                if turn.length() > 3.0 {
                    DVec3::ZERO
                } else {
                    turn
                }
            })
            .collect();
        let middle = turns.iter().sum::<DVec3>() / count;
        let speed = window
            .iter()
            .map(|pose| pose.velocity.length())
            .fold(0.0, f32::max);
        if speed > 0.05 || window.iter().any(|pose| pose.how != PoseHow::Optical) {
            continue;
        }
        rest += window.len();
        slow += window
            .iter()
            .map(|pose| (pose.position.as_dvec3() - all).powf(2.0))
            .sum::<DVec3>();
        place += window
            .iter()
            .map(|pose| (pose.position.as_dvec3() - mean).powf(2.0))
            .sum::<DVec3>();
        turn += turns
            .iter()
            .map(|turn| (*turn - middle).length_squared())
            .sum::<f64>();
    }
    if rest > 100 {
        let place = (place / rest as f64).powf(0.5) * 1e3;
        let slow = (slow / rest as f64).powf(0.5) * 1e3;
        println!(
            "  at rest {:.0} %: sd in 0.5 s {:.4} {:.4} {:.4} mm, {:.4} degrees; \
             about the mean {:.4} {:.4} {:.4} mm",
            100.0 * rest as f64 / poses.len() as f64,
            place.x,
            place.y,
            place.z,
            (turn / rest as f64).sqrt().to_degrees(),
            slow.x,
            slow.y,
            slow.z,
        );
    }
    // What the accelerometer says about up, in the mean over everything.
    let mut up = DVec3::ZERO;
    let mut after = 0;
    for sample in imu {
        while after + 1 < poses.len() && poses[after].at < sample.at {
            after += 1;
        }
        if poses[after].at.since_secs(sample.at).abs() < 0.02 {
            up += (poses[after].rotation * sample.accel).as_dvec3();
        }
    }
    println!(
        "  tilt {:.3} degrees",
        up.angle_between(DVec3::Y).to_degrees()
    );
}

/// How many poses of every second are optical, their residual, and where the device is.
fn timeline(poses: &[Pose], begin: HostTime) {
    let second = |pose: &Pose| pose.at.since_secs(begin).floor();
    for part in poses.chunk_by(|a, b| second(a) == second(b)) {
        let optical: Vec<&Pose> = part
            .iter()
            .filter(|pose| pose.how == PoseHow::Optical)
            .collect();
        let square: f32 = optical.iter().map(|pose| pose.residual_rad.powi(2)).sum();
        println!(
            "  {:3} s: {} of {} poses, residual {:.2e} rad, at {:.4}",
            second(&part[0]),
            optical.len(),
            part.len(),
            (square / optical.len().max(1) as f32).sqrt(),
            part[part.len() - 1].position,
        );
    }
}

/// The true poses of a device.
fn truth(path: &str, serial: &str) -> Fallible<Reference> {
    let mut found = Vec::new();
    for line in BufReader::new(File::open(path)?).lines() {
        let line: serde_json::Value = serde_json::from_str(&line?)?;
        if line["device"] != serial {
            continue;
        }
        let number = |key: &str, index: usize| line[key][index].as_f64().unwrap_or(f64::NAN);
        let at = line["t_ns"].as_u64().unwrap_or(0) as f64 * 1e-9;
        let place = DVec3::from_array(std::array::from_fn(|axis| number("position", axis)));
        let turn = DQuat::from_array(std::array::from_fn(|axis| number("rotation", axis)));
        found.push((at, place, turn));
    }
    Ok(found)
}

/// libsurvive's poses of a device, in posed's world.
fn survive(path: &str, name: &str) -> Fallible<Reference> {
    let mut found = Vec::new();
    let turn = from_z_up();
    for line in BufReader::new(MultiGzDecoder::new(File::open(path)?))
        .lines()
        .map_while(Result::ok)
    {
        let words: Vec<&str> = line.split_whitespace().collect();
        let [time, device, "EXTERNAL_POSE" | "POSE", numbers @ ..] = &words[..] else {
            continue;
        };
        if *device != name {
            continue;
        }
        let numbers: Vec<f64> = numbers
            .iter()
            .filter_map(|word| word.parse().ok())
            .collect();
        let [x, y, z, qw, qx, qy, qz] = numbers[..] else {
            continue;
        };
        let rotation = turn * DQuat::from_xyzw(qx, qy, qz, qw);
        found.push((
            time.parse()?,
            turn * DVec3::new(x, y, z),
            rotation.normalize(),
        ));
    }
    Ok(found)
}

/// Our pose at a time, between its neighbours.
fn at(poses: &[Pose], time: HostTime) -> Option<(DVec3, DQuat, &Pose)> {
    let after = poses.partition_point(|pose| pose.at < time);
    let (a, b) = (poses.get(after.checked_sub(1)?)?, poses.get(after)?);
    let span = b.at.since_secs(a.at);
    if span > 0.05 || a.how == PoseHow::Lost {
        return None;
    }
    let share = time.since_secs(a.at) / span.max(1e-9);
    let place = a.position.as_dvec3().lerp(b.position.as_dvec3(), share);
    Some((
        place,
        a.rotation.as_dquat().slerp(b.rotation.as_dquat(), share),
        a,
    ))
}

/// The rotation about the vertical and the shift that take our world nearest to the reference's.
fn align(pairs: &[(f64, DVec3, DQuat, DVec3, DQuat)]) -> (DQuat, DVec3) {
    let turns = pairs.iter().map(|(_, _, ours, _, theirs)| {
        let turn = (*theirs * ours.conjugate()).normalize();
        let turn = if turn.w < 0.0 { -turn } else { turn };
        DVec3::new(0.0, turn.y.atan2(turn.w) * 2.0, 0.0)
    });
    let yaw = turns
        .map(|turn| DVec3::new(turn.y.cos(), 0.0, turn.y.sin()))
        .sum::<DVec3>();
    let turn = DQuat::from_rotation_y(yaw.z.atan2(yaw.x));
    let shift = pairs
        .iter()
        .map(|(_, ours, _, theirs, _)| *theirs - turn * *ours)
        .sum::<DVec3>();
    (turn, shift / pairs.len().max(1) as f64)
}

fn against(poses: &[Pose], reference: &Reference, offset: f64, aligned: bool) {
    let mut pairs = Vec::new();
    for (time, place, turn) in reference {
        let time = HostTime::from_secs_f64(time + offset);
        if let Some((ours, rotation, _)) = at(poses, time) {
            pairs.push((time.as_secs_f64(), ours, rotation, *place, *turn));
        }
    }
    if pairs.len() < 10 {
        println!("  nothing to compare with");
        return;
    }
    let (turn, shift) = if aligned {
        align(&pairs)
    } else {
        (DQuat::IDENTITY, DVec3::ZERO)
    };
    let (mut metres, mut degrees, mut ahead) = (Vec::new(), Vec::new(), Vec::new());
    let (mut along, mut square) = (0.0, 0.0);
    for (index, (time, ours, rotation, theirs, their_rotation)) in pairs.iter().enumerate() {
        let off = turn * *ours + shift - *theirs;
        metres.push(off.length() * 1e3);
        degrees.push(
            (turn * *rotation)
                .angle_between(*their_rotation)
                .to_degrees(),
        );
        if let (Some(before), Some(after)) = (
            index.checked_sub(1).and_then(|i| pairs.get(i)),
            pairs.get(index + 1),
        ) {
            let velocity = (after.3 - before.3) / (after.0 - before.0).max(1e-6);
            along += off.dot(velocity);
            square += velocity.length_squared();
        }
        let Some((_, _, pose)) = at(poses, HostTime::from_secs_f64(*time)) else {
            continue;
        };
        let then = pose.at.as_secs_f64() + 0.03;
        let next = pairs.partition_point(|pair| pair.0 < then);
        if let (Some(a), Some(b)) = (
            next.checked_sub(1).and_then(|i| pairs.get(i)),
            pairs.get(next),
        ) && b.0 - a.0 < 0.03
        {
            let truth = a.3.lerp(b.3, (then - a.0) / (b.0 - a.0));
            let foretold =
                turn * (pose.position.as_dvec3() + 0.03 * pose.velocity.as_dvec3()) + shift;
            ahead.push((foretold - truth).length() * 1e3);
        }
    }
    println!(
        "  {} compared: median {:.2} mm {:.3} degrees, p95 {:.2} {:.3}, p99 {:.2} {:.3}, worst {:.1} {:.2}",
        metres.len(),
        quantile(&mut metres, 0.5),
        quantile(&mut degrees, 0.5),
        quantile(&mut metres, 0.95),
        quantile(&mut degrees, 0.95),
        quantile(&mut metres, 0.99),
        quantile(&mut degrees, 0.99),
        quantile(&mut metres, 1.0),
        quantile(&mut degrees, 1.0),
    );
    println!(
        "  lag {:.2} ms, 30 ms ahead p95 {:.2} mm",
        -1e3 * along / square.max(1e-9),
        quantile(&mut ahead, 0.95),
    );
}

fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let index = (values.len().saturating_sub(1)) as f64 * share;
    values.get(index as usize).copied().unwrap_or(f64::NAN)
}
