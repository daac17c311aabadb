"""Draws what the character does in a scene, from the frames that the tracker made:

    cargo run -p posed --example interaction -- tests/assets/scenes/ball.toml > BALL.json
    cd policy/training && python -m questsim.pictures BALL.json questsim/pictures/ball.png

Seen from the side, the wearer walks to the right: a strip of moments about the one when the
character first touches a thing, or, without things, over the walk. Red is left, blue is right; a star
is set where the character was just put back on its feet and what is shown leads over to it.
"""

import argparse
import json

import matplotlib
import numpy as np

matplotlib.use("Agg")
from matplotlib import patches, pyplot  # noqa: E402

COLOURS = {"left": "tab:red", "right": "tab:blue", "middle": "0.25"}
LEFT, RIGHT = {1, 4, 7, 10, 13, 16, 18, 20}, {2, 5, 8, 11, 14, 17, 19, 21}
HEAD, PELVIS = 15, 0
# The built-in human's first walk.
WALK_S = (4.6, 6.6)


def side(joint):
    return "left" if joint in LEFT else "right" if joint in RIGHT else "middle"


def turned(q, v):
    """`v` turned by the quaternion `q` (x, y, z, w)."""
    u, w = np.array(q[:3]), q[3]
    return v + 2 * np.cross(u, np.cross(u, v) + w * v)


def flat(point):
    """A place as seen from the wearer's right: forward is to the right."""
    return np.array([-point[2], point[1]])


def draw_object(axes, shape, place, touched):
    position, rotation = np.array(place[0]), place[1]
    look = {"facecolor": "tab:orange" if touched else "0.8", "edgecolor": "0.3", "zorder": 3}
    if shape["kind"] == "ball":
        axes.add_patch(patches.Circle(flat(position), shape["radius"], **look))
        return
    half = np.array(shape["size"]) / 2
    corners = [flat(position + turned(rotation, half * np.array([0, y, z])))
               for y, z in ((-1, -1), (-1, 1), (1, 1), (1, -1))]
    axes.add_patch(patches.Polygon(corners, **look))


def draw(axes, data, frame, middle):
    way = np.linspace(2, -2, len(data["ground"]))
    axes.fill_between(way, np.array(data["ground"]), -0.1, color="0.88", zorder=0)
    for shape, place in zip(data["scene"]["objects"], frame["objects"], strict=True):
        draw_object(axes, shape, place, frame["touched"])
    joints = np.array(frame["joints"])
    for joint, parent in enumerate(data["parents"]):
        if parent is None:
            continue
        ends = np.array([flat(joints[parent]), flat(joints[joint])])
        axes.plot(*ends.T, color=COLOURS[side(joint)], linewidth=4, solid_capstyle="round",
                  alpha=0.85, zorder=4 if side(joint) == "right" else 2)
    axes.add_patch(patches.Circle(flat(joints[HEAD]) + [0, 0.08], 0.1, color="0.25", zorder=4))
    axes.set(xlim=(middle - 0.62, middle + 0.62), ylim=(-0.1, 1.9), xticks=[], yticks=[],
             aspect="equal", xlabel=f"{frame['seconds']:.2f} s{'' if frame['own'] else ' *'}")
    for spine in axes.spines.values():
        spine.set_visible(False)


def moments(data, count):
    """Frames about the first touch; without things, over the walk."""
    frames = data["frames"]
    if data["scene"]["objects"]:
        first = next(i for i, frame in enumerate(frames) if frame["touched"])
        chosen = first + np.linspace(-27, 63, count).astype(int)
    else:
        seconds = np.array([frame["seconds"] for frame in frames])
        chosen = np.searchsorted(seconds, np.linspace(*WALK_S, count))
    return [frames[i] for i in np.clip(chosen, 0, len(frames) - 1)]


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("frames")
    parser.add_argument("out")
    parser.add_argument("--count", type=int, default=6)
    args = parser.parse_args()
    with open(args.frames) as file:
        data = json.load(file)
    chosen = moments(data, args.count)
    figure, all_axes = pyplot.subplots(1, args.count, figsize=(1.35 * args.count, 2.4))
    for axes, frame in zip(all_axes, chosen, strict=True):
        draw(axes, data, frame, flat(np.array(frame["joints"][PELVIS]))[0])
    figure.tight_layout(pad=0.3)
    figure.savefig(args.out, dpi=90, bbox_inches="tight", pad_inches=0.05)


if __name__ == "__main__":
    main()
