"""Reads sessions on disk back with packages that are not ours, and compares them with the program's summary.

    host-bridge demo --headless --speed 0 --json --record DEMO.mcap > DEMO.json
    python tests/mcap/check.py DEMO.mcap DEMO.json     (packages: tests/mcap/requirements.txt)

A third argument names a file that a killed program left: it must be read as far as it goes. Exit code 0 =
everything holds.
"""

import collections
import json
import math
import pathlib
import sys

import mcap.reader
import mcap_ros2.decoder
import rosbags.highlevel
import rosbags.interfaces
import rosbags.typesys

TYPES = {
    "/bridge/left/received": "bimanual_msgs/msg/Bytes",
    "/bridge/left/sent": "bimanual_msgs/msg/Bytes",
    "/bridge/right/received": "bimanual_msgs/msg/Bytes",
    "/bridge/right/sent": "bimanual_msgs/msg/Bytes",
    "/bridge/turns": "bimanual_msgs/msg/Turns",
    "/cmd_vel": "geometry_msgs/msg/TwistStamped",
    "/events": "bimanual_msgs/msg/Event",
    "/hands/left/sample": "bimanual_msgs/msg/LeftSample",
    "/hands/right/imu": "sensor_msgs/msg/Imu",
    "/hands/right/mag": "sensor_msgs/msg/MagneticField",
    "/hands/right/sample": "bimanual_msgs/msg/RightSample",
    "/hands/state": "bimanual_msgs/msg/Hands",
    "/intents": "bimanual_msgs/msg/Intent",
    "/joint_states": "sensor_msgs/msg/JointState",
    "/odom": "nav_msgs/msg/Odometry",
    "/rosout": "rcl_interfaces/msg/Log",
    "/stops": "bimanual_msgs/msg/Stop",
    "/tf": "tf2_msgs/msg/TFMessage",
}

failures = []


def check(what, holds, got=""):
    print(f"{'ok    ' if holds else 'FAILED'} {what} {got}")
    if not holds:
        failures.append(what)


def read_with_mcap(path):
    """Messages by topic, decoded by the schemas in the file; the types; the header's profile."""
    messages, types = collections.defaultdict(list), {}
    with path.open("rb") as stream:
        reader = mcap.reader.make_reader(stream, decoder_factories=[mcap_ros2.decoder.DecoderFactory()])
        profile = reader.get_header().profile
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            types[channel.topic] = schema.name
            messages[channel.topic].append((message.log_time, decoded))
    return messages, types, profile


def read_with_rosbags(path):
    """The same, and with the types as rosbags knows them where it does."""
    messages, types = collections.defaultdict(list), {}
    store = rosbags.typesys.get_typestore(rosbags.typesys.Stores.ROS2_JAZZY)
    with rosbags.highlevel.AnyReader([path], default_typestore=store) as reader:
        for connection, time, raw in reader.messages():
            types[connection.topic] = connection.msgtype
            messages[connection.topic].append((time, reader.deserialize(raw, connection.msgtype)))
    return messages, types


def stamp_of(message):
    stamp = message.header.stamp
    seconds = stamp.sec if hasattr(stamp, "sec") else 0
    return seconds * 1_000_000_000 + (stamp.nanosec if hasattr(stamp, "nanosec") else 0)


