"""A physical model, linear around a working point: what the linear model leaves out becomes a bounded
disturbance.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from fractions import Fraction
from math import ceil, floor
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.exact.linalg import Number, rational
from jaxbound.models.discretise import Affine, decimals, held
from jaxbound.models.remainder import derivatives, plane
from jaxbound.models.signals import Each
from jaxbound.models.system import LinearSystem
from jaxbound.models.uncertainty import Uncertainty
from jaxbound.sets.floats.probe import refuse_unverified

__all__ = ["linearize"]


def linearize(
    f: Callable[..., jax.Array],
    x0: Each,
    u0: Each | None = None,
    dt: Number = 1.0,
    *,
    region: Mapping[str, Any],
    output: Callable[..., jax.Array] | None = None,
    parameters: Mapping[str, Sequence[Number]] | None = None,
    varying: bool = True,
    continuous: bool = True,
    **bounds: Any,
) -> LinearSystem:
    """Return a LinearSystem that holds, with a bounded disturbance, wherever a nonlinear model stays in a
    region.

    Args:
        f: f(x, u), or f(x, u, p) with parameters, in JAX: dx/dt, or x+ with continuous=False. x (n,), u (m,),
            p {name: number}, value (n,), in engineering units.
        x0, u0: working point (n,), (m,); u0 None: no inputs. It becomes the offset of the model; it need not
            be an equilibrium.
        dt: sampling period in seconds (the unit of time of f). Inputs are held over one period.
        region: {"x": .., "u": ..}: where the model is to hold. One number, or one a signal: radii around x0,
            u0; (n, 2), (m, 2): lo, hi.
        output: h(x, u), or h(x, u, p), value (p,); None: every state is measured.
        parameters: {name: (lo, hi)} of numbers in f and h of which only bounds are known. As far as they act
            linearly on the matrices they become uncertainties of the model, in their own units; the rest
            counts to the disturbance. With x0 = u0 = 0 (and a region elsewhere) a model that is linear but
            for its parameters leaves nothing to the disturbance.
        varying: True if parameters may change from sample to sample (not within one), False if they keep one
            value over a window.
        continuous: False if f gives the next state.
        bounds: every other argument of `LinearSystem`: tolerance, noise, inputs, outputs, states, units,
            disturbance, ...

    Returns:
        A LinearSystem with offset {"u": u0, "y": h(x0, u0)}. Its disturbance acts on every state, [lo, hi]
        around the constant part of f; what an output has beyond its linear part is added to its noise.
        `provenance` names the region.

    Raises:
        ValueError: f or h is not proved to be continuous with bounded slopes over the region, shapes that do
            not fit.
        NotImplementedError: f uses a JAX primitive that `inclusion` has no rule for.

    Encloses: every trajectory of f with inputs constant over each step whose state stays in the region,
    between samples too, is a
        trajectory of the model, rounding and the matrix exponential included. Of one that leaves the region
        nothing is said.

    Example:
        >>> import jax.numpy as jnp
        >>> tank = lambda x, u: jnp.array([0.1 * u[0] - 0.05 * jnp.sqrt(x[0])])  # level and inflow
        >>> near = {"x": 0.2, "u": 0.1}
        >>> m = linearize(tank, [1.0], [0.5], dt=2.0, region=near, states=["level"], noise=0.005)
        >>> lo, hi = m.disturbance[0]
        >>> print(f"{float(m.A[0][0]):.4f} {float(m.B[0][0]):.4f} [{float(lo):.6f}, {float(hi):.6f}]")
        0.9512 0.1951 [-0.000000, 0.000544]
    """
    refused = sorted(set(bounds) & {"E", "offset", "uncertainties"})
    if refused:
        raise ValueError(f"linearize itself finds {', '.join(refused)}: give x0, u0 and parameters instead")
    refuse_unverified()
    at_x, at_u, period = _point("x0", x0), _point("u0", () if u0 is None else u0), rational(dt)
    n, m = len(at_x), len(at_u)
    if not n or period <= 0:
        raise ValueError(
            f"linearize needs at least one state and a positive dt: {n} states, dt={float(period):g}"
        )
    names, between = _parameters(parameters)
    signals = [*_names(bounds, "states", n, "x"), *_names(bounds, "inputs", m, "u")]
    if (
        not isinstance(region, dict)
        or set(region) - {"x", "u"}
        or "x" not in region
        or (m and "u" not in region)
    ):
        raise ValueError(f'region needs the fields "x" and, with inputs, "u": not {region!r}')
    box = [*_box("x", region["x"], at_x), *(_box("u", region["u"], at_u) if m else ()), *between]
    call = lambda function: _Call(function, n, m, names)

    g = _about(call(f), box, [*at_x, *at_u], "f", n, signals)
    g = held(g, n, period) if continuous else replace(g, constant=g.constant - np.array(at_x, object))
    g, at_zero = _at_zero(g, middles := _middles(between))
    given, y0 = dict(bounds), at_x
    seen, seen_at_zero = (
        0 * g.change,
        np.array([[Fraction(i == j) for j in range(n + m)] for i in range(n)], object),
    )
    if output is None:
        given.setdefault("outputs", tuple(signals[:n]) if "states" in bounds else None)
    else:
        seen, seen_at_zero, y0, given["noise"] = _measured(call(output), box, [*at_x, *at_u], middles, bounds)
    ranges = [
        f"{s} in [{float(a):g}, {float(b):g}]" for s, (a, b) in zip([*signals, *names], box, strict=True)
    ]
    where = f"linearized over {', '.join(ranges)}"
    sides = {
        "model": where,
        "disturbance": where,
        **({"noise": f"as given, plus what was {where}"} if output is not None else {}),
    }
    given["provenance"] = {**sides, **dict(bounds.get("provenance") or {})}
    given["disturbance"] = _disturbed(g, n, bounds.get("disturbance"))
    uncertainties = []
    for k, name in enumerate(names):
        parts = {"A": g.change[:, k, :n], "B": g.change[:, k, n:], "C": seen[:, k, :n], "D": seen[:, k, n:]}
        parts = {letter: part.tolist() for letter, part in parts.items() if part.size and (part != 0).any()}
        if parts:
            uncertainties.append(Uncertainty(name, **parts, varying=varying, between=between[k]))
    (A, B), (C, D) = (np.split(matrix, [n], axis=1) for matrix in (at_zero, seen_at_zero))
    return LinearSystem(
        A.tolist(),
        B.tolist() if m else None,
        C.tolist(),
        D.tolist() if m else None,
        period,
        uncertainties=uncertainties,
        offset={"u": list(at_u), "y": list(y0)},
        **given,
    )


@dataclass(frozen=True)
class _Call:
    """f(x, u, p) as a function of one array, (x, u, p) joined."""

    f: Any
    n: int
    m: int
    names: tuple

    def __call__(self, z: jax.Array) -> jax.Array:
        x, u, p = z[: self.n], z[self.n : self.n + self.m], z[self.n + self.m :]
        value = self.f(x, u, *([{name: p[k] for k, name in enumerate(self.names)}] if self.names else []))
        return jnp.ravel(jnp.asarray(value, z.dtype))


@dataclass(frozen=True)
class _Parts:
    """f at the middle of the parameters, then its derivatives by each of them wherever they are.

    f(x, u, p) = f(x, u, middle) + sum_k pi_k times values that the k-th derivative takes between the middle
    and p.
    """

    f: _Call
    middles: tuple

    def __call__(self, z: jax.Array) -> jax.Array:
        here = len(z) - len(self.middles)
        by = derivatives(lambda p: self.f(jnp.concatenate([z[:here], p])))(z[here:])
        return jnp.concatenate(
            [self.f(jnp.concatenate([z[:here], jnp.array(self.middles, z.dtype)])), by.T.ravel()]
        )


def _about(f, box, origin, letter, rows, labels):
    """Return the Affine of a function over a box, about the working point."""
    lo, hi = (np.array(ends, object) for ends in zip(*box, strict=True))
    here, origin = len(origin), np.array(origin, object)
    (count,) = jax.eval_shape(f, jnp.zeros(len(box))).shape
    if rows is not None and count != rows:
        raise ValueError(f"{letter} must return one number for each of the {rows} states: it returns {count}")
    q, middles = len(box) - here, _middles(box[here:])
    found = plane(_Parts(f, middles), lo, hi, q, (f,)) if q else plane(f, lo, hi)
    loose = sorted(
        {i % count for i, ends in enumerate(found.remainder) if not np.isfinite(ends.astype(float)).all()}
    )
    if loose:
        which = ", ".join(map(str, (labels[i] if rows else i + 1 for i in loose)))
        raise ValueError(
            f"{letter} is not proved to be continuous with bounded slopes all over the region (its value for "
            f"{which}): choose a region without jumps, poles and roots of 0"
        )
    low, high = found.remainder.T  # the plane is about the middle of the box: move it
    middle, rad = (
        (found.slopes[:, :here] @ (origin - found.centre[:here]) + (low + high) / 2),
        (high - low) / 2,
    )
    by = lambda part: np.moveaxis(part[count:].reshape(q, count, *part.shape[1:]), 0, 1)
    spread = np.array(
        [max(b - c, c - a) for (a, b), c in zip(box[here:], map(Fraction, middles), strict=True)], object
    )
    return Affine(
        middle[:count],
        found.slopes[:count, :here],
        by(middle),
        by(found.slopes[:, :here]),
        rad[:count] + by(rad) @ spread,
        lo[:here] - origin,
        hi[:here] - origin,
        spread,
    )


def _middles(between):
    """Return floats near the middles of pairs: what the parameters are counted from."""
    return tuple(float(np.asarray((a + b) / 2, jnp.result_type(float))) for a, b in between)


def _measured(h, box, origin, middles, bounds):
    """Return the coefficients of parameters in the outputs, their matrix at 0, their values at the working
    point, and the noise with the rest.
    """
    there = np.asarray(h(jnp.asarray(np.array([*origin, *middles], float))))
    if not np.isfinite(there).all():
        raise ValueError(f"the outputs at the working point must be numbers, not {there.tolist()}")
    y0 = [rational(float(y)) for y in there]
    g, at_zero = _at_zero(_about(h, box, origin, "output", None, None), middles)
    reach = abs(g.constant - np.array(y0, object)) + g.remainder
    factor = [1 + t for t in _each("tolerance", bounds.get("tolerance", 0), len(y0))]
    noise = _each("noise", bounds.get("noise", 0), len(y0))
    return (
        g.change,
        at_zero,
        y0,
        [b + _rounded(t * r, r, ceil) for b, t, r in zip(noise, factor, reach, strict=True)],
    )


def _at_zero(g, middles):
    """Return g and its matrix at the value 0 of every parameter, in decimals of floats; what they round away
    goes to the remainder.
    """
    g = decimals(g)
    move = sum((Fraction(c) * g.change[:, k] for k, c in enumerate(middles)), 0 * g.matrix)
    zero = decimals(replace(g, matrix=g.matrix - move))
    return zero, zero.matrix


def _disturbed(g, n, more):
    """Return the disturbance of the model: one for each state, around the constant, and what the caller
    adds.
    """
    G = [[int(i == j) for j in range(n)] for i in range(n)]
    bound = [
        (_rounded(c - r, r, floor), _rounded(c + r, r, ceil))
        for c, r in zip(g.constant, g.remainder, strict=True)
    ]
    if more is None:
        return G, bound
    extra = LinearSystem(G, None, G, disturbance=more)  # reads every form of a disturbance
    return [[*row, *added] for row, added in zip(G, extra.G, strict=True)], [*bound, *extra.disturbance]


def _rounded(x, width, direction):
    """Return a short decimal beyond x, floor or ceil, away by less than a millionth of the width."""
    if not width:
        return x
    tick = Fraction(10) ** ((Decimal(width.numerator) / Decimal(width.denominator)).adjusted() - 6)
    return direction(x / tick) * tick


def _point(field, values):
    try:
        return [rational(x) for x in (values if np.ndim(values) else [values])]
    except ValueError as e:
        raise ValueError(f"{field}: {e}") from None


def _each(field, value, count):
    values = _point(field, value)
    if len(values) not in (1, count):
        raise ValueError(f"{field} needs one number, or one for each of {count} outputs: {len(values)} given")
    return values * count if len(values) < count else values


def _names(bounds, field, count, letter):
    given = bounds.get(field)
    names = (
        [f"{letter}{i + 1}" for i in range(count)]
        if given is None
        else [given]
        if isinstance(given, str)
        else list(map(str, given))
    )
    if len(names) != count:
        raise ValueError(f"{field} needs {count} names, one for each: {len(names)} given")
    return names


def _parameters(given):
    """Return the names and their bounds as pairs of Fractions."""
    names, between = tuple(map(str, given or {})), []
    for name, ends in dict(given or {}).items():
        if np.shape(ends) != (2,):
            raise ValueError(f"parameter {name!r} needs its lowest and its highest value, not {ends!r}")
        lo, hi = _point(f"parameter {name!r}", ends)
        if lo >= hi:
            raise ValueError(f"parameter {name!r} needs lo < hi, not [{float(lo):g}, {float(hi):g}]")
        between.append((lo, hi))
    return names, between


def _box(field, given, centre):
    """Return pairs (lo, hi) of Fractions: radii around the centre, or pairs as given."""
    k = len(centre)
    if np.shape(given) == (k, 2):
        pairs = [tuple(_point(f"region {field}", pair)) for pair in given]
    else:
        radii = _point(f"region {field}", given)
        if len(radii) not in (1, k):
            raise ValueError(
                f"region {field} needs one radius, {k} radii or {k} pairs lo, hi: its shape is "
                f"{np.shape(given)}"
            )
        pairs = [(c - r, c + r) for c, r in zip(centre, radii * k if len(radii) < k else radii, strict=True)]
    for i, (lo, hi) in enumerate(pairs):
        if lo > hi:
            raise ValueError(
                f"region {field} needs lo <= hi and radii >= 0: entry {i + 1} is [{float(lo):g}, "
                f"{float(hi):g}]"
            )
    return pairs
