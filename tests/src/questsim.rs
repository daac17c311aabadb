//! QuestSim as it ships: what its character meets in a scene, and what a client may do to it.

use std::fs::read_to_string;

use glam::{Quat, Vec3};
use posed::{
    assemble::{Assembly, Options, assemble},
    commands::demo,
    config::{Layer, parse},
    heights::Heights,
    pipeline::{source::Taken, tracking::Request},
    published::PublishedPose,
    simulated,
};
use posed_body::{
    Joint,
    motion::Trajectory,
    scene::{Object, Scene},
};
use posed_device::transport::Event;
use posed_signal::{HostTime, VirtualClock};
use posed_tracker::{
    ObjectMove, Objects, Tracked, Tracker, TrackerKind,
    eval::{Bones, Sensors, Shown, Straps},
    questsim,
};

use crate::{
    allocation::armed,
    demo::in_a_known_room,
    shared::{models, root},
    stage::Run,
};

const RATE_HZ: f64 = 90.0;
/// The built-in human looks around first, and walks along -Z through the origin until then, seconds.
const WALK_S: [f64; 2] = [3.0, 8.0];

/// One tick.
struct Moment {
    seconds: f64,
    tracked: Tracked,
    objects: Objects,
}

fn scene(name: &str) -> Scene {
    let path = root().join("tests/assets/scenes").join(name);
    let layer = Layer {
        origin: name.to_owned(),
        text: read_to_string(path).expect("the scene can be read"),
    };
    parse(&[layer]).expect("the scene holds").scene
}

/// The built-in human from the start to the end of the first walk, with all six frames of look-ahead.
fn walk(scene: &Scene) -> Vec<Moment> {
    let clip = simulated::built_in(1.75, 1);
    let (trajectory, wearer) = (Trajectory::new(&clip), Bones::Clip.wearer(&clip));
    let shown = Shown::new(&trajectory, &clip, Sensors::HmdControllers, Straps::Exact);
    let options = questsim::Options {
        scene: scene.clone(),
        ..questsim::Options::default()
    };
    let mut tracker = models().questsim(None, options).expect("the model fits");
    let ticks = (WALK_S[1] * RATE_HZ) as u32;
    let one = |tick| {
        let seconds = f64::from(tick) / RATE_HZ;
        let target = HostTime::from_secs_f64(1.0 + seconds);
        let tracked = shown.track(&mut tracker, &wearer, seconds, target);
        assert!(tracked.pose.is_sound(), "{seconds} s");
        assert!(
            tracked.forces.is_none_or(|forces| forces.is_sound()),
            "{seconds} s"
        );
        let objects = tracker.objects();
        assert!(
            objects.is_sound() && objects.len() == scene.objects.len(),
            "{seconds} s"
        );
        Moment {
            seconds,
            tracked,
            objects,
        }
    };
    let moments: Vec<_> = (0..ticks).map(one).collect();
    let own = moments
        .iter()
        .filter(|moment| moment.tracked.kind == TrackerKind::QuestSim);
    let own = own.count() as f64 / moments.len() as f64;
    println!("{:?}, {:.0} % its own", tracker.recoveries(), 100.0 * own);
    assert!(own > 0.5, "the character makes {own} of the poses itself");
    assert_eq!(tracker.recoveries().expect("a simulation").faults, 0);
    moments
}

/// When the character first touches the only thing in the scene.
fn first_touch(moments: &[Moment]) -> f64 {
    let touch = moments.iter().find(|moment| moment.objects[0].touched);
    let touch = touch
        .expect("the character touches what lies in its way")
        .seconds;
    println!("touched at {touch:.2} s");
    assert!(touch > WALK_S[0], "not before it walks, but at {touch} s");
    touch
}

