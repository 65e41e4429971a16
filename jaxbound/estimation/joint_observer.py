"""The observer that tests windows exactly, each with a first state that lies in the set that the samples
before it allow.

Samples come in blocks of half a window. The window of a sample begins with the block before its own; its
first state lies in a parallelotope {x : lo <= D x <= hi}, which the window that ended with its own block
found by linear programs, with a first state in the one before that, and so on: nothing is forgotten but what
a parallelotope cannot say, and some strips with it. Its directions are the principal ones of a Kalman filter;
those of the strips are slow modes, and what the outputs will show. A zonotope goes with it (`SetObserver`):
it begins, and bounds what rounding and uncertain parameters act on.

Sources: Scott, Raimondo, Marseglia, Braatz 2016 (the exact set of a window is a linear program); Rao,
Rawlings, Mayne 2003 (a window that knows what came before it). Programs are searched for in floats
(`window_search`) and what they found is checked (`window`).
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, NamedTuple

import jax
import numpy as np

from jaxbound.consistency.interface import Array
from jaxbound.estimation import zonotope_steps as steps
from jaxbound.estimation.blocks import chosen, in_lanes, repeated
from jaxbound.estimation.observed_plant import ObservedPlant
from jaxbound.estimation.parallelotope import (
    lasting,
    parallelotope,
    principal,
    template,
)
from jaxbound.estimation.piece import Piece
from jaxbound.estimation.set_observer import SetObserver, ZonotopeObserver
from jaxbound.estimation.window import Prior, Samples, WindowPlant
from jaxbound.estimation.window_programs import ROOM, gauges, supports
from jaxbound.estimation.window_runs import AverageRows, average_rows
from jaxbound.models.system import LinearSystem
from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.status import Status
from jaxbound.text.objects import readable

SETTLED = 8
"""Blocks after which the directions stay as they are."""


@readable
class JointState(NamedTuple):
    """The sets that the observer carries on, recordings on the last axis.

    Fields: carry, samples: as of `ObserverState`. window: the last two blocks, so far; prior: the set of the
    first state of the window; mark: of the state in the middle of it, from the zonotope; path: a first state
    on a trajectory through all samples.
    """

    carry: steps.ZonotopeCarry
    samples: np.int64
    window: Samples
    prior: Prior
    mark: Prior
    path: Prior


def _is_known(prior: Prior) -> np.ndarray:
    """Return which sets are bounded, (N,) bool."""
    finite = np.isfinite(prior.c).all(0) & np.isfinite(prior.S).all((0, 1))
    bounded: np.ndarray = finite & np.isfinite(prior.r).all(0)
    return bounded


def _only(known: np.ndarray, prior: Prior) -> Prior:
    """Return the sets where (N,) they are to be believed; of others nothing is known."""
    return prior._replace(r=np.where(known, prior.r, np.inf).astype(prior.r.dtype))


@readable
@dataclass(frozen=True, eq=False, kw_only=True)
class JointObserver(SetObserver[JointState]):
    """Tests windows whose first state lies in an enclosure. Build it with `observer(model, Joint())`.

    Fields: as of SetObserver; window: most samples of a window, even.
    """

    hulls: ClassVar[bool] = True

    window: int

    @property
    def made(self) -> tuple[object, ...]:
        """The choices that verdicts depend on beside the model: they name verdicts that are kept."""
        return *super().made, "joint", self.window

    @property
    def half(self) -> int:
        """Samples of a block."""
        return self.window // 2

    @cached_property
    def windows(self) -> WindowPlant:
        """The plant of windows."""
        exact = self.plant.exact
        runs = AverageRows.none(self.window, *exact.C.shape[:1], *exact.W.shape[1:])
        if exact.free is None and isinstance(self.model, LinearSystem):
            runs = average_rows(self.model, self.window)
        # strips go neither with unknown inputs nor with averages
        strips = lasting(np.asarray(exact.A), np.asarray(exact.C), self.half)
        if exact.free is not None or len(runs.m):
            strips = strips[:0]
        strips = strips.astype(self.plant.dtype).astype(np.float64)
        return WindowPlant(exact, strips, runs)

    @cached_property
    def _principal(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Directions of the blocks, [(D, back)], see `principal`."""
        return principal(self.plant.exact, self.half, SETTLED, self.plant.dtype)

    def _directions(self, number: int) -> tuple[np.ndarray, np.ndarray]:
        """Return (rows (n + t, n), back (n, n)) of a block: D, of which back is about the inverse, and
        strips.
        """
        D, back = self._principal[min(number, SETTLED)]
        return np.concatenate([D, self.windows.strips]), back

    def init(self) -> JointState:
        """Return the state of an observer that has seen nothing."""
        system, dtype, carry = self.plant.system, self.plant.dtype, self._first_state.carry

        def zero(*shape: int) -> np.ndarray:
            return np.zeros((*shape, 1), dtype)

        L, c = self.window, zero(system.n)
        outputs, inputs = zero(L, system.p), zero(L, system.m)
        window = Samples(outputs, outputs + np.inf, inputs, inputs, zero(L, system.n) + np.inf)
        prior = self._without_strips(c, zero(system.n, system.n), c + np.inf)
        return JointState(carry, np.int64(0), window, prior, prior, prior)

    def found(self, carry: JointState, samples: Piece) -> tuple[JointState, steps.Found]:
        """Return (state, Found) of samples, decided once: block by block."""
        T, count = samples.fresh.shape
        # the zonotopes are repeated where they are followed: each recording has several
        sets = repeated((carry.window, carry.prior, carry.mark, carry.path), count)
        state = JointState(carry.carry, carry.samples, *sets)
        parts: list[steps.Found] = []
        first = 0
        while first < T or not parts:
            stop = min(first + self.half - int(state.samples) % self.half, T)  # to the end of a block
            state, part = self._tested(state, samples.cut(first, stop))
            parts.append(part)
            first = stop
        return state, jax.tree.map(lambda *x: np.concatenate(x), *parts)

    def _sharpened(self, state: JointState, number: int) -> Prior:
        """Return the sets of the states in the middle of windows: of the mark, met with what windows say."""
        lanes = np.flatnonzero(_is_known(state.prior) & _is_known(state.mark))
        if not len(lanes):
            return state.mark
        mark, prior = chosen(state.mark, lanes), chosen(state.prior, lanes)
        window = chosen(state.window, lanes)
        (rows, back), n = self._directions(number - 1), self.plant.system.n
        lo, hi, most = template(rows, mark.c[None], mark.S[None], mark.r[None])
        # the mark keeps strips of its own, which are often narrower than those of its parallelotope
        lo[n:] = np.maximum(lo[n:], mark.mid - mark.rad)
        hi[n:] = np.minimum(hi[n:], mark.mid + mark.rad)
        middles, (*_, z) = np.full(len(lanes), self.half), gauges(self.windows, prior, window)
        low, high = supports(self.windows, prior, window, z, rows, hi - lo, middles, before=True)
        lo, hi = np.maximum(lo, low), np.minimum(hi, high)
        better = parallelotope(back, rows, lo, hi, most, self.plant.dtype)
        # of what a program lost nothing is believed: the set of the zonotopes stays
        bounded = _is_known(better)
        out: Prior = jax.tree.map(np.array, state.mark)
        for whole, part in zip(out, better, strict=True):
            whole[..., lanes] = np.where(bounded, part, whole[..., lanes])
        return out

    def _mark(self, state: JointState, number: int) -> Prior:
        """Return the set of the state now, from x0 or from the zonotopes."""
        N, lanes = state.prior.c.shape[-1], len(self.weights)
        first = self._first_prior(N)
        if number == 0 and first is not None:
            return first

        def split_lanes(x: Array) -> np.ndarray:
            return np.moveaxis(np.asarray(x).reshape(*x.shape[:-1], x.shape[-1] // lanes, lanes), -1, 0)

        rows, back = self._directions(number)
        c, G, r, age = map(split_lanes, state.carry[:4])
        mark = parallelotope(back, rows, *template(rows, c, G, r), self.plant.dtype)
        return repeated(_only(np.all(age >= 0, 0), mark), N)

    def _first_prior(self, N: int) -> Prior | None:
        """Return x0 of N recordings; None where there is none, or it has more generators than states."""
        if self.x0 is None:
            return None
        n = self.plant.system.n
        center, generators, box, whole = self.x0.padded(n)
        sides = generators[:, np.abs(generators).any(0)]
        if sides.shape[1] > n or not whole:
            return None
        # kernels take as many sides as states: the others are 0
        sides = np.pad(sides, ((0, 0), (0, n - sides.shape[1])))

        def repeated(x: np.ndarray) -> np.ndarray:
            return np.repeat(x[..., None], N, -1)

        return self._without_strips(repeated(center), repeated(sides), repeated(box))

    def _without_strips(self, c: np.ndarray, S: np.ndarray, r: np.ndarray) -> Prior:
        """Return the set of first states whose strips say nothing."""
        mid = np.zeros((len(self.windows.strips), r.shape[-1]), self.plant.dtype)
        return Prior(c, S, r, mid, mid + self.plant.dtype.type(np.inf))

    def _path_on(self, state: JointState, number: int) -> Prior:
        """Return the path of the next block: the state in the middle of the window on a trajectory through
        all of it.
        """
        if number == 1 and self.x0 is not None:
            return self._first_path(state)
        lanes = np.flatnonzero(_is_known(state.path))
        if not len(lanes):
            return state.path
        ok, x, off = self._trajectories(chosen(state.path, lanes), chosen(state.window, lanes))
        c, r = np.zeros_like(state.path.c), np.full_like(state.path.r, np.inf)
        c[:, lanes] = x
        off = rounding.round_up(off + np.abs(x - x.astype(self.plant.dtype)), self.plant.dtype)
        r[:, lanes] = np.where(ok, off, np.inf)
        return state.path._replace(c=c, S=np.zeros_like(state.path.S), r=r)

    def _first_path(self, state: JointState) -> Prior:
        """Return the path where a trajectory begins anywhere in x0, and nowhere else."""
        # an enclosure may leave these bounds out, a trajectory must not
        more = isinstance(self.model, LinearSystem) and (self.model.averages or self.model.constant_tolerance)
        if more or self._first_prior(1) is None or self.plant.unknown is not None:
            return state.path
        c, S, r, *_ = state.mark
        # sides of a box: a state is compared with each
        sides = np.eye(len(S), dtype=bool)[:, :, None]
        # inward: a trajectory has to begin within what the user gave
        inner = np.nextafter(np.abs(S).astype(np.float64) - r[:, None], -np.inf)
        inner = rounding.round_down(np.maximum(inner, 0), self.plant.dtype)
        within = np.where(sides, np.sign(S) * inner, S)
        path = self._without_strips(c, within, np.zeros_like(r))
        return _only(_is_known(state.mark) & ((S == 0) | sides).all((0, 1)), path)

    def _trajectories(self, path: Prior, window: Samples) -> tuple[np.ndarray, ...]:
        """Return (ok, x, off) of the trajectories that a search finds, see `WindowPlant.explained`."""
        L, k = self.window, self.plant.system.n

        def job(lanes: np.ndarray) -> tuple[np.ndarray, ...]:
            some, samples = chosen(path, lanes), chosen(window, lanes)
            *_, z = gauges(self.windows, some, samples)
            w = z[k : k + L * self.plant.exact.W.shape[1]].reshape(L, -1, len(lanes))
            return self.windows.explained(some, samples, z[:k], w)

        return in_lanes(job, path.c.shape[-1], ROOM)

    def _tested(self, state: JointState, samples: Piece) -> tuple[JointState, steps.Found]:
        """Return (state, Found) of samples of one block."""
        T = len(samples.fresh)
        number, place = divmod(int(state.samples), self.half)
        if T and place == 0:  # the window moves on by a block, and its first state with it
            state = state._replace(
                window=_later(state.window, self.half),
                prior=self._sharpened(state, number),
                mark=self._mark(state, number),
                path=self._path_on(state, number),
            )
        if T:  # a set of the state at that very sample was made of the samples before the gap
            state = _believed(state, *[~samples.fresh[0]] * 3)
        t, before = int(state.samples), state.carry
        block, begin = number * self.half, self.half + place
        after, found = self._followed(before, samples)
        state = state._replace(window=self._with_samples(state.window, begin, samples, found))
        since = t + np.arange(T)[:, None] - found.age + 1
        # only where the zonotopes rest on all of the window: its first state is enclosed then
        judged = np.asarray((found.age > 0) & (since <= block - self.half) & _is_known(state.prior))
        judged &= np.asarray(found.status) == Status.UNDECIDED
        wrong, margin, states = self._refuted(state, begin, judged, np.asarray(found.states))
        right = self._consistent(state, begin, judged & ~wrong & _is_known(state.path) & (since == 0))
        wrong &= np.cumsum(wrong, 0) == 1
        # windows behind it speak of samples that are given up
        up_to_it = np.cumsum(wrong, 0) - wrong == 0
        judged, right = judged & up_to_it, right & up_to_it
        if wrong.any():
            after, found = self._followed(before, samples._replace(refuted=wrong))
        status = np.where(right, np.int8(Status.CONSISTENT), found.status)
        # the margin of a FAULT is that of the test which found it: another one saw less
        lower = judged & (margin < found.margin) & (wrong | (found.status != Status.FAULT))
        margin = np.where(lower, margin, found.margin).astype(found.margin.dtype)
        found = found._replace(status=status, margin=margin)
        if self.enclosures:
            narrower = (judged & ~wrong & (found.age > 0))[:, None]
            states = np.where(narrower, np.minimum(states, found.states), found.states)
            found = found._replace(states=states)
        return self._carried_on(state, after, T), found

    def _with_samples(self, window: Samples, begin: int, known: Piece, found: steps.Found) -> Samples:
        """Return the window with the samples of a piece at their place."""
        numbers, n = self.plant.numbers, self.plant.system.n
        direct = (np.abs(numbers.D) + numbers.wide_D).sum(1) > 0
        blind = ~known.known[:, None] & direct[:, None]
        rad = np.where(blind, np.inf, known.rad).astype(self.plant.dtype)
        reach = np.maximum(found.states[:, :n], found.states[:, n:])
        out: Samples = jax.tree.map(np.array, window)
        for to, x in zip(out, (known.mid, rad, known.v, known.slip, reach), strict=True):
            to[begin : begin + len(x)] = x
        return out

    def _carried_on(self, state: JointState, after: steps.ZonotopeCarry, T: int) -> JointState:
        """Return the state behind T samples: sets that are older than what the zonotopes rest on are given
        up.
        """
        t = int(state.samples)
        block = t // self.half * self.half
        ages = after.age.reshape(-1, len(self.weights))
        since = np.where((ages >= 0).all(1), t + T - ages.max(1), t + T)
        state = state._replace(carry=after, samples=state.samples + T)
        return _believed(state, since <= block - self.half, since <= block, since == 0)

    def _refuted(
        self, state: JointState, begin: int, asked: np.ndarray, states: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return (refuted, margin (T, N), ends of states (T, 2 n, N)) of the windows that end at samples of
        one block, where asked.
        """
        wrong, margin, ends = np.zeros(asked.shape, bool), np.full(asked.shape, np.inf), states.copy()
        ks, lanes = np.nonzero(asked)
        if not len(ks):
            return wrong, margin, ends
        prior, window = chosen(state.prior, lanes), self._up_to(state.window, lanes, begin + ks)
        value, bound, t, z = gauges(self.windows, prior, window)
        refuted = np.abs(value) > bound
        wrong[ks, lanes] = refuted
        with np.errstate(divide="ignore", invalid="ignore"):
            margin[ks, lanes] = np.where(refuted, 1 - np.abs(value) / bound, np.maximum(1 - t, 0))
        if self.enclosures:
            n = self.plant.system.n
            own = ends[ks, :, lanes].T
            width = np.maximum(own[:n] + own[n:], 0)
            low, high = supports(self.windows, prior, window, z, np.eye(n), width, begin + ks)
            # ends in the wrong order are of a search that lost its digits
            shown = ~refuted & np.isfinite(low) & np.isfinite(high) & (low <= high)
            better = rounding.round_up(np.concatenate([-low, high]), self.plant.dtype)
            both = np.concatenate([shown, shown])
            ends[ks, :, lanes] = np.where(both, np.minimum(own, better), own).T
        return wrong, margin, ends

    def _up_to(self, window: Samples, lanes: np.ndarray, last: np.ndarray) -> Samples:
        """Return the windows of some recordings, without the samples behind the last of each."""
        some = chosen(window, lanes)
        later = np.arange(self.window)[:, None] > last
        rad = np.where(later[:, None], np.inf, some.rad).astype(self.plant.dtype)
        return some._replace(rad=rad)

    def _consistent(self, state: JointState, begin: int, asked: np.ndarray) -> np.ndarray:
        """Return (T, N) bool: where a trajectory through all samples so far is exhibited, of windows that end
        in one block.
        """
        out = np.zeros(asked.shape, bool)
        ks, lanes = np.nonzero(asked)
        if not len(ks):
            return out
        path, window = chosen(state.path, lanes), self._up_to(state.window, lanes, begin + ks)
        out[ks, lanes], *_ = self._trajectories(path, window)
        return out


def _later(window: Samples, count: int) -> Samples:
    """Return windows without their first samples, and without samples behind the others."""
    later = []
    for x, nothing in zip(window, (0, np.inf, 0, 0, np.inf), strict=True):
        later.append(np.concatenate([x[count:], np.full_like(x[:count], nothing)]))
    return Samples(*later)


def _believed(state: JointState, prior: np.ndarray, mark: np.ndarray, path: np.ndarray) -> JointState:
    """Return the state with the sets that are still to be believed, (N,) bool each."""
    return state._replace(
        prior=_only(prior, state.prior), mark=_only(mark, state.mark), path=_only(path, state.path)
    )


def joint_observer(zonotopes: ZonotopeObserver, window: int) -> JointObserver:
    """Return the observer that tests windows of up to `window` samples beside zonotopes.

    Raises:
        ValueError: unknown inputs that outputs do not show at once.
    """
    return JointObserver(
        plant=_with_one_way(zonotopes.plant),
        order=zonotopes.order,
        weights=zonotopes.weights,
        restart=zonotopes.restart,
        x0=zonotopes.x0,
        window=window,
    )


def _with_one_way(plant: ObservedPlant) -> ObservedPlant:
    """Return the plant with one way to take unknown inputs out of a sample: programs know no other."""
    if plant.unknown is None:
        return plant
    if plant.unknown.hidden:
        raise ValueError(
            'method "joint" needs outputs that show what unknown inputs do at once: use "zonotope" '
            'or "strips"'
        )
    return replace(plant, unknown=replace(plant.unknown, ways=plant.unknown.ways[:1]))
