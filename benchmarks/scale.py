"""How the work grows: devices, and recordings of 20 and 100 million samples in Parquet.

python -m benchmarks.scale [--rows 100000000] [--windows 10000000]

Virtual devices share the cores of this machine, so more of them cannot be faster: the processor time shows
what they cost.
"""

import hashlib
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import jax
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

import jaxbound as jb
from benchmarks import timing
from benchmarks.parquet import START, run

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from systems import paper  # noqa: E402

FILE, KINDS, REST = 1_000_000, 3, 400


def generate(folder, rows):
    """Write the paper's plant as files that continue each other, with a bias of 0.3 on y1 for 50 samples in
    each.

    There are a few kinds of files that take turns: each ends at rest, where the next one begins.
    """
    rng, kinds = np.random.default_rng(0), []
    for i in range(KINDS):
        u = np.repeat(rng.uniform(-1, 1, (FILE // 20, 1)), 20, 0)
        u[-REST:] = 0
        faults = [jb.Fault("y1", "bias", 0.3, FILE // 2, FILE // 2 + 50)]
        y = np.asarray(jb.simulate(paper(), u, jax.random.key(i), x0=np.zeros(2), faults=faults).y)
        kinds.append({"u1": u[:, 0], "y1": y[:, 0], "y2": y[:, 1]})
    folder.mkdir()
    for i, first in enumerate(range(0, rows, FILE)):
        time = START + 10_000 * np.arange(first, min(first + FILE, rows))
        columns = {name: x[: len(time)] for name, x in kinds[i % KINDS].items()}
        pq.write_table(pa.table({"time": time, **columns}), folder / f"run-{i}.parquet")


def on_devices(windows):
    """Return figures of this process's devices: first call, wall and processor time of the others, digest of
    all verdicts.
    """
    rng, out = np.random.default_rng(0), {}
    u, y = (rng.normal(size=(windows, c)) for c in (1, 2))
    relations, bank = jb.parity_relations(paper()), jb.structured_relations(paper())
    runs = {
        "margins": lambda: (jb.margins(relations, u, y),),
        "detect": lambda: (lambda found: (found.status, found.margin))(jb.detect(relations, u, y)),
        "bank": lambda: (lambda found: (found.words, found.status, found.margin))(jb.detect(bank, u, y)),
    }
    for name, called in runs.items():
        wall, used = [], []
        for _ in range(8):
            start, processor = time.perf_counter(), time.process_time()
            arrays = [np.asarray(x) for x in called()]
            wall.append(time.perf_counter() - start)
            used.append(time.process_time() - processor)
        out[name] = {
            "first call s": round(wall[0], 2),
            "first call, processor s": round(used[0], 2),
            "million windows/s": [
                round(windows / t / 1e6, 1)
                for t in (float(np.median(wall[1:])), max(wall[1:]), min(wall[1:]))
            ],
            "processor s": round(float(np.median(used[1:])), 3),
            "sha256": hashlib.sha256(b"".join(x.tobytes() for x in arrays)).hexdigest(),
        }
    return out


def with_devices(count, windows):
    """Run `on_devices` in a process with so many virtual devices."""
    env = {
        **os.environ,
        "XLA_FLAGS": f"--xla_force_host_platform_device_count={count}",
        "JAX_PLATFORMS": "cpu",
    }
    argv = [sys.executable, "-m", "benchmarks.scale", "--here", "--windows", str(windows)]
    return json.loads(subprocess.run(argv, env=env, capture_output=True, text=True, check=True).stdout)


def linked(folder, name, files):
    """Make a folder with the first so many files of the recording, without copying them."""
    (folder / name).mkdir()
    for i in range(files):
        os.link(folder / f"run/run-{i}.parquet", folder / name / f"run-{i}.parquet")
    return name


def main():
    rows, windows = timing.option("--rows", 100_000_000), timing.option("--windows", 10_000_000)
    devices = {count: with_devices(count, windows) for count in (1, 2, 4, 8)}
    same = {name: len({found[name]["sha256"] for found in devices.values()}) == 1 for name in devices[1]}
    files = -(-rows // FILE)
    fifth = max(files // 5, 1)
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        jb.save_model(paper(), folder / "model.toml")
        generate(folder / "run", rows)
        stored = sum(p.stat().st_size for p in (folder / "run").iterdir())
        part = run(folder, "fifth out", data=linked(folder, "fifth", fifth))
        whole = run(folder, "out")
    timing.save(
        "scale",
        {
            "load average": [round(x, 1) for x in os.getloadavg()],
            "windows": windows,
            "same verdicts on all devices": same,
            "devices": devices,
            "stored MB": round(stored / 1e6),
            f"{fifth * FILE} rows": part,
            f"{rows} rows": whole,
        },
    )


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    if "--here" in sys.argv:
        print(json.dumps(on_devices(timing.option("--windows", 10_000_000))))
    else:
        main()
