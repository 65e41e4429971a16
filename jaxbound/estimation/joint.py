"""The observer that tests windows exactly, each with a first state that lies in what the samples before it
allow.

Samples come in blocks of half a window. The window of a sample begins with the block before its own; its
first state lies in a parallelotope {x : lo <= D x <= hi}, which the window that ended with its own block
found by linear programs, with a first state in the one before that, and so on: nothing is forgotten but what
a parallelotope cannot say, and some strips with it. Its directions are the principal ones of a Kalman filter;
those of the strips are slow modes, and what the outputs will show. A zonotope goes with it (`SetObserver`):
it begins, and bounds what rounding and uncertain parameters act on.

Sources: Scott, Raimondo, Marseglia, Braatz 2016 (the exact set of a window is a linear program); Rao,
Rawlings, Mayne 2003 (a window that knows what came before it). Programs are searched for in floats
(`window_search`) and what they found is proved (`window_proof`).
"""

from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxbound.estimation import zonotope_steps as steps
from jaxbound.estimation.blocks import in_blocks
from jaxbound.estimation.observer import METHODS, SetObserver
from jaxbound.estimation.ordered import added, product
from jaxbound.estimation.parallelotope import OFF, ROUNDED, lasting, parallelotope, principal, strip, template
from jaxbound.estimation.window_proof import Prior, Samples, enclosed, reach_before, window_of
from jaxbound.estimation.window_runs import runs_of
from jaxbound.estimation.window_search import followed, middle, searched, split
from jaxbound.recordings.recording import Recording
from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.status import Status
from jaxbound.text.objects import readable

__all__ = ["JointObserver", "JointState"]

ROOM = 32
"""Windows side by side in the one kernel there is: see `observer.BLOCK`. A search ends with the slowest of
them.
"""
AGAIN, LOST = 2, 1e-3
"""Searches after the first where that lost its trajectory; how far a sample may be off it, as a share of the
largest unknown.
"""
SETTLED = 8
"""Blocks after which the directions stay as they are."""


@readable
class JointState(NamedTuple):
    """What the observer carries on, recordings on the last axis.

    Fields: carry, samples: as of `ObserverState`. window: the last two blocks, so far; prior, held (N,): the
    set of the first state of the window, and where there is one; mark, marked: of the state in the middle of
    it, from the zonotope.
    """

    carry: steps.Carry
    samples: np.int64
    window: Samples
    prior: Prior
    held: np.ndarray
    mark: Prior
    marked: np.ndarray
    path: Prior
    told: np.ndarray


