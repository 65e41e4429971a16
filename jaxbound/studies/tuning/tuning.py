"""Tune bounds to healthy data: a direction by gradient, its smallest scale by the proved test, and what that
says about other data.
"""

import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import ArrayLike

from jaxbound.diagnosis.detection import detect
from jaxbound.estimation.set_observer import SetObserver
from jaxbound.files.checkpoint import Checkpoint
from jaxbound.models.system import LinearSystem
from jaxbound.relations.bounds import Bounds, model_bounds
from jaxbound.relations.identity import identity
from jaxbound.relations.parity import ParityRelation
from jaxbound.relations.redundancy import Redundancy
from jaxbound.relations.residual import Residual
from jaxbound.relations.uncertain import UncertainRelations
from jaxbound.sets.floats.probe import refuse_unverified
from jaxbound.sets.floats.sizes import power
from jaxbound.studies.tuning.confidence import Risk, blocks_of, held_out, risk_of, touched
from jaxbound.studies.tuning.descent import BLOCK, RATE, default_optimizer, descend, objective_of
from jaxbound.studies.tuning.parametrization import model_with, moving
from jaxbound.studies.tuning.scaling import factors, joined_recordings, smallest_scale, worst
from jaxbound.text.objects import readable

if TYPE_CHECKING:
    import optax

__all__ = ["TuneResult", "tune"]

CAPACITY, SEARCHED, NEW = (
    1024,
    256,
    32,
)  # worst windows that steps look at (by strips, by a search), and what a look at all of them adds
UNTUNED = {
    Redundancy: ", whose relations explain alone whatever the joint test explains: tune that, and build the "
    "bank of the tuned .model",
    Residual: ", whose verdict comes from bisection, with no margin to scale or to derive: try boxes by "
    "with_bounds and detect",
    SetObserver: ", whose margin has no derivative: tune long windows, with lags, and build the observer of "
    "the tuned .model",
}
NEAR = 0.01  # bounds this close to the smallest are close enough between steps


@readable
@dataclass(frozen=True, eq=False)
class TuneResult:
    """Bounds that were tuned, how, and what is known of them.

    Fields:
        bounds: {name: array}, smallest times safety, rounded up to four digits: those of .model.
        smallest: {name: array}, at which every healthy window is proved to be consistent. For use with
            `with_bounds`.
        scale: their size, the weighted mean of smallest / starting bounds, rounded down: along this direction
            no smaller bounds explain the healthy data, for a little below it `detect` finds a FAULT. With one
            bound, or no steps, the smallest factor on all of them.
        safety: the factor on top.
        start: {name: array}, where they came from.
        margin: (T,) of the healthy samples laid end to end, at .bounds, by the proved test; NaN where no
            window ends.
        counts: {status name: healthy windows} at .bounds; FAULT is 0. faulty_counts: the same of the faulty
            windows, or None.
        statement, risk: what is known about healthy data not seen, in sentences and as a Risk.
        history: {"step": (k,), "width": (k,) of the smallest bounds in this direction relative to the start,
            "outside": (k,) share of faulty windows outside (NaN without any), "values": (k, b)}; names: (b,),
            of the bounds that moved.
        steps: made. stopped: True if interrupted: this is the best until then.
        model: the LinearSystem with .bounds, for `save_model`. relations: those of its horizon, for `detect`.
        notes: sentences on what did not move.
    """

    bounds: Bounds
    smallest: dict[str, np.ndarray]
    scale: float
    safety: float
    start: Bounds
    margin: np.ndarray
    counts: dict[str, int]
    faulty_counts: dict[str, int] | None
    risk: Risk
    history: dict[str, np.ndarray]
    names: tuple[str, ...]
    steps: int
    stopped: bool
    model: LinearSystem
    relations: ParityRelation | UncertainRelations
    notes: tuple[str, ...]

    @property
    def statement(self) -> str:
        """Sentences about healthy data that were not seen."""
        return self.risk.text

    @property
    def caught(self) -> float | None:
        """The share of faulty windows that are FAULT at .bounds, or None."""
        found = self.faulty_counts
        return None if found is None else found["FAULT"] / max(sum(found.values()) - found["MISSING"], 1)


