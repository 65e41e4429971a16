"""Polynomials with coefficients of their own in each window: images of boxes, ranges at vertices, zeros that
are proved to exist.

    p_k(v, e) = sum_a value[k, a] v^a + sum_j (sum_a spread[k, a, j] v^a) rad[j] e_j,    v in a box of [-1,
    1]^n, e in [-1, 1]^m

The exponents a are static, value is (r, K, N) for N windows, spread (r, K, m) is shared by them and rad is
(m, N). The exact p_k differ from these by at most `error`, one bound a row for all v and e (`row_error`),
rounding in here included.
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

Exponents: TypeAlias = Sequence[tuple[int, ...]]


def multiaffine(exponents: Exponents) -> bool:
    """Return whether no variable has an exponent above 1: extremes over a box are then at its vertices."""
    return all(e <= 1 for a in exponents for e in a)


def closure(exponents: Exponents) -> tuple[tuple[int, ...], ...]:
    """Return the monomials that divide one of these, the constant first, then all variables, orders
    ascending: those of a moved origin.
    """
    n = len(exponents[0])
    units = {tuple(int(i == j) for j in range(n)) for i in range(n)}
    divisors = {d for a in exponents for d in product(*(range(e + 1) for e in a))}
    return tuple(sorted(divisors | units, key=lambda a: (sum(a), tuple(-e for e in a))))


def row_error(
    value: jax.Array, error: jax.Array, spread: jax.Array, rad: jax.Array, exponents: Exponents
) -> jax.Array:
    """Return (r, N): at least |exact p_k - p_k as computed in here| for all |v| <= 1, |e| <= 1.

    Args: error (r, K, N): the exact coefficients, and the noise terms with them, are within error[k, a]
    |v^a|.

    Proof: on a box mid +- radius inside [-1, 1]^n, up to a rounding, (|mid| + radius)^a is at most 1 + n u;
    every part of an image or a derivative is a sum of at most K + m + order products of at most 2 order + 3
    factors, and the sizes of all products add up to at most sum_a |value| + sum_j sum_a |spread| rad. Where
    the origin is moved (`_moved`) a product is added to what is there at most `moves` times on its way, E (E
    + 1) / 2 for each variable with exponents up to E; each of at most K E products for a variable may be
    flushed.
    """
    order, K, m = _order(exponents), value.shape[1], rad.shape[0]
    highest = [max(column) for column in zip(*exponents, strict=True)]
    moves, flushed = sum(e * (e + 1) // 2 for e in highest), len(closure(exponents)) * sum(highest)
    gamma, _ = rounding.product_error(2 * K + m + 5 * order + 12 + moves, value.dtype)
    _, floor = rounding.product_error(2 * K + m + 5 * order + 12 + flushed, value.dtype)
    size = _sizes(value, spread, rad)
    return (1 + gamma) * jnp.sum(error, 1) + gamma * size + floor * (1 + size)


def image(
    value: jax.Array,
    spread: jax.Array,
    rad: jax.Array,
    exponents: Exponents,
    mid: jax.Array | None = None,
    radius: jax.Array | None = None,
) -> tuple[jax.Array, jax.Array]:
    """Return (c (r, N), G (r, q, N)): p(v, e) is in c + G [-1, 1]^q, up to `row_error`, for all v in mid +-
    radius and e.

    Every monomial of order 2 and more in the variables of the box is a variable of its own, the noise e_j
    keeps its direction in the middle of the box, and what this changes with v is lumped, row by row. Columns:
    n variables; further monomials, of a box those of `closure`; m noises; r lumps.

    Args:
        mid, radius: (n, N); None: the whole of [-1, 1]^n.

    Source: Ploix, Adrot 2006, (14), with what it neglects.
    """
    r, m, degrees = value.shape[0], rad.shape[0], closure(exponents)
    if mid is None or radius is None:
        degrees = tuple(d for d in degrees if d in exponents or sum(d) == 1)
    value, spread = _among(value, exponents, degrees), _among(spread, exponents, degrees)
    columns = [value[:, k] for k in range(len(degrees))]
    at: list[Any] = [1.0]
    change: list[Any] = [1.0] * len(degrees)
    if mid is not None and radius is not None:
        own, far, at = (_powers(v, degrees) for v in (radius, jnp.abs(mid) + radius, mid))
        columns = [x * _row(own[k]) for k, x in enumerate(_moved(columns, degrees, mid))]
        change = [x - jnp.abs(y) for x, y in zip(far, at, strict=True)]
    c, G = columns[0], columns[1:]
    for k, d in enumerate(degrees[1:]):
        if all(e % 2 == 0 for e in d):
            G[k] = 0.5 * G[k]
            c = c + G[k]
    if m:
        noise = _noise(spread, rad, at)
        G += [noise[:, j] for j in range(m)]
        if len(degrees) > 1:
            within = jnp.sum(jnp.abs(spread)[..., None] * rad[None, None], 2)
            lump = total(within[:, k] * _row(change[k]) for k in range(1, len(degrees)))
            G += [jnp.where(np.arange(r)[:, None] == k, lump, 0) for k in range(r)]
    return c, jnp.stack(G, 1)


def bends(value: jax.Array, exponents: Exponents, radius: jax.Array) -> jax.Array:
    """Return (n, N): how much each variable of a box adds to what an image does not keep, relative to the
    rows: where to cut.
    """
    n = len(exponents[0])
    size = jnp.sum(jnp.abs(value), 1)
    weight = jnp.sum(jnp.abs(value) / jnp.where(size > 0, size, 1)[:, None], 0)
    out = [1e-9 * x for x in radius]
    for a, alpha in enumerate(exponents):
        for i in range(n):
            others = [radius[l] * (e - (l == i)) for l, e in enumerate(alpha) if e > (l == i)]
            if alpha[i] and others:
                out[i] += weight[a] * radius[i] * total(others)
    return jnp.stack(out)


def slopes(
    value: jax.Array, spread: jax.Array, rad: jax.Array, exponents: Exponents, z: jax.Array
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Return (p (r, N), J (r, n + m, N), bend (r, N)) at z = (v, e) (n + m, N): the values, their derivative
    and a bound on its change.

    p and the derivatives by v are the first coefficients of the polynomial with its origin moved to v.

    bend: at least max_i |J(x) - J(z)|_i / max_i |x_i - z_i| for x, z in the box. Both p and J are within
    `row_error` of the exact ones, J times the order, as long as |z| <= 1.
    """
    n, m, order, kept = len(exponents[0]), rad.shape[0], _order(exponents), closure(exponents)
    bend = order * (order + 1) * _sizes(value, spread, rad) * (1 + 1e-6)
    value, spread = _among(value, exponents, kept), _among(spread, exponents, kept)
    if m:
        e = rad * z[n:]
        value = value + total(spread[:, :, j, None] * e[j][None, None] for j in range(m))
    moved = _moved([value[:, k] for k in range(len(kept))], kept, z[:n])
    J = jnp.stack(moved[1 : n + 1], 1) if n else jnp.zeros((len(value), 0, z.shape[1]), z.dtype)
    if m:
        J = jnp.concatenate([J, _noise(spread, rad, _powers(z[:n], kept))], 1)
    return moved[0], J, bend


