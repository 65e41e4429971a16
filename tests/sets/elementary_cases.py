"""Draws and references of the elementary functions: 200-bit values, and fast ones that settle all but the
closest cases.
"""

import numpy as np
from flint import arb, ctx

from jaxbound.sets import interval
from jaxbound.sets.intervals import angles

COUNT = 1500  # one shape for most tests: every function is compiled once for each precision
BITS = 200
ctx.prec = BITS
ARB = {
    "sqrt": arb.sqrt,
    "exp": arb.exp,
    "exp2": lambda v: (v * arb.const_log2()).exp(),
    "exp10": lambda v: (v * arb(10).log()).exp(),
    "log": arb.log,
    "log2": lambda v: v.log() / arb.const_log2(),
    "log10": lambda v: v.log() / arb(10).log(),
    "sin": arb.sin,
    "cos": arb.cos,
    "tan": arb.tan,
    "asin": arb.asin,
    "acos": arb.acos,
    "atan": arb.atan,
    "sinh": arb.sinh,
    "cosh": arb.cosh,
    "tanh": arb.tanh,
    "asinh": arb.asinh,
    "acosh": arb.acosh,
    "atanh": arb.atanh,
}
FAST = {op: (lambda v: np.power(v.dtype.type(10), v)) if op == "exp10" else getattr(np, op) for op in ARB}
DOMAIN = {
    "sqrt": (0, np.inf),
    "log": (0, np.inf),
    "log2": (0, np.inf),
    "log10": (0, np.inf),
    "asin": (-1, 1),
    "acos": (-1, 1),
    "acosh": (1, np.inf),
    "atanh": (-1, 1),
}


def box(lo, hi, dtype=np.float64):
    """Return Intervals of the given bounds (numbers or arrays), repeated up to COUNT."""
    return interval(*(np.resize(np.asarray(v, dtype), COUNT) for v in (lo, hi)))


def points(rng, op, dtype, count):
    """Draw normal points of the domain of `op`: ordinary, of all sizes, and close to where its formulas
    change.
    """
    info = np.finfo(dtype)
    size = lambda a, b: np.exp2(rng.uniform(a, b, count)) * rng.choice([-1, 1], count)
    near = lambda *centers: rng.choice(centers, count) * (1 + size(-info.nmant, -1))
    huge = size(info.minexp + 1, info.maxexp - 1)
    if op in ("sin", "cos", "tan"):
        limit = angles.LARGEST_ANGLE[np.dtype(dtype).itemsize]
        turns = np.round(rng.uniform(-limit, limit, count) * 2 / np.pi) * np.pi / 2
        kinds = [
            rng.uniform(-7, 7, count),
            rng.uniform(-limit, limit, count),
            turns,
            near(*np.arange(1, 40) * np.pi / 4),
            size(-40, 0),
        ]
        x = np.clip(np.choose(rng.integers(0, len(kinds), count), kinds), -limit, limit)
    elif op in ("asin", "acos", "atanh"):
        kinds = [
            rng.uniform(-1, 1, count),
            np.sign(huge) * (1 - abs(size(-info.nmant, -1))),
            size(-60, 0),
            near(0.125, 0.17, 0.25, 0.37, 0.5, 0.72, 0.875, -0.875),
        ]
        x = np.clip(np.choose(rng.integers(0, len(kinds), count), kinds), -1, 1)
    elif op.startswith("log") or op in ("sqrt", "acosh"):
        kinds = [
            abs(huge),
            rng.uniform(0, 4, count),
            abs(near(0.5, 0.5**0.5, 1, 2**0.5, 2)),
            1 + abs(size(-info.nmant, 3)),
        ]
        x = np.choose(rng.integers(0, len(kinds), count), kinds)
    else:
        steep = np.log(2.0) * info.maxexp / (2.4 if op == "exp10" else 1)
        kinds = [
            rng.uniform(-2, 2, count),
            rng.uniform(-steep, steep, count),
            near(1, -1, 0.35, 0.125, 0.37, 0.72, 8.0),
            size(-60, 4),
        ]
        kinds += [huge] if op in ("atan", "asinh", "tanh") else []
        x = np.choose(rng.integers(0, len(kinds), count), kinds)
    x = x.astype(dtype)
    low, high = DOMAIN.get(op, (-np.inf, np.inf))
    inside = np.isfinite(x) & (x >= low) & (x <= high) & (abs(x) >= info.tiny)
    inside &= ~((op == "atanh") & (abs(x) == 1))
    return np.where(inside, x, dtype(1 if op == "acosh" else 0.5))


def exactly(f, x):
    """Return 200-bit balls of f at floats."""
    return [f(arb(v)) for v in np.asarray(x, float).tolist()]


def ball_misses(lo, hi, balls):
    """Return the places where an exact value lies outside its bounds, or where there are none; a value known
    to 200 bits may touch.
    """
    rows = zip(np.asarray(lo, float).tolist(), np.asarray(hi, float).tolist(), balls, strict=True)
    return [
        (i, a, b, v)
        for i, (a, b, v) in enumerate(rows)
        if not a <= b or (a > -np.inf and v < arb(a)) or (b < np.inf and v > arb(b))
    ]


def close_calls(lo, hi, fast, digits):
    """Return where a reference with a relative error below 2^-digits does not prove that it lies between the
    bounds.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        slack = abs(fast) * fast.dtype.type(2.0**-digits)
        return ~((lo <= fast - slack) & (fast + slack <= hi))


def largest_error(fast, balls):
    """Return the largest relative error of longer floats."""
    near = [float(v) for v in fast]
    rest = [float(v - type(v)(a)) for v, a in zip(fast, near, strict=True)]
    return max(
        float(abs(arb(a) + arb(r) - v) / abs(v))
        for a, r, v in zip(near, rest, balls, strict=True)
        if 1e-280 < abs(a) < np.inf
    )


def distance(bound, ball, dtype):
    """Return how far a bound is from an exact value, in ulps of the value."""
    return float(abs(arb(float(bound)) - ball)) / float(np.spacing(abs(dtype(float(ball)))))


def inside(rng, lo, hi, count):
    """Return `count` floats of each [lo, hi], ends included, as rows."""
    dtype = lo.dtype
    top = np.finfo(dtype).max
    a, b = np.maximum(lo, -top), np.minimum(hi, top)
    share = np.concatenate(
        [np.zeros((1, len(lo))), np.ones((1, len(lo))), rng.random((count - 2, len(lo)))]
    ).astype(dtype)
    return np.clip(a * (1 - share) + b * share, a, b)
