"""Reads an exported LeRobotDataset v3 with pyarrow and checks it against the format's schema.

    host-bridge export SESSION.mcap --lerobot DIR
    python tests/lerobot/check.py DIR     (packages: tests/lerobot/requirements.txt)

Exit code 0 = everything holds. With lerobot itself installed (2.8 GB), its own loader opens it:

    python -c "from lerobot.datasets.lerobot_dataset import LeRobotDataset as D; d = D('me/mine', root='DIR'); print(d, d[0])"
"""

import json
import math
import pathlib
import sys

import pyarrow as pa
import pyarrow.parquet as pq


def expect(condition, what) -> None:
    if not condition:
        sys.exit(f"wrong: {what}")


def main() -> None:
    root = pathlib.Path(sys.argv[1])
    info = json.loads((root / "meta/info.json").read_text())
    expect(info["codebase_version"] == "v3.0", "version")
    fps, features = info["fps"], info["features"]
    data = pq.read_table(root / info["data_path"].format(chunk_index=0, file_index=0))
    # Each feature is a column of its type; nothing else is.
    expect(set(data.column_names) == set(features), f"columns {data.column_names}")
    types = {"float32": pa.float32(), "int64": pa.int64()}
    for name, feature in features.items():
        kind, (width,) = types[feature["dtype"]], feature["shape"]
        column = data.schema.field(name)
        if feature["names"] is None:
            expect(width == 1 and column.type == kind, f"{name}: {column.type}")
        else:
            expect(pa.types.is_list(column.type) and column.type.value_type == kind, f"{name}: {column.type}")
            expect(len(feature["names"]) == width, f"{name}: names")
            expect(all(len(row) == width for row in data[name].to_pylist()), f"{name}: not always {width} wide")
            values = data[name].combine_chunks().flatten()
            expect(values.null_count == 0 and all(math.isfinite(v) for v in values.to_pylist()), f"{name}: values")
    expect(data.num_rows == info["total_frames"], "total_frames")
    expect(data["index"].to_pylist() == list(range(data.num_rows)), "index")

    episodes = pq.read_table(root / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    expect(len(episodes) == info["total_episodes"], "total_episodes")
    expect(info["splits"] == {"train": f"0:{len(episodes)}"}, "splits")
    tasks = pq.read_table(root / "meta/tasks.parquet")
    expect(json.loads(tasks.schema.metadata[b"pandas"])["index_columns"] == ["__index_level_0__"], "tasks' index")
    tasks = dict(zip(tasks["__index_level_0__"].to_pylist(), tasks["task_index"].to_pylist()))
    expect(len(tasks) == info["total_tasks"], "total_tasks")
    at = 0
    for number, episode in enumerate(episodes):
        expect(episode["episode_index"] == number, "episode_index")
        expect(episode["dataset_from_index"] == at, f"episode {number} begins at {at}")
        rows = data.slice(at, episode["length"])
        at += episode["length"]
        expect(episode["dataset_to_index"] == at, f"episode {number} ends at {at}")
        expect(set(rows["episode_index"].to_pylist()) == {number}, f"episode {number}: rows")
        expect(rows["frame_index"].to_pylist() == list(range(rows.num_rows)), f"episode {number}: frames")
        times = rows["timestamp"].to_pylist()
        expect(all(abs(t - n / fps) < 1e-4 for n, t in enumerate(times)), f"episode {number}: times")
        expect([tasks[task] for task in episode["tasks"]] == sorted(set(rows["task_index"].to_pylist())), "task")
        state = rows["observation.state"].to_pylist()
        for name, fold in (("min", min), ("max", max)):
            folded = [fold(column) for column in zip(*state)]
            expect(all(abs(a - b) < 1e-5 for a, b in zip(folded, episode[f"stats/observation.state/{name}"])), name)
    stats = json.loads((root / "meta/stats.json").read_text())
    expect(set(stats) == set(features), "statistics")
    expect(all(set(s) == {"min", "max", "mean", "std", "count"} for s in stats.values()), "statistics' names")
    print(f"{len(episodes)} episodes, {data.num_rows} rows, state {features['observation.state']['names']}, "
          f"action {features['action']['names']}")


main()
