"""The arm's angles as a person gets to see them, one JSON object per line: live from the page's and Foxglove's sockets
with the time at which they arrive, or from a session's file with the time at which they were written down.

    python tests/ros2/shown.py http://127.0.0.1:8042/ ws://127.0.0.1:8765/     until its input ends
    python tests/ros2/shown.py SESSION.mcap

Packages: tests/foxglove/requirements.txt.
"""

import asyncio
import json
import sys
import threading
import time

import mcap.reader
import mcap.records
import mcap_ros2.decoder
import websockets.asyncio.client

TOPIC = "/joint_states"
ARM = [f"joint_{i}" for i in range(1, 8)]


def say(event, t, angles):
    sys.stdout.write(json.dumps({"event": event, "t": t, "position": angles}) + "\n")
    sys.stdout.flush()


def arm_of(message):
    """The arm's angles in a JointState that may hold more."""
    angles = dict(zip(message.name, message.position))
    return [angles[name] for name in ARM] if all(name in angles for name in ARM) else None


async def page(url):
    place = url.split("://", 1)[1].split("/", 1)[0]
    async with websockets.asyncio.client.connect(f"ws://{place}/live", origin=f"http://{place}") as socket:
        async for frame in socket:
            t, message = time.time(), json.loads(frame)
            if "frame" not in message:
                continue
            angles = message["state"]["arm"]["joints_rad"][:7]
            # NaN, which stands for unknown, becomes null in JSON.
            if None not in angles:
                say("page", t, angles)
            # As the page says it once a frame is drawn; the next one waits for it.
            await socket.send("took")


async def foxglove(url):
    async with websockets.asyncio.client.connect(url, subprotocols=["foxglove.sdk.v1"]) as socket:
        json.loads(await socket.recv())
        channels = json.loads(await socket.recv())["channels"]
        channel = next(channel for channel in channels if channel["topic"] == TOPIC)
        schema = mcap.records.Schema(1, channel["schema"].encode(), channel["schemaEncoding"], channel["schemaName"])
        decode = mcap_ros2.decoder.DecoderFactory().decoder_for(channel["encoding"], schema)
        wish = {"id": 1, "channelId": channel["id"]}
        await socket.send(json.dumps({"op": "subscribe", "subscriptions": [wish]}))
        async for frame in socket:
            t = time.time()
            if isinstance(frame, bytes):
                # Behind one byte of kind, four of subscription and eight of time.
                angles = arm_of(decode(frame[13:]))
                if angles:
                    say("foxglove", t, angles)


def read(path):
    with open(path, "rb") as stream:
        reader = mcap.reader.make_reader(stream, decoder_factories=[mcap_ros2.decoder.DecoderFactory()])
        for _, _, message, decoded in reader.iter_decoded_messages(topics=[TOPIC]):
            angles = arm_of(decoded)
            if angles:
                say("file", message.log_time * 1e-9, angles)


async def until_told(*work):
    told = asyncio.Event()
    loop = asyncio.get_running_loop()
    threading.Thread(target=lambda: (sys.stdin.read(), loop.call_soon_threadsafe(told.set)), daemon=True).start()
    tasks = [asyncio.create_task(some) for some in work]
    ended = asyncio.create_task(told.wait())
    done, _ = await asyncio.wait([ended, *tasks], return_when=asyncio.FIRST_COMPLETED)
    for task in done:
        if task is not ended and task.exception():
            raise task.exception()
    for task in tasks:
        task.cancel()


if __name__ == "__main__":
    if len(sys.argv) == 2:
        read(sys.argv[1])
    else:
        asyncio.run(until_told(page(sys.argv[1]), foxglove(sys.argv[2])))
