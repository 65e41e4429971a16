"""What several devices find: run with XLA_FLAGS=--xla_force_host_platform_device_count=8, prints digests for
some of them.

python devices_case.py BLOCK SAMPLES COUNTS case [case ...]
"""

import hashlib
import json
import sys
import warnings

import jax
import numpy as np
from lying_device import lying, unexamined
from systems import paper

import jaxbound as jb
from jaxbound.consistency import devices, drive
from jaxbound.consistency.bank import BankTest
from jaxbound.consistency.strips import StripsTest

jax.config.update("jax_enable_x64", True)


KINDS = StripsTest, BankTest  # whose blocks are made small


def recording(samples, dtype=np.float64):
    """Return u, y: quiet and loud by turns, with holes."""
    rng = np.random.default_rng(0)
    size = np.repeat(10 ** rng.uniform(-3, 0.5, (samples // 8 + 1, 1)), 8, 0)[:samples]
    u, y = rng.uniform(-1, 1, (samples, 1)) * size, rng.normal(size=(samples, 2)) * size
    y[rng.random(y.shape) < 0.001] = np.nan
    return u.astype(dtype), y.astype(dtype)


def both(result):
    return result.status, result.margin


def lied(method, relations, u, y):
    """Return the verdicts by devices that nobody examined and that lie."""
    with unexamined(), lying(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return both(jb.detect(relations, u, y, method=method))


CASES = {
    "one sensor": lambda u, y: both(
        jb.detect(jb.parity_relations(jb.LinearSystem([[0.5]], None, [[1]], noise=0.1)), None, y[:, :1])
    ),
    "joint": lambda u, y: both(jb.detect(jb.parity_relations(paper()), u, y)),
    "float32": lambda u, y: both(
        jb.detect(jb.parity_relations(paper()), u.astype(np.float32), y.astype(np.float32))
    ),
    "box": lambda u, y: both(jb.detect(jb.parity_relations(paper(), 2), u, y, method="box")),
    "batch": lambda u, y: both(
        jb.detect(jb.parity_relations(paper(), 2), u.reshape(5, -1, 1), y.reshape(5, -1, 2))
    ),
    "margins": lambda u, y: (jb.margins(jb.parity_relations(paper()), u, y),),
    "bank": lambda u, y: (lambda found: (found.words, *both(found)))(
        jb.detect(jb.structured_relations(paper()), u, y)
    ),
    "lying, one sensor": lambda u, y: lied(
        "joint", jb.parity_relations(jb.LinearSystem([[0.5]], None, [[1]], noise=0.1)), None, y[:, :1]
    ),
    "lying, bank": lambda u, y: lied("box", jb.structured_relations(paper()), u, y),
    "lying, long windows": lambda u, y: lied("joint", jb.parity_relations(paper(), 20), u, y),
    "long windows": lambda u, y: both(jb.detect(jb.parity_relations(paper(), 20), u, y)),
}


def digests(cases, block, samples, counts):
    """Return {case: [sha256 of all it returns, on so many devices]}, with the status names that occur."""
    jb.compile("always")  # NumPy has no devices
    for kind in KINDS:
        kind.block = block
    u, y = recording(samples)
    found = {}
    for case in cases:
        for count in counts:
            chosen = tuple(jax.local_devices()[:count])
            drive.usable_devices = lambda chosen=chosen: chosen
            arrays = [np.asarray(x) for x in CASES[case](u, y)]
            found.setdefault(case, []).append(
                hashlib.sha256(b"".join(x.tobytes() for x in arrays)).hexdigest()
            )
        found[case].append(len(np.unique(arrays[0])))
    found["compiled"] = devices._on_mesh._cache_size() + devices._wide_on_mesh._cache_size()
    return found


if __name__ == "__main__":
    block, samples, counts, *cases = sys.argv[1:]
    print(json.dumps(digests(cases, int(block), int(samples), [int(c) for c in counts.split(",")])))