def check_values(name, messages, summary):
    """What the messages say against the program's summary."""
    events = [json.loads(m.json) for _, m in messages["/events"]]
    check(f"{name}: all events, in order, with all values", events == summary["events"], len(events))
    gestures = [(m.name, m.outcome) for _, m in messages["/intents"] if m.hand == "right"]
    outcome = lambda o: o if isinstance(o, str) else json.dumps(o, separators=(",", ":"))
    expected = [(g["label"], outcome(g["outcome"])) for g in summary["gestures"]]
    check(f"{name}: the gestures and what followed", gestures == expected, len(gestures))
    halts = [m.reason for _, m in messages["/stops"] if m.halted]
    reasons = [outcome(h["reason"]) for h in summary["halts"]]
    check(f"{name}: the halts and their reasons", halts == reasons, halts)
    # At least as many log lines as events: the ends of recordings are told there, too.
    check(f"{name}: a line of log per event", len(messages["/rosout"]) >= len(events), len(messages["/rosout"]))

    seconds = summary["seconds"]
    for topic, hz in [("/joint_states", 100), ("/odom", 50), ("/tf", 50), ("/cmd_vel", 50), ("/hands/state", 20)]:
        count, due = len(messages[topic]), seconds * hz
        check(f"{name}: {topic} at {hz} Hz", abs(count - due) <= 2, f"{count} in {seconds} s")

    last = messages["/odom"][-1][1]
    wanted = summary["odometry"]
    place = (last.pose.pose.position.x, last.pose.pose.position.y)
    check(f"{name}: the base ends where it should, to the bit", place == (wanted["x_m"], wanted["y_m"]), place)
    heading = 2 * math.atan2(last.pose.pose.orientation.z, last.pose.pose.orientation.w)
    off = abs(math.remainder(heading - wanted["heading_rad"], 2 * math.pi))
    check(f"{name}: and looks where it should", off < 1e-12, off)
    path = sum(
        math.dist((a.pose.pose.position.x, a.pose.pose.position.y), (b.pose.pose.position.x, b.pose.pose.position.y))
        for (_, a), (_, b) in zip(messages["/odom"], messages["/odom"][1:])
    )
    check(f"{name}: its way by the file", abs(path - wanted["path_m"]) < 0.002, f"{path:.4f} of {wanted['path_m']:.4f} m")

    joints = messages["/joint_states"]
    check(f"{name}: seven joints and two wheels", len(joints[0][1].name) == 9, list(joints[0][1].name))
    # Positions must follow from velocities: 100 Hz, trapezoids.
    off = max(
        abs(b.position[k] - a.position[k] - 0.005 * (a.velocity[k] + b.velocity[k]))
        for (_, a), (_, b) in zip(joints, joints[1:])
        for k in range(9)
    )
    check(f"{name}: joints move as fast as they say", off < 1e-3, f"{off:.2e} rad")

    frames = [t.child_frame_id for t in messages["/tf"][0][1].transforms]
    check(f"{name}: frames", frames[:3] == ["base_link", "arm_base_link", "arm_shoulder_link"] and frames[-1] == "arm_end_effector_link", frames)
    q = [
        t.transform.rotation
        for _, m in messages["/tf"]
        for t in m.transforms
    ]
    off = max(abs(r.x * r.x + r.y * r.y + r.z * r.z + r.w * r.w - 1) for r in q)
    check(f"{name}: rotations are rotations", off < 1e-12, off)

    raw, imu = messages["/hands/right/sample"], messages["/hands/right/imu"]
    check(f"{name}: as many raw samples as converted ones", len(raw) == len(imu) > 0, len(raw))
    off = max(
        max(
            abs(a.values[0] - b.linear_acceleration.x),
            abs(math.radians(a.values[4]) - b.angular_velocity.y),
        )
        for (_, a), (_, b) in zip(raw, imu)
    )
    check(f"{name}: in m/s2 and rad/s", off < 1e-9, off)
    check(
        f"{name}: the left hand's counts have 10 bits",
        all(0 <= c < 1024 for _, m in messages["/hands/left/sample"] for c in m.counts),
    )
    for topic in ["/joint_states", "/odom", "/cmd_vel", "/hands/right/imu"]:
        check(f"{name}: {topic}: stamps are log times", all(t == stamp_of(m) for t, m in messages[topic]))


def check_session(path, summary):
    ours, types, profile = read_with_mcap(path)
    check("profile", profile == "ros2", profile)
    check("mcap: topics and types", {t: k for t, k in types.items() if t != "/bridge/operated"} == TYPES)
    check_values("mcap", ours, summary)
    theirs, their_types = read_with_rosbags(path)
    check("rosbags: topics and types", their_types == types)
    counts = lambda messages: {topic: len(m) for topic, m in messages.items()}
    check("rosbags: as many messages on every topic", counts(theirs) == counts(ours), sum(counts(ours).values()))
    check_values("rosbags", theirs, summary)
    raw = lambda messages, topic: b"".join(bytes(m.data) for _, m in messages[topic])
    for hand in ["left", "right"]:
        bytes_of = raw(ours, f"/bridge/{hand}/received")
        check(f"{hand}: the same bytes in both", bytes_of == raw(theirs, f"/bridge/{hand}/received"), len(bytes_of))
        # Frames end in a zero; a hand that begins with one ends the noise of a line that was just opened.
        frames = bytes_of.count(0) - (bytes_of[:1] == b"\0")
        told = summary["frames"][hand]["frames"]
        check(f"{hand}: frames", frames == told, f"{frames} of {told}")


def check_left_behind(path):
    ours, _, _ = read_with_mcap(path)
    count = sum(len(m) for m in ours.values())
    theirs, _ = read_with_rosbags(path)
    check("killed: rosbags reads as much as mcap", count == sum(len(m) for m in theirs.values()) > 0, count)
    times = [t for t, _ in ours["/joint_states"]]
    # The first one is at 1 ms, all others at full tens.
    steps = {b - a for a, b in zip(times[1:], times[2:])}
    check("killed: no gap up to its end", steps == {10_000_000}, f"{(times[-1] - times[0]) / 1e9:.2f} s")


def main():
    check_session(pathlib.Path(sys.argv[1]), json.loads(pathlib.Path(sys.argv[2]).read_text()))
    if len(sys.argv) > 3:
        check_left_behind(pathlib.Path(sys.argv[3]))
    if failures:
        sys.exit(f"{len(failures)} checks failed: {', '.join(failures)}")


main()
