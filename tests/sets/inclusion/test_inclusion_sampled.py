"""Ordinary programs of jax.numpy, sampled over many boxes at once: every value lies in its enclosure. A dozen
by default, all of them slow.

The oracle is the program itself, run on numbers: a finite value may be off by a few roundings, nothing else
may be outside.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from jaxbound.sets import Interval, inclusion
from jaxbound.sets.floats.kernel import kernel

MASK = np.array([True, False, True])

FEW = {
    "nanmin": lambda z: jnp.nanmin(jnp.sqrt(z)),
    "nanmean": lambda z: jnp.nan_to_num(jnp.nanmean(jnp.log(z))),
    "isinf": lambda z: jnp.where(jnp.isinf(1 / z), 3.0, z),
    "maximum": lambda z: jnp.nan_to_num(jnp.maximum(jnp.log(z), 0.0), nan=-33.0),
    "inf - inf": lambda z: jnp.nan_to_num(1 / z - 1 / z**2, nan=17.0),
    "mod": lambda z: z % 0.7,
    "sort": lambda z: jnp.nan_to_num(jnp.sort(jnp.log(z)), nan=44.0),
    "heaviside": lambda z: jnp.heaviside(z, 0.5),
    "norm": lambda z: jnp.linalg.norm(z),
    "running max": lambda z: lax.scan(lambda c, x: (jnp.maximum(c, x), c), -jnp.inf, z)[1],
    "carry": lambda z: jnp.nan_to_num(lax.scan(lambda c, x: (c + jnp.sqrt(x), c * 2), 0.0, z)[0], nan=-8.0),
    "pad and roll": lambda z: jnp.nan_to_num(
        jnp.roll(jnp.pad(jnp.log(z), 1, constant_values=jnp.nan), 1), nan=0.5
    ),
}
REST = {
    "nanprod": lambda z: jnp.nanprod(jnp.sqrt(z)),
    "nanstd": lambda z: jnp.nan_to_num(jnp.nanstd(jnp.log(z))),
    "nancumsum": lambda z: jnp.nancumsum(jnp.log(z)),
    "not less": lambda z: jnp.where(~(jnp.sqrt(z) >= -1.0), 10.0, z),
    "predicate": lambda z: jnp.sqrt(z).astype(bool) * 1.0,
    "power": lambda z: jnp.nan_to_num(z**0.7, nan=8.0),
    "powers": lambda z: jnp.nan_to_num(jnp.power(z, z[::-1]), nan=-2.0),
    "0 inf": lambda z: jnp.nan_to_num(z * (1 / z), nan=17.0),
    "remainder": lambda z: jnp.nan_to_num(lax.rem(z, jnp.floor(z)), nan=3.0),
    "max norm": lambda z: jnp.linalg.norm(z, jnp.inf),
    "normalized": lambda z: jnp.nan_to_num(z / jnp.linalg.norm(z)),
    "cummax": lambda z: jnp.nan_to_num(lax.cummax(jnp.log(z)), nan=-1.0),
    "masked softmax": lambda z: jax.nn.softmax(jnp.where(MASK, z, -jnp.inf)),
    "logaddexp": lambda z: jnp.logaddexp(z, z[::-1]),
    "least": lambda z: jnp.min(jnp.where(z > 0, z, jnp.inf)),
    "constant of a scan": lambda z: lax.scan(lambda c, x: (jnp.nan_to_num(c + x * jnp.log(z[0])), c), 0.0, z)[
        1
    ],
    "carry of a while": lambda z: jnp.nan_to_num(
        lax.while_loop(lambda s: s[1] < 3, lambda s: (jnp.sqrt(s[0]) - 0.5, s[1] + 1), (z[0], 0))[0], nan=6.0
    ),
    "cond under vmap": lambda z: jax.vmap(lambda a: lax.cond(jnp.sqrt(a) >= 0, lambda: a, lambda: -3.0))(z),
    "switch": lambda z: lax.switch(
        jnp.clip(z[0].astype(int), 0, 2), [lambda x: x, lambda x: -x, lambda x: jnp.nan_to_num(jnp.log(x))], z
    ),
    "guarded": lambda z: jnp.where(z > 0, jnp.log(jnp.where(z > 0, z, 1.0)), 0.0),
    "sinc": jnp.sinc,
    "angle": lambda z: jnp.arctan2(z, jnp.floor(z[::-1])),
    "concatenate": lambda z: jnp.nanmax(jnp.concatenate([z, jnp.log(z), jnp.array([jnp.nan])])),
    "dot": lambda z: jnp.nan_to_num(jnp.log(z) @ jnp.ones((3, 2)), nan=12.0),
    "prod": lambda z: jnp.nan_to_num(jnp.prod(jnp.log(z)), nan=12.0),
    "scatter": lambda z: jnp.nan_to_num(jnp.zeros(3).at[jnp.array([0, 0, 2])].add(jnp.log(z)), nan=1.0),
    "set": lambda z: jnp.nan_to_num(z.at[1].set(jnp.log(z[0])), nan=1.0),
    "rematerialised": lambda z: jax.checkpoint(jax.jit(lambda v: jnp.nan_to_num(jnp.log(v))))(z),
    "close": lambda z: jnp.isclose(jnp.log(z), 0.1, atol=0.3) * 1.0,
    "any": lambda z: jnp.where(jnp.any(jnp.isnan(jnp.sqrt(z))), 1.0, 0.0),
    "all": lambda z: jnp.where(jnp.all(jnp.isfinite(1 / z)), 1.0, 0.0),
    "xor": lambda z: jnp.where((z > 0) ^ jnp.isnan(jnp.log(z - 1)), 1.0, 2.0),
    "rsqrt": lambda z: jnp.nan_to_num(lax.rsqrt(z), nan=3.0),
    "sine of infinity": lambda z: jnp.nan_to_num(jnp.sin(1 / jnp.floor(z)), nan=2.0),
    "gradient": lambda z: jnp.nan_to_num(
        jax.grad(lambda v: jnp.sum(jnp.where(v > 0, jnp.sqrt(v), 0.0)))(z), nan=2.0
    ),
    "overflow": lambda z: jnp.nan_to_num(jnp.exp(z * 400) * 0.0, nan=5.0),
    "overflow seen": lambda z: jnp.where(jnp.isfinite(jnp.exp(z * 400)), 1.0, 2.0),
}


def boxes(rng, count):
    """Draw boxes in three dimensions around numbers where domains end; many are points in some of them."""
    center = rng.choice([-2.0, -1, -0.5, 0, 0.25, 1, 2, 3], (count, 3))
    radius = rng.choice([0, 0.01, 0.3, 1, 2.5], (count, 3), p=[0.1, 0.2, 0.3, 0.2, 0.2])
    return center - radius * rng.integers(0, 2, (count, 3)), center + radius


@pytest.mark.parametrize(
    "programs",
    [FEW, pytest.param(FEW | REST, marks=(pytest.mark.long, pytest.mark.compiled))],
    ids=["few", "all"],
)
def test_every_value_of_a_program_lies_in_its_enclosure(programs, rng):
    lo, hi = boxes(rng, 24)
    every = lambda z: {name: f(z) for name, f in programs.items()}
    found = kernel(jax.vmap(inclusion(every)))(Interval(jnp.asarray(lo), jnp.asarray(hi)))
    share = np.where(
        rng.random((300, 24, 3)) < 0.6, rng.uniform(0, 1, (300, 24, 3)), rng.choice([0, 0.5, 1], (300, 24, 3))
    )
    z = np.clip(lo + (hi - lo) * share, lo, hi)
    values = kernel(jax.vmap(jax.vmap(every)))(z)
    for name, value in values.items():
        value, (a, b) = np.asarray(value), map(np.asarray, (found[name].lo, found[name].hi))
        slack = 1e-9 * (1 + abs(value))
        with np.errstate(over="ignore", invalid="ignore"):
            missed = np.isfinite(value) & ~((a <= value + slack) & (value - slack <= b))
        assert not missed.any(), (name, z[tuple(np.argwhere(missed)[0][:2])])
