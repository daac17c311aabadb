"""PIP: sensors on known motions, the memory, the losses, training, the exported step."""

import json
from types import SimpleNamespace

import numpy as np
import torch

from common import checkpoint
from pip import evaluate, export, golden
from pip.lanes import Lanes, targets
from pip.losses import cumulative, losses
from pip.model import CONFIGS, Pip, select
from pip.motion import Motions, build, from_arrays
from pip.sensors import ACCELERATION, JOINTS_OF, NoError, SensorError, features, measure
from pip.train import Run
from posed_mocap import sitting
from posed_mocap import store as stores
from posed_mocap.amass import AVERAGE_OFFSETS
from posed_mocap.clips import Clip
from posed_mocap.rotations import geodesic, quat_to_matrix, rotvec_to_quat, yaw_matrix
from posed_mocap.skeleton import forward_kinematics


def made_up_motions(clips=6, frames=300):
    generator = torch.Generator().manual_seed(0)
    made = []
    for i in range(clips):
        slow = 0.4 * torch.randn(1, 22, 3, generator=generator)
        t = torch.arange(frames)[:, None, None] / 60
        quats = rotvec_to_quat(slow * torch.sin(2 * t + slow)).numpy().astype(np.float32)
        root = np.stack([np.sin(np.arange(frames) / 40), np.full(frames, 0.95),
                         np.cos(np.arange(frames) / 40)], 1).astype(np.float32)
        made.append(Clip(f"c{i}", "bandai", "train", quats, root, AVERAGE_OFFSETS, 1.45))
    return from_arrays(build(stores.Store(stores.pack(made))))


def test_features_do_not_depend_on_heading_or_size():
    turns = quat_to_matrix(rotvec_to_quat(torch.randn(1, 4, 6, 3)))
    accelerations, height = torch.randn(1, 4, 6, 3), torch.tensor([1.4])
    plain = features(turns, accelerations, height)
    turn = yaw_matrix(torch.tensor(1.1))
    turned = features(turn @ turns, (turn @ accelerations.unsqueeze(-1)).squeeze(-1), height)
    assert torch.allclose(plain, turned, atol=1e-5)
    grown = features(turns, 1.2 * accelerations, 1.2 * height)
    assert torch.allclose(plain, grown, atol=1e-6)
    seen = torch.ones(1, 4, 6, dtype=torch.bool)
    seen[..., 2] = False
    lost = features(turns, accelerations, height, seen)
    assert not lost[..., 6:9].any() and not lost[..., 36:45].any()
    assert torch.equal(lost[..., :6], plain[..., :6])


def test_a_sensor_on_a_circle_feels_the_centripetal_acceleration():
    rate, spread = 2.0, 1 / 60
    t = spread * torch.tensor([-1.0, 0.0, 1.0])
    turns = rotvec_to_quat(torch.stack([0 * t, rate * t, 0 * t], -1))
    turns = turns[None, None, :, None].expand(1, 1, 3, 6, 4)
    arm = torch.zeros(1, 6, 3)
    arm[..., 0] = 0.5
    _, felt = measure(turns, torch.zeros(1, 1, 3, 6, 3), arm, torch.tensor([spread]), NoError)
    assert torch.allclose(felt[0, 0, 0], torch.tensor([-0.5 * rate**2, 0, 0]), atol=1e-2)
    assert ACCELERATION == 20.0


def test_a_drifting_sensor_turns_what_it_tells():
    turns, felt = torch.eye(3).expand(1, 2, 6, 3, 3), torch.tensor([1.0, 0, 0]).expand(1, 2, 6, 3)
    drift = torch.full((1, 2, 6), 0.3)
    upright = torch.tensor([0.0, 0, 0, 1]).expand(1, 6, 4)
    error = SensorError(upright, drift, torch.zeros(1, 6, 3), torch.zeros(1), torch.Generator())
    told, acceleration = error.apply(turns, felt)
    assert torch.allclose(told, yaw_matrix(drift), atol=1e-6)
    assert torch.allclose(acceleration, yaw_matrix(drift)[..., 0], atol=1e-6)


