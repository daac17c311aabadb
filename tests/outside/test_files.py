"""Files that posed writes, read by programs that others wrote."""

import json
import shutil
import subprocess
import time

import bvhio
import numpy
import pytest

from conftest import POSED, running_demo, skip

NAMES = (
    "Hips LeftUpLeg RightUpLeg Spine LeftLeg RightLeg Spine1 LeftFoot RightFoot Spine2 LeftToeBase "
    "RightToeBase Neck LeftShoulder RightShoulder Head LeftArm RightArm LeftForeArm RightForeArm "
    "LeftHand RightHand"
).split()
SMPL = (
    "pelvis left_hip right_hip spine1 left_knee right_knee spine2 left_ankle right_ankle spine3 "
    "left_foot right_foot neck left_collar right_collar head left_shoulder right_shoulder "
    "left_elbow right_elbow left_wrist right_wrist"
).split()
VALIDATOR = "gltf-validator@2.0.0-dev.3.10"
VALIDATE = """
const validator = require("gltf-validator"), fs = require("fs");
validator.validateBytes(new Uint8Array(fs.readFileSync(process.argv[1])))
  .then((report) => console.log(JSON.stringify(report)));
"""


@pytest.fixture(scope="module")
def poses(demo, tmp_path_factory):
    """Some seconds of the demo as lines of JSON, as `posed record start` writes them."""
    demo.posed("record", "start", "--format", "poses", "--name", "walk")
    time.sleep(4)
    demo.posed("record", "stop")
    return demo.recordings / "walk.poses.jsonl"


def export(poses, out, *args):
    subprocess.run([POSED, "export", poses, "--out", out, *args], check=True, timeout=60)
    return out


def joints_of_bvh(path, names):
    """Positions of the joints in every frame, centimetres."""
    root = bvhio.readAsHierarchy(str(path))
    joints = {joint.Name: joint for joint, _, _ in root.layout()}
    first, last = root.getKeyframeRange()
    frames = []
    for frame in range(first, last + 1):
        root.loadPose(frame)
        frames.append([[*joints[name].PositionWorld] for name in names])
    return numpy.array(frames)


@pytest.mark.parametrize("preset, names", [("mixamo", NAMES), ("smpl", SMPL)])
def test_bvh_has_the_joints_where_they_were_published(poses, tmp_path, preset, names):
    path = export(poses, tmp_path / "walk.bvh", "--format", "bvh", "--names", preset)
    published = [json.loads(line) for line in poses.read_text().splitlines()]
    times = numpy.array([pose["target_ns"] for pose in published]) * 1e-9
    joints = numpy.array([pose["joints"] for pose in published])
    read = joints_of_bvh(path, names)
    assert len(read) > 100
    # BVH has frames at a steady rate: published poses are read at the frames' times.
    at = times[0] + numpy.arange(len(read)) / 90.0
    inside = at <= times[-1]
    flat = joints.reshape(len(joints), -1)
    expected = numpy.stack([numpy.interp(at, times, column) for column in flat.T], axis=1)
    worst = numpy.linalg.norm(
        read[inside] / 100.0 - expected.reshape(-1, 22, 3)[inside], axis=2
    ).max(axis=1)
    # Where a frame falls on a pose there is nothing between the two but rounding.
    nearest = numpy.abs(at[inside][:, None] - times).min(axis=1)
    assert worst[nearest < 2e-6].max() < 0.001
    assert numpy.median(worst) < 0.001, f"median of the worst joint: {numpy.median(worst)} m"


def test_glb_passes_the_khronos_validator(poses, tmp_path):
    path = export(poses, tmp_path / "walk.glb", "--format", "glb")
    if shutil.which("npm") is None:
        skip("npm")
    install = ["npm", "install", "--silent", "--prefix", tmp_path, VALIDATOR]
    subprocess.run(install, check=True, timeout=120)
    ran = subprocess.run(
        ["node", "-e", VALIDATE, path], cwd=tmp_path, capture_output=True, text=True, timeout=60
    )
    assert ran.returncode == 0, ran.stderr
    report = json.loads(ran.stdout)
    assert report["issues"]["numErrors"] == 0, report["issues"]
    assert report["info"]["animationCount"] == 1


def test_a_killed_posed_leaves_a_file_that_can_be_read(tmp_path):
    with running_demo(tmp_path) as demo:
        demo.posed("record", "start", "--format", "bvh", "--name", "killed")
        path = demo.recordings / "killed.bvh"
        deadline = time.monotonic() + 30
        # The count of frames is brought up to date every second.
        while not path.exists() or "Frames:          0" in path.read_text():
            assert time.monotonic() < deadline
            time.sleep(0.1)
        demo.process.kill()
    assert len(joints_of_bvh(path, NAMES)) >= 89
