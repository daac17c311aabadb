"""The loader: delta coding, up-sampling, frame conversion, kinematics, AMASS."""

import numpy as np
import pytest
import torch

from posed_mocap import amass, store
from posed_mocap.clips import Clip, decode_delta, load_set, resample, sign_continuous, to_posed_frame
from posed_mocap.rotations import (
    geodesic, matrix_to_six, quat_multiply, quat_to_matrix, rotvec_to_quat, six_to_matrix,
    small_rotvec, yaw_matrix, yaw_of,
)
from posed_mocap.skeleton import JOINTS, MIRROR, PARENTS, forward_kinematics


def random_quats(*shape, seed=0):
    q = torch.randn(*shape, 4, generator=torch.Generator().manual_seed(seed))
    return q / q.norm(dim=-1, keepdim=True)


def smooth_quats(frames, seed=0):
    generator = torch.Generator().manual_seed(seed)
    slow = torch.randn(1, JOINTS, 3, generator=generator)
    t = torch.linspace(0, 1, frames)[:, None, None]
    return rotvec_to_quat(slow * torch.sin(3 * t + slow)).numpy()


def encode(quats):
    values = np.rint(quats.reshape(len(quats), -1) * 32767).astype(np.int16)
    delta = np.diff(values, axis=0, prepend=np.zeros((1, 88), np.int16)).astype(np.int16)
    unsigned = delta.T.view(np.uint16) if delta.T.flags.c_contiguous else delta.T.copy().view(np.uint16)
    return (unsigned & 0xFF).astype(np.uint8), (unsigned >> 8).astype(np.uint8)


def test_delta_coding_wraps_and_round_trips():
    quats = smooth_quats(50)
    quats[25:] *= -1  # The jump from q to -q overflows int16 and must wrap back.
    decoded = decode_delta(*encode(quats))
    assert np.abs(decoded - quats).max() < 1e-4


def test_zero_quaternion_is_an_error():
    with pytest.raises(ValueError, match="length zero"):
        decode_delta(np.zeros((88, 3), np.uint8), np.zeros((88, 3), np.uint8))


def test_resample_passes_through_source_frames_and_is_smooth():
    quats = smooth_quats(60)
    root = np.stack([np.sin(np.arange(60) / 9)] * 3, 1)
    up, moved = resample(quats, root, 30.0)
    assert len(up) == 119
    assert np.abs(up[::2] - sign_continuous(quats)).max() < 1e-5
    assert np.abs(moved[::2] - root).max() < 1e-5
    jerk = np.abs(np.diff(moved[10:-10], n=3, axis=0)).max()
    assert jerk < 1.2 * (1 / 18) ** 3, "acceleration spikes at source frames"


def test_frame_conversion_commutes_with_kinematics():
    quats, offsets = random_quats(4, JOINTS).numpy(), np.random.default_rng(0).normal(size=(22, 3))
    offsets = offsets.astype(np.float32)
    turned, _, turned_offsets = to_posed_frame(quats, np.zeros((4, 3), np.float32), offsets)
    _, before = forward_kinematics(quat_to_matrix(torch.from_numpy(quats)), torch.from_numpy(offsets))
    _, after = forward_kinematics(
        quat_to_matrix(torch.from_numpy(turned)), torch.from_numpy(turned_offsets)
    )
    assert torch.allclose(after, before * torch.tensor([-1.0, 1.0, -1.0]), atol=1e-5)


def test_kinematics_against_one_joint_at_a_time():
    rotations, offsets = quat_to_matrix(random_quats(3, JOINTS)), torch.randn(JOINTS, 3)
    world, position = forward_kinematics(rotations, offsets)
    for joint in range(1, JOINTS):
        parent = PARENTS[joint]
        assert torch.allclose(world[:, joint], world[:, parent] @ rotations[:, joint], atol=1e-5)
        reach = position[:, parent] + world[:, parent] @ offsets[joint]
        assert torch.allclose(position[:, joint], reach, atol=1e-5)


