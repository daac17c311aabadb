use super::*;
use crate::output::motion::tests::frames;

/// A GLB file taken apart by the specification: its JSON and its bytes.
struct Read {
    root: Value,
    bytes: Vec<u8>,
}

impl Read {
    fn new(file: &[u8]) -> Self {
        let word = |at: usize| u32::from_le_bytes(file[at..at + 4].try_into().unwrap());
        assert_eq!(
            (&file[..4], word(4), word(8) as usize),
            (&b"glTF"[..], 2, file.len())
        );
        let text = word(12) as usize;
        assert_eq!((&file[16..20], text % 4), (&b"JSON"[..], 0));
        let root = serde_json::from_slice(&file[20..20 + text]).unwrap();
        let at = 20 + text;
        let length = word(at) as usize;
        assert_eq!(
            (&file[at + 4..at + 8], at + 8 + length),
            (&b"BIN\0"[..], file.len())
        );
        Self {
            root,
            bytes: file[at + 8..].to_vec(),
        }
    }

    fn accessor(&self, index: &Value) -> (&Value, &[u8]) {
        let accessor = &self.root["accessors"][index.as_u64().unwrap() as usize];
        let view = &self.root["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
        let offset = view["byteOffset"].as_u64().unwrap() as usize;
        assert_eq!(offset % 4, 0);
        let length = view["byteLength"].as_u64().unwrap() as usize;
        (accessor, &self.bytes[offset..offset + length])
    }

    fn floats<const N: usize>(&self, index: &Value) -> Vec<[f32; N]> {
        let (accessor, bytes) = self.accessor(index);
        assert_eq!(accessor["componentType"], FLOAT);
        let numbers: Vec<f32> = bytes
            .chunks_exact(4)
            .map(|b| f32::from_le_bytes(b.try_into().unwrap()))
            .collect();
        let values: Vec<[f32; N]> = numbers
            .chunks_exact(N)
            .map(|chunk| chunk.try_into().unwrap())
            .collect();
        assert_eq!(accessor["count"].as_u64().unwrap() as usize, values.len());
        values
    }

    /// The nodes' matrices in the world at one key frame, as a player computes them.
    fn worlds(&self, key: usize) -> Vec<Mat4> {
        let nodes = self.root["nodes"].as_array().unwrap();
        let vector = |value: &Value| -> Option<Vec<f32>> {
            Some(
                value
                    .as_array()?
                    .iter()
                    .map(|number| number.as_f64().unwrap() as f32)
                    .collect(),
            )
        };
        let mut locals: Vec<(Vec3, Quat)> = nodes
            .iter()
            .map(|node| {
                let place =
                    vector(&node["translation"]).map_or(Vec3::ZERO, |v| Vec3::from_slice(&v));
                let turn =
                    vector(&node["rotation"]).map_or(Quat::IDENTITY, |v| Quat::from_slice(&v));
                (place, turn)
            })
            .collect();
        let animation = &self.root["animations"][0];
        for channel in animation["channels"].as_array().unwrap() {
            let sampler = &animation["samplers"][channel["sampler"].as_u64().unwrap() as usize];
            let local = &mut locals[channel["target"]["node"].as_u64().unwrap() as usize];
            match channel["target"]["path"].as_str().unwrap() {
                "translation" => local.0 = Vec3::from_array(self.floats(&sampler["output"])[key]),
                "rotation" => local.1 = Quat::from_array(self.floats(&sampler["output"])[key]),
                other => panic!("{other}"),
            }
        }
        let mut worlds = vec![Mat4::IDENTITY; nodes.len()];
        let mut waiting: Vec<(usize, Mat4)> = self.root["scenes"][0]["nodes"]
            .as_array()
            .unwrap()
            .iter()
            .map(|root| (root.as_u64().unwrap() as usize, Mat4::IDENTITY))
            .collect();
        while let Some((index, parent)) = waiting.pop() {
            let (place, turn) = locals[index];
            worlds[index] = parent * Mat4::from_rotation_translation(turn, place);
            for child in nodes[index]["children"].as_array().into_iter().flatten() {
                waiting.push((child.as_u64().unwrap() as usize, worlds[index]));
            }
        }
        worlds
    }
}

// glTF's models look along +Z; the wearer who looks along -Z is turned by half a turn about Y, so
// that the left hand, at -X in posed, is at +X in the file, as VRM 1.0 wants it.
#[test]
fn joints_are_where_they_were_after_half_a_turn() {
    let frames = frames(60);
    let read = Read::new(&glb(&frames, Names::Vrm).unwrap());
    for (key, frame) in frames.iter().enumerate() {
        let expected = frame.skeleton.forward(&frame.pose);
        let worlds = read.worlds(key);
        for joint in Joint::ALL {
            let node = read.root["extensions"]["VRMC_vrm_animation"]["humanoid"]["humanBones"]
                [Names::Vrm.of(joint)]["node"]
                .as_u64()
                .unwrap() as usize;
            assert_eq!(read.root["nodes"][node]["name"], Names::Vrm.of(joint));
            let place = worlds[node].transform_point3(Vec3::ZERO);
            let there = Quat::from_rotation_y(std::f32::consts::PI) * expected.position(joint);
            assert!(
                place.distance(there) < 1e-4,
                "{}: {place} {there}",
                joint.name()
            );
        }
    }
}

#[test]
fn the_rest_pose_is_a_t_pose_on_the_floor_facing_plus_z() {
    let read = Read::new(&glb(&frames(1), Names::Smpl).unwrap());
    let nodes = read.root["nodes"].as_array().unwrap();
    let mut places = vec![Vec3::ZERO; JOINTS];
    for joint in Joint::ALL {
        let node = &nodes[joint as usize];
        assert_eq!(
            (&node["name"], &node["rotation"][3]),
            (&joint.name().into(), &1.0.into())
        );
        let offset: Vec<f32> = serde_json::from_value(node["translation"].clone()).unwrap();
        let parent = joint
            .parent()
            .map_or(Vec3::ZERO, |parent| places[parent as usize]);
        places[joint as usize] = parent + Vec3::from_slice(&offset);
    }
    let lowest = places.iter().map(|place| place.y).fold(f32::MAX, f32::min);
    assert!(lowest.abs() < 1e-6, "{lowest}");
    assert!(places[Joint::LeftWrist as usize].x > 0.5, "left at +X");
    assert!(places[Joint::LeftFoot as usize].z > 0.05, "toes to +Z");
}

#[test]
fn times_rise_from_zero_and_signs_do_not_flip() {
    let mut frames = frames(90);
    for (index, frame) in frames.iter_mut().enumerate() {
        if index % 2 == 1 {
            frame.pose.rotations = frame.pose.rotations.map(|rotation| -rotation);
        }
    }
    frames.insert(9, frames[8]);
    let read = Read::new(&glb(&frames, Names::Vrm).unwrap());
    let animation = &read.root["animations"][0];
    let (accessor, _) = read.accessor(&animation["samplers"][0]["input"]);
    let times = read.floats::<1>(&animation["samplers"][0]["input"]);
    assert_eq!(
        (times.len(), times[0][0]),
        (90, 0.0),
        "the repeated frame is left out"
    );
    assert!(times.is_sorted_by(|a, b| a[0] < b[0]));
    assert_eq!(accessor["max"][0].as_f64().unwrap() as f32, times[89][0]);
    for sampler in animation["samplers"].as_array().unwrap().iter().skip(1) {
        let rotations = read.floats::<4>(&sampler["output"]);
        for pair in rotations.windows(2) {
            assert!(Quat::from_array(pair[0]).dot(Quat::from_array(pair[1])) > 0.0);
        }
    }
}

// A skin must leave the figure as it is when every joint is at rest: corner by corner, the joint's
// matrix times its inverse bind matrix is the identity.
#[test]
fn the_figure_hangs_on_its_bones() {
    let mut frames = frames(1);
    let skeleton = frames[0].skeleton;
    let height = rest_height(&skeleton);
    frames[0].pose = BodyPose::rest(Vec3::new(0.0, height, 0.0));
    let read = Read::new(&glb(&frames, Names::Vrm).unwrap());
    let worlds = read.worlds(0);
    let inverse = read.floats::<16>(&read.root["skins"][0]["inverseBindMatrices"]);
    for joint in 0..JOINTS {
        let matrix = worlds[joint] * Mat4::from_cols_array(&inverse[joint]);
        assert!(matrix.abs_diff_eq(Mat4::IDENTITY, 1e-5), "{matrix}");
    }
    let attributes = &read.root["meshes"][0]["primitives"][0]["attributes"];
    let positions = read.floats::<3>(&attributes["POSITION"]);
    let normals = read.floats::<3>(&attributes["NORMAL"]);
    let (_, bones) = read.accessor(&attributes["JOINTS_0"]);
    assert_eq!((positions.len() % 3, bones.len()), (0, 4 * positions.len()));
    let rest = turned_skeleton(&skeleton).forward(&BodyPose::rest(Vec3::new(0.0, height, 0.0)));
    for (corner, bone) in positions.iter().zip(bones.chunks_exact(4)) {
        let joint = rest.positions[usize::from(bone[0])];
        assert!(
            Vec3::from_array(*corner).distance(joint) < 0.55,
            "near its joint"
        );
    }
    let top = positions.iter().map(|corner| corner[1]).fold(0.0, f32::max);
    assert!((1.6..1.85).contains(&top), "{top}");
    assert!(
        normals
            .iter()
            .all(|normal| (Vec3::from_array(*normal).length() - 1.0).abs() < 1e-5)
    );
}

#[test]
fn nothing_is_an_error() {
    assert_eq!(glb(&[], Names::Vrm), Err(GlbError::Empty));
}