#[test]
fn a_ball_is_kicked() {
    let moments = walk(&scene("ball.toml"));
    let touch = first_touch(&moments);
    let at = |moment: &Moment| moment.objects[0].position;
    let start = at(&moments[0]);
    let moved = |moment: &&Moment| at(moment).distance(start) > 0.005;
    let first = moments
        .iter()
        .find(moved)
        .expect("the ball is kicked away")
        .seconds;
    assert!(
        (first - touch).abs() < 0.1,
        "it lies still until it is touched: {first} s"
    );
    let rolled = at(moments.last().expect("a walk")).distance(start);
    println!("rolled {rolled:.2} m");
    assert!(rolled > 0.3, "{rolled} m");
}

#[test]
fn a_box_is_stepped_on_or_tripped_over() {
    let scene = scene("box.toml");
    let moments = walk(&scene);
    let touch = first_touch(&moments);
    // It does not give way.
    let place = scene.objects[0].place().position.as_vec3();
    let still = |moment: &Moment| moment.objects[0].position.distance(place) < 1e-5;
    assert!(moments.iter().all(still));
    // While it is touched it carries or holds back a foot.
    let pressed = moments.iter().filter(|moment| moment.objects[0].touched);
    let force = |moment: &Moment| {
        let feet = moment
            .tracked
            .forces
            .map_or([0.0; 2], |forces| forces.feet.map(|f| f.force.length()));
        feet[0].max(feet[1])
    };
    let most = pressed.map(force).fold(0.0, f32::max);
    println!("at most {most:.0} N on a foot meanwhile");
    assert!(most > 50.0, "{most} N");
    assert!(
        moments.iter().any(|moment| moment.seconds > touch + 1.0),
        "life goes on"
    );
}

#[test]
fn rough_ground_is_walked_on() {
    let scene = scene("rough.toml");
    let moments = walk(&scene);
    let (mut standing, mut lowest, mut highest) = (0, f64::MAX, f64::MIN);
    for moment in moments.iter().filter(|moment| moment.seconds > WALK_S[0]) {
        let feet = moment.tracked.forces.map(|forces| forces.feet);
        for foot in feet
            .iter()
            .flatten()
            .filter(|foot| foot.force.length() > 20.0)
        {
            let ground = scene
                .ground
                .at(foot.centre.x.into(), foot.centre.z.into())
                .height;
            // The centre lies between the contact points, which the ground may fall away from.
            let above = f64::from(foot.centre.y) - ground;
            assert!(
                above.abs() < 0.03,
                "{above} m above the ground at {} s",
                moment.seconds
            );
            standing += 1;
            (lowest, highest) = (lowest.min(ground), highest.max(ground));
        }
    }
    println!("{standing} footings on ground from {lowest:.3} to {highest:.3} m");
    assert!(standing > 100, "{standing}");
    assert!(
        highest - lowest > 0.02,
        "the ground is rough where it is walked on"
    );
    let root = |moment: &Moment| moment.tracked.pose.root;
    let way = root(&moments[0]).distance(root(moments.last().expect("a walk")));
    assert!(way > 0.8, "it walked {way} m");
}

/// What a replay of the embedded capture publishes; `ask` may say something at each tick.
fn replay(options: Options, mut ask: impl FnMut(usize) -> Option<Request>) -> Vec<PublishedPose> {
    let Assembly {
        mut source,
        mut tracker,
        mut requests,
    } = assemble(Box::new(demo::replay().expect("embedded")), options);
    let (mut poses, mut next): (Vec<PublishedPose>, _) = (Vec::new(), None);
    loop {
        let event = source.next(0);
        if let Event::Packet(packet) = &event {
            let due = *next.get_or_insert(packet.at);
            if packet.at > due {
                next = Some(due.plus_secs(1.0 / RATE_HZ));
                source.tick(due);
                if let Some(request) = ask(poses.len()) {
                    assert!(requests.tracker.push(request));
                }
                let clock = VirtualClock::new(due);
                let (pose, allocations) = armed(|| tracker.tick(&clock, &mut |_, _| {}));
                // The first tick with a headset builds the world.
                let started = poses.iter().rev().take(1).any(|pose| pose.has_input());
                assert!(!started || allocations == 0, "tick {}", poses.len());
                poses.push(pose);
            }
        }
        if source.take(event) == Taken::End || poses.len() >= 6 * RATE_HZ as usize {
            return poses;
        }
    }
}

