"""Looks at what the planner, the kinematics and the base do with independent engines: MuJoCo, and Ruckig for moves
with limited jerk.

    cargo run -p host-bridge --example plan-trace -- DIRECTORY
    python tests/mujoco/check.py DIRECTORY        (packages: tests/mujoco/requirements.txt)

The models are written here, from the figures in shared/reference/hardware.md (part G) and the sizes in
host-bridge/crates/arm/src/model.rs and the scene files. Exit code 0 = everything holds.
"""

import csv
import math
import pathlib
import sys
import tomllib

import mujoco
import numpy as np
import ruckig

ROOT = pathlib.Path(__file__).resolve().parents[2]
SCENES = ["posts", "shelf", "bins"]

# Joint: origin in m, roll in quarter turns, limit in rad, speed in rad/s; link: ends of its capsule, radius.
JOINTS = [
    ((0, 0, 0.15643), 2, None, 1.3963, ((0, -0.0078, -0.1284), (0, 0, -0.0325), 0.0538)),
    ((0, 0.005375, -0.12838), 1, 2.24, 1.3963, ((0, -0.2131, -0.0063), (0, 0.0038, -0.0192), 0.0479)),
    ((0, -0.21038, -0.006375), 3, None, 1.3963, ((0, -0.0043, -0.2155), (0, 0, -0.0298), 0.0523)),
    ((0, 0.006375, -0.21038), 1, 2.57, 1.3963, ((0, -0.1885, -0.0064), (0, 0.0033, -0.0202), 0.0478)),
    ((0, -0.20843, -0.006375), 3, None, 1.2218, ((0, -0.0129, -0.1059), (0, 0, -0.0298), 0.0435)),
    ((0, 0.00017505, -0.10593), 1, 2.09, 1.2218, ((0, -0.1006, -0.0002), (0, -0.001, -0.0197), 0.0395)),
    ((0, -0.10593, -0.00017505), 3, None, 1.2218, ((0, 0, -0.0536), (0, 0, -0.023), 0.0395)),
]
FOOT = ((-0.0046, 0, 0.0149), (0.0001, 0, 0.1446), 0.0532)
FLANGE = ((0, 0, -0.061525), 2)
ACCELERATION = 8.6
SCALING = (0.1, 0.05)
MOUNT = (0.1, 0.0, 0.4)
BODY_SIZE, BODY_ABOVE_FLOOR = (0.6, 0.5, 0.35), 0.05

failures = []


def check(holds, text):
    print(("ok     " if holds else "FAILED ") + text)
    if not holds:
        failures.append(text)


def numbers(values):
    return " ".join(repr(float(v)) for v in values)


def roll(quarters):
    return numbers((math.cos(quarters * math.pi / 4), math.sin(quarters * math.pi / 4), 0, 0))


def capsule(ends_and_radius):
    one, other, radius = ends_and_radius
    return f'fromto="{numbers(one + other)}" size="{radius}"'


def arm_model(boxes):
    """The arm on its base, among the scene's boxes. Links are bodies link1 … link7."""
    inner = f'<site name="flange" pos="{numbers(FLANGE[0])}" quat="{roll(FLANGE[1])}"/>'
    for i in reversed(range(7)):
        origin, quarters, limit, _, link = JOINTS[i]
        limited = f'limited="true" range="{-limit} {limit}"' if limit else 'limited="false"'
        inner = f"""<body name="link{i + 1}" pos="{numbers(origin)}" quat="{roll(quarters)}">
            <joint name="joint_{i + 1}" axis="0 0 1" {limited}/>
            <geom name="link{i + 1}" type="capsule" {capsule(link)} mass="1"/>
            {inner}</body>"""
    obstacles = "".join(
        f"""<geom name="{b["name"]}" type="box" pos="{numbers(b["center_m"])}"
            size="{numbers(s / 2 for s in b["size_m"])}" euler="0 0 {b.get("yaw_rad", 0.0)}"/>"""
        for b in boxes
    )
    apart = [("foot", 1), ("foot", 2), ("chassis", 1)] + [(f"link{i}", i + k) for i in range(1, 7) for k in (1, 2)]
    excludes = "".join(f'<exclude body1="{a}" body2="link{b}"/>' for a, b in apart if b <= 7)
    half = [s / 2 for s in BODY_SIZE]
    return f"""<mujoco><compiler angle="radian"/>
        <worldbody>
          <geom name="floor" type="plane" size="9 9 1"/>{obstacles}
          <body name="chassis"><geom name="chassis" type="box"
             pos="0 0 {BODY_ABOVE_FLOOR + half[2]}" size="{numbers(half)}"/></body>
          <body name="foot" pos="{numbers(MOUNT)}">
            <geom name="foot" type="capsule" {capsule(FOOT)}/>{inner}</body>
        </worldbody>
        <contact>{excludes}</contact></mujoco>"""


