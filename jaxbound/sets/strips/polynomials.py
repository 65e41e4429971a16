"""Polynomials with coefficients of their own in each window: images of boxes, ranges at vertices, zeros that are proved to exist.

    p_k(v, e) = sum_a value[k, a] v^a + sum_j (sum_a spread[k, a, j] v^a) rad[j] e_j,    v in a box of [-1, 1]^n, e in [-1, 1]^m

The exponents a are static, value is (r, K, N) for N windows, spread (r, K, m) is shared by them and rad is (m, N). The exact p_k differ
from these by at most `error`, one bound a row for all v and e (`row_error`), rounding in here included.
"""

import math
from collections.abc import Sequence
from itertools import product
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.unrolled import total

__all__ = ["bends", "image", "multiaffine", "row_error", "slopes", "vertex_gauge", "vertex_margin"]


Exponents: TypeAlias = Sequence[tuple[int, ...]]


NOTHING: list[Any] = [0.0]  # the terms of a sum without any: a number of any dtype


def multiaffine(exponents: Exponents) -> bool:
    """Return whether no variable has an exponent above 1: extremes over a box are then at its vertices."""
    return all(e <= 1 for a in exponents for e in a)


def row_error(value: jax.Array, error: jax.Array, spread: jax.Array, rad: jax.Array, exponents: Exponents) -> jax.Array:
    """Return (r, N): at least |exact p_k - p_k as computed in here| for all |v| <= 1, |e| <= 1.

    Args: error (r, K, N): the exact coefficients, and the noise terms with them, are within error[k, a] |v^a|.

    Proof: on a box mid +- radius inside [-1, 1]^n, up to a rounding, (|mid| + radius)^a is at most 1 + n u; every part of an image or a
    derivative is a sum of at most K + m + order products of at most 2 order + 3 factors, and the sizes of all products add up to at most
    sum_a |value| + sum_j sum_a |spread| rad.
    """
    order, (r, K), m = _order(exponents), value.shape[:2], rad.shape[0]
    gamma, floor = rounding.product_error(2 * K + m + 5 * order + 12, value.dtype)
    size = _sizes(value, spread, rad)
    bound = [total(error[k]) for k in range(r)]
    return jnp.stack([(1 + gamma) * bound[k] + gamma * size[k] + floor * (1 + size[k]) for k in range(r)])


def image(
    value: jax.Array,
    spread: jax.Array,
    rad: jax.Array,
    exponents: Exponents,
    mid: jax.Array | None = None,
    radius: jax.Array | None = None,
    linear: bool = False,
) -> tuple[jax.Array, jax.Array]:
    """Return (c (r, N), G (r, q, N)): p(v, e) is in c + G [-1, 1]^q, up to `row_error`, for all v in mid +- radius and e.

    Every monomial of order 2 and more in the variables of the box is a variable of its own, the noise e_j keeps its direction in the middle
    of the box, and what this changes with v is lumped, row by row. Columns: n variables; further monomials; m noises; r lumps.

    Args:
        mid, radius: (n, N); None: the whole of [-1, 1]^n. linear: only variables and noise, guaranteeing nothing.

    Source: Ploix, Adrot 2006, (14), with what it neglects.
    """
    r, n, m = value.shape[0], len(exponents[0]), rad.shape[0]
    parts = _expansion(exponents, mid, radius)  # {d: {a: factor}}
    units = [tuple(int(i == j) for j in range(n)) for i in range(n)]
    coefficient = lambda d: total([value[:, a] * _row(f) for a, f in parts.get(d, {}).items()] or [jnp.zeros_like(value[:, 0])])
    c = coefficient((0,) * n)
    columns = [coefficient(d) for d in units]
    for d in parts:
        if sum(d) > 1 and not linear:
            even = all(e % 2 == 0 for e in d)
            columns.append(coefficient(d) * (0.5 if even else 1.0))
            c = c + columns[-1] if even else c
    if m:
        for j in range(m):
            columns.append(total(spread[:, a, j, None] * _row(f) for a, f in parts[(0,) * n].items()) * rad[j][None])
        varies = [a for a, alpha in enumerate(exponents) if any(alpha)]
        if varies and not linear:
            within = lambda a: total(jnp.abs(spread[:, a, j, None]) * rad[j][None] for j in range(m))
            lump = total(within(a) * _row(_change(exponents[a], mid, radius)) for a in varies)
            columns += [jnp.where(jnp.arange(r)[:, None] == k, lump, 0) for k in range(r)]
    return c, jnp.stack(columns, 1)


