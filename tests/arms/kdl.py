"""KDL's inverse kinematics on the places that `ik-times` wrote, beside its figures.

    cargo run --release -p host-arm --features urdf --example ik-times -- target/ik
    python tests/arms/kdl.py target/ik        (Debian: python3-pykdl)

Each place is tried from the same start, with KDL's Levenberg-Marquardt solver, and with its Newton-Raphson that keeps to
limits. A place counts as found if the flange is within 1e-6 and every joint within its limits.
"""

import csv
import math
import pathlib
import sys
import time

import PyKDL as kdl


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
        solvers = {
            "LMA": kdl.ChainIkSolverPos_LMA(chain),
            "NR_JL": kdl.ChainIkSolverPos_NR_JL(
                chain, low, high, forward, kdl.ChainIkSolverVel_pinv(chain), 1000, 1e-9
            ),
        }
        for name, solver in solvers.items():
            found, times = 0, []
            for place in places:
                target, answer = frame(place), kdl.JntArray(len(joints))
                begin = time.perf_counter()
                solver.CartToJnt(array(start), target, answer)
                times.append(1e6 * (time.perf_counter() - begin))
                there = kdl.Frame()
                forward.JntToCart(answer, there)
                off = kdl.diff(there, target)
                near = off.vel.Norm() < 1e-6 and off.rot.Norm() < 1e-6
                turned = [math.isfinite(answer[i]) and low[i] <= answer[i] <= high[i] for i in range(len(joints))]
                found += near and all(turned)
            times.sort()
            print(
                f"{file.stem}: KDL {name}: {found} of {len(places)} found from the same start; "
                f"median {times[len(times) // 2]:.1f} us, 99 % {times[len(times) * 99 // 100]:.1f} us"
            )


if __name__ == "__main__":
    main()