def test_truth_in_the_pelvis_frame_rebuilds_the_pose():
    motions = made_up_motions()
    index = torch.arange(20, 60)[None]
    height = motions.height[:1]
    leaves, joints, six, velocities = targets(
        motions, index, index - 1, index + 1, torch.tensor([2 / 60]), height)
    turns = evaluate.full_rotations(six)
    place = evaluate.positions(turns, motions.offsets[:1, None])
    true = joints.unflatten(-1, (21, 3)) * height[:, None, None, None]
    # Feet and hands go on straight, so what hangs on ankles and wrists may differ.
    assert torch.allclose(place[:, :, 1:9], true[:, :, :8], atol=1e-4)
    root = velocities.unflatten(-1, (22, 3))[:, :, 0] * height
    world = quat_to_matrix(motions.turns[index, 0].float() / 32767) @ root.unsqueeze(-1)
    moved = (world.squeeze(-1)[0] / 60).sum(0)
    way = (motions.root[60] + motions.root[59] - motions.root[20] - motions.root[19]) / 2
    assert torch.allclose(moved, way, atol=1e-3)
    assert leaves.shape == (1, 40, 15)


def test_lanes_join_up_and_mirror_keeps_sensors_and_truth_together():
    motions = made_up_motions()
    lanes = Lanes(motions, 8, 20, seed=3)
    for _ in range(4):
        batch = lanes.next_batch()
        for name in ("features", "leaves", "joints", "rotations", "velocities"):
            assert getattr(batch, name).isfinite().all(), name
    plain = Lanes(motions, 8, 20, seed=3, augment=False)
    plain.lane["mirrored"][:] = torch.arange(8) % 2 == 0
    batch = plain.next_batch()
    told = batch.features[..., 18:].unflatten(-1, (6, 3, 3))
    truth = evaluate.full_rotations(batch.rotations)
    for sensor, joint in enumerate(JOINTS_OF[:5]):
        assert geodesic(told[:, :, sensor], truth[:, :, joint]).max() < 1e-3


def test_the_memory_is_what_one_long_run_has_and_a_reset_begins_anew():
    model = Pip(CONFIGS["tiny"]).eval()
    x = torch.randn(2, 20, 72)
    state = model.begin(torch.randn(2, 15), torch.randn(2, 66))
    whole, _ = model(x, state)
    head, kept = model(x[:, :7], state)
    tail, _ = model(x[:, 7:], kept)
    assert torch.allclose(torch.cat([head["joints"], tail["joints"]], 1), whole["joints"], atol=1e-5)
    fresh = model.begin(torch.zeros(2, 15), torch.zeros(2, 66))
    chosen = select(torch.tensor([True, False]), fresh, kept)
    assert torch.equal(chosen["leaves"][0][:, 0], fresh["leaves"][0][:, 0])
    assert torch.equal(chosen["leaves"][0][:, 1], kept["leaves"][0][:, 1])


def test_a_constant_velocity_error_costs_more_than_one_that_averages_out():
    truth = torch.zeros(1, 27, 66)
    drifting = truth + 0.1
    jittering = truth + 0.1 * (-1.0) ** torch.arange(27)[None, :, None]
    assert cumulative(drifting, truth) > 1.5 * cumulative(jittering, truth)


def test_full_model_has_the_papers_size():
    count = sum(p.numel() for p in Pip(CONFIGS["full"]).parameters())
    assert 4.3e6 < count < 5.4e6


def arguments(tmp_path, **changes):
    values = dict(seed=1, mocap=None, cache=None, sets="", model="tiny", no_initial=False, only=None,
                  shares=None, batch=6, frames=16, stride=1, rate=5e-3, warmup=3, steps=100, decay=0,
                  until=None, until_decay=0, out=str(tmp_path))
    return SimpleNamespace(**{**values, **changes})


