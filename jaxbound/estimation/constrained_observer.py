"""The observer that carries a constrained zonotope: samples are kept as equations, until there are too many
of them.

A zonotope forgets of every sample what its shape cannot say; a constrained zonotope keeps the last equations
and a rest of older ones (`constrained_steps`). Whether anything is left of it is a small linear program,
which `sets.zonotopes` searches and proves. A zonotope of as many generators goes with it (`SetObserver`): it
begins, and holds where rounding takes too much.

Source: Scott, Raimondo, Marseglia, Braatz 2016.
"""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import numpy as np

from jaxbound.estimation import constrained_steps, zonotope_steps
from jaxbound.estimation.blocks import chosen, in_blocks, repeated
from jaxbound.estimation.constrained_hulls import refuted, row_hulls, rows_at
from jaxbound.estimation.contradictions import ended, fresh_behind, is_first, latched, staying, with_refuted
from jaxbound.estimation.set_observer import ObserverSetup, Piece, SetObserver, checked_weights
from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.status import Status
from jaxbound.text.objects import readable

__all__ = ["ConstrainedObserver", "ConstrainedState", "constrained_observer"]

BLOCK, PIECE = 8, 16
"""Recordings side by side in the one kernel there is, and samples: see `set_observer.BLOCK`."""


@readable
class ConstrainedState(NamedTuple):
    """The sets that the observer carries on.

    Fields: carry, samples: as of `ObserverState`; held: of `constrained_steps`, recordings last.
    """

    carry: zonotope_steps.ZonotopeCarry
    samples: np.int64
    held: constrained_steps.HeldRows


class _Looked(NamedTuple):
    """Samples that the kernels have followed, and the linear programs of them.

    Fields: carry, held: behind them; found: of zonotopes, with narrower states; wrong, margin (T, N): of the
    programs.
    """

    carry: zonotope_steps.ZonotopeCarry
    held: constrained_steps.HeldRows
    found: zonotope_steps.Found
    wrong: np.ndarray
    margin: np.ndarray

    def of_some(self, lanes: np.ndarray, other: "_Looked") -> None:
        """Write another result over some recordings, all but its verdicts."""
        for whole, part in zip(jax.tree.leaves(self[:3]), jax.tree.leaves(other[:3]), strict=True):
            whole[..., lanes] = part


