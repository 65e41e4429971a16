"""Simulated data that are truly explained by unknowns within their bounds, at the speed of a plain recursion.

`models.simulate` carries twice the digits, so that a sample is right to the last one. A study of windows
needs less, because the state at the start of a window is free.

**Claim.** Let floats of unit roundoff u be computed by

    x+ = A x + B (v - v0) + G w,    t = C x + D (v - v0),    y = t + theta t + delta + y0,

in any order, with or without FMA, with floats |theta| <= sigma, lo <= w <= hi and |delta| <= rho - beta, beta
from `rounding_room`, v the recorded input. Then every window of s + 1 samples y is exactly explained by the
model: by a state, by these w and theta, and by noises of at most rho. So `detect` never calls it FAULT.

**Proof.** Take as the state at the start of the window the float that the recursion had there, and let the
exact model run on from it with the same v, w and theta. Each component of one step, a sum of N = n + m + g
products of coefficients rounded once (B and D times v - v0, rounded too), is off by e <= (N + 8) u (|A| X +
|B| (V + |v0|) + |G| W), where X, V, W bound the magnitudes of x, v and w: N products and sums, one rounding
of a coefficient, three of v - v0, and second-order terms. Errors of steps before the window do not matter:
its state is free. Within it they add up to at most sum_{i < s} |C A^i| e on t, whose own sum adds (n + m + 8)
u (|C| X + |D| (V + |v0|)); then (1 + sigma) of both, and at most 8 u (Y + |y0|) of the last line, Y bounding
|y - y0|. beta is twice the sum of these, which covers the rounding of beta itself, of W and X as they are
computed here, and the coefficients' rounding in `largest_reach`; a few hundred times the smallest
normal number covers underflow. What y differs from (1 + theta) t + delta + y0 of the exact model is then a
noise of at most beta, and |delta| + beta <= rho.

The room is some 1e-14 of a unit in float64: vertices lie that far inside, and an exact boundary is met up to
it. Where it is more than `SHARE` of the noise (no noise at all, or a state that grows out of proportion)
`fits` is False, and a study simulates with `simulate` instead.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.models.system import LinearSystem
from jaxbound.models.window import model_matrices
from jaxbound.random.threefry import Array
from jaxbound.sets.floats import rounding

Zeros: TypeAlias = tuple[tuple[bool, ...], ...]
"""Which entries of a matrix are zero."""

SHARE = 1e-2
"""Of the noise, that a study may take for rounding."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class FloatPlant:
    """The numbers of a model in floats; the noise is smaller by the room for rounding.

    Fields: A (n, n), B (n, m), C (p, n), D (p, m), G (n, g), tolerance, noise, offset_y (p,), offset_u (m,),
    lo, hi (g,).
    zeros: for each matrix, which entries are zero: static, so that they cost nothing.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    G: Array
    tolerance: Array
    noise: Array
    offset_y: Array
    offset_u: Array
    lo: Array
    hi: Array
    zeros: tuple[Zeros, ...] = field(metadata={"static": True})

    @property
    def shape(self) -> tuple[int, int, int, int]:
        """(n, m, p, g)."""
        return self.A.shape[0], self.B.shape[1], self.C.shape[0], self.lo.shape[0]


def largest_reach(model: LinearSystem, inputs: np.ndarray, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the largest |x| (n,) and |y - offset| (p,) that `samples` steps from x = 0 can come to.

    Args:
        model: a LinearSystem. inputs: (m,) the largest |v - offset| that acts. samples: how many.
    """
    A, B, C, D, G = model_matrices(model, "ABCDG")
    drive = np.hstack([B * inputs, G * _largest_disturbances(model)])
    power, states, outputs = np.eye(model.n), np.zeros(model.n), np.abs(D) @ inputs
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(samples):
            states = states + np.abs(power @ drive).sum(1)
            outputs = outputs + np.abs(C @ power @ drive).sum(1)
            power = power @ A
        noise, tolerance = _as_floats(model.noise), _as_floats(model.tolerance)
        return 1.001 * states, 1.001 * ((1 + tolerance) * outputs + noise)


def rounding_room(
    model: LinearSystem, horizon: int, inputs: np.ndarray, samples: int, dtype: np.dtype
) -> np.ndarray:
    """Return beta (p,) of the claim above, for inputs whose |v - offset| is at most `inputs` (m,); inf where
    it is out of proportion.
    """
    A, B, C, D, G = model_matrices(model, "ABCDG")
    u, (n, m, g) = float(rounding.unit(dtype)), (model.n, model.m, model.g)
    states, outputs = largest_reach(model, inputs, samples)
    level = inputs + 2 * abs(_as_floats(model.offset["u"]))
    bound = _largest_disturbances(model)
    with np.errstate(over="ignore", invalid="ignore"):
        each = (n + m + g + 8) * u * (np.abs(A) @ states + np.abs(B) @ level + np.abs(G) @ bound)
        through, power, grown = np.zeros((model.p, n)), np.eye(n), np.zeros(n)
        for i in range(samples):
            through = through + np.abs(C @ power) * (i < horizon)
            grown = grown + np.abs(power) @ each
            power = power @ A
        out = through @ each + (n + m + 8) * u * (np.abs(C) @ states + np.abs(D) @ level)
        shown = outputs + abs(_as_floats(model.offset["y"]))
        out = (1 + _as_floats(model.tolerance)) * out + 8 * u * shown
        out = 2 * out + 400 * (n + m + g + 1) * float(rounding.tiny(dtype)) * (1 + through.sum(1))
        within = np.all(grown <= 1e-4 * states + float(rounding.tiny(dtype))) and np.isfinite(states).all()
    return np.where(np.isfinite(out) & within, out, np.inf)