def tune(
    relations: ParityRelation | UncertainRelations,
    healthy: object,
    faulty: object = None,
    optimizer: "optax.GradientTransformation | None" = None,
    steps: int = 300,
    *,
    bounds: str | Iterable[str] | None = None,
    weights: Mapping[str, ArrayLike] | None = None,
    safety: float = 1.25,
    calibrate: float = 1 / 3,
    block: int | None = None,
    confidence: float = 0.95,
    every: int = 10,
    progress: Callable[[float], object] | None = None,
    state: str | os.PathLike | None = None,
) -> TuneResult:
    """Find the smallest bounds under which healthy data are consistent; with faulty data, those that leave
    most of these outside.

    The direction of the bounds is found by gradient, free of their size; their size is then the smallest at
    which the proved test finds no healthy window outside, so this holds whatever the gradient did.

    Args:
        relations: from `parity_relations`; their bounds are the start. Those at 0 stay 0. What the joint test
            explains, "box", "paving" and a bank do not refute either: bounds tuned by it hold for them too.
        healthy: (u, y), arrays (..., T, m) and (..., T, p) or DataFrames, or a list of such tuples, one a
            recording; (u, y, starts) where samples do not follow the one before, as for `detect`. NaN marks a
            missing sample.
        faulty: the same for recordings with faults, every window of which should be outside; or None.
        optimizer: any optax.GradientTransformation, acting on the logarithms of the bounds; None: Adam with a
            falling step.
        steps: of it. 0: only the size is found.
        bounds: names of those that move, "noise", "tolerance", "disturbance", "parameters"; None: all. The
            ends of an asymmetric disturbance move separately.
        weights: {name: number or one per entry}: what is made small is their weighted sum; None: 1 / starting
            bound.
        safety: factor >= 1 on the smallest bounds, for what the data did not show: 1.25 as in `fit` and at
            the command line; 1 for the smallest themselves. It is kept apart and in no statement.
        calibrate: share of the blocks of healthy windows that has no part in finding the direction, on which
            the statement about other data rests; 0: all are used to find it.
        block: windows in a block; None: so many that there are about 100 blocks.
        confidence: of that statement.
        every: steps between two looks at all windows.
        progress: called with the share of the work done.
        state: a file that is kept up to date: the same call goes on from it. An interruption (Ctrl-C) ends
            the search, not the call.

    Returns:
        A TuneResult.

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
    _check(
        relations,
        steps=steps,
        safety=safety,
        calibrate=calibrate,
        block=block,
        confidence=confidence,
        every=every,
    )
    refuse_unverified()
    model, s, report = relations.model, relations.horizon, progress or (lambda share: None)
    moved = moving(relations, bounds, weights)
    good = joined_recordings(model, s, healthy)
    bad = None if faulty is None else joined_recordings(model, s, faulty, "faulty")
    if bad is not None:
        _refuse_same(good, bad)
    across, gone = good.across(s), good.without(s)
    label, length = blocks_of(gone, s, block)
    alone = len(moved.names) == 1
    if model.constant_tolerance and steps and not alone:
        raise NotImplementedError(
            "the margin of constant_tolerance comes from a search for the best gains, which has no "
            "derivative: tune with steps=0 scales "
            "all bounds by one factor, or those that bounds= names"
        )
    kept = held_out(int(label.max(initial=-1)) + 1, 0 if alone else calibrate)
    unseen = gone | touched(np.isin(label, np.flatnonzero(kept)), s)
    search = _Search(relations, moved, good, unseen, bad, safety, optimizer, steps, every, state)
    if steps and not alone:
        search.run(lambda share: report(0.9 * share))
    low, high = smallest_scale(relations, moved, search.best, good)
    report(0.95)
    smallest = np.nextafter(high * search.best, np.inf)
    source = f"fitted to {int((~gone).sum())} healthy windows, safety factor {safety:g}"
    extra = 1.0
    while True:
        values = moved.rounded_up(smallest * safety * extra)
        new = model_with(relations, moved, values, source)
        final = relations.with_bounds({**model_bounds(new), **_parameters(moved, values)})
        res = detect(final, good.u, good.y, starts=good.starts)
        if not res.counts["FAULT"] and (
            isinstance(relations, UncertainRelations) or not (res.margin <= 0).any()
        ):
            break
        extra *= 1.001  # only where a search ends early, or the test is not monotone (uncertain parameters)
        if extra > 2:
            raise ValueError(
                "the proved test refutes a healthy window even at twice the bounds that it accepted: look at "
                "that model"
            )
    found = None if bad is None else detect(final, bad.u, bad.y, starts=bad.starts).counts
    t = factors(relations.with_bounds(moved.bounds(smallest)), good)
    fixed = search.step == 0
    kinds = {name for name, at in _rows(moved) if moved.select[at].any()}
    risk = risk_of(
        t,
        label,
        length,
        kept,
        tuned=len(moved.names),
        convex=kinds <= {"noise", "disturbance"},
        fixed=fixed,
        confidence=confidence,
        safety=safety,
        horizon=s,
    )
    report(1.0)
    counts = {name: n - int(across.sum()) * (name == "MISSING") for name, n in res.counts.items()}
    if found is not None and bad is not None:
        found["MISSING"] -= int(bad.across(s).sum())
    scale = low * moved.total(search.best) / moved.total(moved.start)
    return TuneResult(
        final.bounds,
        moved.bounds(smallest),
        scale,
        safety,
        relations.bounds,
        res.margin,
        counts,
        found,
        risk,
        search.told(),
        moved.names,
        search.step,
        search.stopped,
        new,
        final,
        (*moved.notes, *_vanished(moved, smallest)),
    )


class _Search:
    """The host's side of the descent: worst windows that the steps look at, the best bounds so far, and the
    file they are kept in.
    """

    def __init__(self, relations, moved, good, unseen, bad, safety, optimizer, steps, every, file):
        self.relations, self.moved, self.good, self.unseen, self.bad = relations, moved, good, unseen, bad
        self.safety, self.optimizer, self.steps, self.every = safety, optimizer, steps, every
        self.file, self.kept = file, None
        self.step, self.stopped, self.best, self.score = 0, False, moved.start, (np.inf, np.inf)
        self.history, self.ends = [], np.zeros(0, np.int64)
        strips = isinstance(relations, ParityRelation) and relations.frame is None
        self.capacity = CAPACITY if strips else SEARCHED

    def run(self, report):
        """Make all steps, or those until an interruption."""
        optimizer, rate = (self.optimizer, (1.0, 1.0)) if self.optimizer else (default_optimizer(), RATE)
        dtype, s = self.good.y.dtype, self.relations.horizon
        problem = objective_of(self.relations, self.moved, self.safety, dtype)
        z = jax.device_put(np.log(self.moved.start).astype(dtype))
        carry = z, optimizer.init(z)
        if self.file is not None:
            self.kept = Checkpoint(self.file, self._identity(carry))
            carry = self._taken_up(carry)
        faulty = None if self.bad is None else self._blocks()
        try:
            if not self.step:
                carry = jax.device_put(np.log(self._look(self.moved.start)).astype(dtype)), carry[1]
            while self.step < self.steps:
                u, y = self.good.gather(np.resize(self.ends, self.capacity), s)
                healthy = jax.device_put((np.moveaxis(u, 0, 2), np.moveaxis(y, 0, 2)))
                present = np.arange(self.capacity) < len(self.ends)
                carry, best = descend(
                    problem,
                    optimizer,
                    self.every,
                    carry,
                    self.step,
                    self.steps,
                    rate,
                    healthy,
                    present,
                    faulty,
                )
                self.step = min(self.step + self.every, self.steps)
                self._look(np.exp(np.asarray(best, np.float64)))
                self._save(carry)
                report(self.step / self.steps)
        except KeyboardInterrupt:
            self.stopped = True

    def _look(self, values):
        """Look at all windows: add the worst to those the steps look at; keep the values, at their smallest
        scale, if they are the best.
        """
        for _ in range(8):
            t = factors(self.relations.with_bounds(self.moved.bounds(values)), self.good)
            fresh = worst(np.where(self.unseen, np.nan, t), NEW)
            top = float(t[fresh[0]]) if len(fresh) else 1.0
            self.ends = np.concatenate([self.ends[~np.isin(self.ends, fresh)], fresh])[-self.capacity :]
            if not abs(top - 1) > NEAR:
                break
            values = np.minimum(values * np.clip(top, 1e-3, 1e3), self.moved.most)
        width, outside = self.moved.total(values) * top, np.nan
        if self.bad is not None:
            t = factors(
                self.relations.with_bounds(
                    self.moved.bounds(np.minimum(values * top * self.safety, self.moved.most))
                ),
                self.bad,
            )
            outside = float(np.sum(t > 1) / max(np.sum(~np.isnan(t)), 1))
        score = (-outside if self.bad is not None else 0.0, width)
        if score < self.score:
            self.best, self.score = values, score
        self.history.append((self.step, width / self.moved.total(self.moved.start), outside, values * top))
        return values

    def _blocks(self):
        """Return the faulty windows in blocks, shuffled so that each block shows all of them."""
        t = factors(self.relations, self.bad)
        ends = np.random.default_rng(0).permutation(np.flatnonzero(~np.isnan(t)))
        if not len(ends):
            raise ValueError("no faulty window has any data: all are MISSING")
        size = min(BLOCK, power(len(ends)))
        blocks = -(-len(ends) // size)
        real = np.arange(blocks * size).reshape(blocks, size) < len(ends)
        return jax.device_put(
            (self.bad.u, self.bad.y, np.resize(ends, blocks * size).reshape(blocks, size), real)
        )

    def told(self):
        """Return the history as arrays."""
        nothing = (), (), (), np.zeros((0, len(self.moved.names)))
        step, width, outside, values = zip(*self.history, strict=True) if self.history else nothing
        return {
            "step": np.array(step, int),
            "width": np.array(width),
            "outside": np.array(outside),
            "values": np.array(values),
        }

    def _identity(self, carry):
        """Return the mark that tells this call from others. Of an optimiser nobody can say more than what it
        carries.
        """
        data = lambda w: None if w is None else (w.u, w.y, w.starts)
        carried = [str(jax.tree.structure(carry)), *((x.shape, str(x.dtype)) for x in jax.tree.leaves(carry))]
        also = {
            "healthy recordings": data(self.good),
            "faulty recordings": data(self.bad),
            "share held out": self.unseen,
            "bounds": (
                self.moved.names,
                self.moved.select,
                self.moved.weights,
                self.moved.fixed,
                self.moved.start,
            ),
            "safety": self.safety,
            "steps": self.steps,
            "every": self.every,
            "optimizer": carried,
        }
        return identity(self.relations, **also)

    def _save(self, carry):
        if self.kept is None:
            return
        fields = {"step": self.step, "best": self.best, "score": np.array(self.score), "ends": self.ends}
        leaves = {f"leaf{i}": np.asarray(x) for i, x in enumerate(jax.tree.leaves(carry))}
        self.kept.save(**fields, **leaves, **{f"history_{name}": x for name, x in self.told().items()})

    def _taken_up(self, carry):
        """Return the carry of the checkpoint, if there is one, and take over the rest of what it holds."""
        held = None if self.kept is None else self.kept.load()
        if held is None:
            return carry
        self.step, self.best, self.score, self.ends = (
            int(held["step"]),
            held["best"],
            tuple(held["score"].tolist()),
            held["ends"],
        )
        columns = (held[f"history_{name}"] for name in ("step", "width", "outside", "values"))
        self.history = [(int(a), float(b), float(c), d) for a, b, c, d in zip(*columns, strict=True)]
        leaves, tree = jax.tree.flatten(carry)
        return jax.tree.unflatten(tree, [jnp.asarray(held[f"leaf{i}"]) for i in range(len(leaves))])


def _vanished(moved, values):
    """Return a sentence on bounds that fell to next to nothing: the optimum of a linear program lies at a
    corner.
    """
    small = [
        name
        for name, now, before in zip(moved.names, values, moved.start, strict=True)
        if now < 1e-3 * before
    ]
    return (
        (
            f"next to nothing is left of {', '.join(small)}: the others explain these data, new ones perhaps "
            f"not. "
            "To keep it, leave its kind out of what moves, or give it less weight",
        )
        if small
        else ()
    )


def _rows(moved):
    """Yield (name, slice of the flat bounds)."""
    at = 0
    for name, count in moved.sizes:
        yield name, slice(at, at + count)
        at += count


def _parameters(moved, values):
    """Return the bounds of parameters, in the half-widths of the model that the relations were made for."""
    rows = dict(_rows(moved))
    if "parameters" not in rows:
        return {}
    return {
        "parameters": (moved.fixed + moved.select @ np.array([float(v) for v in values]))[rows["parameters"]]
    }


def _refuse_same(good, bad):
    """Refuse faulty recordings that are healthy ones: no bounds can tell them apart."""
    pieces = lambda w: [
        (u.tobytes(), y.tobytes())
        for u, y in zip(np.split(w.u, w.first[1:]), np.split(w.y, w.first[1:]), strict=True)
    ]
    known = {piece: i for i, piece in enumerate(pieces(good))}
    for j, piece in enumerate(pieces(bad)):
        if piece in known:
            raise ValueError(
                f"faulty recording {j + 1} is the same as healthy recording {known[piece] + 1}: no bounds "
                f"can tell them apart"
            )


def _check(relations, steps, safety, calibrate, block, confidence, every):
    if not isinstance(relations, ParityRelation | UncertainRelations):
        why = next((text for kind, text in UNTUNED.items() if isinstance(relations, kind)), "")
        raise TypeError(f"tune needs relations from parity_relations, not {type(relations).__name__}{why}")
    whole = lambda x, least: not isinstance(x, bool) and isinstance(x, int | np.integer) and x >= least
    for name, x, least in (
        ("steps", steps, 0),
        ("every", every, 1),
        ("block", 1 if block is None else block, 1),
    ):
        if not whole(x, least):
            raise ValueError(f"{name} must be a whole number >= {least}, not {x!r}")
    if not 1 <= safety < np.inf:
        raise ValueError(f"safety is a factor >= 1 on the smallest bounds, not {safety!r}")
    if not 0 <= calibrate < 1:
        raise ValueError(
            f"calibrate is the share of blocks kept out of the search: 0 <= calibrate < 1, not {calibrate!r}"
        )
    if not 0 < confidence < 1:
        raise ValueError(f"confidence must lie between 0 and 1, not {confidence!r}")
