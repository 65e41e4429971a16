"""Seconds of `jaxbound detect` on a CSV of a million rows, report included; and what `import jaxbound` adds
to `import jax`.

python -m benchmarks.command_line [--rows 1000000]
"""

import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import jax
import numpy as np

import jaxbound as jb
from benchmarks import timing

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from systems import paper  # noqa: E402


def shell(folder, cache):
    """Return the seconds of one run with its compilation cache in `cache`."""
    command = [
        shutil.which("jaxbound", path=Path(sys.executable).parent) or "jaxbound",
        "detect",
        "model.toml",
        "run.csv",
        "--out",
        "report",
    ]
    start = time.perf_counter()
    done = subprocess.run(
        command, cwd=folder, env={**os.environ, "XDG_CACHE_HOME": str(cache)}, capture_output=True, text=True
    )
    if done.returncode not in (0, 1):
        raise RuntimeError(done.stderr)
    return time.perf_counter() - start


def importing():
    """Return the seconds that jaxbound adds to jax, the median of five."""
    code = "import time, jax; t = time.perf_counter(); import jaxbound; print(time.perf_counter() - t)"
    return float(
        np.median(
            [
                float(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout)
                for _ in range(5)
            ]
        )
    )


def main():
    rows = timing.option("--rows", 1_000_000)
    model = paper()
    with tempfile.TemporaryDirectory() as folder:
        folder = Path(folder)
        u = np.repeat(np.random.default_rng(0).uniform(-1, 1, (rows // 20 + 1, 1)).round(6), 20, 0)[:rows]
        y = np.asarray(
            jb.simulate(
                model, u, jax.random.key(0), faults=[jb.Fault("y1", "bias", 0.2, rows // 2, rows // 2 + 40)]
            ).y
        )
        jb.save_model(model, folder / "model.toml")
        table = np.column_stack([0.01 * np.arange(rows), u, y])
        np.savetxt(
            folder / "run.csv",
            table,
            fmt=["%.2f", "%.6f", "%.9f", "%.9f"],
            delimiter=",",
            header="time,u1,y1,y2",
            comments="",
        )
        cold = [shell(folder, folder / f"cache{i}") for i in range(3)]
        warm = [shell(folder, folder / "cache0") for _ in range(5)]
        size = (folder / "run.csv").stat().st_size
    timing.save(
        "command_line",
        {
            "rows": rows,
            "csv MB": round(size / 1e6, 1),
            "cold s": [round(float(f(cold)), 2) for f in (np.median, min)],
            "warm s": [round(float(f(warm)), 2) for f in (np.median, min)],
            "import s": round(importing(), 3),
        },
    )


if __name__ == "__main__":
    main()
