"""Features, augmentation, network, training state and export."""

import json
from types import SimpleNamespace

import numpy as np
import onnxruntime
import pytest
import torch

from common import checkpoint
from common.golden import procedural_motion
from common.lanes import shares_of
from common.optimizer import MuonAdamW, orthogonal
from hmd_nemo import export, golden, step
from hmd_nemo.avatar_poser import AvatarPoser, AvatarPoserConfig, WindowStep
from hmd_nemo.features import hide, observe
from hmd_nemo.lanes import CONTROLLERS, FIELD_OF_VIEW, HEAD_ONLY, Lanes, mirror
from hmd_nemo.losses import losses, total
from hmd_nemo.metrics import sequence_metrics
from hmd_nemo.model import CONFIGS, HmdNemo
from hmd_nemo.sample import build, hand_visibility
from hmd_nemo.train import Run
from hmd_nemo.visibility import in_view
from hmd_nemo.workers import Workers
from posed_mocap import store
from posed_mocap.amass import AVERAGE_OFFSETS
from posed_mocap.clips import Clip
from posed_mocap.rotations import quat_to_matrix, yaw_matrix
from posed_mocap.skeleton import forward_kinematics, head_height


def made_up_store(clips=3, frames=260):
    """Clips of the procedural motion, as if from a set."""
    quats, root = procedural_motion(frames)
    height = float(head_height(torch.from_numpy(AVERAGE_OFFSETS)))
    made = [Clip(f"c{i}", "bandai", "train", quats.numpy(), root.numpy().astype(np.float32),
                 AVERAGE_OFFSETS, height) for i in range(clips)]
    return store.Store(store.pack(made))


def sensor_features(turn=0.0, shift=(0.0, 0.0), scale=1.0):
    offsets = torch.from_numpy(AVERAGE_OFFSETS) * scale
    quats, root = procedural_motion(40)
    rotation, position = golden.sensors(quats, root * scale, offsets)
    spin = yaw_matrix(torch.tensor(turn))
    rotation = spin @ rotation
    position = (spin @ position.unsqueeze(-1)).squeeze(-1)
    position = position + torch.tensor([shift[0], 0.0, shift[1]])
    height = head_height(offsets)[None]
    return observe(rotation[None, :, 0], position[None, :, 0], rotation[None, :, 1:],
                   position[None, :, 1:], height)[0]


def test_features_do_not_know_place_heading_or_size():
    plain = sensor_features()
    assert torch.allclose(plain, sensor_features(turn=2.1, shift=(3.0, -7.0)), atol=2e-3)
    assert torch.allclose(plain, sensor_features(scale=1.17), atol=2e-3)


def test_feature_values_of_a_simple_motion():
    eye = torch.eye(3).expand(1, 2, 3, 3)
    head = torch.tensor([[[1.0, 1.5, 2.0], [1.0, 1.5, 1.9]]])
    hands = head.unsqueeze(2) + torch.tensor([[-0.3, -0.6, -0.3], [0.3, -0.6, -0.3]])
    features, yaw = observe(eye, head, eye.unsqueeze(2).expand(1, 2, 2, 3, 3), hands,
                            torch.tensor([1.5]))
    assert yaw.abs().max() < 1e-6
    expected = torch.tensor([1.0, 0, 0, 0, 1, 0, 0, 1, 0, 0, 0, 0, 0, 0, -4.0])
    assert torch.allclose(features[0, 0, 0], expected, atol=1e-4)
    assert torch.allclose(features[0, 0, 1, 6:9], torch.tensor([-0.2, 0.6, -0.2]), atol=1e-5)
    assert torch.allclose(features[0, 0, 3, 6:9], torch.tensor([-0.2, -0.4, -0.2]), atol=1e-5)
    assert features[0, 0, 3, 9:].abs().max() < 1e-4, "the hand does not move in the head"


def test_hiding_zeroes_lost_hands_and_first_velocities():
    features = torch.ones(1, 2, 5, 15)
    visible = torch.tensor([[[False, True], [True, True]]])
    before = torch.tensor([[[False, True], [False, True]]])
    out = hide(features, visible, before)
    assert (out[0, 0, [1, 3]] == 0).all() and (out[0, :, [0, 2, 4]] == 1).all()
    assert (out[0, 1, [1, 3], :9] == 1).all() and (out[0, 1, [1, 3], 9:] == 0).all()


