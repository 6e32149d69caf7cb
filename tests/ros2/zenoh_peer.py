"""The robot of `robot.py` on Zenoh, with names, tokens and attachments as rmw_zenoh lays them out (read from its source:
liveliness_utils.cpp, attachment_helpers.cpp, rmw_client_data.cpp, rmw_service_data.cpp). Messages are laid out by
Eclipse Cyclone's Python package; nothing here is shared with the program under test.

    python tests/ros2/zenoh_peer.py --zenoh session.json5        (packages: tests/ros2/requirements.txt)
"""

import queue
import re
import struct
import time
from pathlib import Path

import xxhash
import zenoh

import messages as ros
from robot import PERIOD_S, Robot, options, say

TABLE = Path(__file__).parents[2] / "host-bridge/crates/ros2/src/hashes.rs"
# REP-2016's hashes; tests/ros2/hashes.py holds the table against Jazzy's packages.
HASHES = dict(re.findall(r'"(\w+/\w+/\w+)",\s*"(RIHS01_[0-9a-f]{64})"', TABLE.read_text()))
LATE_S = 3.0
RELIABLE, LATCHED = "::,50:,:,:,,", ":1:,1:,:,:,,"
EXECUTING = 2
# What rmw_cyclonedds_cpp puts before requests and replies; here they go without.
HEADER = 16


def ros_type(kind):
    """`geometry_msgs/msg/Twist` of a class."""
    return kind.__idl_typename__.replace(".", "/").replace("::", "/").replace("/dds_/", "/").removesuffix("_")


def key(domain, name, type_name):
    """Where messages of a topic, or requests to a service, go."""
    package, part, plain = type_name.split("/")
    return f"{domain}/{name.strip('/')}/{package}::{part}::dds_::{plain}_/{HASHES[type_name]}"


def laid_out(message):
    return message.serialize(use_version_2=False)


class Attachment:
    """Number, time of sending in ns and 16 bytes of identity; Jazzy names them, later releases do not."""

    LABELS = [b"sequence_number", b"source_timestamp", b"source_gid"]

    def __init__(self, number, sent_ns, writer):
        self.number, self.sent_ns, self.writer = number, sent_ns, writer

    def plain(self):
        return struct.pack("<qqB", self.number, self.sent_ns, 16) + self.writer

    def labelled(self):
        values = [struct.pack("<q", self.number), struct.pack("<q", self.sent_ns), b"\x10" + self.writer]
        return b"".join(bytes([len(label)]) + label + value for label, value in zip(self.LABELS, values))

    @classmethod
    def read(cls, data):
        if len(data) == 33 and data[16] == 16:
            return cls(*struct.unpack_from("<qq", data), data[17:])
        if len(data) == 77 and data[1:16] == cls.LABELS[0]:
            return cls(struct.unpack_from("<q", data, 16)[0], struct.unpack_from("<q", data, 41)[0], data[61:])
        raise ValueError(f"no attachment: {data.hex()}")


class Token:
    """What a liveliness token says."""

    def __init__(self, text):
        admin, self.domain, self.session, _, _, self.kind, _, space, node, *end = text.split("/")
        if admin != "@ros2_lv":
            raise ValueError(text)
        plain = lambda part: part.replace("%", "/")
        self.node = plain(space).rstrip("/") + "/" + plain(node)
        self.name, self.type, self.hash, self.kept = [plain(part) for part in end[:4]] if end else ("", "", "", "")


