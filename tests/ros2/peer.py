"""The robot of `robot.py` on Eclipse Cyclone DDS, with ROS 2's names, types and actions as rmw_cyclonedds_cpp has them.

    python tests/ros2/peer.py --domain 7        (packages: tests/ros2/requirements.txt)
"""

import time

from cyclonedds.core import InstanceState, Policy, Qos, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

import messages as ros
from robot import PERIOD_S, Robot, options, say

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
LATCHED = Qos(
    Policy.Reliability.Reliable(duration(milliseconds=100)),
    Policy.Durability.TransientLocal,
    Policy.History.KeepLast(1),
)
LATE_S = 3.0


class Server:
    """An action server, request by request."""

    def __init__(self, net, name, kind, judge, start, cancel):
        self.kind = ros.ACTIONS[kind]
        self.judge, self.start, self.cancel = judge, start, cancel
        self.waiting, self.done, self.late = {}, {}, []
        action = f"{name}/_action"
        net.read(f"rq{action}/send_goalRequest", self.kind.SendGoalRequest, self.goal)
        net.read(f"rq{action}/cancel_goalRequest", ros.CancelRequest, self.cancelled)
        net.read(f"rq{action}/get_resultRequest", self.kind.ResultRequest, self.result)
        self.goal_reply = net.write(f"rr{action}/send_goalReply", self.kind.SendGoalReply, RELIABLE)
        self.cancel_reply = net.write(f"rr{action}/cancel_goalReply", ros.CancelReply, RELIABLE)
        self.result_reply = net.write(f"rr{action}/get_resultReply", self.kind.ResultReply, RELIABLE)
        self.feedback_writer = net.write(f"rt{action}/feedback", self.kind.FeedbackMessage, RELIABLE)
        net.servers.append(self)

    def goal(self, now, message):
        goal_id = bytes(message.goal_id).hex()
        verdict = self.judge(now, message.goal)
        if verdict == "late":
            self.late.append((now + LATE_S, message))
        elif verdict == "reject":
            self.goal_reply.write(self.kind.SendGoalReply(message.request, False, ros.Time()))
        elif verdict != "silent":
            self.goal_reply.write(self.kind.SendGoalReply(message.request, True, ros.Time()))
            self.start(now, goal_id, message.goal)

    def tick(self, now):
        for due, message in [late for late in self.late if now >= late[0]]:
            self.late.remove((due, message))
            self.goal_reply.write(self.kind.SendGoalReply(message.request, True, ros.Time()))
            say(event="accepted late", t=now)
            self.start(now, bytes(message.goal_id).hex(), message.goal)

    def cancelled(self, now, message):
        running = self.cancel(now, bytes(message.goal_info.goal_id).hex())
        canceling = [message.goal_info] if running else []
        self.cancel_reply.write(ros.CancelReply(message.request, 0 if running else 2, canceling))

    def result(self, now, message):
        goal_id = bytes(message.goal_id).hex()
        if goal_id in self.done:
            self.result_reply.write(self.kind.ResultReply(message.request, *self.done[goal_id]))
        else:
            self.waiting[goal_id] = message.request

    def feedback(self, goal_id, values):
        message = self.kind.FeedbackMessage(list(bytes.fromhex(goal_id)), self.kind.Feedback(**values))
        self.feedback_writer.write(message)

    def finish(self, goal_id, status, result):
        if goal_id is None:
            return
        self.done[goal_id] = (status, self.kind.Result(**result))
        if goal_id in self.waiting:
            self.result_reply.write(self.kind.ResultReply(self.waiting.pop(goal_id), *self.done[goal_id]))


class Net:
    """A participant of Cyclone DDS."""

    def __init__(self, options):
        self.domain = Domain(options.domain, MULTICAST if options.multicast else LOOPBACK)
        self.participant = DomainParticipant(options.domain)
        self.waitset = WaitSet(self.participant)
        self.readers, self.servers, self.matched = [], [], {}

    def read(self, name, kind, handle, qos=RELIABLE):
        reader = DataReader(self.participant, Topic(self.participant, name, kind), qos=qos)
        condition = ReadCondition(reader, SampleState.Any | ViewState.Any | InstanceState.Any)
        self.waitset.attach(condition)
        self.readers.append((name, reader, handle, condition))

    def write(self, name, kind, qos):
        return DataWriter(self.participant, Topic(self.participant, name, kind), qos=qos)

    def listen(self, name, kind, handle, latched=False):
        self.read(f"rt{name}", getattr(ros, kind), handle, LATCHED if latched else RELIABLE)

    def writer(self, name, kind, latched=False):
        return self.write(f"rt{name}", getattr(ros, kind), LATCHED if latched else RELIABLE).write

    def action(self, name, kind, judge, start, cancel):
        return Server(self, name, kind, judge, start, cancel)

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

    def take(self):
        for _, reader, handle, _ in self.readers:
            for message in reader.take(N=100):
                # Disposals are no messages.
                if message.sample_info.valid_data:
                    handle(time.time(), message)


def main():
    opts = options(__doc__)
    net = Net(opts)
    robot = Robot(opts, net, ros)
    robot.listen()
    say(event="ready", t=time.time(), middleware="cyclonedds")
    next_tick, count = time.monotonic(), 0
    while robot.obey():
        wait = max(next_tick - time.monotonic(), 0.0)
        if wait > 0.0:
            net.waitset.wait(duration(nanoseconds=int(wait * 1e9)))
        net.take()
        now = time.monotonic()
        if now >= next_tick:
            for server in net.servers:
                server.tick(time.time())
            robot.tick(count)
            count += 1
            next_tick = max(next_tick + PERIOD_S, now)
    robot.end()
    # Says goodbye: others need not wait until its lease is over.
    net.participant.__del__()


if __name__ == "__main__":
    main()
