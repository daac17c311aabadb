//! What is simulated decodes to what went in.

use std::f64::consts::{PI, TAU};

use glam::{DQuat, DVec3};
use posed_signal::{PoseHow, Role, Sample};
use proptest::prelude::*;

use super::*;
use crate::lighthouse::model::DeviceModel;
use crate::lighthouse::reader::{Event, Reader};
use crate::lighthouse::reproject::{PLANE_CENTRE, reproject};
use crate::rig::{self, Rig};
use crate::{catalog, lighthouse};

/// A smooth, fast motion about `centre`: up to 1.3 m/s and 2.5 rad/s.
fn swaying(centre: DVec3) -> impl Path {
    move |seconds: f64| Placement {
        position: centre
            + DVec3::new(
                0.25 * (3.1 * seconds).sin(),
                0.15 * (2.3 * seconds).cos(),
                0.2 * (4.0 * seconds).sin(),
            ),
        rotation: DQuat::from_rotation_y(1.2 * (1.7 * seconds).sin())
            * DQuat::from_rotation_x(0.6 * (2.9 * seconds).cos()),
    }
}

fn options(duration_s: f64) -> Options {
    Options {
        duration_s,
        ..Options::default()
    }
}

fn exact(duration_s: f64) -> Options {
    Options {
        imu: ImuNoise::NONE,
        light: LightNoise::NONE,
        usb: UsbTiming::NONE,
        ..options(duration_s)
    }
}

fn simulator(options: Options) -> Simulator {
    let place = |x: f64, y: f64, z: f64| swaying(DVec3::new(x, y, z));
    let devices = vec![
        Device::new(Model::Headset, place(0.0, 1.6, 0.0)),
        Device::new(Model::LeftController, place(-0.4, 1.0, -0.3)),
        Device::new(Model::RightController, place(0.4, 1.0, -0.3)),
    ];
    Simulator::new(options, devices).unwrap()
}

/// Everything that a reader finds in the packets of the `index`-th device.
fn events(simulator: &mut Simulator, index: usize) -> Vec<Event> {
    let port = simulator.units[index].port;
    let (mut reader, mut events) = (Reader::default(), Vec::new());
    for packet in simulator.by_ref().filter(|packet| packet.port == port) {
        reader
            .packet(&packet, &mut events)
            .expect("every packet is sound");
    }
    events
}

#[test]
fn packets_come_in_order_and_repeat_by_seed() {
    let run = |seed| {
        simulator(Options {
            seed,
            ..options(0.5)
        })
        .collect::<Vec<_>>()
    };
    let first = run(1);
    assert!(first.len() > 1_000);
    assert!(first.windows(2).all(|pair| pair[0].at <= pair[1].at));
    assert!(first[0].at >= Options::default().start);
    assert_eq!(first, run(1));
    assert_ne!(first, run(2));
}

#[test]
fn the_configuration_arrives_as_it_was_made() {
    for (index, model) in [
        Model::Headset,
        Model::LeftController,
        Model::RightController,
    ]
    .into_iter()
    .enumerate()
    {
        let mut simulator = simulator(options(0.2));
        let events = events(&mut simulator, index);
        let texts: Vec<_> = events
            .iter()
            .filter_map(|event| match event {
                Event::Configuration(text) => Some(text.clone()),
                _ => None,
            })
            .collect();
        assert_eq!(texts.len(), 1);
        let unit = &simulator.units[index];
        let blueprint = blueprint::Blueprint::new(model, &simulator.options, index);
        let made = configuration::document(model, &unit.device.serial, &blueprint);
        assert_eq!(
            serde_json::from_str::<serde_json::Value>(&texts[0]).unwrap(),
            made
        );
        let read = DeviceModel::from_json(&texts[0]).unwrap();
        assert_eq!(read.identity.serial.as_str(), unit.device.serial);
        assert_eq!(read.identity.natural_role, model.role());
        assert_eq!(
            read.sensors.iter().flatten().count(),
            blueprint.sensors.len()
        );
        let ranges = Event::Ranges(blueprint.range.gyro_mode, blueprint.range.acc_mode);
        assert!(events.contains(&ranges));
    }
}

#[test]
fn every_inertial_sample_arrives_once() {
    // Wired, every sample comes through; by radio too when the radio loses nothing.
    for (index, nominal) in [(0, 48_000.0), (1, 192_000.0)] {
        let mut simulator = simulator(exact(2.0));
        let events = events(&mut simulator, index);
        let ticks: Vec<u64> = events
            .iter()
            .filter_map(|event| match event {
                Event::Imu { ticks, .. } => Some(*ticks),
                _ => None,
            })
            .collect();
        let apart: Vec<u64> = ticks.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let interval = apart.iter().sum::<u64>() as f64 / apart.len() as f64;
        assert!((interval / nominal - 1.0).abs() < 0.02, "{interval} ticks");
        // A controller's counter shows every 256th tick.
        assert!(
            apart
                .iter()
                .all(|&one| (one as f64 - interval).abs() < 257.0)
        );
        let expected = (2.0 * 48e6 / interval) as usize;
        assert!(
            (expected - 6..=expected + 1).contains(&ticks.len()),
            "{} samples",
            ticks.len()
        );
    }
}