#[test]
fn a_client_throws_a_ball_and_a_reset_brings_it_back() {
    let ball = Object::Ball {
        radius: 0.1,
        position: [2.0, 0.1, 2.0],
        mass: 0.4,
    };
    let place = ball.place().position.as_vec3();
    let scene = Scene {
        objects: vec![ball],
        ..Scene::default()
    };
    let tracker = models().tracker(TrackerKind::QuestSim, &scene);
    let options = Options {
        trackers: vec![tracker.expect("the model fits").expect("built in")],
        tracker: TrackerKind::QuestSim,
        ..in_a_known_room()
    };
    let to = ObjectMove {
        index: 0,
        position: Vec3::new(-2.0, 1.0, -2.0),
        rotation: Quat::IDENTITY,
        velocity: Vec3::new(0.0, 2.0, 0.0),
        angular_velocity: Vec3::Y,
    };
    const THROW: usize = 300;
    const RESET: usize = 400;
    let poses = replay(options, |tick| match tick {
        THROW => Some(Request::Move(to)),
        RESET => Some(Request::Reset),
        _ => None,
    });
    let ball = |tick: usize| poses[tick].objects[0].position;
    assert!(ball(THROW - 1).distance(place) < 0.01);
    assert!(ball(THROW).distance(to.position) < 0.1, "{}", ball(THROW));
    assert!(
        ball(THROW + 15).y > 1.15,
        "it flies up: {}",
        ball(THROW + 15)
    );
    assert!(ball(THROW + 90).y < 0.2, "and falls: {}", ball(THROW + 90));
    assert!(ball(RESET + 1).distance(place) < 0.01);
    let own = poses
        .iter()
        .filter(|pose| pose.kind == TrackerKind::QuestSim);
    assert!(own.count() > poses.len() / 3);
    assert!(poses.iter().all(PublishedPose::is_sound));
    assert!(poses.last().is_some_and(|pose| pose.recoveries.is_some()));
}

#[test]
fn the_first_seconds_upright_tell_the_height() {
    let options = Options {
        heights: Heights::of(1.6),
        measure_height: true,
        ..in_a_known_room()
    };
    let run = Run::of(demo::replay().expect("embedded"), options);
    let measured = run.poses.last().and_then(|pose| pose.measured_m);
    let measured = measured.expect("somebody stands upright");
    println!("{measured} m, truly {} m", demo::HEIGHT);
    assert!((measured - demo::HEIGHT).abs() < 0.03, "{measured} m");
    let pelvis = |pose: &PublishedPose| pose.joints.position(Joint::Pelvis).y;
    let known = run.poses.iter().filter(|pose| pose.measured_m.is_some());
    assert!(known.count() > run.poses.len() / 2);
    let last = run.poses.last().expect("poses");
    assert!(
        pelvis(last) > 0.85,
        "a taller wearer stands on longer legs: {}",
        pelvis(last)
    );
}

#[test]
fn an_avatar_of_another_height_stands_as_upright_where_the_wearer_is() {
    let played = |heights| {
        let options = Options {
            heights,
            ..in_a_known_room()
        };
        Run::of(demo::replay().expect("embedded"), options).poses
    };
    let own = played(Heights::of(demo::HEIGHT));
    for scale in [0.8, 1.2] {
        let avatar = played(Heights {
            wearer: demo::HEIGHT,
            avatar: Some(demo::HEIGHT * scale),
        });
        let mut compared = 0;
        for (own, avatar) in own.iter().zip(&avatar).filter(|(own, _)| own.has_input()) {
            let head = |pose: &PublishedPose| pose.joints.position(Joint::Head);
            let (own, avatar) = (head(own), head(avatar));
            assert!((avatar.y - scale * own.y).abs() < 0.02, "{avatar} {own}");
            assert!((avatar - own).with_y(0.0).length() < 0.02, "{avatar} {own}");
            compared += 1;
        }
        assert!(compared > 500, "{compared}");
    }
}
