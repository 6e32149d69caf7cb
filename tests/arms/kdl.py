"""KDL's inverse kinematics on the places that `ik-times` wrote, beside its figures.

    cargo run --release -p host-arm --features urdf --example ik-times -- target/ik
    python tests/arms/kdl.py target/ik        (Debian: python3-pykdl)

Each place is tried from the same start and then from random ones, with KDL's Levenberg-Marquardt solver, and with its
Newton-Raphson that keeps to limits. A place counts as found if the flange is there and every joint within its limits; "there"
is 1e-6, and for the former solver its own default tolerance, which the Python binding cannot change without numpy.
"""

import csv
import math
import pathlib
import random
import sys
import time

import PyKDL as kdl

STARTS = 30


def frame(v):
    return kdl.Frame(kdl.Rotation(*v[3:12]), kdl.Vector(*v[:3]))


def array(values):
    made = kdl.JntArray(len(values))
    for i, value in enumerate(values):
        made[i] = value
    return made


def main():
    for file in sorted(pathlib.Path(sys.argv[1]).glob("*.csv")):
        joints, places, flange, start = [], [], None, None
        for word, *values in csv.reader(file.open()):
            values = [float(value) for value in values]
            if word == "joint":
                joints.append(values)
            elif word == "flange":
                flange = values
            elif word == "start":
                start = values
            else:
                places.append(values)
        chain = kdl.Chain()
        # A segment's joint turns in the frame that the segment before it ends in.
        chain.addSegment(kdl.Segment(kdl.Joint(kdl.Joint.Fixed), frame(joints[0])))
        for i, joint in enumerate(joints):
            following = frame(joints[i + 1] if i + 1 < len(joints) else flange)
            axis = kdl.Joint(f"j{i}", kdl.Vector(0, 0, 0), kdl.Vector(*joint[12:15]), kdl.Joint.RotAxis)
            chain.addSegment(kdl.Segment(axis, following))
        low = array([max(joint[15], -1e3) for joint in joints])
        high = array([min(joint[16], 1e3) for joint in joints])
        forward = kdl.ChainFkSolverPos_recursive(chain)
        # The binding does not keep what a solver refers to, so it has a name here.
        velocity = kdl.ChainIkSolverVel_pinv(chain)
        solvers = {
            # Its own tolerance, in m and (because it weighs turns by a hundredth) in rad.
            "LMA": (kdl.ChainIkSolverPos_LMA(chain), 1e-5, 1e-3),
            "NR_JL": (kdl.ChainIkSolverPos_NR_JL(chain, low, high, forward, velocity, 100, 1e-9), 1e-6, 1e-6),
        }
        within = [(max(joint[15], -math.pi), min(joint[16], math.pi)) for joint in joints]
        for name, (solver, near_m, near_rad) in solvers.items():
            chance = random.Random(5)
            once, found, times = 0, 0, []
            for place in places:
                target, begin = frame(place), time.perf_counter()
                for k in range(STARTS):
                    first = start if k == 0 else [chance.uniform(*limit) for limit in within]
                    answer, there = kdl.JntArray(len(joints)), kdl.Frame()
                    solver.CartToJnt(array(first), target, answer)
                    forward.JntToCart(answer, there)
                    off = kdl.diff(there, target)
                    near = off.vel.Norm() < near_m and off.rot.Norm() < near_rad
                    if near and all(low[i] <= answer[i] <= high[i] for i in range(len(joints))):
                        once += k == 0
                        found += 1
                        break
                times.append(1e6 * (time.perf_counter() - begin))
            times.sort()
            print(
                f"{file.stem}: KDL {name}: {once} of {len(places)} from the same start, {found} from {STARTS}; "
                f"median {times[len(times) // 2]:.1f} us, 99 % {times[len(times) * 99 // 100]:.1f} us"
            )


if __name__ == "__main__":
    main()