def test_field_of_view_and_scenarios():
    ahead, beside = torch.tensor([0.1, -0.2, -0.4]), torch.tensor([0.25, -0.65, 0.02])
    assert in_view(ahead) and not in_view(beside)
    assert not in_view(torch.tensor([0.0, 0.1, 0.5])), "behind the head"
    places = torch.stack([ahead, beside]).expand(3, 1, 2, 3)
    scenario = torch.tensor([CONTROLLERS, FIELD_OF_VIEW, HEAD_ONLY])
    seen = hand_visibility(scenario, places, torch.zeros(3, 1, 2, dtype=torch.bool),
                           torch.full((3,), 1.5))
    assert seen[:, 0].tolist() == [[True, True], [True, False], [False, False]]


def test_mirror_reflects_joint_positions():
    offsets = torch.from_numpy(AVERAGE_OFFSETS)
    quats, root = procedural_motion(10)
    _, before = forward_kinematics(quat_to_matrix(quats), offsets)
    quats, _, offsets = mirror(quats, root, offsets)
    _, after = forward_kinematics(quat_to_matrix(quats), offsets)
    assert torch.allclose(after[:, 21], before[:, 20] * torch.tensor([-1.0, 1, 1]), atol=1e-5)


def test_lanes_join_up_and_repeat_by_seed():
    whole = made_up_store()
    plain = Lanes(whole, 4, 40, seed=3, augment=False)
    first, clips, places = plain.next_chunk(), plain.lane["clip"].clone(), plain.lane["place"].clone()
    second = plain.next_chunk()
    joined = (plain.lane["clip"] == clips) & (plain.lane["place"] == places + 40)
    assert joined.any()
    assert torch.allclose(first.quats[joined, -1], second.quats[joined, 0], atol=1e-4)
    a, b = Lanes(whole, 4, 40, seed=5), Lanes(whole, 4, 40, seed=5)
    for _ in range(8):
        x, y = a.next_chunk(), b.next_chunk()
    assert torch.equal(x.quats, y.quats) and torch.equal(x.lost, y.lost)
    again = Lanes(whole, 4, 40, seed=9)
    again.load_state_dict(a.state_dict())
    assert torch.equal(a.next_chunk().quats, again.next_chunk().quats)


def test_stride_skips_frames_and_keeps_speeds():
    whole = made_up_store()
    slow = build(Lanes(whole, 8, 20, seed=2, augment=False, stride=3).next_chunk())
    fast = build(Lanes(whole, 8, 20, seed=2, augment=False).next_chunk())
    assert slow.rate == 20.0 and fast.rate == 60.0
    speeds = [s.features[:, :, 0, 12:].norm(dim=-1).mean() for s in (slow, fast)]
    assert abs(speeds[0] / speeds[1] - 1) < 0.1


def test_truth_has_no_loss():
    sample = build(Lanes(made_up_store(), 4, 40, seed=1).next_chunk())
    out = {"six": torch.cat([sample.local[..., 0], sample.local[..., 1]], -1),
           "local": sample.local}
    named, error = losses(out, sample)
    assert error.norm(dim=-1).max() < 1e-4
    assert named["position"] < 2e-4 and named["rotation"] < 1e-6


def test_chunks_give_what_one_long_run_gives():
    torch.manual_seed(0)
    model = HmdNemo(CONFIGS["tiny"]).eval()
    features, visible = torch.randn(2, 30, 5, 15), torch.rand(2, 30, 2) > 0.4
    reset, go_on = torch.ones(2, 1, dtype=torch.bool), torch.zeros(2, 1, dtype=torch.bool)
    whole, _ = model(features, visible, model.initial_state(2), reset)
    head, state = model(features[:, :11], visible[:, :11], model.initial_state(2), reset)
    tail, _ = model(features[:, 11:], visible[:, 11:], state, go_on)
    for name in ("local", "root", "contact"):
        assert torch.allclose(torch.cat([head[name], tail[name]], 1), whole[name], atol=1e-5)


