use super::*;

fn layer(origin: &str, text: &str) -> Layer {
    Layer {
        origin: origin.into(),
        text: text.into(),
    }
}

fn error(text: &str) -> String {
    parse(&[layer("posed.toml", text)]).unwrap_err().to_string()
}

#[test]
fn the_documented_file_is_the_default() {
    let documented = parse(&[layer("default.toml", include_str!("default.toml"))]).unwrap();
    assert_eq!(documented, Config::default());
    assert_eq!(parse(&[]).unwrap(), Config::default());
}

#[test]
fn the_documented_file_names_every_key() {
    // With the optional keys' examples taken in, it still parses: none of them is misspelt.
    let text: String = include_str!("default.toml")
        .lines()
        .map(|line| match line.strip_prefix("# ") {
            Some(key) if key.contains(" = \"/") || key.contains("\" = \"") => format!("{key}\n"),
            Some(key) if key.starts_with("avatar_height_m") => format!("{key}\n"),
            _ => format!("{line}\n"),
        })
        .collect();
    let config = parse(&[layer("default.toml", &text)]).unwrap();
    assert!(config.devices.base_stations.is_some());
    assert_eq!(config.devices.roles["LHR-12345678"], Role::Waist);
    assert_eq!(config.wearer.avatar_height_m, Some(1.95));
}

#[test]
fn the_documented_scenes_can_be_built() {
    let text = include_str!("default.toml");
    let list = text.split("# objects = [").nth(1).unwrap();
    let list = list.split("# ]").next().unwrap().replace("\n#", "\n");
    let grounds = text.lines().filter_map(|line| {
        let ground = line.strip_prefix("#   { kind")?;
        Some(format!("{{ kind{}}}", ground.split('}').next()?))
    });
    let grounds: Vec<_> = grounds.collect();
    assert_eq!(grounds.len(), 4);
    for ground in grounds {
        let scene = format!("[scene]\nground = {ground}\nobjects = [{list}]\n");
        let config = parse(&[layer("posed.toml", &scene)]).unwrap();
        assert_eq!(config.scene.objects.len(), 4);
        let loose = config
            .scene
            .objects
            .iter()
            .map(posed_body::scene::Object::is_loose);
        assert_eq!(loose.collect::<Vec<_>>(), [true, true, false, false]);
    }
}

#[test]
fn a_scene_replaces_the_one_below() {
    let ball = "objects = [{ kind = \"ball\", radius = 0.1, mass = 1.0, position = [0, 1, 0] }]";
    let rough = "ground = { kind = \"rough\", amplitude = 0.1 }";
    let config = parse(&[
        layer("system", &format!("[scene]\n{rough}\n{ball}\n")),
        layer(
            "user",
            "[scene]\nground = { kind = \"slope\", degrees = 3 }\n",
        ),
    ])
    .unwrap();
    assert!(config.scene.objects.is_empty());
    let slope = posed_body::scene::Ground::Slope {
        degrees: 3.0,
        heading: 0.0,
    };
    assert_eq!(config.scene.ground, slope);
}

#[test]
fn later_layers_win_key_by_key() {
    let config = parse(&[
        layer(
            "system",
            "[tracker]\nname = \"pip\"\nrate_hz = 60.0\n[grpc]\ntcp = \"off\"\n",
        ),
        layer(
            "user",
            "[tracker]\nrate_hz = 120\n[devices.roles]\nA = \"waist\"\n",
        ),
        layer("explicit", "[devices.roles]\nA = \"none\"\nB = \"waist\"\n"),
    ])
    .unwrap();
    assert_eq!(
        (config.tracker.name, config.tracker.rate_hz),
        (TrackerKind::Pip, 120.0)
    );
    assert_eq!(config.grpc.tcp, None);
    assert_eq!(config.devices.roles["A"], Role::None);
    assert_eq!(config.devices.roles["B"], Role::Waist);
}