/// Difference between the angle that each sweep says and the one that the model gives for where
/// the sensor truly was, rad.
fn residuals(simulator: &mut Simulator, index: usize) -> Vec<f64> {
    let events = events(simulator, index);
    let unit = &simulator.units[index];
    let blueprint = blueprint::Blueprint::new(unit.device.model, &simulator.options, index);
    let in_head = blueprint.head.inverse();
    let (mut syncs, mut residuals) = (std::collections::BTreeMap::new(), Vec::new());
    for event in events {
        match event {
            Event::Sync { channel, ticks, .. } => {
                syncs.insert(channel, unit.clock.seconds(ticks));
            }
            Event::Sweep {
                channel,
                sensor,
                ticks,
            } => {
                let Some(sync) = syncs.get(&channel) else {
                    continue;
                };
                let seconds = unit.clock.seconds(ticks);
                let rotor = simulator
                    .rotors
                    .iter()
                    .find(|r| r.station.source == Source::Channel(channel));
                let rotor = rotor.expect("the channel is that of a base station");
                let angle = (seconds - sync) / rotor.mean_period_s() * TAU;
                let plane = usize::from(angle > PI);
                let eye = blueprint.sensors.iter().find(|one| one.channel == sensor);
                let eye = in_head.point(eye.expect("the sensor exists").position);
                let point = rotor
                    .station
                    .to_local(unit.device.path.at(seconds).point(eye));
                let reading = reproject(&rotor.station.calibration[plane], plane, point);
                residuals.push(angle - PLANE_CENTRE[plane] - reading);
            }
            _ => {}
        }
    }
    residuals
}

#[test]
fn sweeps_without_errors_are_where_the_model_says() {
    for (index, least) in [(0, 3_500), (1, 1_500), (2, 1_500)] {
        let residuals = residuals(&mut simulator(exact(2.0)), index);
        assert!(
            residuals.len() > least,
            "device {index}: {} sweeps",
            residuals.len()
        );
        // Half a tick of the sync and a quarter of the sweep's half ticks are 5e-6 rad.
        let worst = residuals.iter().fold(0.0f64, |worst, r| worst.max(r.abs()));
        assert!(worst < 6e-6, "device {index}: {worst} rad");
    }
}

#[test]
fn sweeps_have_the_noise_asked_for() {
    let light = LightNoise {
        sweep_s: 200e-9,
        reflection: 0.01,
        ..LightNoise::NONE
    };
    let residuals = residuals(
        &mut simulator(Options {
            light,
            ..exact(3.0)
        }),
        0,
    );
    let inliers: Vec<f64> = residuals
        .iter()
        .copied()
        .filter(|r| r.abs() < 1e-3)
        .collect();
    let square = inliers.iter().map(|r| r * r).sum::<f64>() / inliers.len() as f64;
    let expected = 200e-9 * 51.0 * TAU;
    assert!(
        (square.sqrt() / expected - 1.0).abs() < 0.05,
        "{} rad",
        square.sqrt()
    );
    let outliers = (residuals.len() - inliers.len()) as f64 / residuals.len() as f64;
    assert!((0.006..0.014).contains(&outliers), "{outliers}");
}

#[test]
fn what_stands_in_the_light_hides_a_station() {
    let station = default_stations()[0].position;
    let wall = Occluder {
        axis: Box::new(move |_| {
            let middle = station * 0.5 + DVec3::new(0.0, 0.6, 0.0);
            [middle - DVec3::Y, middle + DVec3::Y]
        }),
        radius: 1.0,
    };
    let channels = |occluders| {
        let mut simulator = simulator(Options {
            occluders,
            ..exact(1.0)
        });
        let mut channels: Vec<u8> = events(&mut simulator, 0)
            .iter()
            .filter_map(|event| match event {
                Event::Sweep { channel, .. } => Some(*channel),
                _ => None,
            })
            .collect();
        channels.sort_unstable();
        channels.dedup();
        channels
    };
    assert_eq!(channels(vec![]), [2, 8]);
    assert_eq!(channels(vec![wall]), [8]);
}

