"""Golden vectors for the metrics: a made-up motion, a disturbed one, and what numpy measures.

    python make_metrics.py metrics.json

Written from the definitions in the papers, not from the Rust code. Needs numpy only.
"""

import json
import sys

import numpy as np

FRAMES, FPS = 20, 12.0
PARENTS = [-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19]
FEET = [7, 8, 10, 11]
UPPER = [3, 6, 9] + list(range(12, 22))
LOWER = [0, 1, 2, 4, 5, 7, 8, 10, 11]
G = 9.81


def waves(rng, shape, size):
    """Smooth random curves (FRAMES, *shape)."""
    t = np.arange(FRAMES).reshape(-1, *[1] * len(shape)) / FPS
    out = np.zeros((FRAMES, *shape))
    for _ in range(3):
        out += rng.normal(size=shape) * np.sin(
            rng.uniform(1, 9, size=shape) * t + rng.uniform(0, 6, size=shape))
    return size * out


def unit(q):
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def motion(rng):
    """Positions (n, 22, 3) and local quaternions (n, 22, 4), x y z w."""
    height = np.array([0.95, .9, .9, 1.0, .5, .5, 1.1, .06, .06, 1.2, .03, .03, 1.4, 1.35, 1.35,
                       1.5, 1.4, 1.4, 1.1, 1.1, .9, .9])
    p = waves(rng, (22, 3), 0.05)
    p[..., 1] += height
    p[..., 0] += 2.5 * np.arange(FRAMES)[:, None] / FPS
    for i, joint in enumerate(FEET):
        # Feet stand most of the time and jump between places.
        p[:, joint] = np.array([0.2 * i, height[joint], 0.3 * (-1) ** i])
        p[:, joint, 0] += 0.7 * (np.arange(FRAMES) // (6 + i))
        p[:, joint] += rng.normal(size=(FRAMES, 3)) * 0.003
    q = unit(waves(rng, (22, 4), 0.3) + np.array([0, 0, 0, 1.0]))
    return p, q


def disturbed(rng, p, q):
    p = p + waves(rng, (22, 3), 0.03) + rng.normal(size=p.shape) * 0.004
    p[8:11] += [0.7, 0, 0]
    q = unit(q + waves(rng, (22, 4), 0.1))
    # The same rotation has two quaternions.
    return p, q * np.where(rng.uniform(size=q.shape[:2]) < 0.3, -1, 1)[..., None]


def matrices(q):
    x, y, z, w = np.moveaxis(q, -1, 0)
    return np.stack([
        1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w),
        2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
        2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y),
    ], -1).reshape(*q.shape[:-1], 3, 3)


def world(local):
    out = local.copy()
    for j, parent in enumerate(PARENTS):
        if parent >= 0:
            out[:, j] = out[:, parent] @ local[:, j]
    return out


def rotvec(m):
    """Axis-angle vectors of rotation matrices, by the skew part and the trace."""
    skew = np.stack([m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0],
                     m[..., 1, 0] - m[..., 0, 1]], -1) / 2
    s = np.linalg.norm(skew, axis=-1)
    a = np.arctan2(s, (np.trace(m, axis1=-2, axis2=-1) - 1) / 2)
    return skew * (a / np.maximum(s, 1e-12))[..., None]


def angle(a, b):
    return np.degrees(np.linalg.norm(rotvec(np.swapaxes(a, -1, -2) @ b), axis=-1))


def norm(v):
    return np.linalg.norm(v, axis=-1)


def jitter(p):
    return norm(np.diff(p, n=3, axis=0)).mean() * FPS**3 / 1000


def translation(p, t, metres):
    path = np.concatenate([[0], np.cumsum(norm(np.diff(t[:, 0], axis=0)))])
    pairs, start, end = [], 0, 1
    while end < len(path):
        if path[end] - path[start] < metres:
            end += 1
        else:
            if not pairs or pairs[-1][1] != end:
                pairs.append((start, end))
            start += 1
    errors = [norm((t[e, 0] - t[s, 0]) - (p[e, 0] - p[s, 0])) / (path[e] - path[s]) * metres
              for s, e in pairs]
    return 100 * float(np.mean(errors)) if errors else None


def zmp(p, rotation, parts):
    floor = p[2:30][:, [10, 11], 1].mean() + 0.01
    com = np.stack([p[:, j] + rotation[:, j] @ np.array(o) for j, o, _ in parts], 1)
    mass = np.array([m for _, _, m in parts])
    accel = (com[2:] - 2 * com[1:-1] + com[:-2]) * FPS**2
    com = com[2:]
    press = mass * (accel[..., 1] + G)
    point = [
        ((press * com[..., k] - mass * accel[..., k] * (com[..., 1] - floor)).sum(1) / press.sum(1))
        for k in (0, 2)
    ]
    out = []
    for i in range(len(com)):
        if press[i].sum() <= 1:
            continue
        z = np.array([point[0][i], point[1][i]])
        l, r = (p[i + 2, j][[0, 2]] for j in (10, 11))
        down_l, down_r = (p[i + 2, j, 1] <= floor for j in (10, 11))
        if down_l and down_r:
            u = np.clip(((z - l) @ (r - l)) / ((r - l) @ (r - l)), 0, 1)
            d = norm(z - l - u * (r - l))
        elif down_l or down_r:
            d = norm(z - (l if down_l else r))
        else:
            continue
        out.append(max(d - 0.1, 0))
    return float(np.mean(out))