def vertex_margin(
    value: jax.Array, spread: jax.Array, rad: jax.Array, exponents: Exponents, error: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return (margin (N,), inside (N,)) of one multi-affine polynomial: margin < 0 is proof that it has no
    zero, inside that it has one.

    Its range over the box is the interval between its extremes at the vertices. margin is 1 - t, see
    `vertex_gauge`.
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
    """Return (t, low, high), each (N,), of one multi-affine polynomial: the ends of its range over the box,
    at the vertices.

    t is the factor on the box at which 0 just belongs to the range, within 2^+-10; not rounded, to about
    1e-6. smooth: differentiable.
    """
    n, m = len(exponents[0]), rad.shape[0]
    at = lambda vertex: [math.prod(s**e for s, e in zip(vertex, a, strict=True)) for a in exponents]
    signs = jnp.asarray(np.array([at(vertex) for vertex in product((-1, 1), repeat=n)]), value.dtype)
    order = np.array([sum(a) for a in exponents])
    constants = jax.lax.stop_gradient((value, spread, rad))

    def ends(value, spread, rad, t=1.0):
        """Return the least and largest value over t times the box."""
        scale = [t**k for k in range(order.max() + 2)]
        middle = total(
            signs[:, a, None] * (value[0, a] * scale[order[a]])[None] for a in range(len(exponents))
        )
        radius = jnp.zeros_like(middle)
        for j in range(m):
            by_order = {
                k: total(signs[:, a] * spread[0, a, j] for a in np.flatnonzero(order == k))
                for k in sorted(set(order.tolist()))
            }
            radius += jnp.abs(
                total(part[:, None] * (rad[j] * scale[k + 1])[None] for k, part in by_order.items())
            )
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
        reached = nearest(middle, constants) <= 0
        return jnp.where(reached, below, middle), jnp.where(reached, middle, above)

    one = jnp.ones_like(constants[0][0, 0])
    below, above = jax.lax.fori_loop(0, 24, halve, (one * 2.0**-10, one * 2.0**10))
    if not smooth:
        return above, low, high
    slope = jax.jvp(lambda t: nearest(t, constants), (above,), (one,))[1]
    slope = jnp.where((slope < 0) & (above < 2.0**10) & (below > 2.0**-10), slope, -jnp.inf)
    t = (
        above - nearest(above, (value, spread, rad)) / slope
    )  # one step of Newton's: its derivative is that of the root
    return jnp.clip(t, below * (1 - 1e-6), above * (1 + 1e-6)), low, high


def _among(x: jax.Array, exponents: Exponents, kept: Exponents) -> jax.Array:
    """Return the coefficients (r, K, ...) of other monomials, 0 where a monomial is new."""
    if tuple(exponents) == tuple(kept):
        return x
    number = {a: k for k, a in enumerate(exponents)}
    padded = jnp.concatenate([x, jnp.zeros_like(x[:, :1])], 1)
    return padded[:, np.array([number.get(d, len(exponents)) for d in kept])]


def _moved(rows: Sequence[jax.Array], kept: Exponents, mid: jax.Array) -> list[jax.Array]:
    """Return the coefficients of p(mid + w) as a polynomial in w, from the rows of p: Horner's scheme, one
    variable after the other.
    """
    rows, number = list(rows), {a: k for k, a in enumerate(kept)}
    for i, column in enumerate(zip(*kept, strict=True)):
        above = {a: (*a[:i], a[i] + 1, *a[i + 1 :]) for a in kept}
        for first in range(max(column)):
            for e in range(max(column) - 1, first - 1, -1):
                for a in kept:
                    if a[i] == e and above[a] in number:
                        rows[number[a]] = rows[number[a]] + rows[number[above[a]]] * mid[i][None]
    return rows


def _powers(v: jax.Array, kept: Exponents) -> list[Any]:
    """Return v^a of v (n, N) for all monomials, each from one of a lower order."""
    out: dict[tuple[int, ...], Any] = {kept[0]: 1.0}
    for a in kept[1:]:
        i = next(i for i, e in enumerate(a) if e)
        out[a] = out[*a[:i], a[i] - 1, *a[i + 1 :]] * v[i]
    return [out[a] for a in kept]


def _noise(spread: jax.Array, rad: jax.Array, at: Sequence[Any]) -> jax.Array:
    """Return the columns (r, m, N) of the noises where the monomials have the values `at`."""
    return total(spread[:, k, :, None] * _row(_row(x)) for k, x in enumerate(at)) * rad[None]


def _row(x: Any) -> Any:
    """Return numbers of windows as a row beside others; a plain number as it is."""
    return x[None] if isinstance(x, jax.Array) else x


def _sizes(value: jax.Array, spread: jax.Array, rad: jax.Array) -> jax.Array:
    """Return sum_a |value| + sum_j sum_a |spread| rad, row by row."""
    return jnp.sum(jnp.abs(value), 1) + jnp.sum(jnp.sum(jnp.abs(spread), 1)[..., None] * rad[None], 1)


def _order(exponents: Exponents) -> int:
    return max(1, *map(sum, exponents))
