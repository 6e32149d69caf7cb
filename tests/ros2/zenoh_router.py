"""Zenoh's router, with a configuration file of its own (docs/zenoh/router.json5), until standard input ends.

    python tests/ros2/zenoh_router.py router.json5
"""

import json
import sys

import zenoh

with zenoh.open(zenoh.Config.from_file(sys.argv[1])) as session:
    print(json.dumps({"event": "ready", "router": str(session.zid())}), flush=True)
    sys.stdin.read()