def place(model, data, angles):
    data.qpos[:] = angles
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)


def kinematics():
    model = mujoco.MjModel.from_xml_string(arm_model([]))
    data = mujoco.MjData(model)
    rows = list(csv.reader((ROOT / "host-bridge/tests/data/kinova_gen3_fk.csv").open()))[1:]
    worst = 0.0
    for row in rows:
        values = np.array(row, dtype=float)
        place(model, data, values[:7])
        worst = max(worst, np.linalg.norm(data.site("flange").xpos - MOUNT - values[7:10]))
    check(len(rows) == 200 and worst <= 1e-6, f"reference table against MuJoCo: {len(rows)} rows, worst {worst:.1e} m")


def scene(name, directory):
    boxes = tomllib.loads((ROOT / f"host-bridge/scenes/{name}.toml").read_text())["box"]
    model = mujoco.MjModel.from_xml_string(arm_model(boxes))
    data = mujoco.MjData(model)

    # Places and distances of random configurations.
    excluded = {(s >> 16, s & 0xFFFF) for s in model.exclude_signature}
    links = [model.geom(f"link{i}").id for i in range(1, 8)]
    pairs = []
    for i, link in enumerate(links):
        for other in range(model.ngeom):
            a, b = model.geom_bodyid[link], model.geom_bodyid[other]
            apart = (min(a, b), max(a, b)) in excluded or (max(a, b), min(a, b)) in excluded
            # The first link turns on its foot, at the same height above the floor for ever.
            still = i == 0 and model.geom(other).name in ("floor", "foot", "chassis")
            if other not in links[: i + 1] and not apart and not still:
                pairs.append((link, other))
    rows = np.fromfile(directory / f"{name}.clearances", "<f8").reshape(-1, 11)
    off_m, distance_off_m, apart_rows, touching = 0.0, 0.0, 0, 0
    fromto = np.zeros(6)
    for row in rows:
        place(model, data, row[:7])
        off_m = max(off_m, np.linalg.norm(data.site("flange").xpos - MOUNT - row[7:10]))
        nearest = min(mujoco.mj_geomDistance(model, data, a, b, 2.0, fromto) for a, b in pairs)
        if row[10] > 0.0:
            apart_rows += 1
            distance_off_m = max(distance_off_m, abs(nearest - row[10]))
        else:
            touching += nearest <= 1e-6
    check(off_m <= 1e-6, f"{name}: flange of {len(rows)} random configurations, worst {off_m:.1e} m")
    check(
        distance_off_m <= 1e-5 and touching == len(rows) - apart_rows and apart_rows > 20,
        f"{name}: shortest distance of {apart_rows} clear configurations, worst {distance_off_m:.1e} m off; "
        f"{touching} of {len(rows) - apart_rows} others touch here too",
    )

    # Executed motions.
    rows = np.fromfile(directory / f"{name}.motions", "<f8").reshape(-1, 8)
    number, angles = rows[:, 0], rows[:, 1:]
    contacts, beyond = 0, 0
    for row in angles:
        place(model, data, row)
        mujoco.mj_collision(model, data)
        contacts += data.ncon
    for i, (_, _, limit, _, _) in enumerate(JOINTS):
        beyond += 0 if limit is None else int(np.sum(np.abs(angles[:, i]) > limit))
    speed, acceleration = 0.0, 0.0
    limits = np.array([joint[3] for joint in JOINTS]) * SCALING[0]
    for k in np.unique(number):
        motion = angles[number == k]
        velocity = np.diff(motion, axis=0) * 100.0
        speed = max(speed, np.max(np.abs(velocity) / limits))
        # Mean speeds of neighbouring intervals differ by at most the acceleration times their distance.
        acceleration = max(acceleration, np.max(np.abs(np.diff(velocity, axis=0))) * 100.0)
    acceleration /= ACCELERATION * SCALING[1]
    motions = len(np.unique(number))
    check(
        contacts == 0 and motions >= 60,
        f"{name}: {motions} motions, {len(rows)} samples: {contacts} contacts",
    )
    check(
        beyond == 0 and speed <= 1 + 1e-6 and acceleration <= 1 + 1e-6,
        f"{name}: {beyond} samples beyond joint limits; fastest {speed:.4f} of the speed limit, "
        f"{acceleration:.4f} of the acceleration limit",
    )
    # The check itself sees contacts where there are some.
    place(model, data, [0, 2.2, 0, 1.5, 0, 0, 0])
    mujoco.mj_collision(model, data)
    check(data.ncon > 0, f"{name}: an arm bent into its base is seen ({data.ncon} contacts)")


