"""The observer that carries a constrained zonotope: what samples say is kept as equations, until there are
too many of them.

A zonotope forgets of every sample what its shape cannot say; a constrained zonotope keeps the last equations
and what is left of older ones (`constrained_steps`). Whether anything is left of it is a small linear
program, which `sets.zonotopes` searches and proves. A zonotope of as many generators goes with it
(`SetObserver`): it begins, and holds where rounding takes too much.

Source: Scott, Raimondo, Marseglia, Braatz 2016.
"""

from functools import cached_property
from typing import Any, NamedTuple

import jax
import numpy as np

from jaxbound.estimation import constrained_steps, zonotope_steps
from jaxbound.estimation.blocks import in_blocks
from jaxbound.estimation.observer import METHODS, SetObserver
from jaxbound.recordings.recording import Recording
from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.status import Status
from jaxbound.sets.zonotopes import gauges, proof
from jaxbound.text.objects import readable

__all__ = ["ConstrainedObserver", "ConstrainedState"]

BLOCK, PIECE = 8, 16
"""Recordings side by side in the one kernel there is, and samples: see `observer.BLOCK`."""
HULLS, SEARCH = 256, 12
"""Sets whose hulls are looked for at a time, and steps of it."""


@readable
class ConstrainedState(NamedTuple):
    """What the observer carries on. Fields: carry, samples: as of `ObserverState`; held: of
    `constrained_steps`, recordings last.
    """

    carry: zonotope_steps.Carry
    samples: np.int64
    held: constrained_steps.Held


