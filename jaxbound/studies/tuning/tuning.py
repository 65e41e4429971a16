"""Tune bounds to healthy data: a direction by gradient, its smallest scale by the proved test, and what that
says about other data.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any, TypeAlias, cast, overload

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from jaxbound.consistency.monitorbank import MonitorBank
from jaxbound.estimation.set_observer import SetObserver
from jaxbound.files.checkpoint import Checkpoint
from jaxbound.models.arguments import taking_fields
from jaxbound.models.numbers import is_real, is_whole
from jaxbound.models.system import LinearSystem
from jaxbound.relations.identity import identity
from jaxbound.relations.parity import ParityRelation
from jaxbound.relations.uncertain import UncertainRelations
from jaxbound.sets.floats.kernel import sparing
from jaxbound.sets.floats.probe import where_proofs_hold
from jaxbound.sets.floats.sizes import power
from jaxbound.studies.tuning.confidence import Search, blocks_of, held_out, risk_of, touched
from jaxbound.studies.tuning.descent import (
    BLOCK,
    RATE,
    Faulty,
    Pace,
    default_optimizer,
    descend,
    objective_of,
)
from jaxbound.studies.tuning.left_out import factors_left_out
from jaxbound.studies.tuning.monitor_tuning import MonitorTuneResult, tuned_monitor
from jaxbound.studies.tuning.observer_tuning import tuned_observer
from jaxbound.studies.tuning.parametrization import Moving, Tunable, moving
from jaxbound.studies.tuning.scaling import JoinedRecordings, both_recordings, factors, smallest_scale, worst
from jaxbound.studies.tuning.tune_result import History, TuneResult
from jaxbound.studies.tuning.widening import Smallest, concluded, stated_factor
from jaxbound.text.names import listed
from jaxbound.text.progress import reporter

if TYPE_CHECKING:
    import optax

__all__ = ["MonitorTuneResult", "TuneResult", "tune"]

Windows: TypeAlias = ParityRelation | UncertainRelations
Carry: TypeAlias = "tuple[jax.Array, optax.OptState]"
"""Logarithms of the values that move, and the state of the optimiser."""

# worst windows that steps look at (by strips, by a search), and what a look at all of them adds
CAPACITY, SEARCHED, NEW = 1024, 256, 32
NEAR = 0.01  # bounds this close to the smallest are close enough between steps


@dataclass(frozen=True)
class _Asked:
    """The arguments of `tune` beside its recordings."""

    optimizer: optax.GradientTransformation | None
    steps: int
    bounds: str | Iterable[str] | None = None
    weights: Mapping[str, ArrayLike] | None = None
    safety: float = 1.25
    calibrate: float = 1 / 3
    block: int | None = None
    confidence: float = 0.95
    every: int = 10
    state: str | os.PathLike[str] | None = None


@overload
def tune(
    relations: Tunable,
    healthy: object,
    faulty: object = ...,
    optimizer: optax.GradientTransformation | None = ...,
    steps: int = ...,
    *,
    progress: Callable[[float], object] | None = ...,
    **fields: object,
) -> TuneResult: ...


@overload
def tune(
    relations: MonitorBank,
    healthy: object,
    faulty: object = ...,
    optimizer: None = ...,
    steps: int = ...,
    *,
    progress: Callable[[float], object] | None = ...,
    **fields: object,
) -> MonitorTuneResult: ...


@taking_fields(_Asked)
@where_proofs_hold()
@sparing(False)
def tune(
    relations: Tunable | MonitorBank,
    healthy: object,
    faulty: object = None,
    optimizer: optax.GradientTransformation | None = None,
    steps: int = 300,
    *,
    progress: Callable[[float], object] | None = None,
    **fields: object,
) -> TuneResult | MonitorTuneResult:
    """Find the smallest bounds under which healthy data are consistent; with faulty data, those that leave
    most of these outside.

    The direction of the bounds is found by gradient, free of their size; their size is then the smallest at
    which the proved test finds no healthy window outside, so this holds whatever the gradient did. Each of
    several recordings is then left out in turn: the bounds are as many times as wide as the one that needs
    most asks for, and `safety` on top. A model that `fit` made for these windows keeps the factor that was
    found there: to its own recordings it is no stranger.

    Args:
        relations: from `parity_relations`; their bounds are the start. Those at 0 stay 0. What the joint test
            explains, "box" and a bank do not refute either: bounds tuned by it hold for them too.
            Or a set observer of a LinearSystem: one factor on all bounds, by bisection, at which no sample is
            FAULT. Or a `jb.monitor`: one factor a test on the bounds that it scales, found as for this test
            alone; it takes neither optimizer, bounds, weights nor state, and makes no steps.
        healthy: (u, y), arrays (..., T, m) and (..., T, p) or DataFrames, or a list of such tuples, one a
            recording left out in turn; (u, y, starts) where a sample does not follow the last. NaN: missing.
        faulty: the same for recordings with faults, every window of which should be outside; or None.
        optimizer: of optax, on the logarithms of the bounds; None: Adam with a falling step.
        steps: of it. 0: only the size is found.
        progress: called with the share of the work done.
        fields: what is rare. bounds: names of those that move, "noise", "tolerance", "disturbance",
            "parameters"; None: all. The ends of an asymmetric disturbance move separately.
        weights: {name: number or one per entry}: what is made small is their weighted sum; None: 1 / starting
            bound.
        safety: factor >= 1 on the smallest bounds, for what the data did not show: 1.25 as in `fit` and at
            the command line; 1 for the smallest themselves. It is kept apart and in no statement.
        calibrate: share of the blocks of healthy windows, a third, that has no part in finding the direction,
            on which the statement about other data rests; 0: all are used to find it.
        block: windows in a block; None: so many that there are about 100 blocks.
        confidence: of that statement, .95.
        every: steps between two looks at all windows, 10.
        state: a file that is kept up to date: the same call goes on from it. An interruption (Ctrl-C) ends
            the search, not the call.

    Returns:
        A TuneResult; of a monitor a MonitorTuneResult.

    Raises:
        ValueError: no healthy window, bounds that cannot explain the healthy data, an unknown bound, faulty
            data that are the healthy ones, numbers out of range, a state of another call.
        NotImplementedError: constant_tolerance, of which there is no gradient (steps=0 works).

    Example:
        >>> import jaxbound as jb
        >>> r = jb.parity_relations(jb.LinearSystem([[0.5]], None, [[1]], noise=0.1))
        >>> # |y[k-1] - 2 y[k]| <= 3 noise
        >>> res = tune(r, (None, [[1.0], [0.8], [0.3]]), steps=0, safety=1.5)
        >>> round(res.scale, 6), res.bounds["noise"], res.counts["FAULT"]
        (2.0, array([0.3001]), 0)
    """
    rare = list(_Asked.__dataclass_fields__)[2:]
    unknown = set(fields) - set(rare)
    if unknown:
        raise TypeError(f"tune takes no argument {listed(sorted(unknown))}; the rare ones are {listed(rare)}")
    plan = replace(_Asked(optimizer, steps), **fields)  # type: ignore[arg-type]  # `_check` reads them
    safety, confidence, state = plan.safety, plan.confidence, plan.state
    _check_relations(relations)
    _check(plan)
    report = reporter(progress, "tune")
    if relations.parts:
        for name in ("optimizer", "bounds", "weights", "state"):
            if getattr(plan, name) is not None:
                raise ValueError(
                    f"tune finds one factor a test of a monitor: {name} belongs to one test alone"
                )
        one = partial(tune, steps=0, **fields)
        return tuned_monitor(cast(MonitorBank, relations), healthy, faulty, one, report)
    if relations.remembers:
        watch = cast(SetObserver[Any], relations)
        return tuned_observer(watch, healthy, faulty, plan.bounds, safety, confidence, report)
    model, s = relations.model, relations.horizon
    moved = moving(relations, plan.bounds, plan.weights)
    # one bound has no direction to look for: its size is all there is
    alone = len(moved.names) == 1
    good, bad = both_recordings(model, s, healthy, faulty)
    gone = good.without(s)
    blocks = blocks_of(gone, s, plan.block)
    if model.constant_tolerance and steps and not alone:
        raise NotImplementedError(
            "the margin of constant_tolerance comes from a search for the best gains, which has no "
            "derivative: tune with steps=0 scales all bounds by one factor, or those that bounds= names"
        )
    # blocks that settle the size have no part in the direction: on them rests what is said of other data
    for_scale = held_out(int(blocks.label.max(initial=-1)) + 1, 0 if alone else plan.calibrate)
    unseen = gone | touched(np.isin(blocks.label, np.flatnonzero(for_scale)), s)
    searching = partial(_Search, relations, moved, bad, plan)
    search = searching(good, unseen, state)
    if steps and not alone:
        search.run(lambda share: report(0.6 * share))

    low, high = smallest_scale(relations, moved, search.best, good)
    # the product is rounded: one step up holds what was proved
    smallest = np.nextafter(high * search.best, np.inf)

    def direction(number: int, others: JoinedRecordings) -> np.ndarray:
        if search.stopped or not steps or alone:
            return search.best
        again = searching(others, others.without(s), None)
        again.run(lambda share: report(0.6 + 0.3 * (number + share) / len(good.entries)))
        search.stopped = again.stopped
        return again.best

    left: tuple[float, ...] = ()
    if stated_factor(relations) is None:
        left = factors_left_out(relations, moved, good, direction)
    report(0.95)
    moved_kinds = {kind for kind, rows in moved.rows.items() if moved.select[rows].any()}
    convex = moved_kinds <= {"noise", "disturbance"}
    needs = factors(relations.with_bounds(moved.bounds(smallest)), good)
    found_by = Search(for_scale, len(moved.names), convex, search.step == 0)
    risk = risk_of(needs, blocks, found_by, confidence, safety)
    scale = low * moved.total(search.best) / moved.total(moved.start)
    found = Smallest(smallest, scale, left, risk, search.history, search.step, search.stopped)
    result = concluded(relations, moved, found, safety, good, bad)
    report(1.0)
    return replace(result, notes=(*result.notes, *_vanished(moved, smallest)))


@dataclass(eq=False)
class _Search:
    """The host's side of the descent: worst windows that the steps look at, the best bounds so far, and the
    file they are kept in.
    """

    relations: Windows
    moved: Moving
    bad: JoinedRecordings | None
    asked: _Asked
    good: JoinedRecordings
    unseen: np.ndarray
    file: str | os.PathLike[str] | None
    step: int = 0
    stopped: bool = False
    score: tuple[float, float] = (np.inf, np.inf)
    history: History = field(default_factory=list)
    checkpoint: Checkpoint | None = None

    def __post_init__(self) -> None:
        self.best: np.ndarray = self.moved.start
        self.ends: np.ndarray = np.zeros(0, np.int64)
        many = self.relations.searched or self.relations.uncertain
        self.capacity = SEARCHED if many else CAPACITY

    def run(self, report: Callable[[float], object]) -> None:
        """Make all steps, or those until an interruption."""
        optimizer, rate = default_optimizer(), RATE
        if self.asked.optimizer is not None:
            optimizer, rate = self.asked.optimizer, (1.0, 1.0)
        pace = Pace(self.asked.steps, self.asked.every, rate)
        dtype, s = self.good.y.dtype, self.relations.horizon
        problem = objective_of(self.relations, self.moved, self.asked.safety, dtype)
        z = _start(self.moved.start, dtype)
        carry = z, optimizer.init(z)
        if self.file is not None:
            self.checkpoint = Checkpoint(self.file, self._identity(carry))
            carry = self._taken_up(carry)
        faulty = None if self.bad is None else self._blocks(self.bad)
        try:
            if not self.step:
                carry = _start(self._look(self.moved.start), dtype), carry[1]
            while self.step < self.asked.steps:
                u, y = self.good.gather(np.resize(self.ends, self.capacity), s)
                u, y = jax.device_put((np.moveaxis(u, 0, 2), np.moveaxis(y, 0, 2)))
                healthy = u, y, np.arange(self.capacity) < len(self.ends)
                carry, best = descend(problem, optimizer, pace, carry, self.step, healthy, faulty)
                self.step = min(self.step + self.asked.every, self.asked.steps)
                self._look(np.exp(np.asarray(best, np.float64)))
                self._save(carry)
                report(self.step / self.asked.steps)
        except KeyboardInterrupt:
            self.stopped = True

    def _look(self, values: np.ndarray) -> np.ndarray:
        """Look at all windows: add the worst to those the steps look at; keep the values, at their smallest
        scale, if they are the best.
        """
        for _ in range(8):
            t = self._factors(values, self.good)
            fresh = worst(np.where(self.unseen, np.nan, t), NEW)
            top = float(t[fresh[0]]) if len(fresh) else 1.0
            self.ends = np.concatenate([self.ends[~np.isin(self.ends, fresh)], fresh])[-self.capacity :]
            if not abs(top - 1) > NEAR:
                break
            values = np.minimum(values * np.clip(top, 1e-3, 1e3), self.moved.most)
        width, outside, score = self.moved.total(values) * top, np.nan, 0.0
        if self.bad is not None:
            widened = np.minimum(values * top * self.asked.safety, self.moved.most)
            t = self._factors(widened, self.bad)
            outside = float(np.sum(t > 1) / max(np.sum(~np.isnan(t)), 1))
            score = -outside
        if (score, width) < self.score:
            self.best, self.score = values, (score, width)
        relative = width / self.moved.total(self.moved.start)
        self.history.append(np.array([self.step, relative, outside, *(values * top)]))
        return values

    def _factors(self, values: np.ndarray, recordings: JoinedRecordings) -> np.ndarray:
        return factors(self.relations.with_bounds(self.moved.bounds(values)), recordings)

    def _blocks(self, bad: JoinedRecordings) -> Faulty:
        """Return the faulty windows in blocks, shuffled so that each block shows all of them."""
        t = factors(self.relations, bad)
        ends = np.random.default_rng(0).permutation(np.flatnonzero(~np.isnan(t)))
        if not len(ends):
            raise ValueError("no faulty window has any data: all are MISSING")
        size = min(BLOCK, power(len(ends)))
        shape = -(-len(ends) // size), size
        filled = np.resize(ends, shape)
        real = np.arange(filled.size).reshape(shape) < len(ends)
        blocks: Faulty = jax.device_put((bad.u, bad.y, filled, real))
        return blocks

    def _identity(self, carry: Carry) -> dict[str, str]:
        """Return the mark that tells this call from others. Of an optimiser nobody can say more than what it
        carries.
        """
        carried: list[object] = [str(jax.tree.structure(carry))]
        for x in jax.tree.leaves(carry):
            carried.append((x.shape, str(x.dtype)))
        moved = self.moved
        also = {
            "healthy recordings": _data(self.good),
            "faulty recordings": None if self.bad is None else _data(self.bad),
            "share held out": self.unseen,
            "bounds": (moved.names, moved.select, moved.weights, moved.fixed, moved.start),
            "safety": self.asked.safety,
            "steps": self.asked.steps,
            "every": self.asked.every,
            "optimizer": carried,
        }
        return identity(self.relations, **also)

    def _save(self, carry: Carry) -> None:
        """Write the state of the search, if there is a file for it."""
        if self.checkpoint is None:
            return
        arrays = {f"leaf{i}": np.asarray(x) for i, x in enumerate(jax.tree.leaves(carry))}
        arrays |= {"score": np.array(self.score), "history": np.array(self.history)}
        self.checkpoint.save(step=self.step, best=self.best, ends=self.ends, **arrays)

    def _taken_up(self, carry: Carry) -> Carry:
        """Return the carry of the checkpoint, if there is one, and take over the rest of what it holds."""
        arrays = None if self.checkpoint is None else self.checkpoint.load()
        if arrays is None:
            return carry
        self.step, self.best, self.ends = int(arrays["step"]), arrays["best"], arrays["ends"]
        side, width = arrays["score"].tolist()
        self.score = side, width
        self.history = list(arrays["history"])
        leaves, tree = jax.tree.flatten(carry)
        kept: Carry = jax.tree.unflatten(tree, [jnp.asarray(arrays[f"leaf{i}"]) for i in range(len(leaves))])
        return kept


def _start(values: np.ndarray, dtype: np.dtype) -> jax.Array:
    """Return values as the optimiser moves them: their logarithms."""
    start: jax.Array = jax.device_put(np.log(values).astype(dtype))
    return start


def _data(recordings: JoinedRecordings) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return recordings.u, recordings.y, recordings.starts


def _vanished(moved: Moving, values: np.ndarray) -> tuple[str, ...]:
    """Return a sentence on bounds that fell to next to nothing: the optimum of a linear program lies at a
    corner.
    """
    small = []
    for name, now, before in zip(moved.names, values, moved.start, strict=True):
        if now < 1e-3 * before:
            small.append(name)
    if not small:
        return ()
    return (
        f"next to nothing is left of {', '.join(small)}: the others explain these data, new ones perhaps "
        f"not. To keep it, leave its kind out of what moves, or give it less weight",
    )


def _check_relations(relations: Tunable | MonitorBank) -> None:
    """Raise TypeError for relations that `tune` does not take."""
    why = getattr(relations, "untuned", "")
    if why is not None:
        raise TypeError(f"tune needs relations from parity_relations, not {type(relations).__name__}{why}")
    if not isinstance(relations.model, LinearSystem):
        raise TypeError(
            "tune needs the observer of a LinearSystem: an interval_system has no bounds to scale"
        )


def _check(asked: _Asked) -> None:
    """Raise ValueError for numbers out of range, an optimiser or a state that is none."""
    _refuse_below("steps", asked.steps, 0)
    _refuse_below("every", asked.every, 1)
    if asked.block is not None:
        _refuse_below("block", asked.block, 1)
    safety, calibrate, confidence = asked.safety, asked.calibrate, asked.confidence
    optimizer, state = asked.optimizer, asked.state
    if not (is_real(safety) and 1 <= safety < np.inf):
        raise ValueError(f"safety is a factor >= 1 on the smallest bounds, not {safety!r}")
    if not (is_real(calibrate) and 0 <= calibrate < 1):
        raise ValueError(
            f"calibrate is the share of blocks kept out of the search: 0 <= calibrate < 1, not {calibrate!r}"
        )
    if not (is_real(confidence) and 0 < confidence < 1):
        raise ValueError(f"confidence must lie between 0 and 1, not {confidence!r}")
    if optimizer is not None and not (hasattr(optimizer, "init") and hasattr(optimizer, "update")):
        raise ValueError(f"optimizer must be one of optax, like optax.adam(0.05), not {optimizer!r}")
    if state is not None and not isinstance(state, str | os.PathLike):
        raise ValueError(f"state must be the path of a file, like 'tuning.npz', not {state!r}")


def _refuse_below(name: str, value: object, least: int) -> None:
    """Raise ValueError for a number that is not whole, or too small."""
    if not is_whole(value) or value < least:
        raise ValueError(f"{name} must be a whole number >= {least}, not {value!r}")
