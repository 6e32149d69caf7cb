"""Trains a small model and runs its files in TensorFlow Lite's own reference kernels.

    pip install -r models/tests/requirements.txt
    cargo build --release -p models
    python models/tests/tflite_check.py target/release/models

The int8 file must give the same bytes in TFLite (BUILTIN_REF, no delegate) as in our kernels, on
random inputs and on inputs that look like features; the float file the same numbers to 1e-5.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from ai_edge_litert.interpreter import Interpreter, OpResolverType

HERE = Path(__file__).resolve().parent
ROWS = 500


def main() -> None:
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    binary = Path(sys.argv[1]).resolve()

    def ours(model: Path, rows) -> list:
        with tempfile.NamedTemporaryFile("w", suffix=".csv") as file:
            file.writelines(",".join(map(str, row)) + "\n" for row in rows.tolist())
            file.flush()
            text = subprocess.run([binary, "infer", model, file.name], check=True,
                                  stdout=subprocess.PIPE, text=True).stdout
        return [[float(value) for value in line.split(",")] for line in text.splitlines()]

    def theirs(model: Path, rows) -> list:
        interpreter = Interpreter(model_path=str(model), num_threads=1,
                                  experimental_op_resolver_type=OpResolverType.BUILTIN_REF)
        interpreter.allocate_tensors()
        [given], [wanted] = interpreter.get_input_details(), interpreter.get_output_details()
        results = []
        for row in rows:
            interpreter.set_tensor(given["index"], row[np.newaxis])
            interpreter.invoke()
            results.append(interpreter.get_tensor(wanted["index"])[0])
        return results

    rng = np.random.default_rng(20261122)
    models = []
    with tempfile.TemporaryDirectory() as folder:
        data = Path(folder) / "data"
        subprocess.run([binary, "synth", "--out", data, "--wearers", "2", "--seconds", "3"],
                       check=True, stdout=subprocess.DEVNULL)
        for recipe, axes, width in (("paper", 3, 39), ("paper", 9, 117), ("aligned", 3, 45), ("aligned", 9, 89)):
            name = f"{recipe}{axes}"
            subprocess.run([binary, "train", data, "--out", folder, "--name", name,
                            "--recipe", recipe, "--axes", str(axes), "--steps", "100"],
                           check=True, stdout=subprocess.DEVNULL)
            models.append((Path(folder) / name, width))
        models.append((HERE.parent / "bundled" / "right-aligned", 89))
        for model, width in models:
            uniform = rng.integers(-128, 128, (ROWS, width))
            natural = np.clip(np.rint(rng.normal(0, 25, (ROWS, width))), -128, 127)
            rows = np.concatenate([uniform, natural]).astype(np.int8)
            file = model.with_name(model.name + ".tflite")
            got, want = np.array(ours(file, rows)), np.array(theirs(file, rows))
            if not np.array_equal(got, want):
                wrong = int((got != want).any(axis=1).sum())
                sys.exit(f"{file.name}: {wrong} of {len(rows)} rows differ from TFLite's reference kernels")
            print(f"{file.name}: {len(rows)} rows, every int8 score equals TFLite's")

            rows = rng.normal(0, 1, (ROWS, width)).astype(np.float32)
            file = model.with_name(model.name + ".float.tflite")
            apart = np.abs(np.array(ours(file, rows)) - np.array(theirs(file, rows))).max()
            if apart > 1e-5:
                sys.exit(f"{file.name}: float scores are {apart} apart")
            print(f"{file.name}: {len(rows)} rows, float scores at most {apart:.1e} apart")


main()