@readable
class ConstrainedObserver(SetObserver):
    """Carries constrained zonotopes. Build it with `observer(model, method="constrained")`.

    Fields: as of SetObserver; constraints: how many are kept.
    """

    usual_order = 5.0

    def __init__(
        self, model: Any, order: float, weight: Any, *given: Any, constraints: int = 8, **more: Any
    ) -> None:
        super().__init__(model, order, 1.0, *given, **more)
        if self._unknown is not None:
            raise ValueError("method 'constrained' takes no unknown inputs: use zonotope, strips or joint")
        if isinstance(constraints, bool) or not isinstance(constraints, (int, np.integer)) or constraints < 1:
            raise ValueError(f"constraints must be a whole number >= 1, not {constraints!r}")
        self.constraints = int(constraints)

    @property
    def made(self) -> tuple:
        """What verdicts depend on beside the model: by it what is kept of them is known again."""
        return *super().made, "constrained", self.constraints

    @cached_property
    def _generators(self):
        return int(self.order * self._system.n) + self.constraints

    def _fresh(self):
        begun = super()._fresh()
        held = constrained_steps.nothing(self._system.n, self.constraints, self._generators, 1, self._dtype)
        return ConstrainedState(begun.carry, begun.samples, held)

    def judged(self, carry: ConstrainedState, piece: Recording) -> tuple[ConstrainedState, Any]:
        """Return what `fold` does, by XLA alone: its FAULTs are decided once."""
        lead, count, (*given, rounded) = self._given(carry, piece)
        state = jax.tree.map(lambda x: np.repeat(x, count // x.shape[-1], -1), (carry.carry, carry.held))
        T, first = len(given[0]), 0
        parts: list[zonotope_steps.Found] = []
        while first < T or not parts:
            stop = min(first + PIECE, T)
            state, found = self._tested(state, [x[first:stop] for x in given], rounded)
            parts.append(found)
            first = stop
        found = jax.tree.map(lambda *x: np.concatenate(x), *parts)
        return ConstrainedState(state[0], carry.samples + T, state[1]), self._told(found, lead, T, carry)

    def _tested(self, before, given, rounded):
        """Return (state, Found) of up to `PIECE` samples."""
        *samples, fresh = given
        after, found, asked = self._on(before, given, rounded)
        wrong, margin = self._looked_at(found, asked)
        if not wrong.any():
            return after, _lower(found, wrong, margin)
        if not self.restart:
            return self._lasting(before[0].empty, after, found, wrong, margin, fresh)
        refuted = wrong & (np.cumsum(wrong, 0) == 1)
        again = refuted
        while again.any():  # what follows a contradiction begins anew, and is looked at again
            lanes = np.flatnonzero(again.any(0))
            anew = fresh.copy()
            anew[1:] |= refuted[:-1]
            some = jax.tree.map(lambda x: np.take(x, lanes, -1), (before, [*samples, anew]))  # noqa: B023
            done, told, rows = self._on(some[0], some[1], rounded)
            more, less = self._looked_at(told, rows)
            later = np.cumsum(refuted[:, lanes][::-1], 0)[::-1] == 0  # behind the last one that is known
            new = more & later
            again = np.zeros_like(refuted)
            again[:, lanes] = new & (np.cumsum(new, 0) == 1)
            margin[:, lanes] = np.where(later, less, margin[:, lanes])
            for whole, part in zip(
                jax.tree.leaves((after, found)), jax.tree.leaves((done, told)), strict=True
            ):
                whole[..., lanes] = part
            refuted |= again
        carry, held = after
        gone = refuted[-1]
        carry = carry._replace(
            age=np.where(gone, -1, carry.age).astype(np.int32), ready=np.where(gone, 0, carry.ready)
        )
        return (carry, held._replace(on=held.on & ~gone)), _lower(found, refuted, margin)

    def _lasting(self, lasting, after, found, wrong, margin, fresh):
        """Return (state, Found) where a FAULT stays until a gap; behind it no program is asked, wherever a
        piece ends.
        """
        carry, held = after
        behind = np.zeros_like(wrong)
        for k in range(len(wrong)):
            behind[k] = lasting & ~fresh[k]
            lasting = behind[k] | wrong[k] | (found.status[k] == Status.FAULT)
        found = _lower(found, wrong & ~behind, np.where(behind, np.inf, margin))
        status = np.where(behind, np.int8(Status.FAULT), found.status)
        return (carry._replace(empty=carry.empty | lasting), held), found._replace(status=status)

    def _looked_at(self, found, asked):
        """Return (wrong, margin), (T, N) each, and put the ends of states into Found where they are
        wanted.
        """
        wrong, margin = _refuted(asked, self._system.n)
        if self.enclosures:
            there = np.nonzero(asked.on & ~wrong & (found.status != Status.FAULT) & (found.age > 0))
            if len(there[0]):
                ends = rounding.round_up(_hulls(_rows(asked, there), self._system.n), self._dtype)
                states = np.moveaxis(found.states, 1, -1)  # the same memory
                states[there] = np.minimum(states[there], ends)
        return wrong, margin

    def _on(self, state, given, rounded):
        """Return (state, Found, Asked) of some samples: arrays of all recordings, that may be written to."""
        numbers, start = self._placed
        T, count = given[-1].shape
        known_of = [np.concatenate([x, np.zeros((PIECE - T, *x.shape[1:]), x.dtype)]) for x in given]

        def job(block):
            cut = lambda x: x[..., block]
            u, y, slip, fresh = map(cut, known_of)
            known = zonotope_steps.read(numbers, u, y, slip, fresh, rounded)
            carry, held = jax.tree.map(cut, state)
            out = constrained_steps.follow(
                numbers, start, carry, held, known, T, 2 * self.enclosures, self.restart
            )
            return jax.tree.map(np.asarray, out)

        done = in_blocks(job, count, BLOCK)
        join = lambda *x: np.array(np.concatenate(x, -1)[..., :count])
        carry, held, found, asked = jax.tree.map(join, *done)
        first = lambda tree: jax.tree.map(lambda x: x[:T], tree)
        return (carry, held), first(found), first(asked)


METHODS["constrained"] = ConstrainedObserver


def _lower(found, wrong, margin):
    """Return Found with what linear programs have refuted."""
    low = np.where(
        wrong | (found.status != Status.FAULT), np.minimum(margin, found.margin), found.margin
    ).astype(found.margin.dtype)
    return found._replace(status=np.where(wrong, np.int8(Status.FAULT), found.status), margin=low)


def _rows(asked, at):
    """Return (b, A, s) in float64, sets first, of the rows A xi = b +- s of samples `at`."""
    return tuple(
        np.ascontiguousarray(np.moveaxis(x, -1, 1)[at], np.float64) for x in (-asked.h, asked.H, asked.r)
    )


def _refuted(asked, n):
    """Return (wrong, margin), (T, N) each: where no xi in the unit box has all rows below the first n at 0,
    and 1 - t there.
    """
    wrong, margin = np.zeros(asked.on.shape, bool), np.full(asked.on.shape, np.inf)
    at = np.nonzero(asked.on)
    if len(at[0]):
        b, A, s = (x[:, n:] for x in _rows(asked, at))
        image = proof.image(A)
        found = gauges.gauge_bounds(image, image.scaled(b[:, None]))
        some = np.flatnonzero(found.lower[:, 0] > 1)
        l = np.ldexp(found.l[some, 0], image.powers[some])
        value, reach = _value_and_reach(b[some], A[some], s[some], l[:, None], 0)
        with np.errstate(all="ignore"):
            far = np.abs(value[:, 0]) / reach[:, 0]
        proved = (far > 1) & np.isfinite(far)
        where = tuple(x[some] for x in at)
        wrong[where], margin[where] = proved, np.where(proved, 1 - far, np.inf)
    return wrong, margin


def _value_and_reach(b, A, s, l, g):
    """Return (value, reach), (S, d) each: l b, and at least |(g - l A) xi| + |l| s with all that rounding may
    add to both.

    b, s (S, k), A (S, k, q), l (S, d, k), g (S, d, q) or 0.
    """
    terms = A.shape[1] + A.shape[2] + 2
    gamma, floor = (float(x) for x in rounding.product_error(terms, np.float64))
    with np.errstate(all="ignore"):
        size = np.abs(l)
        reach = np.abs(g - l @ A).sum(-1) + (size * s[:, None]).sum(-1)
        whole = (np.abs(g).sum(-1) if np.ndim(g) else 0) + (
            size * (np.abs(b) + np.abs(A).sum(2) + s)[:, None]
        ).sum(-1)
        least = terms * floor * (1 + size.max(-1)) * (1 + np.abs(b).max(1) + np.abs(A).max((1, 2)))[:, None]
        return (l * b[:, None]).sum(-1), (reach + gamma * whole + least) * (1 + 1e-9)


def _hulls(rows, n):
    """Return ends -lo, hi (S, 2 n) of the first n rows, of middle -b, over all xi in the unit box that have
    the others at 0.
    """
    parts = [slice(first, first + HULLS) for first in range(0, len(rows[0]), HULLS)]
    return np.concatenate([_hull(tuple(x[some] for x in rows), n) for some in parts])


def _hull(rows, n):
    """Return the ends of some sets. For every l: g xi <= l b + |g - l A|_1, the dual program.

    The l are those of least squares, each entry weighted by 1 / |g - l A| of the one before (Lawson 1961),
    with the slope b.
    """
    b, A, s = rows
    g, c, r = (
        np.concatenate([-A[:, :n], A[:, :n]], 1),
        np.concatenate([b[:, :n], -b[:, :n]], 1),
        np.tile(s[:, :n], 2),
    )
    b, A, s = b[:, n:], A[:, n:], s[:, n:]
    size = np.abs(g).sum(2, keepdims=True) + 1e-300
    l, best = np.zeros((*g.shape[:2], A.shape[1])), np.full(g.shape[:2], np.inf)
    for step in range(SEARCH):
        with np.errstate(all="ignore"):
            D = 1 / (np.abs(g - l @ A) + size * 0.3 ** (step + 3))
            gram = (A[:, None] * D[:, :, None]) @ A.swapaxes(1, 2)[:, None]
            gram += (1e-13 * np.trace(gram, axis1=2, axis2=3) + 1e-300)[..., None, None] * np.eye(A.shape[1])
            l = np.linalg.solve(gram, ((D * g) @ A.swapaxes(1, 2) - b[:, None])[..., None])[..., 0]
        l = np.where(np.isfinite(l).all(-1, keepdims=True), l, 0)
        value, reach = _value_and_reach(b, A, s, l, g)
        best = np.fmin(best, value + reach + 1e-15 * np.abs(value))
    return c + best + r + 1e-15 * (np.abs(c) + np.abs(best) + r)