def test_mirror_order_is_an_involution_that_keeps_the_tree():
    assert [MIRROR[MIRROR[j]] for j in range(JOINTS)] == list(range(JOINTS))
    for joint in range(1, JOINTS):
        assert PARENTS[MIRROR[joint]] == MIRROR[PARENTS[joint]]


def test_rotation_conversions():
    a, b = random_quats(50), random_quats(50, seed=1)
    assert torch.allclose(
        quat_to_matrix(quat_multiply(a, b)), quat_to_matrix(a) @ quat_to_matrix(b), atol=1e-5
    )
    matrix = quat_to_matrix(a)
    assert torch.allclose(six_to_matrix(matrix_to_six(matrix)), matrix, atol=1e-5)
    vector = 0.9 * torch.randn(50, 3, generator=torch.Generator().manual_seed(2)).clamp(-1.5, 1.5)
    turn = quat_to_matrix(rotvec_to_quat(vector))
    assert torch.allclose(small_rotvec(turn), vector, atol=1e-4)
    identity = torch.eye(3).expand(50, 3, 3)
    assert torch.allclose(geodesic(turn, identity), vector.norm(dim=-1), atol=1e-3)


def test_yaw_is_the_heading_and_survives_looking_down():
    yaw = torch.tensor([-3.0, -1.0, 0.0, 0.7, 2.9])
    for pitch in (0.0, -1.2, -1.6, -2.0):
        tilt = quat_to_matrix(rotvec_to_quat(torch.tensor([[pitch, 0.0, 0.0]])))
        assert torch.allclose(yaw_of(yaw_matrix(yaw) @ tilt), yaw, atol=1e-4)


def test_store_round_trip(tmp_path):
    quats = smooth_quats(20)
    clip = Clip("a", "bandai", "train", quats, np.ones((20, 3), np.float32),
                np.ones((22, 3), np.float32), 1.4)
    store.export(store.pack([clip, clip]), tmp_path / "s.npz", compress=True)
    read = store.load(tmp_path / "s.npz")
    assert len(read) == 2 and read.frames(1) == (20, 40)
    assert np.abs(read.quats[20:].numpy() / 32767 - quats).max() < 1e-4


def test_an_empty_store_says_what_to_check():
    with pytest.raises(ValueError, match="split names"):
        store.pack([])


def test_amass_standing_body_is_upright_on_the_floor(tmp_path):
    poses = np.zeros((240, 156))
    poses[:, 0] = np.pi / 2  # AMASS: a body that stands in the Z-up world.
    np.savez(tmp_path / "walk_poses.npz", poses=poses, trans=np.zeros((240, 3)),
             mocap_framerate=120.0)
    np.savez(tmp_path / "shape.npz", betas=np.zeros(10))
    (clip,) = list(amass.load_folder(tmp_path))
    assert len(clip.root) == 120
    local = quat_to_matrix(torch.from_numpy(clip.quats))
    _, position = forward_kinematics(local, torch.from_numpy(clip.offsets))
    heights = position[0, :, 1].numpy() + clip.root[0, 1]
    assert abs(heights[[10, 11]].min() - amass.TOE_HEIGHT) < 1e-3
    assert heights[15] - heights[10] == pytest.approx(clip.head_height, abs=1e-3)
    assert clip.head_height > 1.3


def test_amass_without_a_rate_is_an_error(tmp_path):
    np.savez(tmp_path / "x.npz", poses=np.zeros((9, 156)), trans=np.zeros((9, 3)))
    with pytest.raises(ValueError, match="frame rate"):
        amass.load_file(tmp_path / "x.npz")


def test_shared_sets_stand_on_the_floor(shared_mocap):
    clips = list(load_set(shared_mocap / "cmu_amc.npz", {"val"}))
    assert clips
    for clip in clips:
        local = quat_to_matrix(torch.from_numpy(clip.quats))
        _, position = forward_kinematics(local, torch.from_numpy(clip.offsets))
        toes = position[:, [10, 11], 1].numpy().min(1) + clip.root[:, 1]
        assert -0.02 < np.percentile(toes, 5) < 0.1
        assert clip.offsets[18, 0] < 0 < clip.offsets[19, 0], "the left arm lies at -X"
