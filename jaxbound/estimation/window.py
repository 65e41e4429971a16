"""A window whose first state lies in a set: the image of its samples, and the check of multipliers.

States b_j before a sample and x_j behind it, unknown inputs taken out by it (else M = 1, H = 0, x_j = b_j,
see `models.unknown_directions`), a first state b_0 = c + S xi + r eta in strips, and averages over runs
(`window_runs`), of L steps:

    m_j - C x_j = delta_j,  x_j = M b_j + H (m_j - delta_j),  b_(j+1) = A x_j + f_j + W w_j,
    mid - T b_0 = epsilon,  |a + sum F_v delta + sum F_w w| <= b,

with m_j = y_j - D v_j and f_j = B v_j + w known. For multipliers l, strip and u of samples, strips and
averages, whatever they are, and a direction d of one state:

    p_j = C' l_j + A' q_(j+1) - d [x_J],  q_j = M' p_j - d [b_J],  first = q_0 + T' strip,
    d x_J  =  sum_j (l_j - H' p_j)(m_j - delta_j)  -  sum_j q_(j+1) (f_j + W w_j)  -  first b_0
              +  strip (mid - epsilon),                                                     (weak duality)

in which only delta, w, b_0 and epsilon are unknown, each within its bounds: d x_J lies in value +- bound, and
with d = 0 a value beyond its bound is a contradiction.

**Rounding and intervals.** p_j and q_j are what floats made of them: by what they are off, gamma of all that
they are computed from, they act on x_j and b_j, of which bounds are known beforehand (`reach`); so do
intervals in place of entries of A, .., M. Each multiplier therefore pays, beside the radius of its row, a
share gamma of the magnitudes of all that stands in it: `of_sample`, `of_step`, `of_taking`, `size`. The same
gamma, of more terms than any of the sums has, covers the sums themselves.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import jax
import numpy as np

from jaxbound.consistency.interface import Array
from jaxbound.estimation.window_runs import AverageRows, bounds_of
from jaxbound.estimation.zonotope_steps import Numbers
from jaxbound.sets.floats import rounding

STEEPEST = 2.0**60
"""Multipliers from it on are taken for 0: any will do, and these would overflow."""
LESS, OFF = 1 - 1e-9, 1e-12
"""The share of its bounds that a trajectory may use, the rest covers what floats are off by; a share of
magnitudes above what rounding does to any sum of a few hundred numbers in float64.
"""


class Prior(NamedTuple):
    """A set {c + S xi + diag(r) eta} of first states that keep strips |mid - T x| <= rad as well.

    Fields: c (n, N), S (n, n, N), r (n, N), infinite where nothing is known; mid, rad (t, N), the radius
    infinite where there is none.
    """

    c: np.ndarray
    S: np.ndarray
    r: np.ndarray
    mid: np.ndarray
    rad: np.ndarray


class Samples(NamedTuple):
    """L samples of windows.

    Fields: mid, rad (L, p, N), v, slip (L, m, N): see `piece.Piece`; reach (L, n, N): at least |x|.
    """

    mid: np.ndarray
    rad: np.ndarray
    v: np.ndarray
    slip: np.ndarray
    reach: np.ndarray


class Image(NamedTuple):
    """N windows in float64, see the module.

    Fields: prior; m, rad (L, p, N), f (L, n, N); before, behind (L, n, N): at least |b_j|, |x_j|; loose (L,
    p, N): of inputs, in a sample; size (L, p, N): of a sample; of_sample (L, p, N), of_step (L, n, N): of the
    rows of l and of q; b (a, N): of averages, infinite where nothing is said.
    """

    prior: Prior
    m: np.ndarray
    rad: np.ndarray
    f: np.ndarray
    before: np.ndarray
    behind: np.ndarray
    loose: np.ndarray
    size: np.ndarray
    of_sample: np.ndarray
    of_step: np.ndarray
    b: np.ndarray


def through(M: Array, X: Array) -> np.ndarray:
    """Return M X for M (r, n), X (.., n, N) of a block of one size, by NumPy's own loop: libraries of matrix
    products round otherwise for each shape.
    """
    image: np.ndarray = np.einsum("ij,...jN->...iN", M, X)
    return image


def _acting(M: Array, size: np.ndarray) -> np.ndarray:
    """Return M X for M >= 0 and sizes X that may be infinite: those with an entry of 0 do not act."""
    bounded = np.isfinite(size)
    endless = through(np.asarray(M) != 0, ~bounded)
    return np.where(endless, np.inf, through(M, np.where(bounded, size, 0)))


def _told(x: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Return x, 0 where nothing is said: where a radius is infinite."""
    return np.where(np.isfinite(radius), x, 0)


def _against(h: np.ndarray, width: np.ndarray) -> np.ndarray:
    """Return the sums (N,) of |h| times widths that may be infinite: those of h = 0 do not act."""
    acts = h != 0
    return np.asarray(np.where(acts, np.abs(h) * np.where(acts, width, 0), 0).sum((0, 1)))