def _as_floats(values: Sequence[Fraction]) -> np.ndarray:
    return np.array([float(x) for x in values])


def _largest_disturbances(model: LinearSystem) -> np.ndarray:
    """Return the largest magnitude (g,) of each disturbance."""
    return np.array([max(abs(float(lo)), abs(float(hi))) for lo, hi in model.disturbance])


def fits(model: LinearSystem, room: np.ndarray) -> bool:
    """Say whether the fast recursion may stand for this model: certain, all unknowns bounded, and noise
    enough for the room.
    """
    if model.uncertainties or model.d or model.constant_tolerance or model.averages:
        return False
    return bool((_noise_taken(model, room) <= SHARE * _as_floats(model.noise)).all())


def _noise_taken(model: LinearSystem, room: np.ndarray) -> np.ndarray:
    """Return the share (p,) of the room that the noise gives: a logger's resolution gives the rest."""
    return np.asarray(np.maximum(room - _as_floats(model.resolution), 0.0))


def plant_of(model: LinearSystem, room: np.ndarray, dtype: np.dtype) -> FloatPlant:
    """Return the FloatPlant of a model that `fits`, with `room` for rounding."""
    noise = _as_floats(model.noise) * (1 - 1e-15) - _noise_taken(model, room)
    A, B, C, D, G = exact = model_matrices(model, "ABCDG")
    lo = rounding.round_up([low for low, _ in model.disturbance], dtype)
    hi = rounding.round_down([high for _, high in model.disturbance], dtype)
    return FloatPlant(
        A=A.astype(dtype),
        B=B.astype(dtype),
        C=C.astype(dtype),
        D=D.astype(dtype),
        G=G.astype(dtype),
        tolerance=rounding.round_down(list(model.tolerance), dtype),
        noise=rounding.round_down(np.maximum(noise, 0), dtype),
        offset_y=_as_floats(model.offset["y"]).astype(dtype),
        offset_u=_as_floats(model.offset["u"]).astype(dtype),
        lo=lo,
        hi=np.maximum(lo, hi),
        # tuples: a static field is hashed
        zeros=tuple(tuple(map(tuple, (x == 0).tolist())) for x in exact),
    )


def step(
    plant: FloatPlant,
    x: list[Array],
    applied: list[Array],
    theta: Sequence[Array | None],
    delta: list[Array],
    share: list[Array],
) -> tuple[list[Array], list[Array]]:
    """Return (x+, y) of one step, lists of arrays over scenarios.

    Args:
        x: n states. applied: m inputs, offset included. theta: p relative errors (None: none). delta: p
            noises. share: g numbers in [-1, 1], where each disturbance lies within its bounds.
    """
    zero_A, zero_B, zero_C, zero_D, zero_G = plant.zeros
    inputs = [v - plant.offset_u[i] for i, v in enumerate(applied)]
    half = [0.5 * (plant.hi[j] - plant.lo[j]) for j in range(len(share))]
    w = [jnp.clip(plant.lo[j] + (1 + r) * half[j], plant.lo[j], plant.hi[j]) for j, r in enumerate(share)]
    y = []
    for i in range(plant.shape[2]):
        t = _sum([*_terms(plant.C, zero_C, x, i), *_terms(plant.D, zero_D, inputs, i)], delta[i])
        error = theta[i]
        y.append((t if error is None else t + error * t) + delta[i] + plant.offset_y[i])
    after = []
    for i in range(plant.shape[0]):
        terms = [
            *_terms(plant.A, zero_A, x, i),
            *_terms(plant.B, zero_B, inputs, i),
            *_terms(plant.G, zero_G, w, i),
        ]
        after.append(_sum(terms, delta[0]))
    return after, y


def _terms(M: Array, zeros: Zeros, values: Sequence[Array], i: int) -> list[Array]:
    """Return the products of row i of a matrix with values, but for those with an entry that is zero."""
    return [M[i, j] * v for j, v in enumerate(values) if not zeros[i][j]]


def _sum(terms: Sequence[Array], like: Array) -> Array:
    """Return the sum of the terms, zeros like an array if there is none."""
    if not terms:
        return jnp.zeros_like(like)
    return sum(terms[1:], terms[0])
