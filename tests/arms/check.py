"""Looks at planned ways of real arms with an independent engine: Pinocchio's kinematics and Coal's convex hulls of the
makers' own meshes, as they stand in the packages `example-robot-data` and `hello-robot-stretch-urdf`.

    python tests/arms/check.py ARM-WAYS-PROGRAM OUT-FOLDER PAIRS [NAME ...]   (packages: tests/arms/requirements.txt)

Links that are neighbours, and those that touch however the arm is bent, are not held apart, as in MoveIt's set-up; nor are
the tubes of a telescope.
What moves beside the arm (fingers, a head) is not counted on either side. An arm of which no way is planned says why below its
line. Exit code 0 = nothing touches, and ten arms (or all that were named) plan.
"""

import json
import pathlib
import subprocess
import sys

import coal
import numpy as np
import pinocchio as pin

ROBOTS = "example-robot-data/robots"
SHARE = next(iter(p for p in pathlib.Path(sys.prefix).rglob("share/example-robot-data")), None)
STRETCH = next(iter(p for p in pathlib.Path(sys.prefix).rglob("stretch_urdf/SE3")), None)

# Of these, the makers' own hulls are nearer to each other than the planner's usual 10 mm, on every way from one side to the
# other: 4.7 mm between forearm and second wrist of a UR5. Ways with a smaller margin are asked for, in mm.
MARGINS_MM = {"ur3": 3, "ur5": 3, "ur10": 3, "tiago": 3, "stretch": 3}

# Of 30 pairs, so many ways are found. The other arms find all.
LEAST = {"ur3": 25}

# Name: file, root, tip.
ARMS = {
    "panda": (f"{ROBOTS}/panda_description/urdf/panda.urdf", "panda_link0", "panda_hand"),
    "ur3": (f"{ROBOTS}/ur_description/urdf/ur3_robot.urdf", "base_link", "tool0"),
    "ur5": (f"{ROBOTS}/ur_description/urdf/ur5_robot.urdf", "base_link", "tool0"),
    "ur10": (f"{ROBOTS}/ur_description/urdf/ur10_robot.urdf", "base_link", "tool0"),
    "xarm7": (f"{ROBOTS}/xarm_description/urdf/xarm7.urdf", "link_base", "link7"),
    "so100": (f"{ROBOTS}/so_arm_description/urdf/so100.urdf", "-", "-"),
    "so101": (f"{ROBOTS}/so_arm_description/urdf/so101.urdf", "base_link", "gripper_link"),
    "tiago": (f"{ROBOTS}/tiago_description/robots/tiago.urdf", "-", "arm_tool_link"),
    "j2s6s200": (f"{ROBOTS}/kinova_description/robots/kinova.urdf", "j2s6s200_link_base", "j2s6s200_end_effector"),
    "z1": (f"{ROBOTS}/z1_description/urdf/z1.urdf", "-", "-"),
    "pr2": (f"{ROBOTS}/pr2_description/urdf/pr2.urdf", "torso_lift_link", "r_gripper_palm_link"),
    "baxter": (f"{ROBOTS}/baxter_description/urdf/baxter.urdf", "torso", "left_hand_link"),
    "talos": (f"{ROBOTS}/talos_data/robots/talos_left_arm.urdf", "-", "wrist_left_ft_tool_link"),
    "stretch": ("stretch_description_SE3_eoa_wrist_dw3_tool_nil.urdf", "base_link", "link_wrist_roll"),
}


def transform(pose):
    return coal.Transform3s(pose.rotation, pose.translation)


