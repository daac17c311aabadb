//! glTF 2.0 in its binary form (GLB): a figure of bones with a skin, and its motion.
//!
//! The joints carry VRM's humanoid bones (`VRMC_vrm_animation` 1.0), so that programs that know
//! VRM put the motion on any avatar; every other one plays it on the figure itself. glTF's models
//! look along +Z where posed's world looks along -Z: everything is turned by 180° about Y.

use glam::{Mat4, Quat, Vec3};
use posed_body::{BodyPose, JOINTS, Joint, Skeleton, skeleton::PARENTS};
use serde_json::{Value, json};

use super::{gltf_figure::Figure, motion::Frame, names::Names};

/// "glTF", little-endian.
const MAGIC: u32 = 0x4654_6C67;
/// "JSON".
const JSON_CHUNK: u32 = 0x4E4F_534A;
/// "BIN".
const BIN_CHUNK: u32 = 0x004E_4942;
/// Component type "float".
const FLOAT: u32 = 5126;
/// Component type "unsigned byte".
const BYTE: u32 = 5121;
/// Buffer view target "array buffer".
const ARRAY_BUFFER: u32 = 34962;

/// Why a motion cannot be written.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum GlbError {
    /// There are no poses.
    #[error("there is no pose to write")]
    Empty,
    /// GLB's lengths have 32 bits.
    #[error("{frames} poses are more than a GLB file can hold (4 GiB): export a part")]
    TooLong {
        /// How many.
        frames: usize,
    },
}

/// The bytes of a GLB file with `frames`, on the bones of the first; times count from it. Frames
/// that are not newer than the one before are left out.
///
/// # Errors
/// There are no frames, or too many.
pub fn glb(frames: &[Frame], names: Names) -> Result<Vec<u8>, GlbError> {
    let first = frames.first().ok_or(GlbError::Empty)?;
    let mut document = Document::default();
    let skeleton = turned_skeleton(&first.skeleton);
    let floor = rest_height(&skeleton);
    let skin = document.skin(&skeleton, floor);
    let mesh = document.mesh(&Figure::new(&skeleton, floor));
    let animation = document.animation(frames);
    let nodes = nodes(&skeleton, floor, names);
    let bones: serde_json::Map<_, _> = Joint::ALL
        .into_iter()
        .map(|joint| {
            (
                Names::Vrm.of(joint).to_owned(),
                json!({ "node": joint as usize }),
            )
        })
        .collect();
    let root = json!({
        "asset": { "version": "2.0", "generator": "posed" },
        "extensionsUsed": ["VRMC_vrm_animation"],
        "extensions": {
            "VRMC_vrm_animation": { "specVersion": "1.0", "humanoid": { "humanBones": bones } }
        },
        "scene": 0,
        "scenes": [{ "nodes": [0, JOINTS] }],
        "nodes": nodes,
        "skins": [skin],
        "meshes": [mesh],
        "materials": [{
            "name": "bone",
            "pbrMetallicRoughness": {
                "baseColorFactor": [0.36, 0.55, 0.86, 1.0],
                "metallicFactor": 0.0,
                "roughnessFactor": 0.7,
            },
        }],
        "animations": [animation],
        "buffers": [{ "byteLength": document.bytes.len() }],
        "bufferViews": document.views,
        "accessors": document.accessors,
    });
    pack(&root, document.bytes).ok_or(GlbError::TooLong {
        frames: frames.len(),
    })
}

/// posed's axes to glTF's: half a turn about Y.
fn turned(vector: Vec3) -> Vec3 {
    Vec3::new(-vector.x, vector.y, -vector.z)
}

fn turned_rotation(rotation: Quat) -> Quat {
    Quat::from_xyzw(-rotation.x, rotation.y, -rotation.z, rotation.w)
}

fn turned_skeleton(skeleton: &Skeleton) -> Skeleton {
    Skeleton {
        offsets: skeleton.offsets.map(turned),
    }
}

