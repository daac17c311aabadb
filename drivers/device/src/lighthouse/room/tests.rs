//! Rooms that are known, seen by a ball of sensors.

use std::sync::Arc;

use glam::{DMat3, DQuat, DVec3};
use posed_signal::upright::Upright;

use super::{
    snapshot::{Glimpse, Snapshot},
    *,
};
use crate::lighthouse::model::DeviceModel;

/// A ball of 28 sensors with a radius of 9 cm.
fn ball() -> Arc<DeviceModel> {
    let normals: Vec<[f64; 3]> = (0..28)
        .map(|n| {
            let (height, turn) = (f64::from(n) / 13.5 - 1.0, f64::from(n) * 2.4);
            let radius = (1.0 - height * height).sqrt();
            [radius * turn.cos(), height, radius * turn.sin()]
        })
        .collect();
    let points: Vec<_> = normals.iter().map(|n| n.map(|x| x * 0.09)).collect();
    let text = serde_json::json!({"device_class": "hmd", "lighthouse_config": {
        "modelPoints": points, "modelNormals": normals}});
    Arc::new(DeviceModel::from_json(&text.to_string()).unwrap())
}

/// A station that looks at the middle of the room.
fn station(channel: u8, x: f64, z: f64) -> BaseStation {
    let position = DVec3::new(x, 2.2, z);
    let away = (position - DVec3::Y).normalize();
    let right = DVec3::Y.cross(away).normalize();
    let turn = DMat3::from_cols(right, away.cross(right), away);
    BaseStation {
        source: Source::Channel(channel),
        id: u32::from(channel),
        position,
        rotation: DQuat::from_mat3(&turn),
        calibration: TYPICAL,
    }
}

fn stations() -> [BaseStation; 3] {
    [
        station(1, 2.0, 2.0),
        station(2, -2.0, -1.5),
        station(3, 2.0, -2.0),
    ]
}

fn at(x: f64, y: f64, z: f64, turn: f64) -> Frame {
    Frame {
        position: DVec3::new(x, y, z),
        rotation: DQuat::from_rotation_y(turn) * DQuat::from_rotation_x(0.2),
    }
}

/// What the ball sees of some stations.
fn seen(model: &Arc<DeviceModel>, stations: &[BaseStation], pose: &Frame) -> Snapshot {
    let mut glimpses = Vec::new();
    for station in stations {
        for (sensor, entry) in model.sensors.iter().enumerate() {
            let Some(entry) = entry else { continue };
            let point = pose.position + pose.rotation * entry.position;
            if (pose.rotation * entry.normal).dot(station.position - point) < 0.2 {
                continue;
            }
            for plane in 0..2 {
                glimpses.push(Glimpse {
                    source: station.source,
                    plane: plane as u8,
                    sensor: sensor as u8,
                    angle: station.reading(plane, station.to_local(point)).0,
                    arm: entry.position,
                    tau: 0.0,
                });
            }
        }
    }
    Snapshot {
        model: Arc::clone(model),
        up: pose.rotation.conjugate() * DVec3::Y,
        up_sigma: 0.004,
        pose: None,
        glimpses,
    }
}

/// The largest deviation of distances among stations, and of what is up for them.
fn deviation(room: &Room, truth: &[BaseStation]) -> (f64, f64) {
    let found: Vec<&BaseStation> = room.stations().collect();
    assert_eq!(found.len(), truth.len());
    let mut worst = (0.0f64, 0.0f64);
    for (a, true_a) in found.iter().zip(truth) {
        let up = |station: &BaseStation| station.rotation.conjugate() * DVec3::Y;
        worst.1 = worst.1.max(up(a).angle_between(up(true_a)));
        for (b, true_b) in found.iter().zip(truth) {
            let there = a.rotation.conjugate() * (b.position - a.position);
            let truth = true_a.rotation.conjugate() * (true_b.position - true_a.position);
            worst.0 = worst.0.max((there - truth).length());
        }
    }
    worst
}

#[test]
fn stations_are_chained_through_what_sees_them_together() {
    let (model, all) = (ball(), stations());
    let mut room = Room::default();
    room.offer(seen(&model, &all[..1], &at(0.0, 1.6, 0.0, 0.3)));
    assert_eq!(room.stations().count(), 1, "one is enough to begin with");
    assert!(room.stations().all(|station| station.position.y > 1.0));
    room.offer(seen(&model, &all[2..], &at(0.3, 1.6, 0.2, 0.3)));
    assert_eq!(room.stations().count(), 1, "nothing joins it to the first");
    room.offer(seen(&model, &all[..2], &at(0.3, 1.5, 0.2, 0.9)));
    room.offer(seen(&model, &all[1..], &at(-0.4, 1.4, -0.3, 2.0)));
    let (metres, radians) = deviation(&room, &all);
    assert!(metres < 1e-3 && radians < 1e-3, "{metres} m, {radians}");
    assert_eq!(room.moved(), 0);
}

