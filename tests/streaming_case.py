"""A recording larger than a chunk, for tests of streaming: the paper's plant with faults, holes, a gap and a
clock that goes back.
"""

import functools

import jax
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from systems import paper

import jaxbound as jb
from jaxbound.recordings.read import read
from jaxbound.runs import parts, streaming

N = 6000
MODELS = {
    "section 5": lambda: (paper(), None, "joint"),
    "box": lambda: (paper(), 2, "box"),
    "long windows": lambda: (paper(), 20, "joint"),
    "disturbance": lambda: (paper(disturbance=([[1], [0]], [0.01])), 3, "joint"),
}


@functools.cache
def simulated():
    """Return (u, y): N samples of the paper's plant with two faults."""
    u = np.repeat(np.random.default_rng(0).uniform(-1, 1, (N // 20, 1)), 20, 0)
    faults = [jb.Fault("y1", "bias", 0.4, 1500, 2600), jb.Fault("y2", "bias", -1.0, 4990, 5010)]
    return u, np.asarray(jb.simulate(paper(), u, jax.random.key(0), faults=faults).y)


def recording(dtype=np.float64, holes=60):
    """Return (t, u, y): N samples with two faults, a stuck sensor, missing samples, a gap and a clock that
    goes back.
    """
    rng = np.random.default_rng(0)
    u, y = map(np.array, simulated())
    y[700:800, 0] = y[700, 0]
    y[rng.integers(0, N, holes), rng.integers(0, 2, holes)] = np.nan
    u[rng.integers(0, N, holes // 6)] = np.nan
    t = 0.01 * np.arange(N)
    t[3000:] += 1.0
    t[4000:] -= 0.5
    return t, u.astype(dtype), y.astype(dtype)


def write(folder, t, u, y, cuts=(1000, 1003, 4500), groups=700):
    """Write a recording as files that end at `cuts`."""
    folder.mkdir(parents=True)
    for i, (a, b) in enumerate(zip((0, *cuts), (*cuts, N), strict=True)):
        columns = {"t": t[a:b], "u1": u[a:b, 0], "y1": y[a:b, 0], "y2": y[a:b, 1]}
        pq.write_table(
            pa.table({k: pa.array(x, from_pandas=True) for k, x in columns.items()}),
            folder / f"{i}.parquet",
            row_group_size=groups,
        )
    return folder


def verdicts(out):
    """Return (status, margin) of the verdicts in a folder."""
    table = pq.read_table(out / "verdicts.parquet")
    status = np.array([jb.Status[name] for name in table["status"].to_pylist()], np.int8)
    return status, table["margin"].to_numpy()


def parts_of(folder):
    """Return {name: bytes} of the parts in a folder."""
    return {p.name: p.read_bytes() for p in parts.part_files(folder)}


def shrink(monkeypatch):
    """Make parts of 1024 samples and let chunks be of any size."""
    monkeypatch.setattr(streaming, "PART", 1024)
    monkeypatch.setattr(streaming, "LEAST", 1)


def cases(tmp_path_factory):
    """Return a function that gives (relations, folder of Parquet, Result in one piece, Recording) of a model;
    each is made once.
    """
    made = {}

    def get(name, dtype=np.float64):
        if (name, dtype) not in made:
            model, horizon, method = MODELS[name]()
            r = jb.parity_relations(model, horizon)
            folder = write(
                tmp_path_factory.mktemp("data") / "run", *recording(dtype, 2 if horizon == 20 else 60)
            )
            whole = read(folder, model)
            made[name, dtype] = (
                r,
                folder,
                jb.detect(r, whole.u, whole.y, method=method, starts=whole.starts),
                whole,
            )
        return made[name, dtype]

    return get


class Stop(Exception):
    pass


def stopped_after(share):
    """Return a progress callback that stops the run once this share is done."""

    def progress(done):
        if done >= share:
            raise Stop

    return progress