def test_training_learns_and_a_resumed_run_equals_an_unbroken_one(tmp_path, monkeypatch):
    motions = made_up_motions()
    assert isinstance(motions, Motions)
    monkeypatch.setattr("pip.motion.cached", lambda *_: motions)
    unbroken = Run(arguments(tmp_path))
    rows = [unbroken.train_step() for _ in range(30)]
    assert rows[-1]["loss"] < 0.8 * rows[0]["loss"]
    first = Run(arguments(tmp_path))
    for _ in range(10):
        first.train_step()
    checkpoint.save(tmp_path / "c.pt", first.state_dict())
    second = Run(arguments(tmp_path))
    second.load_state_dict(checkpoint.load(tmp_path / "c.pt"))
    assert second.step == 10
    third, fourth = first.train_step(), second.train_step()
    # The noise on first poses is drawn anew; it only touches lanes that begin.
    assert abs(third["loss"] - fourth["loss"]) < 0.05 * third["loss"]


def test_without_learned_memory_and_alone(tmp_path, monkeypatch):
    monkeypatch.setattr("pip.motion.cached", lambda *_: made_up_motions())
    run = Run(arguments(tmp_path, no_initial=True, only="leaves,velocities"))
    before = run.model.joints.enter.weight.clone()
    run.train_step()
    assert torch.equal(before, run.model.joints.enter.weight)
    assert not hasattr(run.model, "begin_leaves")


def test_evaluation_of_the_truth_is_free_of_error():
    motions = made_up_motions()
    x, truth, begin, counts, index = evaluate.whole_clips(motions, [0, 1], 1)
    assert x.shape[0] == 2 and begin[0].shape == (2, 15)
    out = {"rotations": truth[2].flatten(2), "velocities": truth[3], "leaves": truth[0],
           "contact": 10 * (motions.contact[index].float() - 0.5)}
    world = quat_to_matrix(motions.turns[index].float() / 32767)
    local = world[:, :, :1].mT @ world
    row = evaluate.clip_errors({n: v[0] for n, v in out.items()},
                               [*(t[0] for t in truth), motions.contact[index[0]].float()],
                               local[0], motions.offsets[0], motions.height[0], int(counts[0]), 1 / 60)
    assert row["sip_deg"] < 0.1 and row["way_cm_s"] < 1e-3 and row["contact"] == 1.0


def test_onnx_equals_pytorch_and_golden_vectors_hold_what_the_contract_says(tmp_path):
    torch.manual_seed(3)
    model = Pip(CONFIGS["tiny"]).eval()
    export.export(model, tmp_path / "m.onnx")
    assert export.compare(model, tmp_path / "m.onnx") < 1e-5
    golden.write(model, tmp_path / "g.json")
    data = json.loads((tmp_path / "g.json").read_text())
    shapes = {"sensor_rotation": 24, "sensor_acceleration": 18, "seen": 6, "features": 72,
              "rotations": 60, "velocities": 66, "contact": 2, "joints": 63}
    for name, size in shapes.items():
        assert len(data[name]) == data["frames"] * size, name


def test_losses_of_the_truth_vanish():
    batch = Lanes(made_up_motions(), 4, 12, seed=1).next_batch()
    out = {"leaves": batch.leaves, "joints": batch.joints, "rotations": batch.rotations.flatten(2),
           "velocities": batch.velocities, "contact": 20 * (batch.contact - 0.5)}
    assert all(v < 1e-3 for v in losses(out, batch).values())


def test_people_who_sit_are_people_and_keep_their_feet_still():
    clip = sitting.sitter(np.random.default_rng(3), "sitter")
    assert np.abs(np.linalg.norm(clip.quats, axis=-1) - 1).max() < 1e-4
    _, places = forward_kinematics(
        quat_to_matrix(torch.from_numpy(clip.quats)), torch.from_numpy(clip.offsets))
    places = places.numpy() + clip.root[:, None]
    feet = places[:, [7, 8]].mean(1)
    assert np.abs(feet - feet[0]).max() < 1e-3
    assert places[:, [10, 11], 1].min() > -0.1
    pelvis = places[:, 0, 1]
    assert pelvis.max() - pelvis.min() > 0.2, "somebody sits down"
