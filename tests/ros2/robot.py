"""A robot on the graph, told apart from the middleware that carries it: a base, an arm, perhaps a gripper, and a log of
everything that arrives and moves, one JSON object per line on standard output.

`peer.py` puts it on Eclipse Cyclone DDS, `rclpy_peer.py` on ROS 2's own client library and Fast DDS. What it does with
what it is told is in `controllers.py`. A line on standard input is an order: `joints on|off`,
`arm accept|reject|silent|late`, `pace FACTOR`, `flag TOPIC on|off` (a latched std_msgs/Bool), `thing TOPIC FRAME X Y Z AGE`
(a PoseStamped at 20 Hz, measured so many s ago; `thing off` ends it), `quit`.
"""

import argparse
import json
import math
import random
import sys
import threading
import time
import xml.etree.ElementTree

from controllers import Arm, Base, Gripper, Point, Trajectory

JOINTS = [f"joint_{i}" for i in range(1, 8)]
HOME = [0.0, 0.26, 3.14, -2.27, 0.0, 0.96, 1.57]
# ros2_kortex reports these within one turn.
WITHOUT_END = [JOINTS[place] for place in (0, 2, 4, 6)]
PERIOD_S = 0.01
# Slower than this counts as standing still, in rad/s.
RESTING = 1e-3
SIMULATION_STARTS_S = 10.0


def say(**line):
    sys.stdout.write(json.dumps(line) + "\n")
    sys.stdout.flush()


def seconds(time_or_duration):
    return time_or_duration.sec + time_or_duration.nanosec * 1e-9


def split(value):
    """Whole seconds and nanoseconds."""
    nanoseconds = round(value * 1e9)
    return {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9}


def plain(message):
    """A JointTrajectory without its middleware."""
    points = [
        Point(seconds(p.time_from_start), p.positions, p.velocities, p.accelerations, p.effort) for p in message.points
    ]
    return Trajectory(seconds(message.header.stamp), message.joint_names, points)


def options(description):
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--domain", type=int, default=0)
    parser.add_argument("--namespace", default="", help="such as /cell1")
    parser.add_argument("--unstamped", action="store_true", help="takes Twist, not TwistStamped")
    parser.add_argument("--base-only", action="store_true", help="no arm, no diagnostics")
    parser.add_argument("--robot", action="store_true", help="publishes joint states, has an arm")
    parser.add_argument("--action", action="store_true", help="the arm takes goals, too")
    parser.add_argument("--inactive", action="store_true", help="the arm's controller is there, but not active")
    parser.add_argument("--demanding", action="store_true", help="wants speeds from before it came (transient local)")
    parser.add_argument("--gripper", choices=["parallel", "command"], help="has a gripper behind this kind of action")
    parser.add_argument("--blocked", type=float, help="an object stops the gripper at this position in m")
    parser.add_argument("--odom", action="store_true", help="publishes odometry at 50 Hz")
    parser.add_argument("--sim", action="store_true", help="reads what --publish-sim publishes")
    parser.add_argument("--pace", type=float, default=20.0, help="how much faster the arm is than it should be")
    parser.add_argument("--lag", type=float, default=0.0, help="the joints follow late, as a filter of so many s")
    parser.add_argument("--following-error", type=float, default=0.0, help="rad by which moving joints are short")
    parser.add_argument("--start-offset", type=float, default=0.0, help="rad by which every joint starts off home")
    parser.add_argument("--joints", default=",".join(JOINTS), help="the arm's joints, as its controller has them")
    parser.add_argument("--start", help="where they begin (default: the Gen3's home)")
    parser.add_argument("--arm-controller", default="joint_trajectory_controller")
    parser.add_argument("--description", help="publishes this URDF as robot_state_publisher does")
    parser.add_argument("--say-angles", action="store_true", help="a line per joint state that it sends")
    parser.add_argument("--noise", type=float, default=0.0, help="rad of noise on the reported angles (deviation)")
    parser.add_argument("--wrap", action="store_true", help="joints 1, 3, 5 and 7 are reported within one turn")
    parser.add_argument("--sim-time", action="store_true", help="its clock begins at 10 s and is published on /clock")
    parser.add_argument("--clock-offset", type=float, default=0.0, help="its clock is so many s ahead of this machine's")
    parser.add_argument("--states-late", type=float, default=0.0, help="joint states are stamped so many s late")
    parser.add_argument("--multicast", action="store_true", help="finds others by multicast on loopback")
    parser.add_argument("--quiet", action="store_true", help="no line per speed")
    parser.add_argument("--zenoh", metavar="FILE", help="zenoh_peer.py: Zenoh's configuration")
    parser.add_argument("--labelled", action="store_true", help="zenoh_peer.py: names what it attaches, as Jazzy does")
    parser.add_argument("--seconds", type=float, default=600.0)
    return parser.parse_args()


