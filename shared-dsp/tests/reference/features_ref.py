"""Compares the features of shared-dsp with float64 ones on recorded data.

    pip install -r shared-dsp/tests/reference/requirements.txt
    cargo build --release -p shared-dsp --example features_dump
    python shared-dsp/tests/reference/features_ref.py --dump target/release/examples/features_dump

Joins all recordings of each set into one stream, so that windows also straddle them, as they do on a board.
Recordings are looked for in ../shared/data beside the repository (BIMANUAL_SHARED overrides `shared`); without
them it says so and passes.
"""

import argparse
import csv
import os
import pathlib
import subprocess
import sys

import numpy as np

WINDOW, HOP = 200, 8
NAMES = ["mean", "rms", "variance", "skewness", "kurtosis"] + [f"P{k}" for k in range(8)]
SHAPE = [3, 4]  # bounded relative to max(|reference|, 1)
BOUND = 1e-4
MEAN = 0
MEAN_BOUND = 1e-9  # what shared_dsp::right::features promises of a mean near 0, where 200 samples cancel


def reference(x):
    """Features (windows, axes, 13) in float64 of a stream (samples, axes) of float32."""
    x = x.astype(np.float64)
    windows = np.lib.stride_tricks.sliding_window_view(x, WINDOW, axis=0)[::HOP]
    # Algebra, not accuracy of the code under test: a constant taken away beforehand changes no central moment
    # and no bin but P0, and spares float64 its own rounding on constant stretches.
    shifted = windows - windows[:, :, :1]
    offset = shifted.mean(axis=2)
    deviation = shifted - offset[:, :, None]
    square = deviation * deviation
    m2, m3, m4 = square.mean(axis=2), (square * deviation).mean(axis=2), (square * square).mean(axis=2)
    moving = m2 > 0
    safe = np.where(moving, m2, 1.0)
    frames = np.lib.stride_tricks.sliding_window_view(windows, 16, axis=2)[:, :, ::HOP]
    dc = frames.sum(axis=3)
    spectrum = np.fft.rfft(frames - frames[:, :, :, :1], axis=3)[:, :, :, :8]
    power = spectrum.real * spectrum.real + spectrum.imag * spectrum.imag
    power[:, :, :, 0] = dc**2
    out = np.empty(windows.shape[:2] + (13,))
    out[:, :, 0] = windows.mean(axis=2)
    out[:, :, 1] = np.sqrt((windows**2).mean(axis=2))
    out[:, :, 2] = m2
    out[:, :, 3] = np.where(moving, m3 / safe**1.5, 0.0)
    out[:, :, 4] = np.where(moving, m4 / safe**2 - 3.0, 0.0)
    out[:, :, 5:] = power.mean(axis=2) / 16.0
    return out


def compare(name, stream, dump):
    """Prints the largest error of each feature; true if all are within the bound."""
    axes = stream.shape[1]
    done = subprocess.run([dump, str(axes)], input=stream.astype("<f4").tobytes(), stdout=subprocess.PIPE, check=True)
    got = np.frombuffer(done.stdout, "<f4").reshape(-1, axes, 13).astype(np.float64)
    expected_count = (len(stream) - WINDOW) // HOP + 1
    if len(got) != expected_count:
        print(f"{name}: {len(got)} hops instead of {expected_count}")
        return False
    worst = np.zeros(13)
    beyond = 0
    chunk = 2000  # hops at a time, to keep memory small
    for start in range(0, expected_count, chunk):
        part = got[start : start + chunk]
        samples = stream[start * HOP : (start + len(part) - 1) * HOP + WINDOW]
        expected = reference(samples)
        scale = np.abs(expected)
        scale[:, :, SHAPE] = np.maximum(scale[:, :, SHAPE], 1.0)
        error = np.abs(part - expected)
        ratio = np.where(error == 0, 0.0, error / np.where(scale == 0, np.finfo(float).tiny, scale))
        wrong = ratio > BOUND
        wrong[:, :, MEAN] &= error[:, :, MEAN] > MEAN_BOUND
        beyond += int(wrong.sum())
        worst = np.maximum(worst, ratio.max(axis=(0, 1)))
    print(f"{name}: {expected_count} windows of {axes} axes, {beyond} of {got.size} features beyond {BOUND:g}")
    print("   largest error: " + ", ".join(f"{n} {w:.1e}" for n, w in zip(NAMES, worst)))
    return beyond == 0


def recordings(folder):
    """All recordings of a set, joined, grouped by their number of axes."""
    streams = {}
    with open(folder / "index.csv", newline="") as index:
        for row in csv.DictReader(index):
            values = np.loadtxt(folder / row["path"], delimiter=",", skiprows=1, dtype=np.float32, ndmin=2)[:, 1:]
            streams.setdefault(values.shape[1], []).append(values)
    return {axes: np.concatenate(parts) for axes, parts in streams.items()}


def synthetic():
    """Signals that break sums of powers: idle under gravity, with and without noise, and after violent motion."""
    rng = np.random.default_rng(1)
    n = 20_000
    step = np.float32(9.80665 * 0.000122)
    idle = 9.81 + 0.01 * rng.standard_normal((n, 3))
    quantised = np.round((9.81 + 0.002 * rng.standard_normal((n, 3))) / step) * step
    burst = (np.arange(n)[:, None] // 450 % 2) * 40.0 * rng.standard_normal((n, 3))
    return {"idle, sigma 0.01": idle, "idle, quantised": quantised, "idle after violent motion": idle + burst}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--dump", default="target/release/examples/features_dump", help="the built example")
    arguments = parser.parse_args()
    good = True
    for name, stream in synthetic().items():
        good &= compare(name, stream.astype(np.float32), arguments.dump)
    root = pathlib.Path(__file__).resolve().parents[3]
    shared = pathlib.Path(os.environ.get("BIMANUAL_SHARED", root.parent / "shared"))
    sets = sorted(path.parent for path in (shared / "data").glob("*/index.csv"))
    if not sets:
        print(f"skipped: no recordings in {shared / 'data'}")
    for folder in sets:
        for axes, stream in recordings(folder).items():
            if axes in (3, 6, 9):
                good &= compare(folder.name, stream, arguments.dump)
    sys.exit(0 if good else 1)


if __name__ == "__main__":
    main()
