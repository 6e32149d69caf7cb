"""Looks at planned ways of the Gen3 with its vision module and a Robotiq 2F-85, on the hulls of the makers' meshes, with Coal.

    cargo run -p host-bridge --example plan-trace -- DIRECTORY --tools
    python tests/arms/gen3.py DIRECTORY HULLS      (packages: tests/arms/requirements.txt)

HULLS is a folder of vertices (`../shared/data/arm-hulls`), which is no part of this project; where it is not there, nothing
is looked at, and that is said. Exit code 0 = nothing touches.
"""

import csv
import pathlib
import sys
import tomllib

import coal
import numpy as np

ROOT = pathlib.Path(__file__).resolve().parents[2]
SCENES = ["posts", "shelf"]
# Thirty pairs of poses each, planned twice.
WAYS = 60
# Of 100 samples a second, at the paper's speeds: the tip moves by no more than 35 mm from one look to the next.
EVERY = 20
MOUNT = np.array([0.1, 0.0, 0.4])
BASE = ((0.6, 0.5, 0.35), (0.0, 0.0, 0.225))

# Origin in m and roll in quarter turns of each joint, and of the flange (kortex_description).
ORIGINS = [
    ((0, 0, 0.15643), 2),
    ((0, 0.005375, -0.12838), 1),
    ((0, -0.21038, -0.006375), 3),
    ((0, 0.006375, -0.21038), 1),
    ((0, -0.20843, -0.006375), 3),
    ((0, 0.00017505, -0.10593), 1),
    ((0, -0.10593, -0.00017505), 3),
    ((0, 0, -0.061525), 2),
]
LINKS = [
    "gen3_base_link",
    "gen3_shoulder_link",
    "gen3_half_arm_1_link",
    "gen3_half_arm_2_link",
    "gen3_forearm_link",
    "gen3_spherical_wrist_1_link",
    "gen3_spherical_wrist_2_link",
    "gen3_bracelet_with_vision_link",
]


def gripper():
    """Where its parts are in the flange's frame while it is open."""
    yield "2f85_robotiq_base", (0, 0, 0)
    for side, sign in (("left", 1), ("right", -1)):
        knuckle = np.array([sign * 0.03060114, 0, 0.05490452])
        finger = knuckle + [sign * 0.03152616, 0, -0.00376347]
        yield f"2f85_{side}_knuckle", knuckle
        yield f"2f85_{side}_finger", finger
        yield f"2f85_{side}_finger_tip", finger + [sign * 0.00563134, 0, 0.04718515]
        yield f"2f85_{side}_inner_knuckle", (sign * 0.0127, 0, 0.06142)


def hull(folder, name):
    points = coal.StdVec_Vec3s()
    for row in list(csv.reader((folder / f"{name}.csv").open()))[1:]:
        points.append(np.array(row, dtype=float))
    return coal.Convex.convexHull(points, True, "Qt")


def ball(shape):
    points = np.array([shape.point(i) for i in range(shape.num_points)])
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    return middle, np.linalg.norm(points - middle, axis=1).max()


def roll(quarters):
    s, c = [(0, 1), (1, 0), (0, -1), (-1, 0)][quarters]
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]], dtype=float)


def turn(angle):
    s, c = np.sin(angle), np.cos(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def frames(angles):
    """Of foot, links and flange in the robot's frame."""
    rotation, place = np.eye(3), MOUNT
    found = [(rotation, place)]
    for (origin, quarters), angle in zip(ORIGINS, [*angles, 0.0]):
        place = place + rotation @ np.array(origin)
        rotation = rotation @ roll(quarters) @ turn(angle)
        found.append((rotation, place))
    return found


def main():
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    directory, folder = map(pathlib.Path, sys.argv[1:])
    if not folder.is_dir():
        print(f"SKIPPED: {folder} is not there")
        return
    # Number of the link (8 is the flange), hull, seat in its frame; what is on the flange belongs to link 7.
    shapes = [(i, hull(folder, name), np.zeros(3)) for i, name in enumerate(LINKS)]
    shapes += [(8, hull(folder, name), np.array(at)) for name, at in gripper()]
    request = coal.DistanceRequest()
    # Balls around all shapes: what is further apart than the nearest so far is not measured.
    round_ = [ball(shape) for _, shape, _ in shapes]

    def placed(angles):
        at = frames(angles)
        for number, shape, seat in shapes:
            rotation, place = at[number]
            yield min(number, 7), shape, coal.Transform3s(rotation, place + rotation @ seat)

    def gap(one, two):
        return coal.distance(one[1], one[2], two[1], two[2], request, coal.DistanceResult())

    # The figures of the kinematics against the reference table.
    rows = list(csv.reader((ROOT / "host-bridge/tests/data/kinova_gen3_fk.csv").open()))[1:]
    off = max(
        np.linalg.norm(frames(v[:7])[8][1] - MOUNT - v[7:10]) for v in (np.array(row, dtype=float) for row in rows)
    )
    assert off < 1e-6, off
    failures = 0
    for name in SCENES:
        boxes = [((b["size_m"]), b["center_m"], b.get("yaw_rad", 0.0)) for b in tomllib.loads(
            (ROOT / f"host-bridge/scenes/{name}.toml").read_text())["box"]]
        around = [(coal.Box(*size), coal.Transform3s(turn(yaw), np.array(center))) for size, center, yaw in boxes]
        sizes = [np.linalg.norm(size) / 2 for size, _, _ in boxes]
        base = (coal.Box(*BASE[0]), coal.Transform3s(np.eye(3), np.array(BASE[1])))
        rows = np.fromfile(directory / f"{name}.tools", "<f8").reshape(-1, 8)[::EVERY]
        contacts, least, of = 0, np.inf, None
        for row in rows:
            now = list(placed(row[1:]))
            balls = [(at.getTranslation() + at.getRotation() @ middle, r) for (_, _, at), (middle, r) in zip(now, round_)]
            nearest = (np.inf, None)

            def look(i, other, middle, radius, what):
                nonlocal nearest
                if np.linalg.norm(balls[i][0] - middle) - balls[i][1] - radius < nearest[0]:
                    nearest = min(nearest, (gap(now[i], other), what), key=lambda found: found[0])

            for i, one in enumerate(now):
                for j in range(i + 1, len(now)):
                    if now[j][0] >= one[0] + 2:
                        look(i, now[j], *balls[j], (one[0], now[j][0]))
                for box, size in zip(around, sizes):
                    look(i, (0, *box), box[1].getTranslation(), size, (one[0], "box"))
                if one[0] >= 2:
                    look(i, (0, *base), base[1].getTranslation(), 0.5, (one[0], "base"))
            contacts += nearest[0] <= 0
            if nearest[0] < least:
                least, of = nearest
        ways = len(np.unique(rows[:, 0]))
        holds = contacts == 0 and ways == WAYS
        failures += not holds
        print(
            f"{'ok    ' if holds else 'FAILED'} {name}: {ways} ways with vision module and 2F-85, {len(rows)} samples: "
            f"{contacts} contacts, nearest {1000 * least:.1f} mm ({of})"
        )
    sys.exit(1 if failures else 0)


if __name__ == "__main__":
    main()