@readable
@dataclass(frozen=True, eq=False, kw_only=True)
class ConstrainedObserver(SetObserver[ConstrainedState]):
    """Carries constrained zonotopes. Build it with `observer(model, Constrained())`.

    Fields: as of SetObserver; constraints: how many are kept.
    """

    constraints: int

    @property
    def made(self) -> tuple[object, ...]:
        """The choices that verdicts depend on beside the model: they name verdicts that are kept."""
        return *super().made, "constrained", self.constraints

    @property
    def generators(self) -> int:
        """How many generators a set has."""
        return super().generators + self.constraints

    def _with_carry(self, carry: zonotope_steps.ZonotopeCarry) -> ConstrainedState:
        """Return the state before the first sample, whose zonotopes are known."""
        held = constrained_steps.nothing(
            self.plant.system.n, self.constraints, self.generators, 1, self.plant.dtype
        )
        return ConstrainedState(carry, np.int64(0), held)

    def _of_all(self, carry: ConstrainedState, count: int) -> ConstrainedState:
        """Return the carry of `count` recordings; one of a single recording is that of all."""
        return ConstrainedState(repeated(carry.carry, count), carry.samples, repeated(carry.held, count))

    def _next_samples(self, state: ConstrainedState) -> int:
        """Return how many samples are tested at once."""
        return PIECE

    def _tested(
        self, state: ConstrainedState, samples: Piece
    ) -> tuple[ConstrainedState, zonotope_steps.Found]:
        """Return (state, Found) of up to `PIECE` samples."""
        looked = self._looked_at(state, samples)
        if not looked.wrong.any():
            carry, held, found = (
                looked.carry,
                looked.held,
                with_refuted(looked.found, looked.wrong, looked.margin),
            )
        elif self.restart:
            carry, held, found = self._begun_anew(state, samples, looked)
        else:
            carry, held, found = self._latched(state, samples, looked)
        return ConstrainedState(carry, state.samples + len(samples.fresh), held), found

    def _begun_anew(
        self, state: ConstrainedState, samples: Piece, looked: _Looked
    ) -> tuple[zonotope_steps.ZonotopeCarry, constrained_steps.HeldRows, zonotope_steps.Found]:
        """Return (carry, held, Found) where samples behind a contradiction begin anew, and are looked at
        again, until no recording has another one.
        """
        wrong = is_first(looked.wrong)
        again = wrong
        while again.any():
            lanes = np.flatnonzero(again.any(0))
            anew = samples._replace(fresh=fresh_behind(samples.fresh, wrong))
            own = state._replace(carry=chosen(state.carry, lanes), held=chosen(state.held, lanes))
            some = self._looked_at(own, anew.of_recordings(lanes))
            # behind the last contradiction that is known
            later = np.cumsum(wrong[:, lanes][::-1], 0)[::-1] == 0
            again = np.zeros_like(wrong)
            again[:, lanes] = is_first(some.wrong & later)
            looked.margin[:, lanes] = np.where(later, some.margin, looked.margin[:, lanes])
            looked.of_some(lanes, some)
            wrong = wrong | again
        gone = wrong[-1]
        held = looked.held._replace(on=looked.held.on & ~gone)
        return ended(looked.carry, gone), held, with_refuted(looked.found, wrong, looked.margin)

    def _latched(
        self, state: ConstrainedState, samples: Piece, looked: _Looked
    ) -> tuple[zonotope_steps.ZonotopeCarry, constrained_steps.HeldRows, zonotope_steps.Found]:
        """Return (carry, held, Found) where a FAULT stays until a gap; behind it no program is asked,
        wherever a piece ends.
        """
        fault = looked.wrong | (looked.found.status == Status.FAULT)
        behind = staying(state.carry.empty, fault, samples.fresh)
        margin = np.where(behind, np.inf, looked.margin)
        found = with_refuted(looked.found, looked.wrong & ~behind, margin)
        carry, found = latched(looked.carry, found, behind | fault)
        return carry, looked.held, found

    def _looked_at(self, state: ConstrainedState, samples: Piece) -> _Looked:
        """Return samples as kernels and linear programs see them: arrays that may be written to."""
        carry, held, found, asked = self._kernels(state, samples)
        n = self.plant.system.n
        wrong, margin = refuted(asked, n)
        if self.enclosures:
            there = np.nonzero(asked.on & ~wrong & (found.status != Status.FAULT) & (found.age > 0))
            if len(there[0]):
                ends = rounding.round_up(row_hulls(rows_at(asked, there), n), self.plant.dtype)
                states = np.moveaxis(np.asarray(found.states), 1, -1)  # the same memory
                states[there] = np.minimum(states[there], ends)
        return _Looked(carry, held, found, wrong, margin)

    def _kernels(
        self, state: ConstrainedState, samples: Piece
    ) -> tuple[
        zonotope_steps.ZonotopeCarry,
        constrained_steps.HeldRows,
        zonotope_steps.Found,
        constrained_steps.AskedRows,
    ]:
        """Return (carry, held, Found, rows) of samples, by the kernels alone."""
        numbers, start = self.plant.placed
        T, count = samples.fresh.shape
        filled = samples.filled(PIECE)
        wanted = zonotope_steps.ALL * self.enclosures

        def job(block: np.ndarray) -> tuple[np.ndarray, ...]:
            known = zonotope_steps.read(numbers, *filled.of_recordings(block))
            carry, held = jax.tree.map(lambda x: x[..., block], (state.carry, state.held))
            enclosures = zonotope_steps.worked_out(wanted)
            carry, held, found, asked = constrained_steps.follow(
                numbers, start, carry, held, known, T, enclosures, self.restart
            )
            found = zonotope_steps.kept(found, wanted)
            on_host: tuple[np.ndarray, ...] = jax.tree.map(np.asarray, (carry, held, found, asked))
            return on_host

        def joined(*parts: np.ndarray) -> np.ndarray:
            return np.array(np.concatenate(parts, -1)[..., :count])

        carry, held, found, asked = jax.tree.map(joined, *in_blocks(job, count, BLOCK))
        found, asked = jax.tree.map(lambda x: x[:T], (found, asked))
        return carry, held, found, asked


def constrained_observer(setup: ObserverSetup, constraints: int) -> ConstrainedObserver:
    """Return the observer that carries constrained zonotopes, with one weight.

    Raises:
        ValueError: unknown inputs.
    """
    if setup.plant.unknown is not None:
        raise ValueError("method 'constrained' takes no unknown inputs: use zonotope, strips or joint")
    return ConstrainedObserver(
        plant=setup.plant,
        order=setup.order,
        weights=checked_weights(1.0),
        restart=setup.restart,
        x0=setup.x0,
        constraints=constraints,
    )