/// Height of the pelvis when the T-pose stands on the floor.
fn rest_height(skeleton: &Skeleton) -> f32 {
    let joints = skeleton.forward(&BodyPose::rest(Vec3::ZERO));
    -joints
        .positions
        .iter()
        .map(|position| position.y)
        .fold(0.0, f32::min)
}

/// The joints, in SMPL order, and the figure.
fn nodes(skeleton: &Skeleton, floor: f32, names: Names) -> Vec<Value> {
    let mut nodes: Vec<Value> = Joint::ALL
        .into_iter()
        .map(|joint| {
            let index = joint as usize;
            let hips = Vec3::new(0.0, floor, 0.0);
            let place = if index == 0 {
                hips
            } else {
                skeleton.offsets[index]
            };
            let mut node = json!({
                "name": names.of(joint),
                "translation": place.to_array(),
                "rotation": Quat::IDENTITY.to_array(),
            });
            let children: Vec<_> = (0..JOINTS).filter(|c| PARENTS[*c] == Some(index)).collect();
            if !children.is_empty() {
                node["children"] = json!(children);
            }
            node
        })
        .collect();
    nodes.push(json!({ "name": "figure", "mesh": 0, "skin": 0 }));
    nodes
}

/// What a GLB file is made of.
#[derive(Debug, Default)]
struct Document {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Document {
    /// Puts bytes into a view of their own and describes them; the answer is the accessor's index.
    fn push(&mut self, bytes: &[u8], target: Option<u32>, accessor: Value) -> usize {
        let mut view =
            json!({ "buffer": 0, "byteOffset": self.bytes.len(), "byteLength": bytes.len() });
        if let Some(target) = target {
            view["target"] = json!(target);
        }
        self.bytes.extend_from_slice(bytes);
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        let mut accessor = accessor;
        accessor["bufferView"] = json!(self.views.len());
        self.views.push(view);
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    fn floats<const N: usize>(&mut self, values: &[[f32; N]], kind: &str) -> usize {
        let accessor = json!({ "componentType": FLOAT, "count": values.len(), "type": kind });
        self.push(&bytes_of(values), None, accessor)
    }

    /// Floats with the bounds that glTF wants of times and positions.
    fn bounded<const N: usize>(
        &mut self,
        values: &[[f32; N]],
        kind: &str,
        target: Option<u32>,
    ) -> usize {
        let fold = |start: f32, choose: fn(f32, f32) -> f32| {
            let start = [start; N];
            let bound = values.iter().fold(start, |bound, value| {
                std::array::from_fn(|axis| choose(bound[axis], value[axis]))
            });
            bound.to_vec()
        };
        let (min, max) = (fold(f32::MAX, f32::min), fold(f32::MIN, f32::max));
        let accessor = json!({
            "componentType": FLOAT, "count": values.len(), "type": kind, "min": min, "max": max,
        });
        self.push(&bytes_of(values), target, accessor)
    }

    fn skin(&mut self, skeleton: &Skeleton, floor: f32) -> Value {
        let rest = skeleton.forward(&BodyPose::rest(Vec3::new(0.0, floor, 0.0)));
        let inverse = rest
            .positions
            .map(|place| Mat4::from_translation(-place).to_cols_array());
        let matrices = self.floats(&inverse, "MAT4");
        let joints: Vec<_> = (0..JOINTS).collect();
        json!({ "skeleton": 0, "joints": joints, "inverseBindMatrices": matrices })
    }

    fn mesh(&mut self, figure: &Figure) -> Value {
        let positions = self.bounded(&figure.positions, "VEC3", Some(ARRAY_BUFFER));
        let count = figure.positions.len();
        let attribute = |component, kind, normalized| {
            json!({
                "componentType": component, "count": count, "type": kind,
                "normalized": normalized,
            })
        };
        let target = Some(ARRAY_BUFFER);
        let normals = bytes_of(&figure.normals);
        let normals = self.push(&normals, target, attribute(FLOAT, "VEC3", false));
        // One bone for each corner.
        let joints: Vec<u8> = figure
            .bones
            .iter()
            .flat_map(|bone| [*bone, 0, 0, 0])
            .collect();
        let joints = self.push(&joints, target, attribute(BYTE, "VEC4", false));
        let weights = [255u8, 0, 0, 0].repeat(count);
        let weights = self.push(&weights, target, attribute(BYTE, "VEC4", true));
        json!({
            "name": "figure",
            "primitives": [{
                "attributes": {
                    "POSITION": positions, "NORMAL": normals,
                    "JOINTS_0": joints, "WEIGHTS_0": weights,
                },
                "material": 0,
            }],
        })
    }

    fn animation(&mut self, frames: &[Frame]) -> Value {
        let frames = rising(frames);
        let times: Vec<[f32; 1]> = frames.iter().map(|(seconds, _)| [*seconds]).collect();
        let input = self.bounded(&times, "SCALAR", None);
        let mut samplers = Vec::new();
        let mut channels = Vec::new();
        let mut channel = |node: usize, path: &str, output: usize| {
            let target = json!({ "node": node, "path": path });
            channels.push(json!({ "sampler": samplers.len(), "target": target }));
            let sampler = json!({ "input": input, "output": output, "interpolation": "LINEAR" });
            samplers.push(sampler);
        };
        let hips: Vec<_> = frames
            .iter()
            .map(|(_, pose)| turned(pose.root).to_array())
            .collect();
        channel(0, "translation", self.floats(&hips, "VEC3"));
        for joint in 0..JOINTS {
            channel(
                joint,
                "rotation",
                self.floats(&rotations(&frames, joint), "VEC4"),
            );
        }
        json!({ "name": "motion", "samplers": samplers, "channels": channels })
    }
}

/// Seconds from the first frame, strictly rising also as 32-bit floats, with the poses.
fn rising(frames: &[Frame]) -> Vec<(f32, &BodyPose)> {
    let mut kept: Vec<(f32, &BodyPose)> = Vec::with_capacity(frames.len());
    for frame in frames {
        let seconds = frame.at.since_secs(frames[0].at) as f32;
        if kept.last().is_none_or(|(last, _)| seconds > *last) {
            kept.push((seconds, &frame.pose));
        }
    }
    kept
}

/// A joint's rotations, each with the sign that is nearer to the one before.
fn rotations(frames: &[(f32, &BodyPose)], joint: usize) -> Vec<[f32; 4]> {
    let mut last = Quat::IDENTITY;
    let nearer = |(_, pose): &(f32, &BodyPose)| {
        let rotation = turned_rotation(pose.rotations[joint]).normalize();
        last = if rotation.dot(last) < 0.0 {
            -rotation
        } else {
            rotation
        };
        last.to_array()
    };
    frames.iter().map(nearer).collect()
}

fn bytes_of<const N: usize>(values: &[[f32; N]]) -> Vec<u8> {
    values
        .iter()
        .flatten()
        .flat_map(|value| value.to_le_bytes())
        .collect()
}

/// The container: a header, the JSON padded with spaces, the binary part padded with zeros.
fn pack(root: &Value, bytes: Vec<u8>) -> Option<Vec<u8>> {
    let mut text = root.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let total = u32::try_from(12 + 8 + text.len() + 8 + bytes.len()).ok()?;
    let mut file = Vec::with_capacity(total as usize);
    let words = [MAGIC, 2, total, text.len() as u32, JSON_CHUNK];
    file.extend(words.iter().flat_map(|word| word.to_le_bytes()));
    file.extend(text);
    file.extend(
        [bytes.len() as u32, BIN_CHUNK]
            .iter()
            .flat_map(|word| word.to_le_bytes()),
    );
    file.extend(bytes);
    Some(file)
}

#[cfg(test)]
mod tests;