class Robot:
    """`net` carries it: `listen(name, kind, handle, latched=False)`, `writer(name, kind, latched=False)`, which returns what sends a
    message, and `action(name, kind, judge, start, cancel)`, which returns a server with `feedback` and `finish`.
    `ros` has the messages' classes. Handlers get the wall clock and the message."""

    def __init__(self, opts, net, ros):
        self.opts, self.net, self.ros = opts, net, ros
        self.started = time.monotonic()
        self.orders = []
        self.flags = {}
        self.things, self.thing = {}, None
        self.mode = "accept"
        self.joints = opts.robot
        self.random = random.Random(1)
        self.base = Base()
        self.base_said = self.base.speed
        start = [float(angle) for angle in opts.start.split(",")] if opts.start else HOME
        start = [angle + opts.start_offset for angle in start]
        self.arm = Arm(opts.joints.split(","), start, opts.pace, opts.lag, opts.following_error, WITHOUT_END if opts.wrap else ())
        self.arm_moved = False
        space = opts.namespace
        self.clock = net.writer("/clock", "Clock") if opts.sim_time else None
        net.listen(f"{space}/cmd_vel", "Twist" if opts.unstamped else "TwistStamped", self.speed,
                   opts.demanding)
        net.listen(f"{space}/bimanual/stopped", "Bool", self.stopped, True)
        self.operator_stop = None
        self.states = self.follow = self.controller_state = self.gripper_action = self.odom = None
        if not opts.base_only:
            net.listen("/diagnostics", "DiagnosticArray", self.diagnostics)
        if opts.sim:
            net.listen(f"{space}/odom", "Odometry", self.odometry)
            net.listen("/tf", "TFMessage", self.transforms)
            net.listen(f"{space}/joint_states", "JointState", self.joint_states)
            net.listen(f"{space}/robot_description", "String", self.description, True)
        if opts.odom:
            self.odom = net.writer(f"{space}/odom", "Odometry")
        if opts.robot:
            name = f"{space}/{opts.arm_controller}"
            self.states = net.writer(f"{space}/joint_states", "JointState")
            self.controller_state = net.writer(f"{name}/controller_state", "JointTrajectoryControllerState")
            net.listen(f"{name}/joint_trajectory", "JointTrajectory", self.trajectory)
            if opts.action:
                self.follow = net.action(f"{name}/follow_joint_trajectory", "FollowJointTrajectory", self.judge,
                                         self.goal, self.cancel)
        if opts.description:
            with open(opts.description, encoding="utf-8") as file:
                text = file.read()
            self.describe = net.writer(f"{space}/robot_description", "String", latched=True)
            self.describe(ros.String(data=text))
        if opts.gripper:
            self.gripper = Gripper(blocked_m=opts.blocked)
            kind = "ParallelGripperCommand" if opts.gripper == "parallel" else "GripperCommand"
            self.gripper_action = net.action(f"{space}/gripper_controller/gripper_cmd", kind, self.judge_grip,
                                             self.grip, self.gripper_cancel)

    def now(self):
        """The robot's own clock."""
        if self.opts.sim_time:
            return SIMULATION_STARTS_S + time.monotonic() - self.started
        return time.time() + self.opts.clock_offset

    # What arrives.

    def stopped(self, now, message):
        if message.data != self.operator_stop:
            self.operator_stop = message.data
            say(event="operator stop", t=now, data=message.data)

    def speed(self, now, message):
        stamp, frame, twist = 0.0, "", message
        if not self.opts.unstamped:
            stamp, frame, twist = seconds(message.header.stamp), message.header.frame_id, message.twist
        became = self.base.take(self.now(), stamp, twist.linear.x, twist.angular.z)
        if not self.opts.quiet or became == "acted on an older one":
            rest = [twist.linear.y, twist.linear.z, twist.angular.x, twist.angular.y]
            say(event="speed", t=now, stamp=stamp, frame=frame, linear=twist.linear.x, angular=twist.angular.z,
                rest=rest, became=became)

    def diagnostics(self, now, message):
        level = lambda value: value[0] if isinstance(value, bytes) else value
        status = {
            s.name: {"level": level(s.level), "message": s.message, "hardware": s.hardware_id,
                     **{v.key: v.value for v in s.values}}
            for s in message.status
        }
        say(event="diagnostics", t=now, stamp=seconds(message.header.stamp), status=status)

    def odometry(self, now, m):
        p, q, v = m.pose.pose.position, m.pose.pose.orientation, m.twist.twist
        say(event="odom", t=now, stamp=seconds(m.header.stamp), frame=m.header.frame_id, child=m.child_frame_id,
            position=[p.x, p.y, p.z], orientation=[q.x, q.y, q.z, q.w], linear=v.linear.x, angular=v.angular.z,
            covariance=[m.pose.covariance[i] for i in (0, 7, 35)],
            speed_covariance=[m.twist.covariance[i] for i in (0, 35)])

    def description(self, now, message):
        robot = xml.etree.ElementTree.fromstring(message.data)
        say(event="description", t=now, links=[link.get("name") for link in robot.iter("link")],
            joints=[joint.get("name") for joint in robot.iter("joint")])

    def transforms(self, now, message):
        for m in message.transforms:
            p, q = m.transform.translation, m.transform.rotation
            say(event="tf", t=now, stamp=seconds(m.header.stamp), frame=m.header.frame_id, child=m.child_frame_id,
                position=[p.x, p.y, p.z], orientation=[q.x, q.y, q.z, q.w])

    def joint_states(self, now, m):
        say(event="joint_states", t=now, stamp=seconds(m.header.stamp), name=list(m.name), position=list(m.position),
            velocity=list(m.velocity))

    def say_trajectory(self, event, now, message, **more):
        points = [[p.at_s, p.positions, p.velocities] for p in message.points]
        say(event=event, t=now, robot=self.now(), stamp=message.stamp, joints=message.names, points=points, **more)

    def trajectory(self, now, message):
        message = plain(message)
        why = self.arm.refusal(message, self.now())
        self.say_trajectory("trajectory", now, message, refused=why)
        if why is None:
            self.arm.follow(message)

    def judge(self, now, goal):
        """`accept`, `reject`, `silent` or `late`, and a line for what will not become a goal at once."""
        trajectory = plain(goal.trajectory)
        why = self.arm.refusal(trajectory, self.now())
        verdict = "reject" if why or self.opts.inactive else self.mode
        if verdict != "accept":
            self.say_trajectory("goal", now, trajectory, id="", mode=verdict, refused=why)
        return verdict

    def goal(self, now, goal_id, goal):
        self.say_trajectory("goal", now, plain(goal.trajectory), id=goal_id, mode="accept", refused=None)
        self.arm.accept(goal_id, plain(goal.trajectory))

    def cancel(self, now, goal_id):
        running = self.arm.cancel(goal_id)
        say(event="cancel", t=now, id=goal_id, running=running)
        return running

    def judge_grip(self, now, goal):
        wanted = self.wanted(goal)
        say(event="grip", t=now, position=wanted)
        return "reject" if wanted is None else self.mode

    def wanted(self, goal):
        """The position that a goal asks for; None where it does not name exactly one."""
        position = goal.command.position
        if self.opts.gripper == "command":
            return position
        return position[0] if len(position) == 1 else None

    def grip(self, now, goal_id, goal):
        self.gripper.accept(goal_id, self.wanted(goal), self.now())

    def gripper_cancel(self, now, goal_id):
        running = self.gripper.cancel(goal_id)
        say(event="grip cancel", t=now, id=goal_id, running=running)
        return running

    # What goes out.

    def tick(self, count):
        """One period of the controllers."""
        wall, now, ros = time.time(), self.now(), self.ros
        if self.clock is not None:
            self.clock(ros.Clock(clock=ros.Time(**split(now))))
        if self.base.update(now, PERIOD_S):
            say(event="stopped", t=wall)
        if self.base.speed != self.base_said:
            self.base_said = self.base.speed
            say(event="base", t=wall, linear=self.base.speed[0], angular=self.base.speed[1])
        if self.states is not None:
            self.move_arm(wall, now, count)
        if self.gripper_action is not None:
            self.move_gripper(wall, now)
        if self.odom is not None and count % 2 == 0:
            self.odom(self.odometry_message(now))
        if self.thing is not None and count % 5 == 0:
            self.tell_thing(now)
        if count % 25 == 0:
            self.net.look()

    def tell_thing(self, now):
        topic, frame, x, y, z, age_s = self.thing
        if topic not in self.things:
            self.things[topic] = self.net.writer(topic, "PoseStamped")
        ros = self.ros
        header = ros.Header(stamp=ros.Time(**split(now - float(age_s))), frame_id=frame)
        pose = ros.Pose(position=ros.Point(x=float(x), y=float(y), z=float(z)),
                        orientation=ros.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0))
        self.things[topic](ros.PoseStamped(header=header, pose=pose))

    def header(self, now):
        return self.ros.Header(stamp=self.ros.Time(**split(now)), frame_id="")

    def move_arm(self, wall, now, count):
        ros, arm = self.ros, self.arm
        arm.update(now, PERIOD_S)
        moves = any(abs(v) > RESTING for v in arm.velocity)
        if moves != self.arm_moved:
            self.arm_moved = moves
            say(event="arm", t=wall, moves=moves, position=arm.position)
        for goal_id, status, code, text in arm.finished:
            say(event="finished", t=wall, id=goal_id, status=status, text=text)
            self.follow.finish(goal_id, status, {"error_code": code, "error_string": text})
        arm.finished.clear()
        if self.joints:
            angles = [p + self.random.gauss(0.0, self.opts.noise) for p in arm.reported()]
            self.states(ros.JointState(header=self.header(now - self.opts.states_late), name=arm.names, position=angles,
                                       velocity=arm.velocity, effort=[]))
            if self.opts.say_angles:
                say(event="angles", t=wall, position=angles)
        if count % 2 == 0 and not self.opts.inactive:
            self.controller_state(self.state_message(now))
        if count % 10 == 0 and arm.goal is not None:
            desired, actual, error = self.three_points()
            self.follow.feedback(arm.goal, {"header": self.header(now), "joint_names": arm.names, "desired": desired,
                                            "actual": actual, "error": error})

    def point(self, positions, velocities, at_s=0.0):
        return self.ros.JointTrajectoryPoint(
            positions=list(positions), velocities=list(velocities), accelerations=[], effort=[],
            time_from_start=self.ros.Duration(**split(max(at_s, 0.0))))

    def three_points(self):
        """Where the arm should be, where it is, and the difference."""
        arm = self.arm
        differences = [a - b for a, b in zip(arm.desired.positions, arm.position)]
        return (self.point(arm.desired.positions, arm.desired.velocities, arm.desired.at_s),
                self.point(arm.position, arm.velocity, arm.desired.at_s),
                self.point(differences, [a - b for a, b in zip(arm.desired.velocities, arm.velocity)]))

    def state_message(self, now):
        ros = self.ros
        desired, actual, error = self.three_points()
        none = lambda: ros.MultiDOFJointTrajectoryPoint(transforms=[], velocities=[], accelerations=[],
                                                        time_from_start=ros.Duration(**split(0.0)))
        return ros.JointTrajectoryControllerState(
            header=self.header(now), joint_names=self.arm.names, reference=desired, feedback=actual, error=error,
            output=self.point(self.arm.command, []), multi_dof_joint_names=[], multi_dof_reference=none(),
            multi_dof_feedback=none(), multi_dof_error=none(), multi_dof_output=none(), speed_scaling_factor=1.0)

    def move_gripper(self, wall, now):
        self.gripper.update(now, PERIOD_S)
        for goal_id, status, stalled, reached in self.gripper.finished:
            say(event="gripped", t=wall, id=goal_id, status=status, stalled=stalled, reached=reached,
                position=self.gripper.position)
            result = {"stalled": stalled, "reached_goal": reached}
            if self.opts.gripper == "parallel":
                result["state"] = self.ros.JointState(header=self.header(now), name=["finger_joint"],
                                                      position=[self.gripper.position], velocity=[], effort=[])
            else:
                result |= {"position": self.gripper.position, "effort": 0.0}
            self.gripper_action.finish(goal_id, status, result)
        self.gripper.finished.clear()

    def odometry_message(self, now):
        ros = self.ros
        x, y, heading = self.base.pose
        covariance = [0.0] * 36
        pose = ros.Pose(position=ros.Point(x=x, y=y, z=0.0),
                        orientation=ros.Quaternion(x=0.0, y=0.0, z=math.sin(heading / 2), w=math.cos(heading / 2)))
        speed = ros.Twist(linear=ros.Vector3(x=float(self.base.speed[0]), y=0.0, z=0.0),
                          angular=ros.Vector3(x=0.0, y=0.0, z=float(self.base.speed[1])))
        header = ros.Header(stamp=ros.Time(**split(now)), frame_id="odom")
        return ros.Odometry(header=header, child_frame_id="base_link",
                            pose=ros.PoseWithCovariance(pose=pose, covariance=covariance),
                            twist=ros.TwistWithCovariance(twist=speed, covariance=covariance))

    # Orders.

    def obey(self):
        """Carries out what was typed; false when it is over."""
        while self.orders:
            match self.orders.pop(0).split():
                case ["joints", word]:
                    self.joints = word == "on"
                case ["arm", mode]:
                    self.mode = mode
                case ["pace", factor]:
                    self.arm.pace = float(factor)
                case ["flag", topic, word]:
                    if topic not in self.flags:
                        self.flags[topic] = self.net.writer(topic, "Bool", latched=True)
                    self.flags[topic](self.ros.Bool(data=word == "on"))
                case ["thing", "off"]:
                    self.thing = None
                case ["thing", *thing]:
                    self.thing = thing
                case ["quit"] | []:
                    return False
        return time.monotonic() - self.started < self.opts.seconds

    def listen(self):
        def read():
            for line in sys.stdin:
                self.orders.append(line.strip() or "nothing")
            self.orders.append("quit")

        threading.Thread(target=read, daemon=True).start()

    def end(self):
        base = self.base
        say(event="end", t=time.time(), received=base.received, dropped=base.dropped, stops=base.stops,
            oldest_ms=base.oldest_s * 1000.0)
