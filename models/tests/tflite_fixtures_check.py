"""Runs the fixtures in TensorFlow Lite's interpreter again: what it says must be what is kept, and what our kernels say.

    pip install -r models/tests/requirements.txt
    cargo build -p models
    python models/tests/tflite_fixtures_check.py target/debug/models

Two networks in eight modes, 1,000 inputs each. `cargo test -p models --test tflite` compares our kernels with the kept
answers on every run; this (`cargo xtask test --full`) asks the interpreter itself, for the kept inputs, and imports each
network with our tool for as many that are drawn anew. What our tool makes of a network takes and gives int8, so inputs of
other types are the same steps in those types.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

OUT = Path(__file__).resolve().parent / "tflite_fixtures"
MODES = ("int8", "uint8", "float-io", "per-tensor", "reshape", "logits", "no-bias", "relu6")
NETWORKS = {"paper": (117, 7, 9), "three": (39, 5, 3)}
ROWS = 1000


def inputs(count: int, width: int) -> np.ndarray:
    """int8 values: a multiplicative hash of row and column, the first rows small, the last ones of full size."""
    row, column = np.meshgrid(np.arange(count, dtype=np.uint64), np.arange(width, dtype=np.uint64), indexing="ij")
    mixed = (row * np.uint64(1009) + column * np.uint64(9176) + np.uint64(12345)) * np.uint64(2654435761)
    byte = (mixed >> np.uint64(13)) % np.uint64(256)
    full = byte.astype(np.int64) - 128
    small = full // 4
    return np.where(row < count // 2, small, full).astype(np.int8)


def answers(interpreter, rows: np.ndarray) -> np.ndarray:
    """What an interpreter, of TensorFlow or of LiteRT, makes of int8 rows, whatever its own types are."""
    interpreter.allocate_tensors()
    [given], [wanted] = interpreter.get_input_details(), interpreter.get_output_details()
    results = []
    for row in rows:
        if given["dtype"] == np.uint8:
            row = (row.astype(np.int16) + 128).astype(np.uint8)
        elif given["dtype"] == np.float32:
            # The value of each step exactly, so that quantising gives the step again. Scale and zero point stand
            # with the tensor behind QUANTIZE.
            scale, zero = quantisation(interpreter, "QUANTIZE", "outputs")
            row = ((row.astype(np.int16) - zero).astype(np.float32) * np.float32(scale)).astype(np.float32)
        interpreter.set_tensor(given["index"], row.reshape(given["shape"]))
        interpreter.invoke()
        result = interpreter.get_tensor(wanted["index"]).reshape(-1)
        if wanted["dtype"] == np.uint8:
            result = (result.astype(np.int16) - 128).astype(np.int8)
        elif wanted["dtype"] == np.float32:
            scale, zero = quantisation(interpreter, "DEQUANTIZE", "inputs")
            result = (np.rint(result / np.float32(scale)) + zero).astype(np.int8)
        results.append(result)
    return np.array(results, dtype=np.int8)


def quantisation(interpreter, operator: str, side: str):
    """Scale and zero point of the int8 tensor before or behind the first operator of that name."""
    operators = interpreter._get_ops_details()
    index = next(op[side][0] for op in operators if op["op_name"] == operator)
    return interpreter._get_tensor_details(index, 0)["quantization"]


def ours(binary: Path, model: Path, width: int, outputs: int, axes: int, rows: np.ndarray) -> np.ndarray:
    """What our tool imports the network as, and what our kernels say."""
    with tempfile.TemporaryDirectory() as folder:
        labels = ",".join(f"g{n}" for n in range(outputs))
        subprocess.run([binary, "import", model, "--labels", labels, "--features", "raw", "--axes", str(axes),
                        "--out", folder, "--name", "it"], check=True, stdout=subprocess.DEVNULL)
        file = Path(folder) / "rows.csv"
        file.write_text("".join(",".join(map(str, row)) + "\n" for row in rows.tolist()))
        text = subprocess.run([binary, "infer", Path(folder) / "it.tflite", file], check=True,
                              stdout=subprocess.PIPE, text=True).stdout
        return np.array([[int(value) for value in line.split(",")] for line in text.splitlines()], dtype=np.int8)


def main() -> None:
    from ai_edge_litert.interpreter import Interpreter, OpResolverType

    if len(sys.argv) != 2:
        sys.exit(__doc__)
    binary = Path(sys.argv[1]).resolve()
    rng = np.random.default_rng(20261129)
    for name, (width, outputs, axes) in NETWORKS.items():
        for mode in MODES:
            model = OUT / f"{name}-{mode}.tflite"

            def theirs(rows):
                return answers(Interpreter(model_path=str(model), num_threads=1,
                                           experimental_op_resolver_type=OpResolverType.BUILTIN_REF), rows)

            kept = np.frombuffer((OUT / f"{name}-{mode}.answers.bin").read_bytes(), np.int8).reshape(ROWS, outputs)
            wrong = int((theirs(inputs(ROWS, width)) != kept).any(axis=1).sum())
            if wrong:
                sys.exit(f"{model.name}: {wrong} of {ROWS} kept answers are not the interpreter's")
            said = f"{model.name}: {ROWS} kept answers are the interpreter's"
            # Our softmax follows logits, so their answers are not comparable here; the kept ones are, in Rust.
            if mode != "logits":
                rows = rng.integers(-128, 128, (ROWS, width)).astype(np.int8)
                wrong = int((theirs(rows) != ours(binary, model, width, outputs, axes, rows)).any(axis=1).sum())
                if wrong:
                    sys.exit(f"{model.name}: {wrong} of {ROWS} new rows differ between our tool and the interpreter")
                said += f", {ROWS} new ones are equal in our tool"
            print(said)


if __name__ == "__main__":
    main()