@dataclass(frozen=True, eq=False)
class WindowPlant:
    """The plant of windows.

    Fields: plant: the numbers, in float64; strips T (t, n): what is known of a first state beside a
    parallelotope; runs: of averages in a window. Strips and runs go neither with each other nor with
    unknown inputs.
    """

    plant: Numbers
    strips: np.ndarray
    runs: AverageRows

    @cached_property
    def taking(self) -> tuple[Array, Array, Array, Array, np.ndarray]:
        """(M, wide_M, H, wide_H, used (p,)): the one way to take unknown inputs out of a sample, and the
        outputs that this uses up.
        """
        free, (p, n) = self.plant.free, self.plant.C.shape
        if free is None:
            return np.eye(n), np.zeros((n, n)), np.zeros((n, p)), np.zeros((n, p)), np.zeros(p, bool)
        used = np.asarray(free.used[:, 0] != 0)
        return free.M[..., 0], free.wide_M[..., 0], free.H[..., 0], free.wide_H[..., 0], used

    @cached_property
    def _sizes(self) -> Numbers:
        """The magnitudes of the numbers."""
        sizes: Numbers = jax.tree.map(np.abs, self.plant)
        return sizes

    def _gamma(self, L: int) -> float:
        """Return the share of magnitudes that a sum over L steps is off by."""
        return float(rounding.product_error(self._terms(L), np.float64)[0])

    def _terms(self, L: int) -> int:
        """Return more than the number of terms of any sum over a window."""
        (n, m), (p, _), g = self.plant.B.shape, self.plant.C.shape, self.plant.W.shape[1]
        rows = len(self.strips) * (n + 2) + 4 * len(self.runs.m)
        return L * (3 * n + m + 2 * p + g + 8) + n + rows

    def _widths(
        self, size: np.ndarray, v: np.ndarray, slip: np.ndarray, gamma: float
    ) -> tuple[np.ndarray, ...]:
        """Return (loose, of C x, of A x + f + W w): how far inputs, and states of such sizes, may put rows
        off.
        """
        plant, sizes, v = self.plant, self._sizes, np.abs(v)
        loose = through(plant.wide_D, v) + through(sizes.D + plant.wide_D, slip)
        of_sample = _acting(plant.wide_C + gamma * sizes.C, size)
        drawn = plant.wide_w + gamma * (sizes.w + sizes.W.sum(1))
        of_step = _acting(plant.wide_A + gamma * sizes.A, size) + np.asarray(drawn)[:, None]
        of_step += through(plant.wide_B + gamma * sizes.B, v) + through(sizes.B + plant.wide_B, slip)
        return loose, of_sample, of_step

    def image(self, prior: Prior, samples: Samples) -> Image:
        """Return the Image of windows."""
        prior, samples = jax.tree.map(lambda x: np.asarray(x, np.float64), (prior, samples))
        plant, sizes, gamma = self.plant, self._sizes, self._gamma(len(samples.mid))
        mid, rad, v, slip, behind = samples
        loose, of_sample, of_step = self._widths(behind, v, slip, gamma)
        first = np.abs(prior.c) + np.abs(prior.S).sum(1) + prior.r
        drawn = np.asarray(sizes.w + sizes.W.sum(1))[:, None] + through(sizes.B, np.abs(v))
        # bounds of the state before a sample: of the one behind the sample before, moved on
        before = np.concatenate([first[None], (_acting(sizes.A, behind) + drawn + of_step)[:-1] * (1 + 1e-9)])
        seen = np.isfinite(rad)
        return Image(
            prior,
            m=np.where(seen, mid - through(plant.D, v), 0),
            rad=rad,
            f=through(plant.B, v) + np.asarray(plant.w)[:, None],
            before=before,
            behind=behind,
            loose=loose,
            size=np.where(seen, np.abs(mid) + through(sizes.D, np.abs(v)) + rad, np.inf),
            of_sample=of_sample,
            of_step=of_step,
            b=bounds_of(self.runs, rad),
        )

    def _multipliers(self, image: Image, h: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return (strip (t, N), l (L, p, N), u (a, N)) of multipliers in this order; 0 where nothing is
        known.
        """
        (L, p, N), t, used = image.m.shape, len(self.strips), self.taking[-1]
        h = np.where(np.abs(h) < STEEPEST, h, 0).astype(np.float64)
        l = np.zeros((L, p, N))
        # samples by which unknown inputs are taken out have no multiplier: it follows from the others
        l[:, ~used] = h[t : len(h) - len(image.b)].reshape(L, -1, N)
        u = h[len(h) - len(image.b) :]
        return _told(h[:t], image.prior.rad), _told(l, image.rad), _told(u, image.b)

    def enclosed(
        self, image: Image, h: np.ndarray, d: np.ndarray, J: np.ndarray, before: bool = False
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return (value, bound), each (N,) in float64: d x_J lies in value +- bound for all that explains the
        samples.

        An infinite bound shows nothing. All on the host: a program would be compiled for longer than most
        recordings take.

        Args:
            h (t + R + a, N): multipliers of strips, of the samples that are tested, and of averages, any. d
            (n, N), J (N,). before: whether x_J is the state before its sample is looked at; that is another
            one with unknown inputs alone.
        """
        plant, prior, L = self.plant, image.prior, len(image.m)
        M, wide_M, H, wide_H, used = self.taking
        strip, l, u = self._multipliers(image, h)
        gamma, up = self._gamma(L), 1 + 8 * self._terms(L) * float(rounding.unit(np.float64))
        pull = np.where(np.arange(L)[:, None, None] == J, np.asarray(d, np.float64), 0)
        P, q = np.zeros(pull.shape), np.zeros((L + 1, *pull.shape[1:]))
        both = np.concatenate([plant.C, plant.A]).T
        for j in reversed(range(L)):
            P[j] = through(both, np.concatenate([l[j], q[j + 1]])) - (0 if before else pull[j])
            q[j] = P[j]
            if used.any():
                q[j] = through(M.T, P[j])
            if before:
                q[j] -= pull[j]
        first, q = q[0] + through(self.strips.T, strip), q[1:]
        on_m, a, b = l - through(H.T, P), np.abs(first), np.abs(P)
        # averages speak of the same errors and disturbances: F_v' u and F_w' u
        on_delta = on_m - np.einsum("aLp,aN->LpN", self.runs.v, u)
        on_w = through(plant.W.T, q) - np.einsum("aLg,aN->LgN", self.runs.w, u)
        taken = through((wide_H + gamma * np.abs(H)).T, b) + gamma * np.abs(l)
        width, s = _told(prior.rad, prior.rad), _told(image.rad, image.rad)
        value = (on_m * image.m).sum((0, 1)) - (q * image.f).sum((0, 1))
        value += (strip * prior.mid).sum(0) - (first * prior.c).sum(0) + (self.runs.m[:, None] * u).sum(0)
        bound = (_told(image.b, image.b) * np.abs(u)).sum(0)
        bound += gamma * (self.runs.sizes(s) * np.abs(u)).sum(0)
        with np.errstate(invalid="ignore", over="ignore"):
            bound += _against(on_delta, image.rad) + np.abs(on_w).sum((0, 1)) + _against(on_m, image.loose)
            bound += _against(l, image.of_sample) + _against(q, image.of_step) + _against(taken, image.size)
            bound += _against(through((wide_M + gamma * np.abs(M)).T, b), image.before)
            bound += gamma * _against(pull, image.behind + image.before)
            bound += np.abs((prior.S * first[:, None]).sum(0)).sum(0) + (a * prior.r).sum(0)
            of_strips = a + through(np.abs(self.strips).T, np.abs(strip))
            bound += 2 * gamma * (of_strips * image.before[0]).sum(0)
            bound += (np.abs(strip) * (width + gamma * (np.abs(prior.mid) + width))).sum(0)
            bound = up * bound + 2.0**-500
        shown = (bound < np.inf) & (np.abs(value) < np.inf)  # not where it is NaN
        return np.where(shown, value, 0), np.where(shown, bound, np.inf)

    def explained(
        self, path: Prior, samples: Samples, xi: np.ndarray, w: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return (ok (N,), x (n, N), off (n, N)): whether a trajectory is proved to keep all bounds, the
        state in the middle of the window, and how far the exact one may be off it.

        The trajectory is the exact one of these xi and w, made a little smaller than 1; floats follow it to
        within `off`. Rounding that widens an enclosure makes a bound tighter here.

        Args:
            path: the sets of the first states. xi (k, N), w (L, g, N).
        """
        plant = self.plant
        path, samples = jax.tree.map(lambda x: np.asarray(x, np.float64), (path, samples))
        xi = np.clip(np.nan_to_num(xi), -LESS, LESS).astype(np.float64)
        w = np.clip(np.nan_to_num(w), -LESS, LESS).astype(np.float64)
        x, off = path.c + (path.S * xi[None]).sum(1), path.r
        # a side so short that rounding of the centre is as long cannot be made smaller
        sides_seen = 1e-9 * np.abs(path.S) > 1e-14 * np.abs(path.c)[:, None]
        ok = ((path.S == 0) | sides_seen).all((0, 1))
        middle = x, off
        for j, (mid, rad, v, slip, _) in enumerate(zip(*samples, strict=True)):
            if j == len(w) // 2:
                middle = x, off
            loose, of_sample, of_step = self._widths(np.abs(x) + off, v, slip, OFF)
            known = OFF * (np.abs(mid) + through(self._sizes.D, np.abs(v)))
            away = np.abs(mid - through(plant.D, v) - through(plant.C, x)) + through(self._sizes.C, off)
            seen = np.isfinite(rad)
            ok &= (~seen | (away + loose + of_sample + known <= LESS * np.where(seen, rad, 1))).all(0)
            x = through(plant.A, x) + through(plant.B, v) + plant.w[:, None] + through(plant.W, w[j])
            off = through(self._sizes.A, off) + of_step
        return ok, *middle