def bends(value: jax.Array, exponents: Exponents, radius: jax.Array) -> jax.Array:
    """Return (n, N): how much each variable of a box adds to what an image does not keep, relative to the rows: where to cut."""
    n = len(exponents[0])
    size = total(value[:, a] * 0 + jnp.abs(value[:, a]) for a in range(len(exponents)))
    share = jnp.abs(value) / jnp.where(size > 0, size, 1)[:, None]
    out = [1e-9 * x for x in radius]
    for a, alpha in enumerate(exponents):
        if sum(alpha) > 1:
            weight = total(share[:, a])
            for i in range(n):
                others = [radius[l] * (e - (l == i)) for l, e in enumerate(alpha) if e > (l == i)]
                out[i] += weight * radius[i] * total(others) if alpha[i] else 0
    return jnp.stack(out)


def slopes(
    value: jax.Array, spread: jax.Array, rad: jax.Array, exponents: Exponents, z: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return (p (r, N), J (r, n + m, N), bend (r, N)) at z = (v, e) (n + m, N): the values, their derivative and a bound on its change.

    bend: at least max_i |J(x) - J(z)|_i / max_i |x_i - z_i| for x, z in the box. Both p and J are within `row_error` of the exact ones, J
    times the order, as long as |z| <= 1.
    """
    n, m, order, count = len(exponents[0]), rad.shape[0], _order(exponents), len(exponents)
    v, e = z[:n], z[n:]
    power = [_power(v, a) for a in exponents]
    w = [value[:, a] + total([spread[:, a, j, None] * (rad[j] * e[j])[None] for j in range(m)] or NOTHING) for a in range(count)]
    p = total(w[a] * _row(power[a]) for a in range(count))
    J = []
    for i in range(n):
        lower = {a: tuple(x - (l == i) for l, x in enumerate(alpha)) for a, alpha in enumerate(exponents) if alpha[i]}
        J.append(total([w[a] * _row(exponents[a][i] * _power(v, b)) for a, b in lower.items()] or [jnp.zeros_like(p)]))
    J += [total(spread[:, a, j, None] * _row(power[a]) for a in range(count)) * rad[j][None] for j in range(m)]
    bend = [order * (order + 1) * x * (1 + 1e-6) for x in _sizes(value, spread, rad)]
    return p, jnp.stack(J, 1), jnp.stack(bend)


def vertex_margin(
    value: jax.Array, spread: jax.Array, rad: jax.Array, exponents: Exponents, error: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return (margin (N,), inside (N,)) of one multi-affine polynomial: margin < 0 is proof that it has no zero, inside that it has one.

    Its range over the box is the interval between its extremes at the vertices. margin is 1 - t, see `vertex_gauge`.
    """
    t, low, high = vertex_gauge(value, spread, rad, exponents, smooth=False)
    outside = (low > error[0]) | (high < -error[0])
    inside = (low < -error[0]) & (high > error[0])
    least = jnp.finfo(t.dtype).eps
    margin = jnp.where(outside, jnp.minimum(1 - t, -least), jnp.where(inside, jnp.maximum(1 - t, least), 0))
    return jnp.where(jnp.isnan(value[0, 0]), jnp.nan, margin), inside


def vertex_gauge(
    value: jax.Array, spread: jax.Array, rad: jax.Array, exponents: Exponents, smooth: bool = True
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return (t, low, high), each (N,), of one multi-affine polynomial: the ends of its range over the box, at the vertices.

    t is the factor on the box at which 0 just belongs to the range, within 2^+-10; not rounded, to about 1e-6. smooth: differentiable.
    """
    n, m = len(exponents[0]), rad.shape[0]
    at = lambda vertex: [math.prod(s**e for s, e in zip(vertex, a, strict=True)) for a in exponents]
    signs = jnp.asarray(np.array([at(vertex) for vertex in product((-1, 1), repeat=n)]), value.dtype)
    order = np.array([sum(a) for a in exponents])
    held = jax.lax.stop_gradient((value, spread, rad))

    def ends(value, spread, rad, t=None):
        """Return the least and largest value over t times the box."""
        scale = [1.0 if t is None else t**k for k in range(order.max() + 2)]
        middle = total(signs[:, a, None] * (value[0, a] * scale[order[a]])[None] for a in range(len(exponents)))
        radius = jnp.zeros_like(middle)
        if m and t is None:
            width = jnp.abs(total(signs[:, a, None] * spread[0, a][None] for a in range(len(exponents))))  # (vertices, m)
            radius = total(width[:, j, None] * rad[j][None] for j in range(m))
        elif m:
            for j in range(m):
                by_order = {
                    k: total(signs[:, a] * spread[0, a, j] for a in np.flatnonzero(order == k)) for k in sorted(set(order.tolist()))
                }
                radius += jnp.abs(total(part[:, None] * (rad[j] * scale[k + 1])[None] for k, part in by_order.items()))
        return jnp.min(middle - radius, 0), jnp.max(middle + radius, 0)

    low, high = ends(value, spread, rad)
    centre = value[0, 0]
    if order.max() <= 1 and not (m and order.max()):
        half = 0.5 * (high - low)
        return jnp.abs(centre) / jnp.where(half > 0, half, 1), low, high

    def nearest(t, parts):
        """Return how far t times the box is from reaching 0."""
        least, most = ends(parts[0], parts[1], parts[2], t)
        return jnp.where(centre > 0, least, -most)

    def halve(_, bracket):
        below, above = bracket
        middle = jnp.sqrt(below * above)
        reached = nearest(middle, held) <= 0
        return jnp.where(reached, below, middle), jnp.where(reached, middle, above)

    one = jnp.ones_like(held[0][0, 0])
    below, above = jax.lax.fori_loop(0, 24, halve, (one * 2.0**-10, one * 2.0**10))
    if not smooth:
        return above, low, high
    slope = jax.jvp(lambda t: nearest(t, held), (above,), (one,))[1]
    slope = jnp.where((slope < 0) & (above < 2.0**10) & (below > 2.0**-10), slope, -jnp.inf)
    t = above - nearest(above, (value, spread, rad)) / slope  # one step of Newton's: its derivative is that of the root
    return jnp.clip(t, below * (1 - 1e-6), above * (1 + 1e-6)), low, high


def _expansion(
    exponents: Exponents, mid: jax.Array | None, radius: jax.Array | None
) -> dict[tuple[int, ...], dict[int, float | jax.Array]]:
    """Return {d: {a: factor}}: (mid + radius w)^a = sum_d factor w^d."""
    out: dict[tuple[int, ...], dict[int, float | jax.Array]] = {}
    for a, alpha in enumerate(exponents):
        if mid is None or radius is None:
            out.setdefault(alpha, {})[a] = 1.0
            continue
        for d in product(*(range(e + 1) for e in alpha)):
            factor: float | jax.Array = float(math.prod(math.comb(e, x) for e, x in zip(alpha, d, strict=True)))
            for i, (e, x) in enumerate(zip(alpha, d, strict=True)):
                for _ in range(e - x):
                    factor = factor * mid[i]
                for _ in range(x):
                    factor = factor * radius[i]
            out.setdefault(d, {})[a] = factor
    return dict(sorted(out.items(), key=lambda item: (sum(item[0]), tuple(-e for e in item[0]))))


def _change(alpha: tuple[int, ...], mid: jax.Array | None, radius: jax.Array | None) -> float | jax.Array:
    """Return at least |v^alpha - mid^alpha| over the box."""
    if mid is None or radius is None:
        return 1.0
    far: float | jax.Array = 1.0
    near: float | jax.Array = 1.0
    for i, e in enumerate(alpha):
        for _ in range(e):
            far, near = far * (jnp.abs(mid[i]) + radius[i]), near * jnp.abs(mid[i])
    return far - near


def _row(x: float | jax.Array) -> float | jax.Array:
    """Return a number a window as a row beside others; a plain number as it is."""
    return x[None] if isinstance(x, jax.Array) else x


def _power(v: jax.Array, alpha: tuple[int, ...]) -> float | jax.Array:
    out: float | jax.Array = 1.0
    for i, e in enumerate(alpha):
        for _ in range(e):
            out = out * v[i]
    return out


def _sizes(value: jax.Array, spread: jax.Array, rad: jax.Array) -> list[jax.Array]:
    """Return sum_a |value| + sum_j sum_a |spread| rad, row by row."""
    noise = jnp.sum(jnp.abs(spread), 1)
    m = rad.shape[0]
    return [total(jnp.abs(value[k])) + total([noise[k, j] * rad[j] for j in range(m)] or NOTHING) for k in range(value.shape[0])]


def _order(exponents: Exponents) -> int:
    return max(1, *map(sum, exponents))
