"""Recipe 3 in numpy (float64), as shared_dsp::right::aligned describes it. Prints tests/data/aligned.json:
python3 tests/reference/aligned_ref.py > tests/data/aligned.json"""
import json
import numpy as np

G, FLOORS = 9.80665, (0.1, 0.2)
HANN = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(1, 26) / 26)


def features(window):
    x = np.asarray(window, float)[:, :6]
    triad_count = 2 if x.shape[1] == 6 else 1
    hops = x.reshape(25, 8, -1)
    bins, tremor = hops.mean(1), hops.var(1).mean(0)
    mean = bins[:, :3].mean(0)
    length = np.linalg.norm(mean)
    up = mean / max(length, 1e-3)
    start = np.array([0.0, 1, 0]) if abs(up[0]) > 0.9 else np.array([1.0, 0, 0])
    e1 = start - up * (up @ start)
    e1 /= np.linalg.norm(e1)
    frame = np.stack([up, e1, np.cross(up, e1)])
    acc = bins[:, :3] @ frame.T
    triads = [(acc - acc.mean(0)) / G]
    if triad_count == 2:
        triads.append(bins[:, 3:6] @ frame.T / 100)
    source = triads[-1]
    xx, yy, xy = (source[:, 1] ** 2).sum(), (source[:, 2] ** 2).sum(), (source[:, 1] * source[:, 2]).sum()
    angle = 0.5 * np.arctan2(2 * xy, xx - yy)
    c, s = np.cos(angle), np.sin(angle)
    out, roots = [], []
    for triad, f in zip(triads, FLOORS):
        z = np.stack([triad[:, 0], c * triad[:, 1] + s * triad[:, 2], c * triad[:, 2] - s * triad[:, 1]], 1)
        z = z - z.mean(0)
        e = (z**2).mean(0)
        energy = e.sum()
        root = np.sqrt(energy)
        out.append(2 * root / (root + 2 * f) - 1)
        out += list(3 * e / (energy + f * f) - 1)
        lines = np.fft.rfft(z * HANN[:, None], n=32, axis=0)[1:11]
        power = np.abs(lines) ** 2
        total = power.sum(0) + 60 * f * f
        out += list((2 * np.sqrt(power / total) - 0.5).reshape(-1))
        for i, j in ((1, 0), (2, 0), (2, 1)):
            cross = (lines[:, i] * np.conj(lines[:, j])).sum() / np.sqrt(total[i] * total[j])
            out += [2 * abs(cross.real) - 0.5, 2 * abs(cross.imag) - 0.5]
        roots += list(np.log(np.sqrt(e) + f) + 1)
    for t, (unit, floor) in enumerate(((1 / G, 0.01), (0.01, 0.02))[:triad_count]):
        out.append(np.log(np.sqrt(tremor[3 * t : 3 * t + 3].sum()) * unit + floor) / 2 + 1.5)
    return np.array(out + roots + [2 * (length / G - 1)])


def windows(rng):
    t = np.arange(200) / 100
    for k in range(8):
        axes = (3, 6, 9)[k % 3]
        size = np.array([3, 30, 10]).repeat(3)[:axes]
        waves = np.sin(2 * np.pi * rng.uniform(0.4, 3, axes) * t[:, None] + rng.uniform(0, 6, axes))
        w = rng.normal(size=axes) + size * 0.6 * waves + rng.normal(size=(200, axes)) * 0.2
        w[:, :3] += G * np.array([0.2, 0.3, 0.93])
        yield f"swing {k}", w
    still = np.tile([1.0, 9.5, -2.0, 0.5, -0.25, 0.125], (200, 1))
    yield "constant", still
    yield "zero", np.zeros((200, 6))
    turning = np.tile([0.0, 0.0, 0.0, 50.0, 20.0, -80.0], (200, 1)) * np.sin(2 * np.pi * 1.1 * t)[:, None]
    yield "no gravity, turning", turning
    yield "gravity along x, clipped", np.clip(
        np.stack([9.81 + 25 * np.sin(2 * np.pi * 2.2 * t), 14 * np.cos(2 * np.pi * 2.2 * t), 0 * t], 1), -19.61, 19.61
    )


if __name__ == "__main__":
    cases = []
    for name, window in windows(np.random.default_rng(1)):
        window = np.round(window, 3).astype(np.float32)
        values = [[float(f"{v:.3f}") for v in row] for row in window]
        cases.append(dict(name=name, axes=window.shape[1], window=values, features=[round(v, 7) for v in features(window)]))
    print(json.dumps(cases, separators=(",", ":")))
