//! The simulated walk as a wearer has it: a body in the light, reflections, moments of darkness.

use glam::DVec3;
use posed_signal::PoseHow;

use super::{
    super::base_station::BaseStation,
    quantile,
    simulated::{Walk, body, truth, walk_with},
};
use crate::simulate::{LightNoise, Occluder, Options, default_stations, four_stations};

/// When the first dark span begins, how long each is and how far apart they are, s.
const DARK: (f64, f64, f64) = (3.0, 0.15, 1.3);
/// Longest spans of the walk, s.
const SECONDS: f64 = 12.0;
/// Errors are counted from here on, s.
const SETTLED: f64 = 2.0;

/// The wearer's trunk and two legs that follow the walk.
fn trunk() -> Vec<Occluder> {
    let capsule = |foot: DVec3, top: DVec3, radius: f64| Occluder {
        axis: Box::new(move |seconds| {
            let (place, turn) = body(seconds);
            [foot, top].map(|end| place + turn * end)
        }),
        radius,
    };
    vec![
        capsule(
            DVec3::new(0.0, 0.95, 0.02),
            DVec3::new(0.0, 1.40, 0.02),
            0.14,
        ),
        capsule(
            DVec3::new(-0.1, 0.05, 0.0),
            DVec3::new(-0.1, 0.85, 0.0),
            0.08,
        ),
        capsule(DVec3::new(0.1, 0.05, 0.0), DVec3::new(0.1, 0.85, 0.0), 0.08),
    ]
}

fn worn(stations: Vec<BaseStation>, dark: Vec<[f64; 2]>) -> Walk {
    let options = Options {
        duration_s: SECONDS,
        stations,
        occluders: trunk(),
        dark,
        light: LightNoise {
            reflection: 0.01,
            ..LightNoise::TYPICAL
        },
        ..Options::default()
    };
    walk_with(options, |_, _| true)
}

/// What a device's poses are off.
struct Figures {
    /// 99th percentiles, m and degrees.
    p99: (f64, f64),
    /// How far they are behind the truth, s.
    lag: f64,
    /// 95th percentile of what they are off when foretold by 30 ms, m.
    ahead: f64,
    /// Share of poses that light stands behind.
    optical: f64,
}

fn figures(walk: &Walk, index: usize) -> Figures {
    let errors = walk.errors(index, SETTLED);
    let model = walk.devices[index].0;
    let (mut along, mut square, mut ahead) = (0.0, 0.0, Vec::new());
    for (pose, ..) in &errors {
        let at = |dt: f64| truth(model, walk.seconds(pose) + dt).position;
        let velocity = (at(1e-4) - at(-1e-4)) / 2e-4;
        along += (pose.position.as_dvec3() - at(0.0)).dot(velocity);
        square += velocity.length_squared();
        let foretold = pose.position.as_dvec3() + 0.03 * pose.velocity.as_dvec3();
        ahead.push((foretold - at(0.03)).length());
    }
    let optical = errors
        .iter()
        .filter(|(pose, ..)| pose.how == PoseHow::Optical);
    Figures {
        p99: (
            quantile(errors.iter().map(|error| error.1), 0.99),
            quantile(errors.iter().map(|error| error.2), 0.99),
        ),
        lag: -along / square,
        ahead: quantile(ahead.into_iter(), 0.95),
        optical: optical.count() as f64 / errors.len() as f64,
    }
}

#[test]
fn a_worn_walk_is_tracked_under_two_and_four_stations() {
    for stations in [default_stations(), four_stations()] {
        let count = stations.len();
        let walk = worn(stations, Vec::new());
        for index in 0..3 {
            let found = figures(&walk, index);
            let (p99, lag) = (found.p99, 1e3 * found.lag);
            println!(
                "{count} stations, {:?}: p99 {:.2} mm {:.3} degrees, lag {lag:.2} ms, \
                 30 ms ahead p95 {:.2} mm, optical {:.1} %",
                walk.devices[index].0,
                1e3 * p99.0,
                p99.1,
                1e3 * found.ahead,
                1e2 * found.optical,
            );
            assert!(p99.0 < 8e-3 && p99.1 < 0.8);
            assert!(lag.abs() < 2.0 && found.ahead < 1e-2);
            assert!(found.optical > 0.95);
        }
    }
}

#[test]
fn a_moment_of_darkness_costs_little() {
    let begins = (0..7).map(|n| DARK.0 + DARK.2 * f64::from(n));
    let dark: Vec<[f64; 2]> = begins.map(|begin| [begin, begin + DARK.1]).collect();
    let near = |seconds: f64| {
        dark.iter()
            .any(|[begin, end]| (*begin..end + 0.1).contains(&seconds))
    };
    for stations in [default_stations(), four_stations()] {
        let count = stations.len();
        let walk = worn(stations.clone(), dark.clone());
        let bright = worn(stations, Vec::new());
        for index in 0..3 {
            let worst = |walk: &Walk| {
                let errors = walk.errors(index, SETTLED);
                let off = errors
                    .iter()
                    .filter(|(pose, ..)| near(walk.seconds(pose)))
                    .map(|error| error.1);
                off.fold(0.0, f64::max)
            };
            let (dark, bright) = (worst(&walk), worst(&bright));
            println!(
                "{count} stations, {:?}: worst {:.2} mm in and after the dark, {:.2} mm without",
                walk.devices[index].0,
                1e3 * dark,
                1e3 * bright,
            );
            assert!(dark - bright < 0.03);
            let lost = walk.devices[index]
                .1
                .poses
                .iter()
                .filter(|pose| walk.seconds(pose) > SETTLED && pose.how == PoseHow::Lost);
            assert_eq!(lost.count(), 0);
        }
    }
}
