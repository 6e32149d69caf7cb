"""Holds the table of type hashes in host-bridge/crates/ros2/src/hashes.rs against the packages of ROS 2 Jazzy.

    target/ros2-jazzy/python tests/ros2/hashes.py        (the environment: `cargo xtask ros2`)
"""

import json
import os
import re
import sys
from pathlib import Path

TABLE = Path(__file__).parents[2] / "host-bridge/crates/ros2/src/hashes.rs"


def main():
    known = {}
    for prefix in os.environ["AMENT_PREFIX_PATH"].split(":"):
        for file in Path(prefix, "share").glob("*/*/*.json"):
            told = json.loads(file.read_text())
            for entry in told.get("type_hashes", []) if isinstance(told, dict) else []:
                known[entry["type_name"]] = entry["hash_string"]
    ours = re.findall(r'"(\w+/\w+/\w+)",\s*"(RIHS01_[0-9a-f]{64})"', TABLE.read_text())
    wrong = [(name, told, known.get(name)) for name, told in ours if told != known.get(name)]
    for name, told, right in wrong:
        print(f"{name}: {told}, in Jazzy {right}")
    print(f"{len(ours)} type hashes, {len(wrong)} wrong")
    sys.exit(1 if wrong or len(ours) < 20 else 0)


if __name__ == "__main__":
    main()
