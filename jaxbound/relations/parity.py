"""Parity relations of a certain model with imperfect sensors: the unknown state is eliminated exactly.

    external form  p_ext = W (Y - H U)                      numbers
    internal form  p_int = W mu,  mu_i in [y - t_hi, y - t_lo] for each sample    a zonotope
    circuits       every minimal-support combination of the relations: the strips of that zonotope

W is a rational left null space, so W O = 0 exactly for the decimals of the model; floats appear only as nearest
values of exact coefficients, whose error `sets.rounding` counts. Source: Adrot, Maquin, Ragot 2000, (6)-(9), (13)-(15).
"""

import dataclasses
import math
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.models import recording, sensor, window
from jaxbound.models.conversion import as_model
from jaxbound.models.system import LinearSystem
from jaxbound.sets import exact, rounding
from jaxbound.sets.interval import Interval
from jaxbound.sets.strips import Strips, strips_of

__all__ = ["ParityRelation", "WindowTest", "parity_relations"]

MAX_CIRCUITS = 20_000


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class WindowTest:
    """Everything a kernel needs of a relation: arrays are traced, so models of one shape share a compilation."""

    strips: Strips
    tolerance: jax.Array
    noise: jax.Array
    resolution: jax.Array
    offset_u: jax.Array
    offset_y: jax.Array
    horizon: int = field(metadata={"static": True})
    lags: int = field(metadata={"static": True})

    def rows(self, u, y):
        """Return (mid, rad, scale, known, known_scale) for all windows of a stretch: u (N + s, m), y (N + s, p) give lists of (N,)."""
        count = y.shape[0] - self.horizon
        mid, rad, scale = [], [], []
        per_output = []
        for i in range(y.shape[1]):
            samples = [y[j : j + count, i] for j in range(self.horizon + 1)]
            per_output.append(sensor.true_value(samples, self.tolerance[i], self.noise[i], self.resolution[i], self.offset_y[i]))
        for j in range(self.horizon + 1):
            for m, r, s in per_output:
                mid.append(m[j]), rad.append(r[j]), scale.append(s[j])
        known, known_scale = [], []
        for j in range(self.lags):
            for i in range(u.shape[1]):
                v = u[j : j + count, i]
                known.append(v - self.offset_u[i])
                known_scale.append(abs(v) + abs(self.offset_u[i]))
        return mid, rad, scale, known, known_scale


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class ParityRelation:
    """Independent parity relations over a window of horizon + 1 samples. Build it with `parity_relations`.

    Fields: bounds {"tolerance": (p,), "noise": (p,)} (floats, never smaller than the model's decimals), model, horizon, form,
    W (count, (s+1)p) and K (count, l): p_ext = W Y - K U with exact entries, rows time-major.
    """

    bounds: dict
    model: LinearSystem = field(metadata={"static": True})
    horizon: int = field(metadata={"static": True})
    form: str = field(metadata={"static": True})
    W: tuple = field(metadata={"static": True})
    K: tuple = field(metadata={"static": True})
    circuits: tuple = field(metadata={"static": True})
    circuits_known: tuple = field(metadata={"static": True})

    @property
    def count(self):
        """Number of independent relations."""
        return len(self.W)

    @cached_property
    def _joint(self):
        return strips_of(self.circuits, self.circuits_known)

    @cached_property
    def _alone(self):
        return strips_of(self.W, self.K)

    def test(self, method, dtype):
        """Return the WindowTest of all circuits ("joint") or of each relation alone ("box") in a float dtype."""
        model, strips = self.model, self._joint if method == "joint" else self._alone
        nearest = np.vectorize(float, otypes=[np.float64])
        return WindowTest(
            strips.astype(dtype),
            _cast(self.bounds["tolerance"], dtype),
            _cast(self.bounds["noise"], dtype),
            rounding.round_up(list(model.resolution), dtype),
            nearest(model.offset["u"]).astype(dtype),
            nearest(model.offset["y"]).astype(dtype),
            self.horizon,
            window.input_lags(model, self.horizon),
        )

    def with_bounds(self, bounds):
        """Return the same relations under other bounds.

        Args:
            bounds: {"tolerance": (p,), "noise": (p,)}, both or one; arrays, numbers or tracers.

        Raises:
            ValueError: an unknown name, a wrong shape, a negative bound, a tolerance >= 1, NaN or infinity.
        """
        unknown = sorted(set(bounds) - set(self.bounds))
        if unknown:
            raise ValueError(f"bounds are {sorted(self.bounds)}, not {unknown}")
        fresh = dict(self.bounds)
        for name, value in bounds.items():
            if np.shape(value) not in ((), (self.model.p,)):
                raise ValueError(f"{name} needs one number or one per output ({self.model.p}): its shape is {np.shape(value)}")
            if not isinstance(value, jax.core.Tracer):
                flat = np.broadcast_to(np.asarray(value, np.float64), (self.model.p,))
                top = 1 if name == "tolerance" else np.inf
                for output, b in zip(self.model.outputs, flat, strict=True):
                    if not 0 <= b < top:
                        raise ValueError(f"{name} must be in [0, {top}): output {output!r} has {b:g}")
                value = flat
            fresh[name] = value if np.ndim(value) else jnp.broadcast_to(value, (self.model.p,))
        return dataclasses.replace(self, bounds=fresh)

    def external(self, u, y):
        """Return p_ext (..., T, count), the residuals, NaN where a window is incomplete. Not rounded: for plots and studies.

        Args:
            u: (..., T, m) inputs (None without inputs). y: (..., T, p) outputs. Arrays or DataFrames.

        Source: Adrot 2000, (7), (14).
        """
        return self._forms(u, y)[0]

    def internal(self, u, y):
        """Return the Interval (..., T, count) that each residual alone may have when the sensors are healthy. Not rounded: for plots.

        Source: Adrot 2000, (9), (15), with mu in [y - t_hi, y - t_lo].
        """
        _, lo, hi = self._forms(u, y)
        return Interval(lo, hi)

    def _forms(self, u, y):
        u, y, _ = recording.arrays(self.model, u, y)
        u, y = jnp.asarray(u), jnp.asarray(y)
        if y.shape[-2] <= self.horizon:
            return (jnp.full((*y.shape[:-1], self.count), jnp.nan, y.dtype),) * 3
        test = self.test("box", y.dtype)
        forms = _forms
        for _ in range(y.ndim - 2):
            forms = jax.vmap(forms, (None, 0, 0))
        return forms(test, u, y)

    def text(self, circuits=False):
        """Return the relations, one a line, as a reader would write them; all circuits instead if asked for.

        Example:
            >>> m = LinearSystem([[0.8, 1], [0, 0.2]], [[0], [1]], [[1, 0], [1, 1]])
            >>> print(parity_relations(m).text())
            r1: y1[k-1] - 5 y2[k-1] + 5 y1[k] = 0
            r2: 4 y2[k-1] - 10 y1[k] + 5 y2[k] - 5 u1[k-1] = 0
        """
        letter, rows = ("c", zip(self.circuits, self.circuits_known, strict=True)) if circuits else ("r", zip(self.W, self.K, strict=True))
        return "\n".join(f"{letter}{i + 1}: {relation_text(self.model, self.horizon, h, k)}" for i, (h, k) in enumerate(rows))


