"""A robot as ROS 2 sees it, on Eclipse Cyclone DDS: a base that takes speeds as diff_drive_controller does,
an arm behind a joint_trajectory_controller, and a log of everything that arrives, one JSON object per line.

    python tests/ros2/peer.py --domain 7        (packages: tests/ros2/requirements.txt)

`--help` tells what can be left out. A line on standard input is an order: `joints on`, `joints off`,
`arm accept|reject|silent|late`, `quit`.
"""

import argparse
import json
import sys
import threading
import time

from cyclonedds.core import InstanceState, Policy, Qos, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

import messages as ros

JOINTS = [f"joint_{i}" for i in range(1, 8)]
HOME = [0.0, 0.26, 3.14, -2.27, 0.0, 0.96, 1.57]
# diff_drive_controller: an older stamp is dropped; silence for so long stops the base.
COMMAND_TIMEOUT_S = 0.5

# Loopback without multicast: peers are asked one by one. As docs/ros2.md says for networks with losses:
# announced every 2 s and kept for 60. By default one lost announcement in 8 s loses the whole participant.
LOOPBACK = """<CycloneDDS><Domain id="any"><General><Interfaces>
<NetworkInterface name="lo" multicast="false"/></Interfaces><AllowMulticast>false</AllowMulticast></General>
<Discovery><LeaseDuration>60s</LeaseDuration><SPDPInterval>2s</SPDPInterval>
<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>60</MaxAutoParticipantIndex>
<Peers><Peer Address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>"""

# As on a site's network, where multicast works on the interface.
MULTICAST = """<CycloneDDS><Domain id="any"><General><Interfaces>
<NetworkInterface name="lo" multicast="true"/></Interfaces><AllowMulticast>true</AllowMulticast></General>
<Discovery><ParticipantIndex>none</ParticipantIndex></Discovery></Domain></CycloneDDS>"""

RELIABLE = Qos(
    Policy.Reliability.Reliable(duration(milliseconds=100)),
    Policy.Durability.Volatile,
    Policy.History.KeepLast(50),
)

def say(**line):
    sys.stdout.write(json.dumps(line) + "\n")
    sys.stdout.flush()


class Base:
    """Takes speeds as diff_drive_controller does."""

    def __init__(self):
        self.speed = (0.0, 0.0)
        self.acted_stamp = 0.0
        self.acted_at = None
        self.received = self.dropped = self.stops = 0
        self.oldest_s = 0.0

    def take(self, now, stamp, linear, angular):
        """What becomes of a command: `acted`, or `dropped` for its age."""
        self.received += 1
        age = now - stamp if stamp else 0.0
        if age > COMMAND_TIMEOUT_S:
            self.dropped += 1
            return "dropped"
        self.oldest_s = max(self.oldest_s, age)
        older = stamp and stamp < self.acted_stamp
        self.acted_stamp, self.acted_at, self.speed = stamp, now, (linear, angular)
        return "acted on an older one" if older else "acted"

    def tick(self, now):
        """Stops after silence; true when it just did."""
        if self.acted_at is not None and now - self.acted_at > COMMAND_TIMEOUT_S and self.speed != (0.0, 0.0):
            self.speed = (0.0, 0.0)
            self.stops += 1
            return True
        return False


class Arm:
    """Follows one trajectory at a time, `pace` times faster than it says."""

    def __init__(self, pace):
        self.pace = pace
        self.position = list(HOME)
        self.run = None
        self.mode = "accept"

    def start(self, goal_id, trajectory, now):
        self.run = {"id": goal_id, "trajectory": trajectory, "since": now, "from": list(self.position)}

    def elapsed(self, now):
        return (now - self.run["since"]) * self.pace

    def tick(self, now):
        """Moves; true when the last point was reached."""
        if self.run is None:
            return False
        elapsed = self.elapsed(now)
        before_s, before = 0.0, self.run["from"]
        for point in self.run["trajectory"].points:
            at_s = point.time_from_start.seconds()
            if elapsed < at_s:
                share = (elapsed - before_s) / (at_s - before_s)
                self.position = [a + share * (b - a) for a, b in zip(before, point.positions)]
                return False
            before_s, before = at_s, point.positions
        self.position = list(before)
        return True