def test_hidden_hands_do_not_reach_the_output():
    model = HmdNemo(CONFIGS["tiny"]).eval()
    features = torch.randn(1, 5, 5, 15)
    changed = features.clone()
    changed[:, :, [1, 3]] += 1.0
    visible = torch.tensor([False, True]).expand(1, 5, 2)
    reset = torch.ones(1, 1, dtype=torch.bool)
    a, _ = model(features, visible, model.initial_state(1), reset)
    b, _ = model(changed, visible, model.initial_state(1), reset)
    assert torch.equal(a["local"], b["local"])


def test_full_model_has_the_papers_size():
    model = HmdNemo(CONFIGS["full"])
    count = sum(p.numel() for n, p in model.named_parameters() if not n.startswith("auxiliary"))
    assert 4.5e6 < count < 6.5e6


def arguments(whole_path, out, **changes):
    values = dict(
        seed=1, store=str(whole_path), mocap=None, device="cpu", batch=4, frames=20,
        family="hmd_nemo", model="tiny", fixed_mask=False, rate=1e-2, steps=100,
        decay=0, out=str(out), threads=1, stride=1, shares=None,
        fresh_optimizer=False, warmup=5, until=None,
    )
    return SimpleNamespace(**{**values, **changes})


def written_store(tmp_path):
    whole = made_up_store()
    path = tmp_path / "s.npz"
    store.export({
        "quats": whole.quats.numpy(), "root": whole.root.numpy(), "start": whole.start.numpy(),
        "offsets": whole.offsets.numpy(), "head_height": whole.head_height.numpy(),
        "sources": np.array(whole.sources), "names": np.array(whole.names),
    }, path)
    return path


def test_training_learns_and_a_resumed_run_equals_an_unbroken_one(tmp_path):
    path = written_store(tmp_path)
    unbroken = Run(arguments(path, tmp_path), Workers(0, 1))
    rows = [unbroken.train_step() for _ in range(24)]
    assert rows[-1]["loss"] < 0.8 * rows[0]["loss"]
    first = Run(arguments(path, tmp_path), Workers(0, 1))
    for _ in range(12):
        first.train_step()
    checkpoint.save(tmp_path / "c.pt", first.state_dict())
    checkpoint.save(tmp_path / "l.pt", first.lanes_dict())
    second = Run(arguments(path, tmp_path, seed=7), Workers(0, 1))
    second.load_state_dict(checkpoint.load(tmp_path / "c.pt"))
    second.load_lanes(checkpoint.load(tmp_path / "l.pt"))
    resumed = [second.train_step() for _ in range(12)]
    assert abs(resumed[-1]["loss"] - rows[-1]["loss"]) < 1e-5


def test_muon_steps_are_orthogonal_per_gate():
    matrix = torch.randn(3, 12, 12, generator=torch.Generator().manual_seed(0))
    values = torch.linalg.svdvals(orthogonal(matrix))
    assert values.min() > 0.5 and values.max() < 1.4
    model = HmdNemo(CONFIGS["tiny"])
    optimizer = MuonAdamW(model.named_parameters(), lr=0.1, weight_decay=0.0)
    weight = model.decoder_gru.from_hidden.weight
    before = weight.detach().clone()
    for parameter in model.parameters():
        parameter.grad = torch.randn_like(parameter)
    optimizer.step()
    for gate in (weight.detach() - before)[0].chunk(3, -1):
        values = torch.linalg.svdvals(gate / (0.1 * 0.2 * 16**0.5))
        # Five iterations do not lift the smallest value of an ill-conditioned matrix to one.
        assert values[:-1].min() > 0.3 and values.max() < 1.4


def test_fixed_mask_and_baseline_train(tmp_path):
    path = written_store(tmp_path)
    fixed = Run(arguments(path, tmp_path, fixed_mask=True), Workers(0, 1))
    assert fixed.model.mask_tokens is None
    assert np.isfinite(fixed.train_step()["loss"])
    model = AvatarPoser(AvatarPoserConfig(window=8, width=16, heads=2, layers=1, feedforward=16))
    sample = build(Lanes(made_up_store(), 2, 20, seed=1).next_chunk())
    reset = torch.ones(2, 1, dtype=torch.bool)
    out, _ = model(sample.features, sample.visible, model.initial_state(2), reset)
    named, _ = losses(out, sample)
    total(named).backward()
    assert out["six"].shape[1] == 2 and model.embed.weight.grad.abs().sum() > 0


