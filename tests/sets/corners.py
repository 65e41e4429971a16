"""What the tests of the sets share: numbers that break floating-point code, exact members of intervals, ways
to run a kernel.
"""

import math
from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np

DTYPES = (np.float32, np.float64)
MODES = {
    "eager": lambda f: lambda *args: f(*jax.tree.map(jnp.asarray, args)),
    "jit": jax.jit,
    "vmap": lambda f: jax.jit(jax.vmap(f)),
}
BEYOND = Fraction(10) ** 400  # a real number that no float reaches: every half-line has such members


def corners(dtype):
    """Return finite corners of a dtype, both signs: zeros, the ends of the normal range, powers at which
    reciprocals underflow.
    """
    info = np.finfo(dtype)
    root = 2.0 ** (info.maxexp // 2)
    positive = [
        0,
        info.tiny,
        2 * info.tiny,
        1 / root,
        0.1,
        1 / 3,
        1 - info.epsneg,
        1,
        1 + info.eps,
        3,
        root,
        root * (1 + info.eps),
        0.3 * info.max,
        0.83 * info.max,
        0.95 * info.max,
        info.max,
    ]
    return np.array([sign * float(x) for x in positive for sign in (1, -1)], dtype)


def subnormals(dtype):
    """Return subnormal numbers of a dtype, both signs: the smallest, the largest and two between."""
    info = np.finfo(dtype)
    step = info.smallest_subnormal
    positive = [step, 3 * step, info.tiny / 2, info.tiny - step]
    return np.array([sign * x for x in positive for sign in (1, -1)], dtype)


def floats(rng, dtype, count):
    """Draw finite normal floats: corners, all magnitudes, and numbers near 1."""
    info = np.finfo(dtype)
    with np.errstate(over="ignore"):
        wide = np.exp2(rng.uniform(info.minexp + 1, info.maxexp - 1, count)) * rng.choice([-1, 1], count)
    kinds = [rng.choice(corners(dtype), count), wide.astype(dtype), rng.uniform(-4, 4, count).astype(dtype)]
    return np.choose(rng.integers(0, 3, count), kinds).astype(dtype)


def bounds(rng, dtype, count, unbounded=True):
    """Draw lo <= hi: of any two floats, of one float (points), of neighbours, of half-lines and entire."""
    a, b = floats(rng, dtype, count), floats(rng, dtype, count)
    with np.errstate(all="ignore"):
        near = np.nextafter(a, np.asarray(np.inf, dtype))
    near = np.where(np.isfinite(near) & (abs(near) >= np.finfo(dtype).tiny), near, a)
    kind = rng.integers(0, 4, count)
    b = np.where(kind == 0, a, np.where(kind == 1, near, b))
    lo, hi = np.minimum(a, b), np.maximum(a, b)
    if unbounded:
        lo = np.where(rng.random(count) < 0.06, -np.inf, lo).astype(dtype)
        hi = np.where(rng.random(count) < 0.06, np.inf, hi).astype(dtype)
    return lo, hi


def members(lo, hi):
    """Return exact members of [lo, hi]: its ends (or numbers beyond all floats), 0 and 1 if inside, the
    middle.
    """
    lo, hi = float(lo), float(hi)
    ends = [-BEYOND if lo == -math.inf else Fraction(lo), BEYOND if hi == math.inf else Fraction(hi)]
    inner = [Fraction(v) for v in (0, 1) if ends[0] < v < ends[1]]
    return list(dict.fromkeys([*ends, *inner, (ends[0] + ends[1]) / 2]))


def in_blocks(kernel, count, *arrays):
    """Run a compiled kernel on blocks of one size, the last one filled up, so that arrays of any length share
    one compilation.
    """
    total = len(arrays[0])
    rows = np.resize(np.arange(total), -(-total // count) * count)
    parts = [kernel(*(a[rows[k : k + count]] for a in arrays)) for k in range(0, len(rows), count)]
    return jax.tree.map(lambda *ends: np.concatenate(ends)[:total], *parts)


def misses(lo, hi, exact):
    """Return [(place, exact value, lo, hi)] of the exact values that an interval fails to hold; exact: one
    iterable an entry.
    """
    lo, hi = np.ravel(lo).tolist(), np.ravel(hi).tolist()
    assert len(lo) == len(hi) == len(exact), (len(lo), len(hi), len(exact))
    return [
        (i, v, a, b)
        for i, (a, b, values) in enumerate(zip(lo, hi, exact, strict=True))
        for v in values
        if not a <= v <= b
    ]


def far(lo, hi, exact, relative, absolute):
    """Return the places at which a bound is further than relative |v| + absolute from the exact range (least,
    largest).
    """
    bad = []
    for i, (a, b, (least, largest)) in enumerate(
        zip(np.ravel(lo).tolist(), np.ravel(hi).tolist(), exact, strict=True)
    ):
        for got, v in ((a, least), (b, largest)):
            if not math.isfinite(got) or abs(Fraction(got) - v) > relative * abs(v) + absolute:
                bad.append((i, got, float(v)))
    return bad


class Counted:
    """A function that counts how often it is traced."""

    def __init__(self, f):
        self.f, self.count = f, 0

    def __call__(self, *args):
        self.count += 1
        return self.f(*args)