class Peer:
    def __init__(self, options):
        self.options = options
        self.space = options.namespace
        self.domain = Domain(options.domain, MULTICAST if options.multicast else LOOPBACK)
        self.participant = DomainParticipant(options.domain)
        self.waitset = WaitSet(self.participant)
        self.orders = []
        self.readers = []
        self.matched = {}
        self.base = Base()
        self.arm = Arm(options.pace)
        self.joints = options.robot
        self.results = {}
        self.done = {}
        self.late = []
        self.read(f"rt{self.space}/cmd_vel", ros.Twist if options.unstamped else ros.TwistStamped, RELIABLE, self.speed)
        if not options.base_only:
            self.read("rt/diagnostics", ros.DiagnosticArray, RELIABLE, self.diagnostics)
        if options.sim:
            self.read(f"rt{self.space}/odom", ros.Odometry, RELIABLE, self.odometry)
            self.read("rt/tf", ros.TFMessage, RELIABLE, self.transforms)
            self.read(f"rt{self.space}/joint_states", ros.JointState, RELIABLE, self.joint_states)
        self.states = None
        if options.robot:
            self.states = self.write(f"rt{self.space}/joint_states", ros.JointState, RELIABLE)
            self.controller()

    def topic(self, name, kind):
        return Topic(self.participant, name, kind)

    def read(self, name, kind, qos, handle):
        reader = DataReader(self.participant, self.topic(name, kind), qos=qos)
        condition = ReadCondition(reader, SampleState.Any | ViewState.Any | InstanceState.Any)
        self.waitset.attach(condition)
        self.readers.append((name, reader, handle, condition))

    def write(self, name, kind, qos):
        return DataWriter(self.participant, self.topic(name, kind), qos=qos)

    def controller(self):
        name = f"{self.space}/joint_trajectory_controller"
        action = f"{name}/follow_joint_trajectory/_action"
        self.read(f"rt{name}/joint_trajectory", ros.JointTrajectory, RELIABLE, self.trajectory)
        if not self.options.action:
            return
        self.read(f"rq{action}/send_goalRequest", ros.SendGoalRequest, RELIABLE, self.goal)
        self.read(f"rq{action}/cancel_goalRequest", ros.CancelRequest, RELIABLE, self.cancel)
        self.read(f"rq{action}/get_resultRequest", ros.ResultRequest, RELIABLE, self.result)
        self.goal_reply = self.write(f"rr{action}/send_goalReply", ros.SendGoalReply, RELIABLE)
        self.cancel_reply = self.write(f"rr{action}/cancel_goalReply", ros.CancelReply, RELIABLE)
        self.result_reply = self.write(f"rr{action}/get_resultReply", ros.ResultReply, RELIABLE)
        self.feedback = self.write(f"rt{action}/feedback", ros.FeedbackMessage, RELIABLE)

    # What arrives.

    def speed(self, now, message):
        stamp, frame, twist = 0.0, "", message
        if not self.options.unstamped:
            stamp, frame, twist = message.header.stamp.seconds(), message.header.frame_id, message.twist
        became = self.base.take(now, stamp, twist.linear.x, twist.angular.z)
        if not self.options.quiet or became == "acted on an older one":
            rest = [twist.linear.y, twist.linear.z, twist.angular.x, twist.angular.y]
            say(event="speed", t=now, stamp=stamp, frame=frame, linear=twist.linear.x, angular=twist.angular.z,
                rest=rest, became=became)

    def diagnostics(self, now, message):
        status = {
            s.name: {"level": s.level, "message": s.message, "hardware": s.hardware_id,
                     **{v.key: v.value for v in s.values}}
            for s in message.status
        }
        say(event="diagnostics", t=now, stamp=message.header.stamp.seconds(), status=status)

    def odometry(self, now, m):
        p, q, v = m.pose.pose.position, m.pose.pose.orientation, m.twist.twist
        say(event="odom", t=now, stamp=m.header.stamp.seconds(), frame=m.header.frame_id, child=m.child_frame_id,
            position=[p.x, p.y, p.z], orientation=[q.x, q.y, q.z, q.w], linear=v.linear.x, angular=v.angular.z,
            covariance=[m.pose.covariance[i] for i in (0, 7, 35)])

    def transforms(self, now, message):
        for m in message.transforms:
            p, q = m.transform.translation, m.transform.rotation
            say(event="tf", t=now, stamp=m.header.stamp.seconds(), frame=m.header.frame_id, child=m.child_frame_id,
                position=[p.x, p.y, p.z], orientation=[q.x, q.y, q.z, q.w])

    def joint_states(self, now, m):
        say(event="joint_states", t=now, stamp=m.header.stamp.seconds(), name=list(m.name),
            position=list(m.position), velocity=list(m.velocity))

    def points(self, trajectory):
        return [[p.time_from_start.seconds(), list(p.positions), list(p.velocities)] for p in trajectory.points]

    def trajectory(self, now, message):
        say(event="trajectory", t=now, stamp=message.header.stamp.seconds(), joints=list(message.joint_names),
            points=self.points(message))
        self.arm.start(None, message, now)

    def goal(self, now, message):
        goal_id = tuple(message.goal_id)
        trajectory = message.goal.trajectory
        say(event="goal", t=now, id=bytes(goal_id).hex(), joints=list(trajectory.joint_names),
            stamp=trajectory.header.stamp.seconds(), points=self.points(trajectory), mode=self.arm.mode)
        if self.arm.mode == "silent":
            return
        accepted = self.arm.mode != "reject"
        reply = ros.SendGoalReply(message.request, accepted, ros.Time.of(now))
        if self.arm.mode == "late":
            self.late.append((now + 3.0, reply, goal_id, trajectory))
            return
        self.goal_reply.write(reply)
        if accepted:
            self.arm.start(goal_id, trajectory, now)

    def cancel(self, now, message):
        goal_id = tuple(message.goal_info.goal_id)
        running = self.arm.run is not None and self.arm.run["id"] == goal_id
        say(event="cancel", t=now, id=bytes(goal_id).hex(), running=running)
        canceling = [message.goal_info] if running else []
        self.cancel_reply.write(ros.CancelReply(message.request, 0 if running else 2, canceling))
        if running:
            self.finish(now, 5)

    def result(self, now, message):
        goal_id = tuple(message.goal_id)
        if goal_id in self.done:
            self.reply(message.request, self.done[goal_id])
        else:
            self.results[goal_id] = message.request

    def reply(self, request, status):
        self.result_reply.write(ros.ResultReply(request, status, ros.FollowResult(0, "")))

    def finish(self, now, status):
        goal_id = self.arm.run["id"]
        self.arm.run = None
        if goal_id is None:
            return
        say(event="finished", t=now, id=bytes(goal_id).hex(), status=status)
        self.done[goal_id] = status
        if goal_id in self.results:
            self.reply(self.results.pop(goal_id), status)

    # What goes out.

    def tick(self, now, count):
        if self.base.tick(now):
            say(event="stopped", t=now)
        if self.arm.tick(now):
            self.finish(now, 4)
        for late in [late for late in self.late if now >= late[0]]:
            self.late.remove(late)
            self.goal_reply.write(late[1])
            self.arm.start(late[2], late[3], now)
            say(event="accepted late", t=now)
        if self.joints and self.states is not None:
            header = ros.Header(ros.Time.of(now), "")
            self.states.write(ros.JointState(header, JOINTS, self.arm.position, [0.0] * 7, []))
        if count % 10 == 0 and self.arm.run is not None and self.arm.run["id"] is not None:
            self.send_feedback(now)
        if count % 25 == 0:
            self.look()

    def send_feedback(self, now):
        elapsed = self.arm.elapsed(now)
        at = ros.Duration(int(elapsed), int((elapsed - int(elapsed)) * 1e9))
        point = ros.JointTrajectoryPoint(self.arm.position, [0.0] * 7, [], [], at)
        empty = ros.MultiDOFJointTrajectoryPoint([], [], [], ros.Duration())
        feedback = ros.FollowFeedback(
            ros.Header(ros.Time.of(now), ""), JOINTS, point, point, point, [], empty, empty, empty
        )
        self.feedback.write(ros.FeedbackMessage(list(self.arm.run["id"]), feedback))

    def look(self):
        """Who writes to us, as which type, with which quality of service."""
        for name, reader, _, _ in self.readers:
            handles = reader.get_matched_publications()
            if len(handles) == self.matched.get(name, 0):
                continue
            self.matched[name] = len(handles)
            for handle in handles:
                data = reader.get_matched_publication_data(handle)
                if data is None:
                    self.matched[name] = -1
                    continue
                qos = {type(policy).__qualname__: str(policy) for policy in data.qos}
                say(event="matched", t=time.time(), topic=name, type=data.type_name, writers=len(handles),
                    reliable=any("Reliable" in key for key in qos),
                    volatile=any("Volatile" in key for key in qos),
                    lifespan=qos.get("Policy.Lifespan", ""))

    def obey(self):
        while self.orders:
            order = self.orders.pop(0)
            match order.split():
                case ["joints", word]:
                    self.joints = word == "on"
                case ["arm", mode]:
                    self.arm.mode = mode
                case ["quit"] | []:
                    return False
        return True

    def run(self):
        threading.Thread(target=self.listen, daemon=True).start()
        say(event="ready", t=time.time())
        period = 0.01
        started = time.time()
        next_tick, count = started, 0
        while self.obey() and time.time() - started < self.options.seconds:
            wait = max(next_tick - time.time(), 0.0)
            if wait > 0.0:
                self.waitset.wait(duration(nanoseconds=int(wait * 1e9)))
            now = time.time()
            for _, reader, handle, _ in self.readers:
                for message in reader.take(N=100):
                    # Disposals are no messages.
                    if message.sample_info.valid_data:
                        handle(time.time(), message)
            if now >= next_tick:
                self.tick(now, count)
                count += 1
                next_tick = max(next_tick + period, now)
        base = self.base
        say(event="end", t=time.time(), received=base.received, dropped=base.dropped, stops=base.stops,
            oldest_ms=base.oldest_s * 1000.0)

    def listen(self):
        for line in sys.stdin:
            self.orders.append(line.strip() or "nothing")
        self.orders.append("quit")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--domain", type=int, default=0)
    parser.add_argument("--namespace", default="", help="such as /cell1")
    parser.add_argument("--unstamped", action="store_true", help="takes Twist, not TwistStamped")
    parser.add_argument("--base-only", action="store_true", help="no arm, no diagnostics")
    parser.add_argument("--robot", action="store_true", help="publishes joint states, has an arm")
    parser.add_argument("--action", action="store_true", help="the arm takes goals, too")
    parser.add_argument("--sim", action="store_true", help="reads what --publish-sim publishes")
    parser.add_argument("--pace", type=float, default=20.0, help="how much faster the arm is than it should be")
    parser.add_argument("--multicast", action="store_true", help="finds others by multicast on loopback")
    parser.add_argument("--quiet", action="store_true", help="no line per speed")
    parser.add_argument("--seconds", type=float, default=600.0)
    Peer(parser.parse_args()).run()


if __name__ == "__main__":
    main()