/// Errors of a device's poses, metres and rad, each sorted.
fn tracking_errors(role: Role) -> [Vec<f64>; 2] {
    let simulator = simulator(options(6.0));
    let (start, stations) = (simulator.options.start, simulator.stations().to_vec());
    let lighthouse = lighthouse::Settings {
        base_stations: stations,
        ..lighthouse::Settings::default()
    };
    let (mut rig, mut rings) = Rig::new(rig::Settings {
        devices: catalog::Settings { lighthouse },
        ..rig::Settings::default()
    });
    let index = simulator
        .units
        .iter()
        .position(|unit| unit.device.model.role() == role)
        .unwrap();
    let port = simulator.units[index].port;
    let path = &swaying([DVec3::new(0.0, 1.6, 0.0), DVec3::new(-0.4, 1.0, -0.3)][index]);
    let [mut position, mut rotation] = [Vec::new(), Vec::new()];
    for packet in simulator.filter(|packet| packet.port == port) {
        rig.packet(&packet);
        for sample in rings
            .iter_mut()
            .flat_map(|ring| std::iter::from_fn(|| ring.pop()))
        {
            let Sample::Pose(pose) = sample else { continue };
            assert_eq!(pose.how, PoseHow::Optical);
            let truth = path.at(pose.at.since_secs(start));
            position.push(pose.position.as_dvec3().distance(truth.position));
            let turn = truth.rotation.conjugate() * pose.rotation.as_dquat();
            rotation.push(2.0 * turn.xyz().length().min(1.0).asin());
        }
    }
    assert_eq!(rig.devices()[0].role, role);
    assert_eq!(rig.devices()[0].counters.decode_errors, 0);
    [position, rotation].map(|mut errors| {
        errors.sort_by(f64::total_cmp);
        errors
    })
}

#[test]
fn decoders_find_the_truth_again() {
    for (role, least) in [(Role::Head, 2_800), (Role::LeftHand, 1_250)] {
        let [position, rotation] = tracking_errors(role);
        assert!(position.len() > least, "{role}: {} poses", position.len());
        let at = |errors: &[f64], share: f64| errors[(share * (errors.len() - 1) as f64) as usize];
        let (median, p99) = (at(&position, 0.5), at(&position, 0.99));
        assert!(
            median < 2e-3 && p99 < 10e-3,
            "{role}: {median} m, p99 {p99} m"
        );
        let (median, p99) = (
            at(&rotation, 0.5).to_degrees(),
            at(&rotation, 0.99).to_degrees(),
        );
        assert!(
            median < 0.2 && p99 < 1.0,
            "{role}: {median} degrees, p99 {p99} degrees"
        );
    }
}

#[test]
fn truth_is_the_path() {
    let simulator = simulator(options(0.1));
    let truth: Vec<Truth> = simulator.truth(5_000_000).collect();
    assert_eq!(truth.len(), 3 * 21);
    let last = &truth[60];
    assert_eq!((last.device.as_str(), last.role), ("SIM-HMD00001", "head"));
    assert_eq!(last.t_ns - Options::default().start.0, 100_000_000);
    let placement = swaying(DVec3::new(0.0, 1.6, 0.0)).at(0.1);
    assert_eq!(last.position, placement.position.to_array());
    let line = serde_json::to_string(last).unwrap();
    assert!(line.starts_with(r#"{"t_ns":1000100000000,"device":"SIM-HMD00001","role":"head""#));
}

#[test]
fn options_out_of_range_are_refused() {
    let with = |change: fn(&mut Options)| {
        let mut options = options(1.0);
        change(&mut options);
        Simulator::new(options, Vec::new()).err()
    };
    assert_eq!(with(|_| {}), None);
    assert!(matches!(
        with(|o| o.duration_s = f64::NAN),
        Some(SimulateError::Range { .. })
    ));
    assert!(matches!(
        with(|o| o.light.drop = 2.0),
        Some(SimulateError::Range { .. })
    ));
    let shared = with(|o| o.stations[1].source = o.stations[0].source);
    assert_eq!(shared, None, "users do that");
    let shared = with(|o| {
        o.stations = generation_one_stations();
        o.stations[1].source = o.stations[0].source;
    });
    assert_eq!(shared, Some(SimulateError::SharedSlot(Source::Slot(0))));
    assert_eq!(
        with(|o| o.stations[0].source = Source::Channel(16)),
        Some(SimulateError::NoSuchChannel(16))
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]
    #[test]
    fn whatever_the_noise_packets_stay_sound(
        seed in any::<u64>(), drop in 0.0f64..1.0, reflection in 0.0f64..1.0,
        sweep_us in 0.0f64..50.0, jitter_ms in 0.0f64..20.0, radio_loss in 0.0f64..1.0,
        accel in 0.0f64..10.0, drift_ppm in 0.0f64..500.0,
    ) {
        let mut options = Options { seed, ..options(0.4) };
        options.light.drop = drop;
        options.light.reflection = reflection;
        options.light.sweep_s = sweep_us * 1e-6;
        options.usb = UsbTiming { jitter_s: jitter_ms * 1e-3, radio_loss, drift_ppm };
        options.imu.accel = accel;
        let mut readers = [const { None::<Reader> }; 3];
        let mut last = HostTime(0);
        for packet in simulator(options) {
            prop_assert!(packet.at >= last);
            last = packet.at;
            let reader = &mut readers[usize::from(packet.port.address) - 10];
            let mut events = Vec::new();
            let read = reader.get_or_insert_default().packet(&packet, &mut events);
            prop_assert!(read.is_ok(), "{read:?}");
        }
    }
}