class Server:
    """An action server: three services and two topics."""

    def __init__(self, net, name, kind, judge, start, cancel):
        self.net, self.kind = net, ros.ACTIONS[kind]
        self.judge, self.start, self.cancel = judge, start, cancel
        self.waiting, self.done, self.late = {}, {}, []
        self.states = {}
        action, types = f"{name}/_action", f"control_msgs/action/{kind}"
        net.serve(f"{action}/send_goal", f"{types}_SendGoal", self.kind.SendGoalRequest, self.goal)
        net.serve(f"{action}/get_result", f"{types}_GetResult", self.kind.ResultRequest, self.result)
        net.serve(f"{action}/cancel_goal", "action_msgs/srv/CancelGoal", ros.CancelRequest, self.cancelled)
        self.feedback_writer = net.publisher(f"{action}/feedback", f"{types}_FeedbackMessage", RELIABLE)
        self.status_writer = net.publisher(f"{action}/status", "action_msgs/msg/GoalStatusArray", LATCHED)
        net.servers.append(self)

    def accept(self, now, query, message, accepted=True):
        self.net.reply(query, self.kind.SendGoalReply(message.request, accepted, ros.Time()))
        if accepted:
            self.state(bytes(message.goal_id).hex(), EXECUTING)
            self.start(now, bytes(message.goal_id).hex(), message.goal)

    def state(self, goal_id, status):
        """Says of all goals how they are."""
        self.states[goal_id] = status
        goals = [ros.GoalStatus(ros.GoalInfo(list(bytes.fromhex(known)), ros.Time()), state)
                 for known, state in self.states.items()]
        self.status_writer(ros.GoalStatusArray(goals))

    def goal(self, now, query, message):
        self.say_age("goal arrived", now, query, message.goal_id)
        verdict = self.judge(now, message.goal)
        if verdict == "late":
            self.late.append((now + LATE_S, query, message))
        elif verdict != "silent":
            self.accept(now, query, message, verdict != "reject")

    def say_age(self, event, now, query, goal_id):
        """How long a request was on its way, by the time of sending that is attached."""
        age_s = now - Attachment.read(query.attachment.to_bytes()).sent_ns * 1e-9
        say(event=event, t=now, id=bytes(goal_id).hex(), age_ms=age_s * 1000.0)

    def tick(self, now):
        for late in [late for late in self.late if now >= late[0]]:
            self.late.remove(late)
            say(event="accepted late", t=now)
            self.accept(now, late[1], late[2])

    def cancelled(self, now, query, message):
        self.say_age("cancel arrived", now, query, message.goal_info.goal_id)
        running = self.cancel(now, bytes(message.goal_info.goal_id).hex())
        canceling = [message.goal_info] if running else []
        self.net.reply(query, ros.CancelReply(message.request, 0 if running else 2, canceling))

    def result(self, now, query, message):
        goal_id = bytes(message.goal_id).hex()
        if goal_id in self.done:
            self.net.reply(query, self.kind.ResultReply(message.request, *self.done[goal_id]))
        else:
            self.waiting[goal_id] = (query, message.request)

    def feedback(self, goal_id, values):
        message = self.kind.FeedbackMessage(list(bytes.fromhex(goal_id)), self.kind.Feedback(**values))
        self.feedback_writer(message)

    def finish(self, goal_id, status, result):
        if goal_id is None:
            return
        self.state(goal_id, status)
        self.done[goal_id] = (status, self.kind.Result(**result))
        if goal_id in self.waiting:
            query, request = self.waiting.pop(goal_id)
            self.net.reply(query, self.kind.ResultReply(request, *self.done[goal_id]))