#[test]
fn errors_say_file_key_value_and_what_is_allowed() {
    for (text, parts) in [
        (
            "[wearer]\nheight_m = 17.5\n",
            &["wearer.height_m = 17.5", "from 1.0 to 2.5"] as &[_],
        ),
        (
            "[wearer]\nheight_m = nan\n",
            &["wearer.height_m = NaN", "metres"],
        ),
        (
            "[wearer]\navatar_height_m = 0.2\n",
            &["wearer.avatar_height_m = 0.2", "metres"],
        ),
        ("[wearer]\nheight_m = \"tall\"\n", &["line 2", "tall"]),
        (
            "[scene]\nground = { kind = \"lava\" }\n",
            &["lava", "rough", "line 2"],
        ),
        (
            "[scene]\nground = { kind = \"slope\", degrees = 60.0 }\n",
            &["the scene's ground slopes more than 45"],
        ),
        (
            "[[scene.objects]]\nkind = \"ball\"\nradius = nan\nmass = 1\nposition = [0, 0, 0]\n",
            &["the scene's object 0 has a radius outside 0.01 to 20 m"],
        ),
        (
            "[[scene.objects]]\nkind = \"chair\"\nposition = [0, 0, inf]\n",
            &["object 0 is further than 100 m away"],
        ),
        (
            "[[scene.objects]]\nkind = \"ball\"\nradius = 0.1\nposition = [0, 0, 0]\n",
            &["mass"],
        ),
        (
            "[wearer]\nhight_m = 1.8\n",
            &["hight_m", "height_m", "line 2"],
        ),
        ("[trakker]\n", &["trakker", "tracker"]),
        (
            "[tracker]\nname = \"slime\"\n",
            &["`slime`", "ik, hmd_nemo, pip, questsim"],
        ),
        (
            "[tracker]\nrate_hz = 0\n",
            &["tracker.rate_hz = 0", "from 10.0 to 1000.0"],
        ),
        (
            "[tracker]\nprediction_ms = 61\n",
            &["tracker.prediction_ms = 61", "-170.0 to 60.0"],
        ),
        (
            "[devices]\nbase_stations = \"x\"\n",
            &["devices.base_stations = x", "absolute"],
        ),
        (
            "[devices.roles]\nLHR-1 = \"tail\"\n",
            &["LHR-1", "`tail`", "left_hand"],
        ),
        (
            "[grpc]\nunix = \"posed.sock\"\n",
            &["posed.sock", "absolute path"],
        ),
        (
            "[grpc]\ntcp = \"0.0.0.0:50770\"\n",
            &["0.0.0.0:50770", "127.0.0.1:50770"],
        ),
        ("[grpc]\ntcp = \"[::]:1\"\n", &["[::]:1", "loopback"]),
        (
            "[grpc]\ntcp = \"localhost\"\n",
            &["`localhost`", "127.0.0.1:50770", "off"],
        ),
        (
            "[log]\nfilter = \"posed=loud\"\n",
            &["log.filter = posed=loud", "debug"],
        ),
        ("[grpc", &["line 1"]),
    ] {
        let error = error(text);
        assert!(error.starts_with("posed.toml: "), "{error}");
        for part in parts {
            assert!(
                error.contains(part),
                "{text:?} gives {error:?}, which lacks {part:?}"
            );
        }
    }
}

#[test]
fn a_role_is_given_once() {
    let text = "[devices.roles]\nA = \"waist\"\nB = \"waist\"\nC = \"none\"\nD = \"none\"\n";
    let error = error(text);
    assert!(error.contains("A and B are both waist"), "{error}");
}

#[test]
fn only_the_loopback_can_be_listened_on() {
    for good in [
        "127.0.0.1:1",
        "127.8.9.1:1",
        "[::1]:1",
        "[::ffff:127.0.0.1]:1",
    ] {
        let addr = good.parse().unwrap();
        assert_eq!(Loopback::try_from(addr).map(Loopback::addr), Ok(addr));
    }
    for wide in [
        "0.0.0.0:1",
        "[::]:1",
        "192.168.1.4:1",
        "[fe80::1]:1",
        "[::ffff:10.0.0.1]:1",
    ] {
        let addr = wide.parse().unwrap();
        assert_eq!(Loopback::try_from(addr), Err(NotLoopback(addr)));
    }
}

proptest::proptest! {
    #[test]
    fn no_text_makes_it_panic(text in "(\\[|\\]|=|\"|\n|[a-z_.0-9 ]){0,60}") {
        let _ = parse(&[layer("any", &text)]);
    }
}