def test_metrics_of_a_known_error():
    frames = 30
    local = torch.eye(3).expand(frames, 22, 3, 3)
    place = torch.zeros(frames, 22, 3)
    moved = place.clone()
    moved[:, 4, 0] = 0.22
    row = sequence_metrics(local, moved, local, place, torch.zeros(frames), torch.zeros(frames, 3))
    assert abs(row["mpjpe_cm"] - 1.0) < 1e-4 and row["mpjve_cm_s"] < 1e-4
    turned = local.clone()
    turned[:, 5] = quat_to_matrix(torch.tensor([0.0, 0.0, np.sin(0.05), np.cos(0.05)])).float()
    row = sequence_metrics(turned, place, local, place, torch.zeros(frames), torch.zeros(frames, 3))
    assert abs(row["mpjre_geodesic_deg"] - np.degrees(0.1) / 21) < 1e-3
    assert abs(row["mpjre_component_deg"] - np.degrees(0.1) / 63) < 1e-3


def test_onnx_equals_pytorch_with_and_without_tamt(tmp_path):
    torch.manual_seed(3)
    for i, config in enumerate((CONFIGS["tiny"], type(CONFIGS["tiny"])(
            embed=4, hidden=16, layers=1, heads=2, feedforward=16, token=8, decoder=16,
            trajectory=8, tamt=False))):
        model = HmdNemo(config).eval()
        path = tmp_path / f"m{i}.onnx"
        export.export(model, path)
        assert export.compare(model, path) < 1e-5


def test_the_baselines_onnx_equals_pytorch(tmp_path):
    torch.manual_seed(3)
    model = AvatarPoser(AvatarPoserConfig(window=8, width=32, heads=2, layers=2,
                                          feedforward=32)).eval()
    path = tmp_path / "baseline.onnx"
    export.export(model, path)
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    features, visible = torch.randn(1, 12, 5, 15), torch.rand(1, 12, 2) > 0.3
    with torch.no_grad():
        expected, _ = model(features, visible, model.initial_state(1), torch.ones(1, 1).bool())
    *_, streams, token, pose, trajectory = WindowStep(model).example_inputs()
    state = [x.numpy() for x in (streams, token, pose, trajectory)]
    for i in range(12):
        feed = [features[:, i].numpy(), visible[:, i].float().numpy(),
                np.array([float(i == 0)], np.float32), *state]
        local, _, _, *state = session.run(step.OUTPUTS, dict(zip(step.INPUTS, feed)))
        assert np.abs(local - expected["local"][:, i].numpy()).max() < 1e-5, i


def test_golden_vectors_hold_what_the_contract_says(tmp_path):
    model = HmdNemo(CONFIGS["tiny"]).eval()
    golden.write(model, tmp_path / "g.json")
    data = json.loads((tmp_path / "g.json").read_text())
    n = data["frames"]
    shapes = {"sensor_position": 9, "sensor_rotation": 12, "visible": 2, "features": 75, "yaw": 1,
              "rotation": 88, "root": 3, "contact": 4}
    for name, size in shapes.items():
        assert len(data[name]) == n * size, name
    assert (tmp_path / "g.json").stat().st_size < 300_000
    quats = torch.tensor(data["sensor_rotation"]).view(n, 3, 4)
    rotation, _, _, _, yaw, _ = golden.motion_features()
    assert torch.allclose(quat_to_matrix(quats), rotation, atol=1e-5)
    assert torch.allclose(torch.tensor(data["yaw"]), yaw, atol=1e-4)


def test_shares_are_told_by_name():
    usual = {"a": 0.3, "b": 0.7}
    assert shares_of(None, usual) == usual
    assert shares_of("b=0.2", usual) == {"a": 0.3, "b": 0.2}
    with pytest.raises(ValueError, match="'c'"):
        shares_of("c=1", usual)