class Net:
    """A session of Zenoh."""

    def __init__(self, options):
        self.domain, self.space = options.domain, options.namespace
        self.labelled = options.labelled
        self.session = zenoh.open(zenoh.Config.from_file(options.zenoh))
        self.zid = str(self.session.zid())
        self.came, self.kept, self.servers, self.read, self.ids = queue.Queue(), [], [], {}, 0
        self.matched, self.tokens = {}, {}
        self.say_here("NN", None, None, None)
        self.kept.append(self.session.liveliness().declare_subscriber(
            f"@ros2_lv/{self.domain}/**", lambda sample: self.came.put((self.token, sample)), history=True))

    def say_here(self, kind, name, type_name, kept):
        """Declares a token; the identity that goes with it."""
        self.ids += 1
        mangled = lambda text: text.replace("/", "%") or "%"
        token = f"@ros2_lv/{self.domain}/{self.zid}/0/{self.ids}/{kind}/%/{mangled(self.space)}/robot"
        if name is not None:
            _, _, wire, digest = key(self.domain, "x", type_name).split("/")
            token += f"/{mangled(name)}/{wire}/{digest}/{kept}"
        self.kept.append(self.session.liveliness().declare_token(token))
        number = xxhash.xxh3_128_intdigest(token.encode())
        return number.to_bytes(16, "little")

    def token(self, now, sample):
        text = str(sample.key_expr)
        if sample.kind == zenoh.SampleKind.DELETE:
            self.tokens.pop(text, None)
            return
        token = Token(text)
        if token.session != self.zid:
            self.tokens[text] = token

    def attached(self, number, writer):
        attachment = Attachment(number, time.time_ns(), writer)
        return attachment.labelled() if self.labelled else attachment.plain()

    def listen(self, name, kind, handle, latched=False):
        kind = getattr(ros, kind)
        self.say_here("MS", name, ros_type(kind), LATCHED if latched else RELIABLE)
        self.read[f"rt{name}"] = (name, ("MP",), "")

        def hear(sample):
            Attachment.read(sample.attachment.to_bytes())
            self.came.put((lambda now, _: handle(now, kind.deserialize(sample.payload.to_bytes())), sample))

        self.kept.append(self.session.declare_subscriber(key(self.domain, name, ros_type(kind)), hear))

    def publisher(self, name, type_name, kept):
        writer = self.say_here("MP", name, type_name, kept)
        where = key(self.domain, name, type_name)
        publisher = self.session.declare_publisher(where)
        last = [0, None, None]
        self.kept.append(publisher)
        if kept == LATCHED:
            # As zenoh_ext's AdvancedPublisher keeps its last word.
            def history(query):
                if last[1] is not None:
                    query.reply(where, last[1], attachment=last[2])
                query.drop()

            self.kept.append(self.session.declare_queryable(f"{where}/@adv/pub/{self.zid}/{self.ids}/_", history))

        def publish(message):
            last[0] += 1
            last[1:] = [laid_out(message), self.attached(last[0], writer)]
            publisher.put(last[1], attachment=last[2])

        return publish

    def writer(self, name, kind, latched=False):
        return self.publisher(name, ros_type(getattr(ros, kind)), LATCHED if latched else RELIABLE)

    def serve(self, name, type_name, request, handle):
        self.say_here("SS", name, type_name, RELIABLE)
        self.read[f"rq{name}Request"] = (name, ("SC",), "Request_")

        def asked(query):
            Attachment.read(query.attachment.to_bytes())
            data = query.payload.to_bytes()
            message = request.deserialize(data[:4] + bytes(HEADER) + data[4:])
            self.came.put((lambda now, _: handle(now, query, message), query))

        self.kept.append(self.session.declare_queryable(key(self.domain, name, type_name), asked, complete=True))

    def reply(self, query, message):
        asked = Attachment.read(query.attachment.to_bytes())
        data = laid_out(message)
        query.reply(query.key_expr, data[:4] + data[4 + HEADER:], attachment=self.attached(asked.number, asked.writer))
        query.drop()

    def action(self, name, kind, judge, start, cancel):
        return Server(self, name, kind, judge, start, cancel)

    def look(self):
        """Who writes to us, as which type, with which quality of service."""
        for topic, (name, kinds, suffix) in self.read.items():
            there = [token for token in self.tokens.values() if token.name == name and token.kind in kinds]
            if len(there) == self.matched.get(topic, 0):
                continue
            self.matched[topic] = len(there)
            for token in there:
                reliable, durable, *_ = token.kept.split(":")
                say(event="matched", t=time.time(), topic=topic, type=token.type + suffix, writers=len(there),
                    reliable=reliable != "2", volatile=durable != "1", lifespan="", node=token.node, hash=token.hash)

    def take(self, until):
        while True:
            try:
                handle, what = self.came.get(timeout=max(until - time.monotonic(), 0.0))
            except queue.Empty:
                return
            handle(time.time(), what)
            if time.monotonic() >= until:
                return


def main():
    opts = options(__doc__)
    net = Net(opts)
    robot = Robot(opts, net, ros)
    robot.listen()
    say(event="ready", t=time.time(), middleware="zenoh")
    next_tick, count = time.monotonic(), 0
    while robot.obey():
        net.take(next_tick)
        now = time.monotonic()
        if now >= next_tick:
            for server in net.servers:
                server.tick(time.time())
            robot.tick(count)
            count += 1
            next_tick = max(next_tick + PERIOD_S, now)
    robot.end()
    net.session.close()


if __name__ == "__main__":
    main()