/// Rooms that differ in nothing but the noise of readings: their stations scatter as they are said
/// to.
#[test]
fn stations_scatter_as_they_are_said_to() {
    let (model, all) = (ball(), stations());
    let mut state = 1u64;
    let mut noise = || {
        // About normal: the sum of twelve even ones.
        let mut even = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            (state >> 40) as f64 / f64::from(1u32 << 24) - 0.5
        };
        (0..12).map(|_| even()).sum::<f64>()
    };
    let relative = |stations: &[BaseStation]| {
        let back = stations[0].rotation.conjugate();
        let place = back * (stations[1].position - stations[0].position);
        (place, back * stations[1].rotation)
    };
    let (place, turn) = relative(&all);
    let (mut squares, mut said, mut rooms) = ([0.0; 2], [0.0; 2], 0.0);
    for _ in 0..24 {
        let mut room = Room::default();
        for (x, z, turn) in [(0.0, 0.0, 0.3), (0.4, 0.2, 1.3), (-0.3, 0.4, 2.6)] {
            let mut snapshot = seen(&model, &all[..2], &at(x, 1.5, z, turn));
            for glimpse in &mut snapshot.glimpses {
                glimpse.angle += 4e-4 * noise();
            }
            let lean =
                DQuat::from_rotation_x(0.004 * noise()) * DQuat::from_rotation_z(0.004 * noise());
            snapshot.up = lean * snapshot.up;
            room.offer(snapshot);
        }
        let found: Vec<BaseStation> = room.stations().copied().collect();
        let (found_place, found_turn) = relative(&found);
        let [(_, Some(sigma))] = room.certainties().collect::<Vec<_>>()[..] else {
            panic!("the second station was measured")
        };
        let off = [
            (found_place - place).length(),
            found_turn.angle_between(turn),
        ];
        for n in 0..2 {
            squares[n] += off[n].powi(2);
            said[n] += sigma[n].powi(2);
        }
        rooms += 1.0;
    }
    for n in 0..2 {
        let (is, should) = ((squares[n] / rooms).sqrt(), (said[n] / rooms).sqrt());
        println!("{n}: off {is:.2e}, said {should:.2e}");
        // Readings are taken to scatter by 6e-4, half as much again as here.
        assert!(is < 1.2 * should && is > 0.4 * should, "{n}: {is} {should}");
    }
}

#[test]
fn a_station_that_was_moved_gets_another_place() {
    let (model, mut all) = (ball(), stations());
    let mut room = Room::default();
    room.offer(seen(&model, &all, &at(0.0, 1.6, 0.0, 0.3)));
    room.offer(seen(&model, &all, &at(0.4, 1.6, 0.2, 1.3)));
    assert!(deviation(&room, &all).0 < 1e-3);
    all[1] = station(2, -2.3, -1.0);
    room.disagrees(all[1].source);
    assert_eq!((room.stations().count(), room.moved()), (2, 1));
    room.offer(seen(&model, &all, &at(0.2, 1.5, 0.1, 2.3)));
    assert!(deviation(&room, &all).0 < 1e-3);
    // A device that is lost among stations blames those that lean otherwise than they did.
    let leaning = all[2].rotation * DQuat::from_rotation_z(0.3);
    all[2].rotation = leaning;
    let lost = seen(&model, &all[1..], &at(0.1, 1.5, 0.1, 2.0));
    room.contradicts(&lost);
    assert!(
        room.stations()
            .all(|station| station.source != all[2].source)
    );
    assert_eq!(room.stations().count(), 2);
}

#[test]
fn a_kept_room_is_the_same_room() {
    let (model, all) = (ball(), stations());
    let mut room = Room::default();
    room.offer(seen(&model, &all, &at(0.0, 1.6, 0.0, 0.3)));
    room.set_floor(0.2);
    let stored = Stored::from_json(&room.to_store().to_json().unwrap()).unwrap();
    let mut again = Room::default();
    again.adopt(&stored);
    assert_eq!(
        (again.to_store(), again.floor()),
        (room.to_store(), Floor::Setup)
    );
    assert!(deviation(&again, &all).0 < 1e-3);
}

#[test]
fn the_first_seconds_upright_tell_the_floor() {
    let (model, all) = (ball(), stations());
    let mut room = Room::default();
    room.set_stature(1.8);
    room.offer(seen(&model, &all, &at(0.0, 1.6, 0.0, 0.3)));
    let before = room.placed();
    let mut upright = Upright::default();
    let heights = (0..40).filter_map(|n| {
        let time = f64::from(n) * 0.1;
        upright.watch(time, 1.2 + 0.01 * time.sin(), 0.0, 0.1)
    });
    room.upright(heights.last().unwrap());
    assert_eq!(room.floor(), Floor::Upright);
    let raised = room.placed()[1].unwrap().position.y - before[1].unwrap().position.y;
    assert!((raised - (1.685 - 1.2)).abs() < 0.01, "{raised}");
}
