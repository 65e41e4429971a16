"""Random compositions of primitives at points: the enclosure of the compiled program holds the 200-bit value.
No miss is allowed.
"""

import flint
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from corners import DTYPES
from inclusion_cases import arb, const

from jaxbound.sets import Interval, inclusion

UNARY = {
    "neg": (lambda x: -x, lambda x: -x),
    "abs": (abs, abs),
    "square": (jnp.square, lambda x: x * x),
    "cube": (lambda x: x**3, lambda x: x**3),
    "sqrt": (jnp.sqrt, lambda x: x.sqrt()),
    "exp": (jnp.exp, lambda x: x.exp()),
    "log": (jnp.log, lambda x: x.log()),
    "sin": (jnp.sin, lambda x: x.sin()),
    "cos": (jnp.cos, lambda x: x.cos()),
    "tanh": (jnp.tanh, lambda x: x.tanh()),
    "atan": (jnp.arctan, lambda x: x.atan()),
    "logistic": (jax.nn.sigmoid, lambda x: 1 / (1 + (-x).exp())),
    "expm1": (jnp.expm1, lambda x: x.expm1()),
    "log1p": (jnp.log1p, lambda x: x.log1p()),
    "recip": (lambda x: 1 / x, lambda x: 1 / x),
    "scale": (lambda x: x * 0.3, lambda x: x * const(0.3)),
    "shift": (lambda x: x - 1.7, lambda x: x - const(1.7)),
    "share": (lambda x: x / 7.1, lambda x: x / const(7.1)),
    "half power": (lambda x: abs(x) ** 0.7, lambda x: abs(x) ** const(0.7)),
}
BINARY = {
    "add": (lambda x, y: x + y, lambda x, y: x + y),
    "sub": (lambda x, y: x - y, lambda x, y: x - y),
    "mul": (lambda x, y: x * y, lambda x, y: x * y),
    "div": (lambda x, y: x / y, lambda x, y: x / y),
    "max": (jnp.maximum, lambda x, y: x.max(y)),
    "min": (jnp.minimum, lambda x, y: x.min(y)),
    "where": (
        lambda x, y: jnp.where(x < y, x * y, y),
        lambda x, y: x * y if x < y else y if x >= y else arb("nan"),
    ),
}
CHEAP = [
    n
    for n in UNARY
    if n not in ("sin", "cos", "tanh", "atan", "logistic", "expm1", "log1p", "half power", "recip")
]


def composition(rng, size, names):
    """Return a random program of `size` operations on three variables, as a list of (name, operands): each
    may use all before it.
    """
    program, values = [], 3
    for _ in range(size):
        unary = rng.random() < 0.5
        name = rng.choice(names if unary else list(BINARY))
        operands = [
            values - 1 if rng.random() < 0.6 else int(rng.integers(values)) for _ in range(1 if unary else 2)
        ]
        program.append((str(name), operands))
        values += 1
    return program


def run(program, z, which):
    values = list(z)
    for name, operands in program:
        values.append((UNARY | BINARY)[name][which](*(values[i] for i in operands)))
    return values[-1]


def misses(programs, dtype, points):
    """Return how many values could be compared, and those that lie outside their enclosure."""
    F = inclusion(lambda z: [run(program, z, 0) for program in programs])
    enclosed = jax.jit(jax.vmap(F, in_axes=1))(Interval(jnp.asarray(points), jnp.asarray(points)))
    compared, bad = 0, []
    with flint.ctx.workprec(200):
        for program, found in zip(programs, enclosed, strict=True):
            lo, hi = np.asarray(found.lo).astype(float), np.asarray(found.hi).astype(float)
            for k, point in enumerate(points.T.astype(float)):
                value = run(program, [arb(float(v)) for v in point], 1)
                if not value.is_finite() or value.rad() > abs(value.mid()) * arb(2) ** -150 + arb(2) ** -1100:
                    continue
                compared += 1
                if value.upper() < arb(lo[k]) or value.lower() > arb(hi[k]):
                    bad.append((program, point, lo[k], hi[k], value))
    return compared, bad


def points_of(rng, dtype, count):
    """Draw points: near 1, of all magnitudes that compositions survive, and small integers, which meet the
    edges of domains.
    """
    near, wide = (
        rng.uniform(-3, 3, (3, count)),
        rng.choice([-1, 1], (3, count)) * 2.0 ** rng.uniform(-20, 20, (3, count)),
    )
    return np.choose(
        rng.integers(0, 3, (3, count)), [near, wide, rng.integers(-3, 4, (3, count)).astype(float)]
    ).astype(dtype)


# constants of the programs are rounded to the working dtype, so that the oracle's are right for float64 only:
# float32 draws none
PLAIN = [n for n in UNARY if n not in ("scale", "shift", "share", "half power")]


@pytest.mark.parametrize("dtype", DTYPES)
def test_no_random_composition_misses_its_value(dtype, rng):
    names = CHEAP if dtype == np.float64 else [n for n in CHEAP if n in PLAIN]
    programs = [composition(rng, 7, names) for _ in range(4)]
    compared, bad = misses(programs, dtype, points_of(rng, dtype, 300))
    assert not bad, bad[0]
    assert compared > 100


@pytest.mark.long(by_day="test_no_random_composition_misses_its_value")
@pytest.mark.parametrize("dtype", DTYPES)
def test_no_composition_of_many_misses_its_value(dtype, rng):
    names = list(UNARY) if dtype == np.float64 else PLAIN
    total = 0
    for _ in range(4):
        compared, bad = misses(
            [composition(rng, int(rng.integers(6, 11)), names) for _ in range(4)],
            dtype,
            points_of(rng, dtype, 1500),
        )
        assert not bad, bad[0]
        total += compared
    assert total > 4000
