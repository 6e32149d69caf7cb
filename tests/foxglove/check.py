"""Looks on at a live session with packages that are not ours, as Foxglove does.

    python tests/foxglove/check.py target/debug     (packages: tests/foxglove/requirements.txt)

The demo is played by the program itself; messages are decoded by the types that it advertises (mcap-ros2-support),
and compared, value for value, with what the example `state-at` says about the same moments. Exit code 0 = everything
holds.
"""

import asyncio
import json
import pathlib
import struct
import subprocess
import sys

import mcap.records
import mcap_ros2.decoder
import websockets
import websockets.asyncio.client

# The demo up to this second, at the pace of the wall clock: by then base and arm have moved. No faster, because a busy
# machine must not let the decoding here fall behind.
UNTIL_S, SPEED = 9.0, 1
WANTED = ["/joint_states", "/odom", "/tf", "/cmd_vel", "/hands/state", "/events", "/rosout", "/hands/right/imu"]

failures = []


def check(what, holds, got=""):
    print(f"{'ok    ' if holds else 'FAILED'} {what} {got}", flush=True)
    if not holds:
        failures.append(what)


async def refused(url, **how):
    try:
        async with websockets.asyncio.client.connect(url, **how):
            return None
    except websockets.exceptions.InvalidStatus as error:
        return error.response.status_code


async def look_on(url):
    """Channels by number; decoded messages by topic, each with its time in ms since the first word's origin."""
    connect = websockets.asyncio.client.connect(url, subprotocols=["foxglove.sdk.v1"], origin="https://app.foxglove.dev")
    async with connect as socket:
        check("the newer protocol is chosen", socket.subprotocol == "foxglove.sdk.v1", socket.subprotocol)
        info = json.loads(await socket.recv())
        check("first the server's own words", info["op"] == "serverInfo" and info["capabilities"] == [], info["name"])
        advertised = json.loads(await socket.recv())
        channels = {channel["id"]: channel for channel in advertised["channels"]}
        check("then the channels", advertised["op"] == "advertise" and len(channels) >= 20, len(channels))
        by_topic = {channel["topic"]: channel for channel in channels.values()}

        factory, decoders, topics = mcap_ros2.decoder.DecoderFactory(), {}, {}
        for number, channel in channels.items():
            schema = mcap.records.Schema(number, channel["schema"].encode(), channel["schemaEncoding"], channel["schemaName"])
            decoder = factory.decoder_for(channel["encoding"], schema)
            check(f"a type that can be read: {channel['topic']}", decoder is not None, channel["schemaName"])
            decoders[channel["topic"]] = decoder
        wishes = [{"id": 100 + k, "channelId": by_topic[topic]["id"]} for k, topic in enumerate(WANTED)]
        topics = {100 + k: topic for k, topic in enumerate(WANTED)}
        await socket.send(json.dumps({"op": "subscribe", "subscriptions": wishes}))

        origin, messages = int(info["sessionId"]), {topic: [] for topic in WANTED}
        time_ms = 0.0
        while time_ms < UNTIL_S * 1000:
            frame = await asyncio.wait_for(socket.recv(), 120)
            if isinstance(frame, str):
                check("no complaint", False, frame)
                continue
            kind, subscription, time_ns = struct.unpack_from("<BIQ", frame)
            topic = topics[subscription]
            time_ms = (time_ns - origin) / 1e6
            messages[topic].append((time_ms, decoders[topic](frame[13:])))
            if kind != 1 or (time_ns - origin) % 1_000_000:
                check("data, at whole milliseconds", False, (kind, time_ns))
        return origin, messages


def compare(folder, origin, messages):
    times = sorted({int(time) for topic in ("/joint_states", "/odom", "/tf") for time, _ in messages[topic]})
    output = subprocess.run([folder / "examples/state-at"], input="\n".join(map(str, times)), text=True,
                            capture_output=True, check=True).stdout
    truth = {line["state"]["time_ms"]: line for line in map(json.loads, output.splitlines())}
    check("the simulator knows every moment", sorted(truth) == times, f"{len(times)} from {times[0]} to {times[-1]} ms")

    def stamped(time, message):
        return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == origin + int(time) * 10**6

    joints = messages["/joint_states"]
    same = [list(m.position) == truth[t]["state"]["arm"]["joints_rad"][:7] + truth[t]["state"]["wheels_rad"]
            and list(m.velocity) == truth[t]["state"]["arm"]["velocity_rad_s"][:7] + truth[t]["state"]["wheels_rad_s"]
            for t, m in joints]
    check("joints and wheels are the simulator's, to the bit", all(same), len(same))
    ends = zip(joints[0][1].position, joints[-1][1].position)
    moved = [abs(a - b) for a, b in ends]
    check("and they moved", max(moved[:7]) > 0.05 and max(moved[7:]) > 1, f"arm {max(moved[:7]):.2f}, wheels {max(moved[7:]):.2f} rad")
    places = [(m.pose.pose.position.x, m.pose.pose.position.y, m.twist.twist.linear.x)
              == (truth[t]["state"]["odometry"]["x_m"], truth[t]["state"]["odometry"]["y_m"],
                  truth[t]["state"]["odometry"]["twist"]["linear_m_s"]) for t, m in messages["/odom"]]
    check("so is the odometry", all(places), len(places))
    flange = [max(abs(a - b) for a, b in zip((v.x, v.y, v.z), truth[t]["state"]["flange"]["position_m"]))
              for t, m in messages["/tf"] for v in [m.transforms[-1].transform.translation]]
    check("and the flange's frame", max(flange) < 1e-12, f"{max(flange):.1e} m in {len(flange)}")
    check("stamps are times of day", all(stamped(t, m) for topic in ("/joint_states", "/odom") for t, m in messages[topic]))

    steps = {int(b[0]) - int(a[0]) for a, b in zip(joints, joints[1:])}
    check("joints at 100 Hz without a gap", steps <= {9, 10}, steps)
    steps = {int(b[0]) - int(a[0]) for a, b in zip(messages["/odom"], messages["/odom"][1:])}
    check("odometry at 50 Hz without a gap", steps <= {19, 20}, steps)
    events = [json.loads(m.json) for _, m in messages["/events"]]
    check("events as they happen", len(events) > 3 and len(messages["/rosout"]) >= len(events), len(events))
    check("the right hand's samples", len(messages["/hands/right/imu"]) > 500, len(messages["/hands/right/imu"]))
    check("the hands' states", len(messages["/hands/state"][0][1].scores) in (0, 8), len(messages["/hands/state"]))


async def main():
    folder = pathlib.Path(sys.argv[1]).resolve()
    program = subprocess.Popen(
        [folder / "host-bridge", "demo", "--headless", "--speed", str(SPEED), "--foxglove=0"],
        stdout=subprocess.PIPE, text=True)
    try:
        url = next(line.split(" ", 1)[1].strip() for line in program.stdout if line.startswith("foxglove: "))
        check("on this machine only", url.startswith("ws://127.0.0.1:"), url)
        v1 = ["foxglove.websocket.v1"]
        evil = await refused(url, subprotocols=v1, origin="http://evil.example")
        check("another site's page is refused", evil == 403, evil)
        check("another protocol is refused", await refused(url, subprotocols=["mqtt"]) == 400)
        check("the older protocol will do", await refused(url, subprotocols=v1) is None)
        compare(folder, *await look_on(url))
    finally:
        program.kill()
        program.wait()
    if failures:
        sys.exit(f"{len(failures)} checks failed: {', '.join(failures)}")


asyncio.run(main())
