"""OMPL's RRTConnect beside the project's planner: the same pairs of poses, the same joint limits, the same collision check.

    cargo build --release -p host-arm --example plan-beside
    python tests/arms/beside_ompl.py target/release/examples/plan-beside [SEEDS]     (packages: tests/arms/requirements.txt)

The program plans each pair, and then serves its own collision check to OMPL over a pipe. A state is valid if nothing is nearer
than the scene's margin. OMPL searches with RRTConnect (range chosen by itself, motions checked every 0.5 % of the space, as in
MoveIt) and simplifies the path with its own PathSimplifier. The program then rounds the corners by at most 0.1 rad, as MoveIt's
TOTG does, and finds the least time on this path, with the same limits of speed and acceleration.

All times are processor times of one thread. OMPL's are made up of

* search and simplification without our part of the check: the time of the call, less the time in the check's Python function,
  less what it takes to call an empty Python function as often (measured on the same space),
* the checks: the time that the planner's program takes for the same states, all in one loop,
* the timing of the path.

So neither pipe nor Python counts for OMPL. The project's times have no binding: they are whole calls of the planner, with timing,
and with the proof that braking on rounded corners is clear too.

OMPL plans in two spaces: with the distance that MoveIt uses, where the goals are judged, and with Euclid's distance, for
comparison. Its rounded path is not checked again, as MoveIt would; the number of paths that touch something is printed.

For each pair, the program also tells the time that the slowest joint needs if it moves alone. No motion takes less time, whatever its
path. Where even these times are more than the goal's share of OMPL's, our motions must come near them instead.

Exit code 0 = all plans succeed, and no goal is missed.
"""

import json
import math
import statistics
import struct
import subprocess
import sys
import time

from ompl import base, geometric, util

COUNT = 7
SCALINGS = ["0.1/0.05", "1/1"]
# Share of the space's extent, as MoveIt sets it.
SEGMENT = 0.005
LONGEST_S = 10.0
# Goals: of the median planning time at 0.1/0.05, of the mean duration, and of the time of the best of several.
HALF, SHORTER, BEST_S = 0.5, 0.6, 0.060
# Where no motion can meet the goal for the duration: at most this many times the least time of any motion.
NEAR_LEAST = 1.05


