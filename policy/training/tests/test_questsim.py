"""QuestSim's environment and training on its own golden character; no motion capture."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from questsim import balance, dagger, motion, observation, ppo
from questsim.character import Character, forward, rotation_exp, rotation_log
from questsim.expert import Expert, cone_least_squares
from questsim.mirror import HINGES, TURNS, Mirror, Symmetric
from questsim.student import Mlp
from questsim.worlds import Options, Worlds

GOLDEN = Path(__file__).parents[2] / "tracker/tests/data/questsim.golden.json"


@pytest.fixture(scope="module")
def standing():
    """One clip of two seconds: the character stands and lowers its arms a little."""
    golden = json.loads(GOLDEN.read_text())
    character = Character.from_mjcf(golden["mjcf"], golden["stature"])
    count = 72
    root = np.tile(character.model.qpos0[:3], (count, 1))
    rotation = np.tile([0.0, 0, 0, 1], (count, 1))
    angles = np.zeros((count, 33))
    angles[:, [9, 15]] = np.linspace(0, 0.4, count)[:, None]
    parts = np.zeros((count, 3, 7))
    parts[..., 6] = 1
    parts[:, :, :3] = [[0, 1.55, 0], [-0.6, 1.3, 0], [0.6, 1.3, 0]]
    made = motion.one(character, root, rotation, angles, parts)
    return motion.Motion(
        characters=[character], mjcf=[golden["mjcf"]], stature=np.array([golden["stature"]]),
        start=np.array([0, count]), character=np.array([0]), names=["standing"],
        strain=np.array([made.pop("strain")]), **made)


def test_rotation_vectors_come_back():
    vectors = np.random.default_rng(1).normal(0, 0.8, (50, 3))
    assert np.abs(rotation_log(rotation_exp(vectors)) - vectors).max() < 1e-9


def test_the_observation_has_its_size_and_does_not_know_the_heading(standing):
    worlds = Worlds(standing, 4, 0, Options(lookaheads=(6,), headset_only=0.0))
    seen = worlds.observe()
    assert seen.shape == (4, observation.SIZE) == (4, 475)
    turn = rotation_exp(np.array([0, 1.0, 0]))
    qpos, qvel = worlds.qpos.copy(), worlds.qvel.copy()
    qpos[:, :3] = qpos[:, :3] @ turn.T + [3.0, 0, -2.0]
    qvel[:, :3] = qvel[:, :3] @ turn.T
    w, x, y, z = qpos[:, 3:7].T
    c, s = np.cos(0.5), np.sin(0.5)
    qpos[:, 3:7] = np.stack([c * w - s * y, c * x + s * z, c * y + s * w, c * z - s * x], 1)
    frames = forward(standing.characters[0], worlds.offsets, qpos, qvel)
    around = np.minimum(worlds.frame[:, None] + np.arange(-1, 7), 71)
    p = standing.parts_p[around] @ turn.T + [3.0, 0, -2.0]
    r = turn @ standing.parts_r[around]
    parts = observation.future_parts(p, r, worlds.lookahead)
    again = observation.observe(frames, qpos, qvel, worlds.feet @ turn.T, *parts, worlds.hands,
                                worlds.stature)
    assert np.abs(again - seen).max() < 1e-6


def test_what_is_beyond_the_lookahead_is_not_seen(standing):
    rng = np.random.default_rng(0)
    position = rng.normal(size=(1, 8, 3, 3))
    rotation = rotation_exp(rng.normal(0, 0.1, (1, 8, 3, 3)))
    for known in (0, 2, 6):
        seen = observation.future_parts(position, rotation, np.array([known]))
        other = position.copy()
        other[:, known + 2:] += 1
        unseen = observation.future_parts(other, rotation, np.array([known]))
        assert (seen[0] == unseen[0]).all()


def test_contact_forces_stay_in_the_cone_and_carry_the_weight():
    rng = np.random.default_rng(0)
    columns = rng.normal(size=(3, 12, 6))
    true = np.maximum(rng.normal(size=(3, 12)), 0)
    target = np.einsum("nkm,nk->nm", columns, true)
    share = cone_least_squares(columns, target)
    assert (share >= 0).all()
    assert np.abs(np.einsum("nkm,nk->nm", columns, share) - target).max() < 0.1


def test_points_are_moved_into_the_hull_of_the_corners_that_count():
    square = np.array([[0.0, 0], [0.2, 0], [0.2, 0.2], [0, 0.2], [5, 5]])
    points = np.array([[0.1, 0.1], [0.3, 0.1], [0.1, -0.1], [0.4, 0.5]])
    valid = np.tile([True, True, True, True, False], (4, 1))
    move = balance.into_hull(points, np.tile(square, (4, 1, 1)), valid)
    assert (move[0] == 0).all()
    landed = (points + move)[:3]
    assert (landed > 0).all() and (landed < 0.2).all()
    assert abs(move[1, 1]) < 1e-9 and -0.13 < move[1, 0] < -0.1
    assert np.linalg.norm(move[3]) == pytest.approx(balance.FARTHEST)


def test_a_sway_beyond_the_soles_is_taken_back_until_the_ground_can_carry_it(standing):
    """The feet stay, and so does what could be carried already."""
    character, count = standing.characters[0], 108
    qpos = np.tile(standing.qpos[0], (count, 1))
    feet = forward(character, np.tile(character.offsets, (count, 1, 1)), qpos, np.zeros((count, 39)))
    corners = motion.sole_corners(character, feet)
    stands = np.ones((count, 2), bool)
    sway = 0.06 * np.sin(2 * np.pi * 1.2 * np.arange(count) / motion.RATE)
    qpos[:, 0] += sway
    balance.keep_feet(character, qpos, feet.position[:, balance.FEET], feet.rotation[:, balance.FEET])

    def outside(q):
        speed = motion.velocities(q)
        point, _ = balance.zero_moment_point(
            character, q, speed, balance.accelerations(speed, motion.RATE))
        flat = corners.reshape(count, 8, 3)[..., [0, 2]]
        move = balance.into_hull(point, flat, np.ones((count, 8), bool))
        return np.linalg.norm(move, axis=1)[4:-4]

    before = outside(qpos)
    balance.balance(character, qpos, stands, motion.velocities, corners, motion.RATE)
    after = outside(qpos)
    assert before.max() > 0.05
    assert after.max() < 0.02, (before.max(), after.max())
    moved = forward(character, np.tile(character.offsets, (count, 1, 1)), qpos, np.zeros((count, 39)))
    assert np.abs(moved.position - feet.position)[:, balance.FEET].max() < 0.01


def test_the_expert_stands_without_help(standing):
    worlds = Worlds(standing, 2, 0, Options(random_start=False, steps_max=10**6))
    expert = Expert(worlds)
    for _ in range(60):
        terms, lost, _ = worlds.step(expert.act())
        assert not lost.any()
    assert terms[:, 2].min() > 0.9, terms
    assert not worlds.options.assist


def arguments(**changes):
    args = dagger.parser().parse_args(["--motion", "m", "--out", "o"])
    args.worlds, args.steps, args.batches, args.batch = 3, 4, 3, 16
    return SimpleNamespace(**(vars(args) | changes))


def weights(run):
    return torch.cat([p.detach().flatten() for p in run.student.parameters()])


def test_a_killed_run_goes_on_with_the_same_curve(standing, tmp_path):
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    whole.mkdir(), parts.mkdir()
    straight = dagger.Run(standing, whole, arguments(rounds=3))
    straight.go()
    for rounds in (1, 3):
        run = dagger.Run(standing, parts, arguments(rounds=rounds))
        run.restore()
        run.go()
    assert torch.equal(weights(run), weights(straight))
    curve = [[json.loads(line)["error"] for line in open(folder / "curve.jsonl")]
             for folder in (whole, parts)]
    assert curve[0] == curve[1]


def test_ppo_goes_on_too(standing, tmp_path):
    torch.save({"student": Mlp().state_dict()}, tmp_path / "start.pt")
    made, curves = [], []
    for name, stops in (("whole", (4,)), ("parts", (3, 4))):
        (tmp_path / name).mkdir()
        for stop in stops:
            run = ppo.Run(standing, tmp_path / name, SimpleNamespace(
                start=tmp_path / "start.pt", iterations=stop, worlds=3, steps=20, lr=1e-4,
                critic_first=0, seed=0, jolted=0.5, misplaced=0.01, standing=None, apart=0.05,
                lost=0.1, save_every=2))
            run.restore()
            run.go()
        made.append(torch.cat([p.detach().flatten() for p in run.actor.parameters()]))
        curves.append([json.loads(line)["reward"] for line in open(tmp_path / name / "curve.jsonl")])
    assert torch.equal(*made)
    assert curves[0] == curves[1] and len(curves[0]) == 4


def test_advantages_stop_at_an_end():
    rewards, values = np.ones((3, 1)), np.zeros((3, 1))
    ended = np.array([[0.0], [1.0], [0.0]])
    gain = ppo.advantages(rewards, values, ended, np.array([10.0]))
    assert gain[1, 0] == 1.0
    assert gain[2, 0] == pytest.approx(1 + 0.97 * 10)


def test_motion_comes_back_from_its_file(standing, tmp_path):
    standing.save(tmp_path / "m.npz")
    again = motion.Motion.read(tmp_path / "m.npz")
    assert again.names == ["standing"] and (again.qpos == standing.qpos).all()


def test_a_mirrored_state_is_seen_and_driven_as_the_mirror_image(standing):
    mirror = Mirror()
    worlds = [Worlds(standing, 1, 0, Options(lookaheads=(6,), headset_only=0.0)) for _ in range(2)]
    rng = np.random.default_rng(3)
    qpos, qvel = worlds[0].qpos[0].copy(), worlds[0].qvel[0].copy()
    qpos[7:] += rng.normal(0, 0.05, 33)
    qvel += rng.normal(0, 0.2, 39)
    image = qpos.copy(), qvel.copy()
    image[0][[0, 5, 6]] *= -1
    image[1][[0, 4, 5]] *= -1
    image[0][7:] = qpos[7:][HINGES] * TURNS
    image[1][6:] = qvel[6:][HINGES] * TURNS
    for world, (place, speed) in zip(worlds, [(qpos, qvel), image]):
        world.data[0].qpos[:40], world.data[0].qvel[:39] = place, speed
        world._read(0)
        world.refresh()
    action = rng.normal(0, 0.1, (1, 33))
    for _ in range(3):
        seen = [torch.from_numpy(world.observe()[:, :312]) for world in worlds]
        padded = torch.nn.functional.pad(seen[0], (0, 475 - 312)).float()
        expected = mirror.observation(padded)[:, :312]
        close = torch.isclose(expected, seen[1].float(), rtol=0.02, atol=0.02)
        # Forces of feet that roll on one corner are stiff: compared as far as they carry.
        close[:, 210:216] = (expected - seen[1]).abs()[:, 210:216] < 60
        assert close.all(), (expected - seen[1]).abs().max()
        worlds[0].step(action)
        worlds[1].step(mirror.action(torch.from_numpy(action)).numpy())


def test_a_symmetric_policy_answers_the_mirror_image_with_the_mirror_image():
    torch.manual_seed(1)
    policy, mirror = Symmetric(Mlp()), Mirror()
    seen = torch.randn(5, observation.SIZE)
    with torch.no_grad():
        answer, image = policy(seen), policy(mirror.observation(seen))
    assert torch.allclose(mirror.action(answer), image, atol=1e-6)
    assert torch.equal(mirror.observation(mirror.observation(seen)), seen)


def test_a_run_begins_with_the_answers_of_another(standing, tmp_path):
    (tmp_path / "old").mkdir(), (tmp_path / "new").mkdir()
    old = dagger.Run(standing, tmp_path / "old", arguments(rounds=2))
    old.go()
    new = dagger.Run(standing, tmp_path / "new", arguments(
        rounds=1, answers=str(tmp_path / "old"), first=2))
    before = weights(new)
    new.restore()
    assert not torch.equal(weights(new), before)
    assert len(new.memory.inputs) == 2
    new.go()
    assert len(new.memory.inputs) == 3


def test_jolted_starts_are_off_the_reference_with_no_sole_below_the_floor(standing):
    plain = Worlds(standing, 8, 0, Options())
    jolted = Worlds(standing, 8, 0, Options(jolted=1.0))
    assert np.abs(plain.qpos - standing.qpos[plain.frame]).max() == 0
    off = np.abs(jolted.qpos - standing.qpos[jolted.frame])
    assert (off[:, 7:].max(1) > 0.01).all()
    soles = motion.sole_corners(standing.characters[0], jolted.frames)
    assert soles[..., 1].min() > -1e-6


def test_standing_clips_get_their_share(standing):
    worlds = Worlds(standing, 1, 0, Options(standing=0.25))
    worlds.motion = SimpleNamespace(start=np.array([0, 10, 20, 30]), qvel=np.zeros((30, 39)))
    worlds.motion.qvel[10:, 0] = 1.0
    worlds.usable = np.arange(3)
    weight = worlds.by_kind(np.array([0.6, 0.1, 0.3]), 0.25)
    assert weight == pytest.approx([0.25, 0.1875, 0.5625])
