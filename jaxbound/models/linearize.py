"""A physical model, linear around a working point: what the linear model leaves out becomes a bounded
disturbance.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from fractions import Fraction
from math import ceil, floor
from typing import Any, TypeAlias, cast

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from jaxbound.exact.linalg import Matrix, Number, beside, identity, rational
from jaxbound.models.discretise import Affine, decimals, held
from jaxbound.models.numbers import ordered_pair
from jaxbound.models.remainder import Plane, derivatives, plane
from jaxbound.models.signals import Each, named, sensors
from jaxbound.models.system import LinearSystem
from jaxbound.models.uncertainty import Uncertainty
from jaxbound.models.unknown import Bounded
from jaxbound.sets.floats.probe import where_proofs_hold
from jaxbound.sets.inclusion.functions import frozen

Ends: TypeAlias = list[tuple[Fraction, Fraction]]
"""A box: (lo, hi) of each entry."""


@where_proofs_hold()
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
    at_x, at_u, period = _exact_values("x0", x0), _exact_values("u0", () if u0 is None else u0), rational(dt)
    n, m = len(at_x), len(at_u)
    if not n or period <= 0:
        raise ValueError(
            f"linearize needs at least one state and a positive dt: {n} states, dt={float(period):g}"
        )
    if bounds.get("times"):
        raise ValueError(
            "linearize takes no times: what it adds to the noise for its remainder must not be times a factor"
        )
    between = _parameters(parameters)
    names = tuple(between)
    states = named("states", bounds.get("states"), n, "x")
    inputs = named("inputs", bounds.get("inputs"), m, "u")
    box = [*_region(region, at_x, at_u), *between.values()]
    middles = _near_middles(list(between.values()))
    where = f"linearized over {_box_text([*states, *inputs, *names], box)}"
    arguments, origins = dict(bounds), {"model": where, "disturbance": where}

    g = _about(_Call(frozen(f), n, m, names), box, [*at_x, *at_u], "f", n, [*states, *inputs])
    if continuous:
        g = held(g, n, period)
    else:
        # states count from x0, the next one as well
        g = replace(g, constant=g.constant - np.array(at_x, object))
    g, dynamics = _at_zero(g, middles)
    arguments["disturbance"] = _disturbed(g, n, bounds.get("disturbance"))

    if output is None:  # y = x
        y0, change = at_x, 0 * g.change
        readout = np.array(identity(n + m), object)[:n]
        if "states" in bounds:
            arguments.setdefault("outputs", states)
    else:
        seen = _measured(_Call(frozen(output), n, m, names), box, [*at_x, *at_u], middles, bounds)
        readout, change, y0 = seen.matrix, seen.change, seen.values
        # no disturbance acts on outputs: what the plane leaves of h widens their noise
        arguments["noise"] = seen.noise
        origins["noise"] = f"as given, plus what was {where}"

    uncertainties = []
    for k, name in enumerate(names):
        parts = _nonzero_parts(g.change[:, k], change[:, k], n)
        if parts:
            uncertainties.append(Uncertainty(name, **parts, varying=varying, between=between[name]))
    arguments["provenance"] = origins | dict(bounds.get("provenance") or {})
    return LinearSystem(
        dynamics[:, :n].tolist(),
        dynamics[:, n:].tolist() if m else None,
        readout[:, :n].tolist(),
        readout[:, n:].tolist() if m else None,
        period,
        uncertainties=uncertainties,
        offset={"u": at_u, "y": y0},
        **arguments,
    )


def _region(region: Mapping[str, Any], at_x: list[Fraction], at_u: list[Fraction]) -> Ends:
    """Return the box of states and inputs in which the model is to hold."""
    known = isinstance(region, dict) and set(region) <= {"x", "u"}
    if not known or "x" not in region or (at_u and "u" not in region):
        raise ValueError(f'region needs the fields "x" and, with inputs, "u": not {region!r}')
    box = _box("x", region["x"], at_x)
    if at_u:
        box += _box("u", region["u"], at_u)
    return box


def _box_text(names: Sequence[str], box: Ends) -> str:
    """Return a box in words."""
    texts = []
    for name, (lo, hi) in zip(names, box, strict=True):
        texts.append(f"{name} in [{float(lo):g}, {float(hi):g}]")
    return ", ".join(texts)


def _nonzero_parts(on_states: np.ndarray, on_outputs: np.ndarray, n: int) -> dict[str, list[list[Fraction]]]:
    """Return {letter: coefficients} of a parameter in the matrices on which it acts."""
    parts = {"A": on_states[:, :n], "B": on_states[:, n:], "C": on_outputs[:, :n], "D": on_outputs[:, n:]}
    return {letter: part.tolist() for letter, part in parts.items() if (part != 0).any()}


@dataclass(frozen=True)
class _Call:
    """f(x, u, p) as a function of one array, (x, u, p) joined."""

    f: Callable[..., jax.Array]
    n: int
    m: int
    names: tuple[str, ...]

    def __call__(self, z: jax.Array) -> jax.Array:
        x, u, p = z[: self.n], z[self.n : self.n + self.m], z[self.n + self.m :]
        if self.names:
            value = self.f(x, u, dict(zip(self.names, p, strict=True)))
        else:
            value = self.f(x, u)
        return jnp.ravel(jnp.asarray(value, z.dtype))


@dataclass(frozen=True)
class _Parts:
    """f at the middle of the parameters, then its derivatives by each of them wherever they are.

    f(x, u, p) = f(x, u, middle) + sum_k pi_k times values that the k-th derivative takes between the middle
    and p.
    """

    f: _Call
    middles: tuple[float, ...]

    def __call__(self, z: jax.Array) -> jax.Array:
        here = len(z) - len(self.middles)
        by = derivatives(lambda p: self.f(jnp.concatenate([z[:here], p])))(z[here:])
        middle = jnp.concatenate([z[:here], jnp.array(self.middles, z.dtype)])
        return jnp.concatenate([self.f(middle), by.T.ravel()])


def _about(
    f: _Call, box: Ends, point: list[Fraction], letter: str, rows: int | None, labels: Sequence[str]
) -> Affine:
    """Return the Affine of a function over a box, about the working point.

    Args:
        letter: of the function, in sentences. rows: how many numbers it must return, None: any. labels: of
            them.
    """
    lo, hi = (np.array(ends, object) for ends in zip(*box, strict=True))
    here, origin = len(point), np.array(point, object)
    (count,) = jax.eval_shape(f, jnp.zeros(len(box))).shape
    if rows is not None and count != rows:
        raise ValueError(f"{letter} must return one number for each of the {rows} states: it returns {count}")
    between = box[here:]
    q, middles = len(between), _near_middles(between)
    if q:
        near = plane(_Parts(f, middles), lo, hi, q, (f,))
    else:
        near = plane(f, lo, hi)
    _refuse_unbounded(near, count, letter, labels if rows else [])

    def by(part: np.ndarray) -> np.ndarray:
        """Return (count, q, ...): the rows that belong to derivatives by parameters."""
        return np.moveaxis(part[count:].reshape(q, count, *part.shape[1:]), 0, 1)

    low, high = near.remainder.T
    slopes, radius = near.slopes[:, :here], (high - low) / 2
    middle = slopes @ (origin - near.centre[:here]) + (low + high) / 2  # the plane was about that of the box
    spread = np.zeros(q, object)
    for k, ((a, b), c) in enumerate(zip(between, map(Fraction, middles), strict=True)):
        spread[k] = max(b - c, c - a)
    return Affine(
        constant=middle[:count],
        matrix=slopes[:count],
        shift=by(middle),
        change=by(slopes),
        remainder=radius[:count] + by(radius) @ spread,
        low=lo[:here] - origin,
        high=hi[:here] - origin,
        spread=spread,
    )


def _refuse_unbounded(near: Plane, count: int, letter: str, labels: Sequence[str]) -> None:
    """Raise ValueError where a plane has no bounded remainder. labels: of the values, [] for numbers."""
    loose = set()
    for i, ends in enumerate(near.remainder):
        if not np.isfinite(ends.astype(float)).all():
            loose.add(i % count)
    if not loose:
        return
    names = labels or [str(i + 1) for i in range(count)]
    which = ", ".join(names[i] for i in sorted(loose))
    raise ValueError(
        f"{letter} is not proved to be continuous with bounded slopes all over the region (its value for "
        f"{which}): choose a region without jumps, poles and roots of 0"
    )


def _near_middles(between: Ends) -> tuple[float, ...]:
    """Return floats near the middles of pairs, from which the parameters are counted."""
    return tuple(float(np.asarray((a + b) / 2, jnp.result_type(float))) for a, b in between)


@dataclass(frozen=True, eq=False)
class _Readout:
    """The outputs, linear.

    Fields: change (p, q, N): coefficients of parameters; matrix (p, N): at the value 0 of all of them;
    values: at the working point; noise: with all that the linear part leaves out.
    """

    change: np.ndarray
    matrix: np.ndarray
    values: list[Fraction]
    noise: list[Fraction]


def _measured(
    h: _Call, box: Ends, origin: list[Fraction], middles: tuple[float, ...], bounds: Mapping[str, Any]
) -> _Readout:
    """Return the outputs of a function over a box, linear around the working point."""
    there = np.asarray(h(jnp.asarray(np.array([*origin, *middles], float))))
    if not np.isfinite(there).all():
        raise ValueError(f"the outputs at the working point must be numbers, not {there.tolist()}")
    y0 = [rational(float(y)) for y in there]
    g, matrix = _at_zero(_about(h, box, origin, "output", None, []), middles)
    outputs = named("outputs", bounds.get("outputs"), len(y0), "y")
    own = sensors(outputs, bounds.get("tolerance", 0), bounds.get("noise", 0), None, False)
    noise = list(own.noise)
    # the plane need not go through the output at the working point, which is the offset
    left_out = abs(g.constant - np.array(y0, object)) + g.remainder
    for i, reach in enumerate(left_out):  # a sensor multiplies it by 1 + theta
        noise[i] += _rounded((1 + own.tolerance[i]) * reach, reach, ceil)
    return _Readout(g.change, matrix, y0, noise)


def _at_zero(g: Affine, middles: tuple[float, ...]) -> tuple[Affine, np.ndarray]:
    """Return g and its matrix at the value 0 of every parameter, in decimals of floats; what they round away
    goes to the remainder.
    """
    g = decimals(g)
    move = 0 * g.matrix
    for k, c in enumerate(middles):
        # parameters count from their middles here, and from 0 in a model
        move = move + Fraction(c) * g.change[:, k]
    zero = decimals(replace(g, matrix=g.matrix - move))
    return zero, zero.matrix


def _disturbed(g: Affine, n: int, more: Bounded | None) -> tuple[Matrix, Ends]:
    """Return the disturbance of the model: one for each state, around the constant, and what the caller
    adds.
    """
    G, bound = identity(n), []
    for c, r in zip(g.constant, g.remainder, strict=True):
        bound.append((_rounded(c - r, r, floor), _rounded(c + r, r, ceil)))
    if more is None:
        return G, bound
    extra = LinearSystem(G, None, G, disturbance=more)  # reads every form of a disturbance
    return beside(G, extra.G), [*bound, *extra.disturbance]


def _rounded(x: Fraction, width: Fraction, direction: Callable[[Fraction], int]) -> Fraction:
    """Return a short decimal beyond x, floor or ceil, away by less than a millionth of the width."""
    # nothing is left over: an exact number stays
    if not width:
        return x
    tick = Fraction(10) ** ((Decimal(width.numerator) / Decimal(width.denominator)).adjusted() - 6)
    return direction(x / tick) * tick


def _exact_values(field: str, values: object) -> list[Fraction]:
    """Return one number, or several, exactly. field: its name in sentences."""
    several = cast("Sequence[Number]", values if np.ndim(cast("ArrayLike", values)) else [values])
    try:
        return list(map(rational, several))
    except ValueError as e:
        raise ValueError(f"{field}: {e}") from None


def _parameters(stated: Mapping[str, Sequence[Number]] | None) -> dict[str, tuple[Fraction, Fraction]]:
    """Return {name: (lo, hi)} of the parameters, exactly."""
    between = {}
    for name, pair in dict(stated or {}).items():
        between[str(name)] = ordered_pair(f"parameter {name!r}", pair, apart=True)
    return between


def _box(field: str, stated: object, centre: list[Fraction]) -> Ends:
    """Return pairs (lo, hi) of Fractions: radii around the centre, or pairs as stated."""
    k, shape, pairs = len(centre), np.shape(cast("ArrayLike", stated)), []
    if shape == (k, 2):
        for pair in cast("Sequence[object]", stated):
            lo, hi = _exact_values(f"region {field}", pair)
            pairs.append((lo, hi))
    else:
        radii = _exact_values(f"region {field}", stated)
        if len(radii) not in (1, k):
            raise ValueError(
                f"region {field} needs one radius, {k} radii or {k} pairs lo, hi: its shape is {shape}"
            )
        if len(radii) == 1:
            radii = radii * k
        pairs = [(c - r, c + r) for c, r in zip(centre, radii, strict=True)]
    for i, (lo, hi) in enumerate(pairs):
        if lo > hi:
            raise ValueError(
                f"region {field} needs lo <= hi and radii >= 0: entry {i + 1} is [{float(lo):g}, "
                f"{float(hi):g}]"
            )
    return pairs
