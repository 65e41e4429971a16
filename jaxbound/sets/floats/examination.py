"""All that proofs assume, asked of a device with thousands of numbers: what a new kind of device or compiler
has to pass first.

`probe.measure` asks a little of it before every first verdict; this takes seconds, for each form in which a
compiler meets an operation: what `rounding` assumes, and the `premises` beside it.
"""

import operator
from collections.abc import Callable
from fractions import Fraction
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from jaxbound.sets.floats import rounding, unrolled
from jaxbound.sets.floats.kinds import most_of_a_quotient, plainly_on

__all__ = ["examination", "premises", "reductions"]

EXACTLY = {
    "sum": operator.add,
    "difference": operator.sub,
    "product": operator.mul,
    "quotient": operator.truediv,
}
ONE, SQUARE = 2.84, 5.7  # units that one operation, and the square of a root, may be off; see also `kinds`
CHAINS: dict[str, Callable] = {
    "(a b) c": lambda a, b, c: (a * b) * c,
    "(a / b) / c": lambda a, b, c: (a / b) / c,
    "a b + c": lambda a, b, c: a * b + c,
    "(a + b) c": lambda a, b, c: (a + b) * c,
    "a / (b + c)": lambda a, b, c: a / (b + c),
}


def examination(
    device: jax.Device, dtype: DTypeLike, count: int = 600, seed: int = 0
) -> dict[str, tuple[float, float]]:
    """Return {claim: (what compiled kernels did on a device, the most that is assumed)}, errors in units u.

    Args:
        device: of jax; kernels run on it with the flags in force. dtype: np.float32 or np.float64. count:
            numbers of each kind.
        seed: of the numbers.

    Example:
        >>> import jax, numpy as np
        >>> found = examination(jax.devices("cpu")[0], np.float32, 50)
        >>> all(value <= most for value, most in found.values())
        True
    """
    rng, info = np.random.default_rng(seed), np.finfo(dtype)
    u, smallest = Fraction(float(info.eps)) / 2, Fraction(float(info.tiny))
    limits = dict.fromkeys(EXACTLY, ONE) | {"quotient": most_of_a_quotient(device, dtype)}
    claims: dict[str, tuple[float, float]] = {}

    def numbers(low, high):
        return (np.exp2(rng.uniform(low, high, count)) * rng.choice([-1, 1], count)).astype(dtype)

    def run(f, *x):
        return jax.tree.map(np.asarray, jax.jit(f)(*(jax.device_put(v, device) for v in x)))

    def off(name, got, want, most):
        pairs = zip(got, want, strict=True)
        errors = [float(abs(f - w) / abs(f) / u) if f else float(w != 0) * np.inf for f, w in pairs]
        claims[f"error of {name}"] = max(errors), most

    def never(name, wrong):
        claims[name] = float(np.sum(wrong)), 0.0

    with plainly_on(device):
        a, b = numbers(-40, 40), numbers(-40, 40)
        forms: dict[str, tuple[Callable, np.ndarray]] = {
            "": (lambda f: run(f, a, b), b),
            " by one number": (lambda f: run(f, a, b[:1]), b[:1]),
            " by a scalar": (lambda f: run(f, a, b[0]), b[:1]),
            " by a constant": (lambda f: run(lambda a: f(a, b[0]), a), b[:1]),
        }
        for form, (go, other) in forms.items():
            pairs = list(zip(_exact(a), _exact(np.broadcast_to(other, a.shape)), strict=True))
            for name, f in EXACTLY.items():
                off(f"a {name}{form}", _exact(go(f)), [f(x, y) for x, y in pairs], limits[name])
        positive = [abs(numbers(-8, 8)) for _ in range(3)]
        for name, f in CHAINS.items():
            want = [f(*x) for x in zip(*map(_exact, positive), strict=True)]
            off(name, _exact(run(f, *positive)), want, 2 * (limits["quotient"] if "/" in name else ONE))
        by_one = run(operator.truediv, a, np.ones(count, dtype))  # by which searches keep roundings apart
        never("quotients by one that are another number", by_one != a)
        x = abs(numbers(info.minexp + 1, info.maxexp - 1))
        roots = _exact(run(jnp.sqrt, x))
        off("the square of a root", [r * r for r in roots], _exact(x), SQUARE)
        c, d = numbers(-12, 12), numbers(-12, 12)
        compensated = run(_compensated, c, d)
        C, D, inexact = _exact(c), _exact(d), _exact(compensated[3])
        wanted = {
            "sums that two_sum loses digits of": map(operator.add, C, D),
            "products that two_prod loses digits of": map(operator.mul, C, D),
            "sums of inexact numbers that two_sum loses digits of": map(operator.add, inexact, D),
        }
        for (name, sums), pair in zip(wanted.items(), compensated[:3], strict=True):
            never(name, [s + e != w for s, e, w in zip(*map(_exact, pair), sums, strict=True)])
        small, half = numbers(info.minexp + 1, info.minexp + 4), numbers(-6, -1)
        near = numbers(info.minexp + 1, info.minexp + 4)
        for name, other in {"difference": near, "product": half, "quotient": 1 / half}.items():
            f = EXACTLY[name]
            want = list(map(f, _exact(small), _exact(other)))
            got = _exact(run(f, small, other))
            over = max(abs(g - w) - 2 * u * abs(g) for g, w in zip(got, want, strict=True))
            claims[f"error of a {name} that underflows, in smallest numbers"] = float(over / smallest), 1.0
        signed = run(operator.truediv, small, np.full(count, 2.0 ** (info.maxexp // 2), dtype))
        never("underflows that lose their sign", np.signbit(signed) != np.signbit(small))
        top = run(lambda x: x + x, np.array([info.max, -info.max], dtype))
        never("overflows that are finite", top != [np.inf, -np.inf])
        many = numbers(-4, 4)
        total, terms = _exact([run(jnp.sum, many)])[0], _exact(many)
        share = float(abs(total - sum(terms)) / (count * u * sum(map(abs, terms))))
        claims["error of a sum of many, in units a term"] = share, 1.01
        whole = np.concatenate([rng.uniform(-2000, 2000, count), [0.5, 1.5, -0.5, 0.49, -2.51]]).astype(dtype)
        away = abs(run(jnp.round, whole).astype(float) - whole.astype(float)).max()
        claims["distance of a rounded number"] = float(away), 0.5
        odd = np.where(np.arange(count) % 2, np.nan, np.inf).astype(dtype)
        never("NaN that are lost", ~np.isnan(run(lambda x: (x - x) + 1, odd)))
        compared = run(_comparisons, np.full(count, np.nan, dtype))
        never("comparisons with NaN that are true", compared)
    return claims | premises(device, dtype, seed)


def _compensated(c, d):
    """Return sums and products in two parts, and a number that is free to be fused into one of the sums."""
    inexact = c * d + c
    return rounding.two_sum(c, d), rounding.two_prod(c, d), rounding.two_sum(inexact, d), inexact


SIZES = 16, 300, 5000
"""Numbers of a kernel in one register, in a loop, and shared out among threads."""
MANY = 2**13
"""Numbers of a reduction that XLA hands to a library, with the operations that it alone reads."""


def premises(device: jax.Device, dtype: DTypeLike, seed: int = 0) -> dict[str, tuple[float, float]]:
    """Return {what proofs rest on beside rounding: (how often compiled kernels broke it on a device, 0)};
    see `examination`.

    A number that is searched for without a claim (a gain, a multiplier) may be any, but has to be one for
    all its uses. NaN in what a proof reads has to stay. What is multiplied and then added shows whether the
    product was rounded in between, as the host does it.
    """
    rng, claims = np.random.default_rng(seed), {}
    run = lambda f, *x: jax.tree.map(np.asarray, jax.jit(f)(*(jax.device_put(v, device) for v in x)))
    with plainly_on(device):
        for count in SIZES:
            a, b, c = (rng.uniform(1, 2, count).astype(dtype) for _ in range(3))
            kept = {
                "quotients that are not one number for all uses": lambda a, b: unrolled.stored(a * b),
                "calls that are not kept apart": unrolled.apart(operator.mul),
            }
            for claim, product in kept.items():
                pairs = [
                    run(partial(use, product), a, b, c, np.int32(1))
                    for use in (_beside, _in_a_loop, _in_a_reduction)
                ]
                claims[f"{claim}, of {count}"] = (
                    float(sum((later != number + c).sum() for number, later in pairs)),
                    0.0,
                )
            number, later = run(_carried, a, b, c, np.int32(1))
            claims[f"carries of a loop that are rounded anew, of {count}"] = (
                float((later != number + c).sum()),
                0.0,
            )
        claims |= reductions(rng.uniform(-1, 1, MANY).astype(dtype).reshape(-1, 8), run)
        top = np.full(16, 2.0 ** (np.finfo(dtype).maxexp - 2), dtype)
        twice = run(lambda x, y: jax.lax.optimization_barrier(x / y) / y, top, np.sqrt(top) * 4)
        claims["quotients of quotients that are merged"] = float((twice == 0).sum()), 0.0
    return claims


def _beside(product, a, b, c, times):
    """Return p and p + c (2, N), p a product of a and b, from one loop of the compiled kernel."""
    p = product(a, b)
    return jnp.stack([p, p + c])


def _in_a_loop(product, a, b, c, times):
    """Return as `_beside`, from within a loop in time."""
    return jax.lax.fori_loop(
        0, times, lambda _, x: _beside(product, a, b, c, times), jnp.zeros((2, len(a)), a.dtype)
    )


def _in_a_reduction(product, a, b, c, times):
    """Return as `_beside`, each as the largest of two equal numbers."""
    p = product(a, b)
    return jnp.max(jnp.stack([jnp.stack([p, p + c])] * 2, 1), 1)


def _carried(a, b, c, times):
    """Return (x, x + c) for a product x that a loop carries, as often as `times` says."""
    x = jax.lax.fori_loop(0, times, lambda _, x: a * b, jnp.zeros_like(a))
    return x, x + c


def reductions(x: np.ndarray, run: Callable) -> dict[str, tuple[float, float]]:
    """Return as `premises`, of what proofs read of many numbers: NaN shows in sums and comparisons, infinity
    also in maxima.

    Args:
        x: (N, 8) finite. run: compiles a function and calls it.
    """
    x, bad = x.copy(), np.arange(len(x)) % 5 == 0
    x[bad, 3] = np.nan
    sums, whole = run(_nan_of_rows, x)
    lost = sum((~np.isnan(f[bad])).sum() for f in sums)
    true = sum(f[bad].sum() for f in whole)
    x[bad, 3], x[::7, 2] = np.inf, -np.inf
    most, least = run(_ends_of_rows, x)
    cut = (most != x.max(1)).sum() + (least != x.min(1)).sum()
    return {
        f"sums of {x.size} numbers that lose NaN": (float(lost), 0.0),
        f"comparisons of {x.size} numbers with NaN that are true": (float(true), 0.0),
        f"maxima of {x.size} numbers that lose infinity": (float(cut), 0.0),
    }


def _nan_of_rows(x):
    """Return reductions of rows with a NaN that are no NaN, and comparisons with it that are true."""
    sums = jnp.sum(x, 1), jnp.sum(jnp.abs(x) * 0, 1)
    return sums, (
        jnp.all(x < jnp.inf, 1),
        jnp.all(jnp.abs(x) - 1 < jnp.inf, 1),
        jnp.all(jnp.isfinite(x), 1),
        jnp.all(x == x, 1),
    )


def _ends_of_rows(x):
    return jnp.max(x, 1), jnp.min(x, 1)


def _comparisons(x):
    return [x >= x, x == x, x <= jnp.inf, jnp.abs(x) < jnp.inf, x >= 0, x <= 0, x - 1 >= 0, jnp.isfinite(x)]


def _exact(x):
    return list(map(Fraction, np.asarray(x, float).tolist()))
