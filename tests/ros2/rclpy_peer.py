"""The robot of `robot.py` on ROS 2's own client library: rclpy of Jazzy, with whatever middleware
`RMW_IMPLEMENTATION` names (rmw_fastrtps_cpp by default), a real ActionServer and real subscriptions.

    python tests/ros2/rclpy_peer.py --domain 7

`cargo xtask ros2` makes the environment that it needs and says how it is used.
"""

import os
import time
from types import SimpleNamespace

OPTIONS = __import__("robot").options(__doc__)
os.environ["ROS_DOMAIN_ID"] = str(OPTIONS.domain)
os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")

import builtin_interfaces.msg
import control_msgs.action
import control_msgs.msg
import diagnostic_msgs.msg
import geometry_msgs.msg
import nav_msgs.msg
import rclpy
import rosgraph_msgs.msg
import sensor_msgs.msg
import std_msgs.msg
import tf2_msgs.msg
import trajectory_msgs.msg
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy, qos_profile_system_default
from rclpy.task import Future

from controllers import CANCELED, SUCCEEDED
from robot import PERIOD_S, Robot, say

PACKAGES = [builtin_interfaces, control_msgs, diagnostic_msgs, geometry_msgs, nav_msgs, rosgraph_msgs, sensor_msgs,
            std_msgs, tf2_msgs, trajectory_msgs]
ROS = SimpleNamespace(**{
    name: kind for package in PACKAGES for name, kind in vars(package.msg).items() if isinstance(kind, type)
})
# As the controllers subscribe: what the middleware has by default.
AS_CONTROLLERS = {"Twist", "TwistStamped", "JointTrajectory"}
RELIABLE = QoSProfile(depth=50, reliability=ReliabilityPolicy.RELIABLE)
LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
LATE_S = 3.0


class Server:
    """An action server; every goal that it takes is run by the robot's own tick."""

    def __init__(self, net, name, kind, judge, start, cancel):
        self.net, self.kind = net, getattr(control_msgs.action, kind)
        self.judge, self.start, self.cancel = judge, start, cancel
        self.goals = {}
        self.server = ActionServer(net.node, self.kind, name, execute_callback=self.execute,
                                   goal_callback=self.asked, handle_accepted_callback=self.accepted,
                                   cancel_callback=self.cancelled)

    async def asked(self, goal):
        verdict = self.judge(time.time(), goal)
        if verdict == "silent":
            await Future(executor=self.net.executor)
        if verdict == "late":
            late = Future(executor=self.net.executor)
            timer = self.net.node.create_timer(LATE_S, lambda: late.set_result(None))
            await late
            self.net.node.destroy_timer(timer)
            say(event="accepted late", t=time.time())
        return GoalResponse.REJECT if verdict == "reject" else GoalResponse.ACCEPT

    def accepted(self, handle):
        goal_id = bytes(handle.goal_id.uuid).hex()
        self.goals[goal_id] = (handle, Future(executor=self.net.executor))
        self.start(time.time(), goal_id, handle.request)
        handle.execute()

    def cancelled(self, handle):
        # The controllers accept every request, and act on it where the goal is the active one.
        self.cancel(time.time(), bytes(handle.goal_id.uuid).hex())
        return CancelResponse.ACCEPT

    async def execute(self, handle):
        goal_id = bytes(handle.goal_id.uuid).hex()
        status, result = await self.goals[goal_id][1]
        {SUCCEEDED: handle.succeed, CANCELED: handle.canceled}.get(status, handle.abort)()
        del self.goals[goal_id]
        return self.kind.Result(**result)

    def feedback(self, goal_id, values):
        if goal_id in self.goals:
            self.goals[goal_id][0].publish_feedback(self.kind.Feedback(**values))

    def finish(self, goal_id, status, result):
        if goal_id in self.goals:
            self.goals[goal_id][1].set_result((status, result))


class Net:
    """A node of rclpy."""

    def __init__(self, options):
        self.node = Node("robot", namespace=options.namespace or None, enable_rosout=False)
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.node)
        self.read = []
        self.matched = {}

    def listen(self, name, kind, handle, latched=False):
        qos = LATCHED if latched else qos_profile_system_default if kind in AS_CONTROLLERS else RELIABLE
        self.node.create_subscription(getattr(ROS, kind), name, lambda message: handle(time.time(), message), qos)
        self.read.append(f"rt{name}")

    def writer(self, name, kind, latched=False):
        return self.node.create_publisher(getattr(ROS, kind), name, LATCHED if latched else RELIABLE).publish

    def action(self, name, kind, judge, start, cancel):
        self.read += [f"rq{name}/_action/{part}Request" for part in ("send_goal", "cancel_goal", "get_result")]
        return Server(self, name, kind, judge, start, cancel)

    def look(self):
        """Who writes to us, as which type, with which quality of service: what `ros2 topic info -v` shows."""
        for topic in self.read:
            infos = self.node.get_publishers_info_by_topic(topic, no_mangle=True)
            known = sorted((info.topic_type, info.node_name, str(info.topic_type_hash)) for info in infos)
            if known == self.matched.get(topic, []):
                continue
            self.matched[topic] = known
            for info in infos:
                qos = info.qos_profile
                say(event="matched", t=time.time(), topic=topic, type=info.topic_type, writers=len(infos),
                    reliable=qos.reliability == ReliabilityPolicy.RELIABLE,
                    volatile=qos.durability == DurabilityPolicy.VOLATILE, lifespan=str(qos.lifespan),
                    node=info.node_namespace.rstrip("/") + "/" + info.node_name, hash=str(info.topic_type_hash))


def main():
    rclpy.init()
    net = Net(OPTIONS)
    robot = Robot(OPTIONS, net, ROS)
    robot.listen()
    done = Future(executor=net.executor)
    count = 0

    def tick():
        nonlocal count
        if not robot.obey():
            done.set_result(None)
        robot.tick(count)
        count += 1

    net.node.create_timer(PERIOD_S, tick)
    say(event="ready", t=time.time(), middleware=rclpy.get_rmw_implementation_identifier())
    try:
        net.executor.spin_until_future_complete(done)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    robot.end()
    # Python's end would wait for what rclpy's threads still hold.
    os._exit(0)


if __name__ == "__main__":
    main()