@readable
class JointObserver(SetObserver):
    """Tests windows whose first state lies in an enclosure. Build it with `observer(model, method="joint")`.

    Fields: as of SetObserver; window: most samples of a window, even.
    """

    hulls = True

    def __init__(self, *given: Any, window: int = 32, **more: Any) -> None:
        super().__init__(*given, **more)
        if self._unknown is not None:
            if self._unknown.hidden:
                raise ValueError(
                    'method "joint" needs outputs that show what unknown inputs do at once: use "zonotope" '
                    'or "strips"'
                )
            self._unknown = replace(self._unknown, ways=self._unknown.ways[:1])
        if isinstance(window, bool) or not isinstance(window, (int, np.integer)) or window < 4 or window % 2:
            raise ValueError(f"window must be an even number of samples >= 4, not {window!r}")
        self.window = int(window)

    @property
    def made(self) -> tuple:
        """What verdicts depend on beside the model: by it what is kept of them is known again."""
        return *super().made, "joint", self.window

    def _fresh(self):
        m, dtype, begun = self._system, self._dtype, super()._fresh()
        zero = lambda *shape: np.zeros((*shape, 1), dtype)
        L, t, nothing = self.window, len(self._strips), np.zeros(1, bool)
        samples = Samples(
            zero(L, m.p), zero(L, m.p) + np.inf, zero(L, m.m), zero(L, m.m), zero(L, m.n) + np.inf
        )
        prior = Prior(zero(m.n), zero(m.n, m.n), zero(m.n), zero(t), zero(t) + np.inf)
        return JointState(begun.carry, begun.samples, samples, prior, nothing, prior, nothing, prior, nothing)

    def judged(self, carry: JointState, piece: Recording) -> tuple[JointState, Any]:
        """Return what `fold` does, by XLA alone: its FAULTs are decided once."""
        lead, count, (*given, rounded) = self._given(carry, piece)
        state = JointState(
            carry.carry,
            carry.samples,
            *jax.tree.map(lambda x: np.repeat(x, count // x.shape[-1], -1), tuple(carry[2:])),
        )
        T, first, half = len(given[0]), 0, self.window // 2
        parts: list[steps.Found] = []
        while first < T or not parts:
            at = int(state.samples) % half
            if at == 0 and T:
                state = self._next_block(state)
            stop = min(first + half - at, T)
            state, found = self._tested(state, count, [x[first:stop] for x in given], rounded)
            parts.append(found)
            first = stop
        found = jax.tree.map(lambda *x: np.concatenate(x), *parts)
        return state, self._told(found, lead, T, carry)

    def _next_block(self, state):
        """Move the window on by a block, and enclose what will be the first state of windows."""
        half, number = self.window // 2, int(state.samples) // (self.window // 2)
        prior, carry, lanes = state.mark, state.carry, len(self.weights)
        if state.held.any():
            D, back = self._directions(number - 1)
            lanes_held = np.flatnonzero(state.held)
            cut = lambda tree: _cut(tree, lanes_held)
            old = cut(prior)
            rows, n = np.concatenate([D, self._strips]), len(D)
            lo, hi = template(rows, old.c[None], old.S[None], old.r[None])
            lo[n:], hi[n:] = np.maximum(lo[n:], old.mid - old.rad), np.minimum(hi[n:], old.mid + old.rad)
            low, high = self._supports(
                cut(state.prior), cut(state.window), rows, hi - lo, np.full(len(lanes_held), half), True
            )
            lo, hi = np.maximum(lo, low), np.minimum(hi, high)
            reach = (
                cut(state.window).reach
                if self._unknown is None
                else reach_before(self._exact, cut(state.prior), cut(state.window))
            )
            better = parallelotope(
                D, back, lo[:n], hi[:n], reach[half], strip(lo[n:], hi[n:], self._dtype), self._dtype
            )
            prior, bounded = jax.tree.map(np.array, prior), _bounded(better)
            for x, new in zip(prior, better, strict=True):
                x[..., lanes_held] = np.where(bounded, new, x[..., lanes_held])
        if number == 0 and self._first is not None:
            mark = Prior(
                *(np.repeat(x[..., None], len(state.held), -1) for x in self._first),
                *self._no_strips(len(state.held)),
            )
            marked = np.ones(len(state.held), bool)
        else:
            split = lambda x: np.moveaxis(x.reshape(*x.shape[:-1], lanes, -1), -2, 0)
            D, back = self._directions(number)
            c, G, r = map(split, carry[:3])
            marked = (split(carry.age) >= 0).all(0)
            lo, hi = template(D, c, G, r)
            reach, told = (
                (abs(c) + added(abs(G), 2) + r).min(0) * ROUNDED,
                strip(*template(self._strips, c, G, r), self._dtype),
            )
            mark = parallelotope(D, back, lo, hi, reach, told, self._dtype)
            marked &= _bounded(mark)
            mark = Prior(*(np.where(marked, x, 0) for x in mark))
        path, told = self._path_on(state, number)
        later = lambda x, nothing: np.concatenate([x[half:], np.full_like(x[half:], nothing)])
        nothing = Samples(0, np.inf, 0, 0, np.inf)
        window = Samples(*(later(x, value) for x, value in zip(state.window, nothing, strict=True)))
        return state._replace(
            window=window, prior=prior, held=state.marked, mark=mark, marked=marked, path=path, told=told
        )

    def _path_on(self, state, number):
        """Return (path, told) of the next block: the state in the middle of the window on a trajectory
        through all of it.
        """
        if number == 1 and self._first is not None:
            more = getattr(self.model, "averages", ()) or getattr(self.model, "constant_tolerance", False)
            if (
                more or self._unknown is not None
            ):  # bounds that enclosures may leave out; a trajectory must not
                return state.path, state.told
            c, S, r, *_ = state.mark
            apart = (S == 0) | np.eye(len(S), dtype=bool)[
                :, :, None
            ]  # sides of a box: a state is compared with each
            return Prior(c, S, np.zeros_like(r), *self._no_strips(r.shape[-1])), state.marked & apart.all(
                (0, 1)
            )
        lanes = np.flatnonzero(state.told)
        if not len(lanes):
            return state.path, state.told
        cut = lambda tree: _cut(tree, lanes)

        def job(chosen):
            some, seen = (_cut(cut(tree), chosen) for tree in (state.path, state.window))
            *_, z, window = self._gauges(some, seen)
            return self._explained(some, seen, *split(z, window)[:2])

        found = zip(*in_blocks(job, len(lanes), ROOM), strict=True)
        ok, x, off = (np.concatenate(parts, -1)[..., : len(lanes)] for parts in found)
        path, told = (
            Prior(*(np.zeros_like(v) for v in state.path[:3]), *state.path[3:]),
            np.zeros_like(state.told),
        )
        path.c[:, lanes], path.r[:, lanes] = (
            x,
            rounding.round_up(off + np.abs(x - x.astype(self._dtype)), self._dtype),
        )
        told[lanes] = ok
        return path, told

    def _explained(self, path, samples, xi, w):
        """Return (ok (N,), x (n, N), off (n, N)): whether a trajectory is proved to keep all bounds, its
        middle state, how far off.

        The trajectory is the exact one of these xi and w, made a little smaller than 1; floats follow it to
        within `off`. What rounds an enclosure outward acts against it here.
        """
        x64 = lambda tree: jax.tree.map(lambda v: np.asarray(v, np.float64), tree)
        m, (path, samples, xi, w) = self._exact, map(x64, (path, samples, xi, w))
        less, size, to = 1 - 1e-9, np.abs, product
        xi, w = np.clip(np.nan_to_num(xi), -less, less), np.clip(np.nan_to_num(w), -less, less)
        x, off = path.c + (path.S * xi[None]).sum(1), path.r.copy()
        ok = ((path.S == 0) | (1e-9 * size(path.S) > 1e-14 * size(path.c)[:, None])).all((0, 1))
        for j in range(self.window):
            mid, s, v, slip, _ = (part[j] for part in samples)
            if j == self.window // 2:
                middle = x, off
            seen = np.isfinite(s)
            away = size(mid - to(m.C, x) - to(m.D, v)) + to(size(m.C), off) + to(m.wide_C, size(x) + off)
            away = away + to(m.wide_D, size(v)) + to(size(m.D), slip)
            away = away + OFF * (size(mid) + to(size(m.C), size(x)) + to(size(m.D), size(v)))
            ok &= (~seen | (away <= less * np.where(seen, s, 1))).all(0)
            if j + 1 < self.window:
                off = (
                    to(size(m.A), off)
                    + to(m.wide_A, size(x) + off)
                    + to(m.wide_B, size(v))
                    + to(size(m.B), slip)
                    + m.wide_w[:, None]
                )
                off = off + OFF * (
                    to(size(m.A), size(x)) + to(size(m.B), size(v)) + (size(m.w) + size(m.W).sum(1))[:, None]
                )
                x = to(m.A, x) + to(m.B, v) + m.w[:, None] + to(m.W, w[j])
        return ok, *middle

    def _tested(self, state, count, given, rounded):
        """Return (state, Found) of samples of one block."""
        u, y, slip, fresh = given
        T, half, t, before = len(fresh), self.window // 2, int(state.samples), state.carry
        begin = half + t % half
        after, found, known = self._followed(before, count, u, y, slip, fresh, rounded)
        after = steps.Carry(*map(np.asarray, after))
        direct = (np.abs(self._numbers.D) + self._numbers.wide_D).sum(1) > 0
        rad = np.where(~known.known[:, None] & direct[:, None], np.inf, known.rad).astype(self._dtype)
        n = self._system.n
        reach = np.maximum(found.states[:, :n], found.states[:, n:])
        window = jax.tree.map(np.array, state.window)
        for to, x in zip(window, (known.mid, rad, known.v, known.slip, reach), strict=True):
            to[begin : begin + T] = x
        since = t + np.arange(T)[:, None] - found.age + 1
        asked = (
            (found.age > 0)
            & (since <= t // half * half - half)
            & state.held
            & (found.status == Status.UNDECIDED)
        )
        state = state._replace(window=window)
        wrong, margin, states = self._windows(state, begin, asked, found.states)
        right = self._consistent(state, begin, asked & ~wrong & state.told & (since == 0))
        if wrong.any():
            first = wrong & (np.cumsum(wrong, 0) == 1)
            before_it = np.cumsum(first, 0) - first == 0  # windows behind it speak of what is given up
            asked, right = asked & before_it, right & before_it
            after, found = self._contradicted(before, count, given, rounded, first, after, found)
            wrong = first
        held = after.age.reshape(len(self.weights), -1)
        since = np.where((held >= 0).all(0), t + T - held.max(0), t + T)
        status = np.where(
            wrong, np.int8(Status.FAULT), np.where(right, np.int8(Status.CONSISTENT), found.status)
        )
        lower = np.where(
            asked & (margin < found.margin) & ((found.status != Status.FAULT) | wrong), margin, found.margin
        )
        found = found._replace(status=status, margin=lower.astype(self._dtype))
        if self.enclosures:
            found = found._replace(
                states=np.where(
                    asked[:, None] & (found.age > 0)[:, None], np.minimum(states, found.states), found.states
                )
            )
        block = t // half * half
        return state._replace(
            carry=after,
            samples=state.samples + T,
            held=state.held & (since <= block - half),
            marked=state.marked & (since <= block),
            told=state.told & (since == 0),
        ), found

    def _contradicted(self, before, count, given, rounded, first, after, found):
        """Return (carry, Found) of samples again, where windows are refuted at `first` (T, N)."""
        u, y, slip, fresh = given
        if self.restart:
            again = fresh.copy()
            again[1:] |= first[:-1]
            after, found, _ = self._followed(before, count, u, y, slip, again, rounded)
            after = steps.Carry(*map(np.asarray, after))
            gone = np.tile(first[-1], len(self.weights))
            return after._replace(
                age=np.where(gone, -1, after.age).astype(np.int32), ready=np.where(gone, 0, after.ready)
            ), found
        lasting = np.zeros_like(first[0])
        status = found.status.copy()
        for k in range(len(first)):
            lasting = (lasting & ~fresh[k]) | first[k]
            status[k] = np.where(lasting, Status.FAULT, status[k])
        return after._replace(empty=after.empty | np.tile(lasting, len(self.weights))), found._replace(
            status=status
        )

    def _windows(self, state, begin, asked, states):
        """Return (refuted, margin (T, N), ends of states (T, 2 n, N)) of the windows that end at samples of
        one block, where asked.
        """
        T, N = asked.shape
        wrong, margin, ends = np.zeros((T, N), bool), np.full((T, N), np.inf), states.copy()
        ks, lanes = np.nonzero(asked)
        if not len(ks):
            return wrong, margin, ends
        later = np.arange(self.window)[:, None] > begin + ks
        cut = lambda tree, chosen: _cut(tree, lanes[chosen])

        def samples(chosen):
            one = cut(state.window, chosen)
            return one._replace(rad=np.where(later[:, None, chosen], np.inf, one.rad).astype(self._dtype))

        def job(chosen):
            return self._gauges(cut(state.prior, chosen), samples(chosen))[:3]

        size = ROOM
        value, bound, t = (
            np.concatenate(x)[: len(ks)] for x in zip(*in_blocks(job, len(ks), size), strict=True)
        )
        refuted = np.abs(value) > bound
        wrong[ks, lanes] = refuted
        with np.errstate(divide="ignore", invalid="ignore"):
            margin[ks, lanes] = np.where(refuted, 1 - np.abs(value) / bound, np.maximum(1 - t, 0))
        if self.enclosures:
            every, n = np.arange(len(ks)), self._system.n
            width = np.maximum(ends[ks, :n, lanes] + ends[ks, n:, lanes], 0).T
            low, high = self._supports(cut(state.prior, every), samples(every), np.eye(n), width, begin + ks)
            shown = ~refuted[:, None] & (np.isfinite(low) & np.isfinite(high)).T & (low <= high).T
            for part, end in ((slice(0, n), -low), (slice(n, 2 * n), high)):
                ends[ks, part, lanes] = np.where(
                    shown,
                    np.minimum(ends[ks, part, lanes], rounding.round_up(end.T, self._dtype)),
                    ends[ks, part, lanes],
                )
        return wrong, margin, ends

    def _consistent(self, state, begin, asked):
        """Return (T, N) bool: where a trajectory through all samples so far is exhibited, of windows that end
        in one block.
        """
        out = np.zeros(asked.shape, bool)
        ks, lanes = np.nonzero(asked)
        if not len(ks):
            return out

        def job(chosen):
            cut = lambda tree: _cut(tree, lanes[chosen])
            later, seen, path = (
                np.arange(self.window)[:, None] > begin + ks[chosen],
                cut(state.window),
                cut(state.path),
            )
            seen = seen._replace(rad=np.where(later[:, None], np.inf, seen.rad).astype(self._dtype))
            *_, z, window = self._gauges(path, seen)
            return self._explained(path, seen, *split(z, window)[:2])[0]

        out[ks, lanes] = np.concatenate(in_blocks(job, len(ks), ROOM))[: len(ks)]
        return out

    def _gauges(self, prior, samples):
        """Return (value, bound, t, z, window) of windows: |value| > bound is a contradiction, t < 1 explains
        in plain floats.

        A search that proved nothing and lost its trajectory begins again from the one that its first state
        and disturbances make.
        """
        window = window_of(self._exact, self._strips, prior, samples, self._runs)
        found = self._gauge(prior, samples, window, middle(window))
        for _ in range(AGAIN):
            value, bound, t, z = found
            lost = (np.abs(value) <= bound) & ~(t < 1)
            if not lost.any():
                break
            near, off = followed(window, z)
            lost &= ~(off <= LOST * t)
            if not lost.any():
                break
            again = self._gauge(prior, samples, window, near)
            found = tuple(np.where(lost, new, old) for new, old in zip(again, found, strict=True))
        return *found, window

    def _gauge(self, prior, samples, window, z):
        """Return (value, bound, t, z) of windows, searched for from a trajectory on."""
        n, N = prior.c.shape
        weight, t, z = searched(window, z, 0.02)
        shown = enclosed(
            self._exact, self._strips, prior, samples, weight, np.zeros((n, N)), np.zeros(N), runs=self._runs
        )
        return *shown, t, z

    def _supports(self, prior, samples, D, width, J, before=False):
        """Return (lo, hi), each (r, N), of D x_J over all that explains windows, D (r, n), J (N,); width (r,
        N): about theirs.
        """
        rows, N, earlier = (
            len(D),
            prior.c.shape[-1],
            before and self._unknown is not None,
        )  # than what unknown inputs add
        scale = np.ldexp(1.0, -np.frexp(np.where((width > 0) & np.isfinite(width), width, 1))[1])
        out = np.full((2, rows, N), np.inf)

        # several bounds of one first state are nearly parallel: closer to the optimum their multipliers lose
        # their digits
        close = 1e-4 if self._dtype == np.float32 else 1e-6 if np.isfinite(prior.rad).any() else 1e-9

        def job(chosen):
            some, seen = (_cut(tree, chosen) for tree in (prior, samples))
            *_, z, window = self._gauges(some, seen)
            found = []
            for sign in (-1, 1):
                for i in range(rows):
                    d = (sign * D[i][:, None] * scale[i, chosen]).astype(self._dtype)
                    pulled = (
                        product(self._exact.A.T, d.astype(np.float64)).astype(self._dtype) if earlier else d
                    )
                    weight, *_ = searched(window, z, close, pulled, J[chosen] - earlier)
                    value, bound = enclosed(
                        self._exact, self._strips, some, seen, weight, d, J[chosen], before, self._runs
                    )
                    found.append(
                        np.where(np.isfinite(bound), _sum_up(value, bound) / scale[i, chosen], np.inf)
                    )
            return np.stack(found, -1)

        size = ROOM
        out = np.concatenate(in_blocks(job, N, size))[:N].T.reshape(2, rows, N)
        return -out[0], out[1]

    @cached_property
    def _exact(self):
        """The numbers, as exact as floats of the dtype are, in float64."""
        return jax.tree.map(lambda x: np.asarray(x, np.float64), self._numbers)

    @cached_property
    def _runs(self):
        """The runs of averages in a window; None: there are none, or unknown inputs beside them."""
        return runs_of(self.model, self.window) if self._unknown is None else None

    @property
    def _first(self):
        """(c, S, r) of x0 where it has no more generators than states, else of its box."""
        if self._x0 is None:
            return None
        c, G, r = (np.pad(x, ((0, self._system.n - len(x)), *[(0, 0)] * (x.ndim - 1))) for x in self._x0)
        n = len(c)
        G = G[:, np.abs(G).any(0)]
        if G.shape[1] <= n:
            return c, np.pad(G, ((0, 0), (0, n - G.shape[1]))), r
        return c, np.diag(rounding.round_up(np.abs(G.astype(np.float64)).sum(1) * ROUNDED, self._dtype)), r

    @cached_property
    def _strips(self):
        """T (t, n): what is enclosed of a first state beside the sides of a parallelotope; nothing beside
        unknown inputs or averages.
        """
        rows = lasting(self._exact.A, self._exact.C, self.window // 2)[
            : None if self._unknown is None and self._runs is None else 0
        ]
        return rows.astype(self._dtype).astype(np.float64)

    def _no_strips(self, N):
        """Return (mid, rad) of strips that say nothing."""
        return np.zeros((len(self._strips), N), self._dtype), np.full(
            (len(self._strips), N), np.inf, self._dtype
        )

    def _directions(self, number):
        """Return (D, back), (n, n) each, back about the inverse of D, of the blocks so far."""
        return self._principal[min(number, SETTLED)]

    @cached_property
    def _principal(self):
        """Directions of the blocks, [(D, back)], see `principal`."""
        return principal(self._exact, self.window // 2, SETTLED, self._dtype)


METHODS["joint"] = JointObserver


def _bounded(prior):
    """Say which sets are bounded, (N,) bool."""
    return np.isfinite(prior.c).all(0) & np.isfinite(prior.S).all((0, 1)) & np.isfinite(prior.r).all(0)


def _cut(tree, lanes):
    """Return some recordings, in the order of memory that all have."""
    return jax.tree.map(lambda x: np.take(x, lanes, -1), tree)


def _sum_up(a, b):
    """Return at least a + b."""
    return np.nextafter(a.astype(np.float64) + b.astype(np.float64), np.inf)
