//! Against an independent implementation, and against what must be zero.

use std::collections::BTreeMap;

use serde::Deserialize;

use super::*;

/// Written by tests/golden/make_metrics.py.
const GOLDEN: &str = include_str!("../../tests/golden/metrics.json");

#[derive(Deserialize)]
struct Golden {
    fps: f64,
    frames: usize,
    predicted_positions: Vec<f32>,
    predicted_local: Vec<f32>,
    true_positions: Vec<f32>,
    true_local: Vec<f32>,
    masses: Vec<(usize, f64, f64, f64, f64)>,
    scores: BTreeMap<String, f64>,
    translation_cm: Vec<Option<f64>>,
}

fn track(golden: &Golden, positions: &[f32], local: &[f32]) -> Track {
    assert_eq!(positions.len(), golden.frames * JOINTS * 3);
    let joint = |frame: usize, index: usize| frame * JOINTS + index;
    let position = |at: usize| Vec3::from_slice(&positions[3 * at..]);
    let rotation = |at: usize| Quat::from_slice(&local[4 * at..]);
    Track::from_parts(
        golden.fps,
        (0..golden.frames)
            .map(|f| std::array::from_fn(|i| position(joint(f, i))))
            .collect(),
        (0..golden.frames)
            .map(|f| std::array::from_fn(|i| rotation(joint(f, i))))
            .collect(),
    )
}

#[test]
fn every_metric_agrees_with_numpy() {
    let golden: Golden = serde_json::from_str(GOLDEN).unwrap();
    let predicted = track(
        &golden,
        &golden.predicted_positions,
        &golden.predicted_local,
    );
    let truth = track(&golden, &golden.true_positions, &golden.true_local);
    let mass = |&(joint, x, y, z, mass): &(usize, f64, f64, f64, f64)| PointMass {
        joint: Joint::ALL[joint],
        offset: DVec3::new(x, y, z),
        mass,
    };
    let masses: Vec<PointMass> = golden.masses.iter().map(mass).collect();
    let scores = Scores::measure(&predicted, &truth, &masses);
    for &metric in Metric::ALL {
        let wanted = golden.scores[metric.name()];
        let found = scores.get(metric).unwrap();
        let bound = 1e-5 * wanted.abs().max(1.0);
        assert!(
            (found - wanted).abs() < bound,
            "{}: {found}, numpy {wanted}",
            metric.name()
        );
        assert!(wanted > 0.0, "{} is put to the test", metric.name());
    }
    assert_eq!(golden.scores.len(), Metric::COUNT);
    for (found, wanted) in scores.translation_cm.iter().zip(&golden.translation_cm) {
        assert_eq!(found.is_some(), wanted.is_some());
        let off = found.unwrap_or(0.0) - wanted.unwrap_or(0.0);
        assert!(off.abs() < 1e-4, "{found:?}, numpy {wanted:?}");
    }
    assert!(scores.translation_cm[0].is_some() && scores.translation_cm[6].is_none());
}

#[test]
fn the_truth_has_no_error() {
    let skeleton = Skeleton::of_height(1.7);
    let mut pose = BodyPose::rest(Vec3::new(0.0, 0.85, 0.0));
    let mut poses = Vec::new();
    for frame in 0..60 {
        pose.root.x = 0.05 * frame as f32;
        pose.rotations[18] = Quat::from_rotation_y(-0.02 * frame as f32);
        poses.push(pose);
    }
    let track = Track::new(60.0, &skeleton, &poses);
    let scores = Scores::measure(&track, &track, &point_masses(&skeleton));
    for &metric in Metric::ALL {
        use Metric::{FootSlide, Jitter, TrueFootSlide, TrueJitter, TrueZmp, Zmp};
        if [FootSlide, Jitter, TrueFootSlide, TrueJitter, TrueZmp, Zmp].contains(&metric) {
            continue;
        }
        let value = scores.get(metric).unwrap();
        assert!(value.abs() < 1e-6, "{}: {value}", metric.name());
    }
    // The feet glide at 3 m/s: none of them ever stands.
    assert_eq!(scores.get(Metric::FootSlide), None);
}

#[test]
fn a_person_who_stands_still_is_in_balance() {
    let skeleton = Skeleton::of_height(1.75);
    let masses = point_masses(&skeleton);
    let total: f64 = masses.iter().map(|part| part.mass).sum();
    assert!((total - 72.0).abs() < 1.0, "{total} kg");
    let poses = [BodyPose::rest(Vec3::new(0.0, 0.9, 0.0)); 40];
    let track = Track::new(60.0, &skeleton, &poses);
    let zmp = Scores::measure(&track, &track, &masses)
        .get(Metric::Zmp)
        .unwrap();
    assert!(zmp < 0.1, "{zmp} m off the feet");
}

#[test]
fn clips_count_once_each_and_only_where_they_say_something() {
    let of = |value: Option<f64>| {
        let mut scores = Scores::EMPTY;
        scores.values[0] = value;
        scores
    };
    let clips = [of(Some(1.0)), of(None), of(Some(4.0))];
    let mean = Scores::mean(clips.iter());
    assert_eq!(mean.get(Metric::ALL[0]), Some(2.5));
    assert_eq!(mean.get(Metric::ALL[1]), None);
    assert_eq!(Scores::mean([].iter()), Scores::EMPTY);
}