class Planner:
    """The project's planner in its own process."""

    def __init__(self, program):
        self.process = subprocess.Popen([program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0)
        line = b""
        while not line.endswith(b"\n"):
            line += self.process.stdout.read(1) or sys.exit("the planner's program ended")
        self.scenes = json.loads(line)

    def ask(self, what, scene, values, answers):
        self.process.stdin.write(struct.pack("<9d", what, scene, *values, *[0.0] * (COUNT - len(values))))
        return self.answer(answers)

    def answer(self, answers):
        raw = b""
        while len(raw) < 8 * answers:
            raw += self.process.stdout.read(8 * answers - len(raw)) or sys.exit("the planner's program ended")
        return struct.unpack(f"<{answers}d", raw)

    def timed(self, scene, path):
        rows = b"".join(struct.pack("<7d", *row) for row in path)
        self.process.stdin.write(struct.pack("<9d", 3, scene, len(path), *[0.0] * (COUNT - 1)) + rows)
        return self.answer(5)


def interval(low, high):
    space = base.RealVectorStateSpace(len(low))
    bounds = base.RealVectorBounds(len(low))
    for i in range(len(low)):
        bounds.setLow(i, low[i])
        bounds.setHigh(i, high[i])
    space.setBounds(bounds)
    return space


class Vector:
    """All joints as one vector with Euclid's distance. Continuous joints turn as far as in our own search."""

    name = "Euclid's distance"

    def space(self, pair):
        return interval(pair["low"], pair["high"])

    def state(self, space, angles):
        state = space.allocState()
        for i in range(COUNT):
            state[i] = angles[i]
        return state

    def angles(self, state):
        return [state[i] for i in range(COUNT)]


class Sum:
    """Distance as the sum of all joints' distances, and continuous joints as circles, as MoveIt has it."""

    name = "MoveIt's distance"

    def space(self, pair):
        space = base.CompoundStateSpace()
        for low, high, turns in zip(pair["low"], pair["high"], pair["turns"]):
            space.addSubspace(base.SO2StateSpace() if turns else interval([low], [high]), 1.0)
        self.turns = pair["turns"]
        return space

    def state(self, space, angles):
        state = space.allocState()
        for i in range(COUNT):
            if self.turns[i]:
                state[i].value = math.remainder(angles[i], math.tau)
            else:
                state[i][0] = angles[i]
        return state

    def angles(self, state):
        return [state[i].value if self.turns[i] else state[i][0] for i in range(COUNT)]


def unwound(rows, first):
    """The path's angles without jumps of a whole turn."""
    found, last = [], first
    for row in rows:
        last = [was + math.remainder(now - was, math.tau) if abs(now - was) > math.pi else now for now, was in zip(row, last)]
        found.append(last)
    return found


def space_of(kind, pair):
    space = kind.space(pair)
    space.setLongestValidSegmentFraction(SEGMENT)
    return space


def empty_call_s(kind, pair):
    """What one call of an empty check costs, from OMPL into Python and back."""
    space = space_of(kind, pair)
    information = base.SpaceInformation(space)
    inside, calls = 0.0, 0

    def check(_state):
        nonlocal inside, calls
        begin = time.thread_time()
        calls += 1
        inside += time.thread_time() - begin
        return True

    information.setStateValidityChecker(check)
    information.setup()
    ends = [kind.state(space, pair["from"]), kind.state(space, pair["to"])]
    begin = time.thread_time()
    for _ in range(100):
        information.checkMotion(*ends)
    return (time.thread_time() - begin - inside) / calls


def plan(planner, kind, scene, pair, empty_s):
    """Time in s of search, simplification and checks, number of checks, and the path; None if there is none."""
    setup = geometric.SimpleSetup(space_of(kind, pair))
    space = setup.getStateSpace()
    inside = 0.0

    def check(state):
        nonlocal inside
        begin = time.thread_time()
        clear = planner.ask(0, scene, kind.angles(state), 1)[0] > 0.0
        inside += time.thread_time() - begin
        return clear

    setup.setStateValidityChecker(check)
    setup.setStartAndGoalStates(kind.state(space, pair["from"]), kind.state(space, pair["to"]))
    setup.setPlanner(geometric.RRTConnect(setup.getSpaceInformation()))
    setup.setup()
    begin = time.thread_time()
    setup.solve(LONGEST_S)
    searched = time.thread_time() - begin - inside
    search_checks, search_check_s = planner.ask(2, scene, [], 2)
    if not setup.haveExactSolutionPath():
        return None
    inside, begin = 0.0, time.thread_time()
    setup.simplifySolution()
    simplified = time.thread_time() - begin - inside
    checks, check_s = planner.ask(2, scene, [], 2)
    path = setup.getSolutionPath()
    rows = unwound([kind.angles(state) for state in path.getStates()], pair["from"])
    return {
        "search_s": searched - empty_s * search_checks + search_check_s,
        "simplify_s": simplified - empty_s * checks + check_s,
        "checks": search_checks + checks,
        "path": rows,
    }


def ms(values):
    values = sorted(values)
    return f"{1e3 * statistics.median(values):.1f} / {1e3 * values[len(values) * 95 // 100]:.1f}"


def main():
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    seeds = int(sys.argv[2]) if len(sys.argv) > 2 else 5
    util.RNG.setSeed(1)
    util.setLogLevel(util.LogLevel.LOG_ERROR)
    planner = Planner(sys.argv[1])
    missed = 0

    def goal(met, text):
        nonlocal missed
        missed += not met
        print(f"  {'met   ' if met else 'MISSED'} {text}")

    for scene, told in enumerate(planner.scenes):
        kinds = [Sum(), Vector()]
        empty_s = [empty_call_s(kind, told["pairs"][0]) for kind in kinds]
        ours, theirs, tried = [], [[] for _ in kinds], 0
        for number, pair in enumerate(told["pairs"]):
            for seed in range(seeds):
                tried += 1
                # In turn, so that what else the machine does meets all.
                ours.append(planner.ask(1, scene, [number, seed], 12))
                for k, kind in enumerate(kinds):
                    found = plan(planner, kind, scene, pair, empty_s[k])
                    if found:
                        theirs[k].append((found, planner.timed(scene, found["path"])))
        good = sum(all(row[0::3]) for row in ours)
        print(f"{told['name']}: {tried} plans each")
        goal(good == tried, f"ours: {good} of {tried} planned")
        goal(all(len(found) == tried for found in theirs), f"OMPL: {[len(found) for found in theirs]} of {tried} planned")
        for j, scaling in enumerate(SCALINGS):
            single, best = [row[6 * j + 1] for row in ours], [row[6 * j + 4] for row in ours]
            motion, best_motion = [row[6 * j + 2] for row in ours], [row[6 * j + 5] for row in ours]
            print(
                f"  ours, {scaling}: ms median / 95 %: {ms(single)}, best of several {ms(best)} (most {1e3 * max(best):.1f}); "
                f"motion s, mean {statistics.mean(motion):.2f}, best of several {statistics.mean(best_motion):.2f}"
            )
            goal(
                statistics.median(best) <= BEST_S,
                f"{scaling}: the best of several in {1e3 * statistics.median(best):.1f} ms (60), most {1e3 * max(best):.1f}",
            )
        for k, kind in enumerate(kinds):
            search, simplify = [f["search_s"] for f, _ in theirs[k]], [f["simplify_s"] for f, _ in theirs[k]]
            nearest = [t[4] for _, t in theirs[k]]
            print(
                f"  OMPL with {kind.name}: {len(theirs[k])} of {tried} planned, ms median / 95 %: search {ms(search)}, simplification "
                f"{ms(simplify)}; {statistics.mean(f['checks'] for f, _ in theirs[k]):.0f} checks; of {1e6 * empty_s[k]:.2f} us each "
                f"for the binding, nothing counts\n"
                f"    on the rounded path {sum(near < 0 for near in nearest)} touch something, "
                f"{sum(near < told['margin_m'] / 2 for near in nearest)} come within half of the margin; nearest {1e3 * min(nearest):.1f} mm"
            )
            for j, scaling in enumerate(SCALINGS):
                single, motion = [row[6 * j + 1] for row in ours], [row[6 * j + 2] for row in ours]
                best_motion = [row[6 * j + 5] for row in ours]
                times = [f["search_s"] + f["simplify_s"] + t[2 * j] for f, t in theirs[k]]
                their_motion = statistics.mean(t[2 * j + 1] for _, t in theirs[k])
                print(
                    f"    {scaling}: ms median / 95 %: {ms(times)}, of which timing {ms([t[2 * j] for _, t in theirs[k]])}; motion s, mean "
                    f"{their_motion:.2f}; a single one of ours {statistics.mean(motion) / their_motion:.2f} of it"
                )
                quick = statistics.median(single) / statistics.median(times)
                short = statistics.mean(best_motion) / their_motion
                if k > 0:
                    print(f"           a single plan takes {quick:.2f} of OMPL's median, the best of several moves {short:.2f} of its time")
                    continue
                if j == 0:
                    goal(quick <= HALF, f"{scaling}: a single plan of ours takes {quick:.2f} of OMPL's median ({HALF})")
                text = f"{scaling}: motions of the best of several take {short:.2f} of OMPL's ({SHORTER})"
                least = statistics.mean(pair["least_s"][j] for pair in told["pairs"])
                bound = least / their_motion
                if bound <= SHORTER:
                    goal(short <= SHORTER, f"{text}; the least of any motion is {bound:.2f}")
                else:
                    goal(
                        statistics.mean(best_motion) <= NEAR_LEAST * least,
                        f"{text}: no motion can, the least of any is {bound:.2f}; ours take {statistics.mean(best_motion) / least:.3f} "
                        f"of the least ({NEAR_LEAST})",
                    )
    sys.exit(1 if missed else 0)


if __name__ == "__main__":
    main()