def pip_reduced(p, local):
    """PIP's evaluate.py: joints [0, 7, 8, 10, 11, 20, 21] (and the hands) set to the identity, then
    forward kinematics with the motion's own bones, the pelvis at the origin."""
    turned = world(local)
    still = local.copy()
    still[:, [0, 7, 8, 10, 11, 20, 21]] = np.eye(3)
    still = world(still)
    places = np.zeros_like(p)
    for j in range(1, 22):
        a = PARENTS[j]
        bone = np.swapaxes(turned[:, a], -1, -2) @ (p[:, j] - p[:, a])[..., None]
        places[:, j] = places[:, a] + (still[:, a] @ bone)[..., 0]
    # Hands go on as the wrists: 24 joints.
    return still[:, list(range(22)) + [20, 21]], places


def measure(p, q, t, qt, parts):
    lp, lt = matrices(q), matrices(qt)
    wp, wt = world(lp), world(lt)
    (rp, pp), (rt, pt) = pip_reduced(p, lp), pip_reduced(t, lt)
    head = p - p[:, 15:16] + t[:, 15:16]
    root = p - p[:, :1] + t[:, :1]
    difference = rotvec(lp[:, 1:]) - rotvec(lt[:, 1:])
    difference = np.abs((difference + np.pi) % (2 * np.pi) - np.pi)
    steps_t, steps_p = np.diff(t[:, FEET], axis=0), np.diff(p[:, FEET], axis=0)
    stand = norm(steps_t) <= 0.01
    level = lambda v: np.hypot(v[..., 0], v[..., 2])[stand].mean() * 100 * FPS
    low_t = np.sort(t[..., 1].min(1))
    low = p[..., 1].min(1) - low_t[int(0.05 * len(t))]
    error = norm(p - t).mean(1)
    falls, fallen = 0, False
    for e in error:
        falls += e > 0.5 and not fallen
        fallen = e > 0.5 or (fallen and e >= 0.25)
    return {
        "mpjpe_head_cm": 100 * norm(head - t).mean(),
        "mpjpe_world_cm": 100 * norm(p - t).mean(),
        "mpjpe_root_cm": 100 * norm(root - t).mean(),
        "upper_pe_cm": 100 * norm(head - t)[:, UPPER].mean(),
        "lower_pe_cm": 100 * norm(head - t)[:, LOWER].mean(),
        "hand_pe_cm": 100 * norm(head - t)[:, [20, 21]].mean(),
        "mpjve_cm_s": 100 * FPS * norm(np.diff(head, axis=0) - np.diff(t, axis=0)).mean(),
        "mpjre_geodesic_deg": angle(lp[:, 1:], lt[:, 1:]).mean(),
        "mpjre_component_deg": np.degrees(difference.mean()),
        "root_position_cm": 100 * norm(p[:, 0] - t[:, 0]).mean(),
        "root_rotation_deg": angle(wp[:, 0], wt[:, 0]).mean(),
        "sip_deg": angle(wp[:, [1, 2, 16, 17]], wt[:, [1, 2, 16, 17]]).mean(),
        "pip_sip_deg": angle(rp[:, [1, 2, 16, 17]], rt[:, [1, 2, 16, 17]]).mean(),
        "pip_angle_deg": angle(rp, rt).mean(),
        "pip_joint_cm": 100 * norm(pp - pt).mean(),
        "jitter_km_s3": jitter(p),
        "true_jitter_km_s3": jitter(t),
        "mhpe_cm": 100 * norm(p - t)[:, [15, 20, 21]].mean(),
        "mhre_deg": angle(wp[:, [15, 20, 21]], wt[:, [15, 20, 21]]).mean(),
        "foot_skate_cm": 100 * np.abs(steps_p * stand[..., None]).mean(),
        "foot_slide_cm_s": level(steps_p),
        "true_foot_slide_cm_s": level(steps_t),
        "penetration_cm": 100 * np.maximum(-low, 0).mean(),
        "floating_cm": 100 * np.maximum(low, 0).mean(),
        "zmp_m": zmp(p, wp, parts),
        "true_zmp_m": zmp(t, wt, parts),
        "translation_2m_cm": translation(p, t, 2),
        "lost_percent": 100 * (error > 0.5).mean(),
        "falls_per_min": falls / (len(t) / FPS / 60),
    }


def main():
    rng = np.random.default_rng(8)
    t, qt = motion(rng)
    p, q = disturbed(rng, t, qt)
    # What is written is what is measured: 32-bit numbers.
    t, qt, p, q = (a.astype(np.float32).astype(np.float64) for a in (t, qt, p, q))
    # A slip of single precision in a quaternion's length must not count.
    parts = [(0, (0.0, 0.05, 0.01), 30.0), (9, (0.02, 0.1, 0.0), 25.0), (4, (0.0, -0.2, 0.0), 8.0)]
    scores = measure(p, unit(q), t, unit(qt), parts)
    flat = lambda a: [float(f"{v:.9g}") for v in np.asarray(a, np.float32).reshape(-1)]
    json.dump({
        "fps": FPS, "frames": FRAMES, "predicted_positions": flat(p), "predicted_local": flat(q),
        "true_positions": flat(t), "true_local": flat(qt),
        "masses": [[j, *o, m] for j, o, m in parts],
        "scores": {k: float(v) for k, v in scores.items()},
        "translation_cm": [translation(p, t, m) for m in range(1, 8)],
    }, open(sys.argv[1], "w"), separators=(",", ":"))


if __name__ == "__main__":
    main()