def relation_text(model, horizon, h, k):
    """Return one relation h Y - k U = 0 as text."""
    at = [f"[k-{horizon - j}]" if j < horizon else "[k]" for j in range(horizon + 1)]
    terms = [(x, model.outputs[i % model.p] + at[i // model.p]) for i, x in enumerate(h)]
    terms += [(-x, model.inputs[i % model.m] + at[i // model.m]) for i, x in enumerate(k)]
    out = ""
    for x, signal in terms:
        if x:
            sign = ("- " if x < 0 else "") if not out else (" - " if x < 0 else " + ")
            size = abs(x)
            factor = "" if size == 1 else f"{size} " if size.denominator == 1 else f"{float(size):.6g} "
            out += sign + factor + signal
    return out + " = 0"


def _cast(bound, dtype):
    return bound.astype(dtype) if isinstance(bound, jax.core.Tracer) else rounding.round_up(np.asarray(bound, np.float64), dtype)


@jax.jit
def _forms(test, u, y):
    s, p = test.horizon, y.shape[1]
    mid, rad, _, known, _ = test.rows(u, y)
    mid, rad = jnp.stack(mid), jnp.stack(rad)
    samples = jnp.stack([y[j : j + mid.shape[1], i] - test.offset_y[i] for j in range(s + 1) for i in range(p)])
    external, centre, width = [], [], []
    for c in range(test.strips.h.shape[0]):
        rows, h, k = test.strips.rows[c], test.strips.h[c], test.strips.k[c]
        external.append(h @ samples[rows] - sum(jnp.where(k[b] == 0, 0, k[b] * known[b]) for b in range(len(known))))
        centre.append(h @ (samples[rows] - mid[rows]))
        width.append(abs(h) @ rad[rows])
    external, centre, width = (jnp.stack(x, 1) for x in (external, centre, width))
    return tuple(jnp.pad(x, ((s, 0), (0, 0)), constant_values=jnp.nan) for x in (external, centre - width, centre + width))


def parity_relations(model, horizon=None, form="first"):
    """Eliminate the unknown state from a window exactly.

    Args:
        model: a LinearSystem, or a discrete state-space object of python-control or scipy.signal (perfect sensors then).
        horizon: s >= 0, a window has s + 1 samples; None: the smallest at which every output that can be checked is checked.
        form: "first" (all samples on the first state) or "second" (dynamics stacked). They test the same set; the basis of the
            relations, and with it the box test, differs.

    Returns:
        A ParityRelation. "first" gives relations that span as few samples as possible, with coprime integers.

    Raises:
        ValueError: no relation at this horizon, or more than 20 000 circuits.

    Source: Adrot, Maquin, Ragot 2000, (6), (13).

    Example:
        >>> m = LinearSystem([[0.8, 1], [0, 0.2]], [[0], [1]], [[1, 0], [1, 1]])
        >>> r = parity_relations(m)
        >>> r.horizon, r.count, len(r.circuits)
        (1, 2, 4)
    """
    model = as_model(model)
    if form not in ("first", "second"):
        raise ValueError(f"form must be 'first' or 'second', not {form!r}")
    if horizon is None:
        horizon = _smallest_useful_horizon(model)
    if isinstance(horizon, bool) or not isinstance(horizon, (int, np.integer)) or horizon < 0:
        raise ValueError(f"horizon must be a whole number >= 0, not {horizon!r}")
    horizon = int(horizon)
    state_rank = exact.rank(window.first_form(model, min(horizon, model.n))[0])  # a longer window does not raise it (Cayley-Hamilton)
    if (count := math.comb((horizon + 1) * model.p, state_rank + 1)) > MAX_CIRCUITS:
        raise ValueError(
            f"horizon {horizon} is too long for this model: {count} circuits of up to {state_rank + 1} samples would have to be tested, "
            f"more than {MAX_CIRCUITS}; choose a shorter horizon"
        )
    O, H = window.first_form(model, horizon)
    null = exact.left_null_space(O)
    if not null:
        raise ValueError(
            f"horizon {horizon} gives no relation: {len(O)} samples do not outnumber the {model.n} states; "
            f"the smallest horizon with one is {_first_horizon(model)}"
        )
    circuits = tuple(map(exact.presentable, exact.circuits(O)))
    if form == "first":
        W = tuple(map(exact.presentable, exact.minimal_span(null)))
        K = exact.matmul(W, H) if H[0] else tuple(() for _ in W)
    else:
        W, K = _second(model, horizon)
    bounds = {"tolerance": rounding.round_up(list(model.tolerance)), "noise": rounding.round_up(list(model.noise))}
    known = exact.matmul(circuits, H) if H[0] else tuple(() for _ in circuits)
    return ParityRelation(bounds, model, horizon, form, W, K, circuits, known)


def _second(model, horizon):
    """Return (W~_L, action on U) of the second static form. Source: (13)-(14)."""
    L, M, N, F = window.second_form(model, horizon)
    stacked = exact.left_null_space(L + M)
    rows = len(L)
    W = tuple(r[:rows] for r in stacked)
    if not F[0]:
        return W, tuple(() for _ in W)
    direct = exact.matmul(W, F)
    if not M:
        return W, direct
    through = exact.matmul(tuple(r[rows:] for r in stacked), N)
    return W, tuple(tuple(a - b for a, b in zip(x, y, strict=True)) for x, y in zip(direct, through, strict=True))


def _checked_outputs(model, horizon):
    null = exact.left_null_space(window.first_form(model, horizon)[0])
    return {i % model.p for row in null for i, x in enumerate(row) if x != Fraction(0)}


def _smallest_useful_horizon(model):
    best = _checked_outputs(model, model.n)  # a longer window involves no further output (Cayley-Hamilton)
    return next(s for s in range(model.n + 1) if _checked_outputs(model, s) == best)


def _first_horizon(model):
    return next(s for s in range(model.n + 1) if _checked_outputs(model, s))