def moves(directory):
    """Single moves with limited jerk against Ruckig's time-optimal ones, along the straight line in joint space."""
    rows = np.fromfile(directory / "moves.jerk", "<f8").reshape(-1, 38)
    engine, worst, worst_stop, shapes = ruckig.Ruckig(1), 0.0, 0.0, set()
    for row in rows:
        way = np.abs(row[7:14] - row[:7])
        v, a, j = (float(np.min(row[k : k + 7] / way)) for k in (14, 21, 28))
        wanted, motion = ruckig.InputParameter(1), ruckig.Trajectory(1)
        wanted.target_position = [1.0]
        wanted.max_velocity, wanted.max_acceleration, wanted.max_jerk = [v], [a], [j]
        assert engine.calculate(wanted, motion) == ruckig.Result.Working
        worst = max(worst, abs(motion.duration - row[35]) / row[35])
        # From where Ruckig's own motion is at that moment.
        _, [speed], [acceleration] = motion.at_time(row[36])
        wanted.control_interface = ruckig.ControlInterface.Velocity
        wanted.current_velocity, wanted.current_acceleration = [speed], [acceleration]
        assert engine.calculate(wanted, motion) == ruckig.Result.Working
        worst_stop = max(worst_stop, abs(motion.duration - row[37]))
        shapes.add((row[35] > 1 / v + v / a + a / j - 1e-9, acceleration > 1e-9, acceleration < -1e-9))
    check(
        len(rows) == 500 and len(shapes) >= 5 and worst < 1e-6 and worst_stop < 1e-5,
        f"jerk: {len(rows)} moves of {len(shapes)} shapes take Ruckig's time within {worst:.1e}, "
        f"and so do stops on the way within {1000 * worst_stop:.1e} ms",
    )


BASE = """<mujoco>
  <default><geom solref="0.004 1"/></default>
  <option timestep="0.002" noslip_iterations="10" impratio="10" integrator="implicitfast"/>
  <worldbody>
    <geom type="plane" size="50 50 1" friction="1 0.005 0.0001"/>
    <body name="base" pos="0 0 0.1"><freejoint/>
      <geom type="box" size="0.3 0.15 0.1" pos="-0.1 0 0.05" mass="20" contype="0" conaffinity="0"/>
      <geom type="sphere" size="0.05" pos="-0.25 0 -0.05" mass="0.2" condim="1" friction="0 0 0" priority="1"/>
      <body name="left" pos="0 0.2 0"><joint name="left" axis="0 1 0" armature="0.01"/>
        <geom type="ellipsoid" size="0.1 0.02 0.1" mass="1"/></body>
      <body name="right" pos="0 -0.2 0"><joint name="right" axis="0 1 0" armature="0.01"/>
        <geom type="ellipsoid" size="0.1 0.02 0.1" mass="1"/></body>
    </body>
  </worldbody>
  <actuator><velocity joint="left" kv="20"/><velocity joint="right" kv="20"/></actuator>
</mujoco>"""


def base(directory):
    rows = np.fromfile(directory / "base.path", "<f8").reshape(-1, 6)
    model = mujoco.MjModel.from_xml_string(BASE)
    data = mujoco.MjData(model)
    for _ in range(250):  # the body settles on its wheels
        mujoco.mj_step(model, data)
    start = data.qpos[:2].copy()
    worst = 0.0
    for left, right, x, y, _heading, _path in rows:
        data.ctrl[:] = (left, right)
        mujoco.mj_step(model, data)
        worst = max(worst, math.dist(data.qpos[:2] - start, (x, y)))
    path = rows[-1, 5]
    w, _, _, z = data.qpos[3:7]
    turn = math.remainder(2 * math.atan2(z, w) - rows[-1, 4], 2 * math.pi)
    check(
        len(rows) == 30000 and path > 5 and worst <= 0.01 * path,
        f"base: 60 s of random speeds, {path:.2f} m: at most {1000 * worst:.1f} mm from the rolling wheels "
        f"({100 * worst / path:.2f} % of the path), {1000 * turn:.1f} mrad at the end",
    )


def main():
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    directory = pathlib.Path(sys.argv[1])
    print(f"MuJoCo {mujoco.__version__}")
    kinematics()
    for name in SCENES:
        scene(name, directory)
    moves(directory)
    base(directory)
    print(f"{len(failures)} failed")
    sys.exit(1 if failures else 0)


if __name__ == "__main__":
    main()