class Judge:
    """The arm as its own file says it is: kinematics by Pinocchio, hulls by Coal."""

    def __init__(self, ways):
        self.model = pin.buildModelFromUrdf(ways["urdf"])
        self.data = self.model.createData()
        folders = [ways["packages"], str(pathlib.Path(ways["urdf"]).parent)]
        geometry = pin.buildGeomFromUrdf(self.model, ways["urdf"], pin.GeometryType.COLLISION, package_dirs=folders)
        self.joints = [self.model.getJointId(name) for name in ways["joints"]]
        root = self.model.frames[self.model.getFrameId(ways["root"])].parentJoint
        # Number of the arm's link -> its shapes, each where it sits on its joint.
        numbers = {joint: i + 1 for i, joint in enumerate(self.joints)} | {root: 0}
        self.shapes = []
        for object_ in geometry.geometryObjects:
            number = numbers.get(object_.parentJoint)
            if number is None:
                continue
            shape = object_.geometry
            if isinstance(shape, coal.BVHModelBase):
                shape.buildConvexHull(True, "Qt")
                shape = shape.convex
            self.shapes.append((number, object_.parentJoint, object_.placement, shape))
        self.root_frame = self.model.getFrameId(ways["root"])
        size = ways["size_m"]
        self.boxes = [(coal.Box(size, size, size), np.array(center)) for center in ways["boxes"]]
        self.request = coal.DistanceRequest()
        count = len(self.joints)
        self.pairs = [(a, b) for a in range(count + 1) for b in range(a + 2, count + 1)]
        rng = np.random.default_rng(5)
        low = [self.limits(joint)[0] for joint in self.joints]
        high = [self.limits(joint)[1] for joint in self.joints]
        always = set(self.pairs)
        for _ in range(200):
            self.place(rng.uniform(low, high))
            always = {pair for pair in always if self.apart(*pair) <= 0}
        self.always = sorted(always)
        self.pairs = [pair for pair in self.pairs if pair not in always and not self.telescope(*pair)]

    def telescope(self, a, b):
        """Tubes that slide within each other along one line."""
        between = [self.model.joints[joint].shortname() for joint in self.joints[a:b]]
        return all(kind.startswith("JointModelP") for kind in between) and len(set(between)) == 1

    def limits(self, joint):
        model = self.model.joints[joint]
        if model.nq == 2:
            return -np.pi, np.pi
        return self.model.lowerPositionLimit[model.idx_q], self.model.upperPositionLimit[model.idx_q]

    def place(self, values):
        q = pin.neutral(self.model)
        for joint, value in zip(self.joints, values):
            model = self.model.joints[joint]
            if model.nq == 2:
                q[model.idx_q : model.idx_q + 2] = np.cos(value), np.sin(value)
            else:
                q[model.idx_q] = value
        pin.framesForwardKinematics(self.model, self.data, q)
        self.now = [(number, shape, self.data.oMi[joint] * seat) for number, joint, seat, shape in self.shapes]

    def distance(self, one, at, two, there):
        result = coal.DistanceResult()
        return coal.distance(one, at, two, there, self.request, result)

    def apart(self, a, b):
        least = np.inf
        for number, shape, pose in self.now:
            if number != a:
                continue
            for other, shape_2, pose_2 in self.now:
                if other == b:
                    least = min(least, self.distance(shape, transform(pose), shape_2, transform(pose_2)))
        return least

    def nearest(self):
        """The least distance of all that is held apart, and of what."""
        least = (np.inf, None)
        for pair in self.pairs:
            least = min(least, (self.apart(*pair), pair), key=lambda found: found[0])
        frame = self.data.oMf[self.root_frame]
        for box, center in self.boxes:
            at = frame * pin.SE3(np.eye(3), center)
            for number, shape, pose in self.now:
                # The foot and the first link are not held apart from boxes that were put there by chance.
                if number >= 1:
                    gap = self.distance(shape, transform(pose), box, transform(at))
                    least = min(least, (gap, (number, "box")), key=lambda found: found[0])
        return least


def main():
    if len(sys.argv) < 4:
        sys.exit(__doc__)
    program, folder, pairs, *wanted = sys.argv[1:]
    folder = pathlib.Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    failures, judged = 0, 0
    for name, (file, root, tip) in ARMS.items():
        if wanted and name not in wanted:
            continue
        share = SHARE.parent if name != "stretch" else STRETCH
        out = folder / f"{name}.json"
        urdf = share / file
        margin = str(MARGINS_MM.get(name, 10))
        run = subprocess.run([program, out, urdf, share, root, tip, pairs, margin], capture_output=True, text=True)
        if run.returncode:
            print(f"{name}: refused: {run.stderr.strip()}")
            continue
        ways = json.loads(out.read_text())
        judge = Judge(ways)
        contacts, samples, least = 0, 0, (np.inf, None)
        for way in ways["ways"]:
            for values in way:
                judge.place(values)
                found = judge.nearest()
                samples += 1
                contacts += found[0] <= 0
                least = min(least, found, key=lambda near: near[0])
        planned = len(ways["ways"])
        holds = contacts == 0 and (pairs != "30" or planned == 0 or planned >= LEAST.get(name, 30))
        failures += not holds
        judged += holds and planned > 0
        print(
            f"{('ok    ' if planned else 'none  ') if holds else 'FAILED'} {name}: {len(ways['joints'])} joints, {planned} of {pairs} ways, "
            f"{samples} samples, {contacts} contacts, margin {margin} mm, nearest {1000 * least[0]:.1f} mm ({least[1]}); always touching: "
            f"{judge.always}"
        )
        for note in run.stdout.splitlines()[1:]:
            print(f"         {note.strip()}")
    wanted_ok = len(wanted) or 10
    print(f"{judged} arms planned without contact (wanted: {wanted_ok}), {failures} failed")
    sys.exit(1 if failures or judged < wanted_ok else 0)


if __name__ == "__main__":
    main()
