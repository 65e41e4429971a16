"""Disturbances of a fit: process noise and slow offsets beside the noise of sensors, and their trade-off.

A model that is only noise of sensors asks for wide ones where it errs over many samples; one whose states may
wander hides every lasting fault. Each Setting says how large a disturbance is in shares of the sensors'
noise; the smallest bounds of a Setting are those of a trajectory that explains each recording from start to
end (`trajectories`). Each recording in turn is explained by a fit that has not seen it, and where the others
do not move as it does by fits that lack a third of it: the largest factor widens all bounds. That Setting is
chosen under whose bounds the smallest fault is seen; where the faults that are wanted are larger than that,
the bounds become wider until these are just seen, for the days that nobody recorded.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from jaxbound.models.faults import Fault
from jaxbound.models.system import LinearSystem
from jaxbound.studies.identification.candidates import LEAST, Candidate, FitProblem, candidate
from jaxbound.studies.identification.fit_result import Tradeoff
from jaxbound.studies.identification.records import Record, Records, left_out_parts
from jaxbound.studies.identification.trajectories import (
    SMALLER,
    GivenUp,
    added_fault,
    hidden_sizes,
    least_factor,
)
from jaxbound.studies.identification.trial import EXCITED, LeftOut, Trial, excited
from jaxbound.text.names import listed


class Setting(NamedTuple):
    """Disturbances in shares of the noise of the sensors.

    Fields: process: on the states that the outputs read, a sample. drift: how far an offset of the readings
        moves a sample.
    """

    process: float
    drift: float


SETTINGS = (
    Setting(0, 0),
    Setting(0, 0.02),
    Setting(0, 0.05),
    Setting(0, 0.1),
    Setting(0, 0.2),
    Setting(0.01, 0),
    Setting(0.01, 0.1),
    Setting(0.05, 0),
    Setting(0.05, 0.1),
    Setting(0.3, 0),
)
"""That are tried, the tightest first."""
WIDER = 1.05
"""A step by which bounds are widened while they still see the faults that are wanted."""


class Disturbed(NamedTuple):
    """The choice of a fit with disturbances.

    Fields:
        trial: the chosen one; its candidate has the states of the drift.
        safety: by which bounds are wider on top of what recordings that are left out ask for: as asked for,
            or as much more as the wanted faults allow.
        rows: a Tradeoff of each that was looked at. sentences: on what is not seen.
    """

    trial: Trial
    safety: float
    rows: tuple[Tradeoff, ...]
    sentences: tuple[str, ...]


class _Piece(NamedTuple):
    """A recording, and what a fit sees that has not seen it, or has not seen a part of it.

    Fields: number: of the row of the table that it belongs to.
    """

    number: int
    others: Records
    own: Record


def refuse_unseen(faults: Sequence[Fault], inputs: Sequence[str], outputs: Sequence[str]) -> None:
    """Raise ValueError for a fault of a signal that the model does not have."""
    known = [*outputs, *inputs]
    for fault in faults:
        if fault.signal not in known:
            raise ValueError(f"see: there is no signal {fault.signal!r}, only {listed(known, str)}")


def structured(
    spec: Mapping[str, Any], level: np.ndarray, setting: Setting
) -> tuple[dict[str, Any], np.ndarray, np.ndarray]:
    """Return (spec, G, walks): arguments of a LinearSystem with the states of a drift, the directions (n, g)
    of its disturbances and their bounds (g,) where those of the sensors are `level` (p,).

    Outputs of one unit, or of units that nobody stated, share an offset, as that of a room or a supply; else
    each has its own.
    """
    outputs, p = spec["outputs"], len(level)
    A, B, C = (spec[letter] for letter in "ABC")
    m = len(spec["inputs"])
    if A is None:
        A, B, C = np.zeros((0, 0)), np.zeros((0, m)), np.zeros((p, 0))
    A, C = np.asarray(A, float), np.asarray(C, float)
    n = len(A)
    offsets = np.zeros((p, 0))
    if setting.drift:
        offsets = np.eye(p)
        if len({(spec.get("units") or {}).get(name) for name in outputs}) == 1:
            offsets = np.ones((p, 1))
    q = offsets.shape[1]
    pushed = 0
    if setting.process and n:
        pushed = p
    G = np.zeros((n + q, pushed + q))
    G[:pushed, :pushed] = np.eye(pushed)
    G[n:, pushed:] = np.eye(q)
    steps = setting.drift * (offsets * level[:, None]).max(0, initial=0)
    if q == 1:
        steps = np.array([setting.drift * level.mean()])
    walks = np.concatenate([setting.process * level[:pushed], steps])
    if n + q == 0:
        return dict(spec), G, walks
    whole = np.eye(n + q)
    whole[:n, :n] = A
    inputs = None
    if m:
        inputs = np.vstack([np.asarray(B, float), np.zeros((q, m))])
    return dict(spec) | {"A": whole, "B": inputs, "C": np.hstack([C, offsets])}, G, walks


def chosen_disturbances(problem: FitProblem, report: Callable[[float], object]) -> Disturbed:
    """Return the Disturbed under whose bounds, as wide as recordings that are left out ask for, and safety on
    top, the smallest faults are seen: those that are wanted; or a bias of each output that was always there,
    and one that begins in the middle of a recording.

    Args:
        report: called with the share of the work done.
    """
    training, safety, see = problem.training, problem.recipe.safety, problem.recipe.faults
    kinds = problem.kinds
    longest = max(training.records, key=lambda record: len(record[1]))
    pieces, why = _pieces(problem)
    faults = list(see)
    if not see:
        for start in (0, len(longest[1]) // 2):
            for name, span in zip(training.outputs, training.spans, strict=True):
                faults.append(Fault(name, "bias", float(span), start))
    best: _Tried | None = None
    least, rows, ended = math.inf, [], []
    for number, kind in enumerate(kinds):
        fits = [_fitted(problem, piece, kind) for piece in pieces]
        for at, setting in enumerate(SETTINGS):
            report((number + at / len(SETTINGS)) / len(kinds))
            try:
                tried = _Tried.of(problem, kind, setting)
                if tried is None:
                    continue
                if best is not None and not tried.sizes(safety, longest, faults, least):
                    continue  # wider bounds see less still
                tried = tried.left(pieces, fits, why)
                if tried is None:
                    continue
                sizes = tried.sizes(safety, longest, faults)
            except GivenUp as end:
                ended.append(f"process {setting.process:g} and drift {setting.drift:g} by {kind!r}: {end}")
                continue
            rows.append(tried.row(safety, sizes, faults))
            score = _score(sizes, faults)
            if best is None or score < least:
                least, best, chosen = score, tried, len(rows) - 1
    if best is None and ended:
        raise ValueError(f"no disturbances could be judged, {ended[0]}; {SMALLER}")
    if best is None:
        raise ValueError(
            "no disturbances up to the size of the sensors' noise explain these recordings: look at the "
            "recordings, or choose another order"
        )
    sentences, used = _unseen(rows[chosen], see), safety
    seen = see and not sentences
    if ended:
        sentences += (
            f"{len(ended)} of {len(SETTINGS) * len(kinds)} disturbances were not compared, first {ended[0]}; "
            f"{SMALLER}",
        )
    if seen:
        try:
            used = best.widened(safety, longest, faults)
            sizes = best.sizes(used, longest, faults)
        except GivenUp as end:
            used = safety
            sentences += (f"safety stays {safety:g}, whatever the wanted faults allow: {end}; {SMALLER}",)
    if used == safety:
        rows[chosen] = rows[chosen]._replace(chosen=True)
    else:
        rows.append(best.row(used, sizes, faults)._replace(chosen=True))
        sentences += (
            f"safety is {used:g} in place of {safety:g}: bounds so wide still show the wanted faults; "
            f"it stays as it is without `see`, see=()",
        )
    return Disturbed(best.trial, used, tuple(rows), sentences)


def _label(fault: Fault) -> str:
    """Return a fault as the table names it."""
    text = f"{fault.signal}:{fault.kind}"
    if fault.start:
        text += f" from sample {fault.start} on"
    return text


def _score(sizes: Sequence[float], faults: Sequence[Fault]) -> float:
    """Return the largest size in units of the wanted one; a size beyond ten times that counts as never."""
    shares = [min(size / abs(fault.size), 10.0) for size, fault in zip(sizes, faults, strict=True)]
    return max(shares) + 1e-3 * sum(shares)


def _unseen(row: Tradeoff, see: Sequence[Fault]) -> tuple[str, ...]:
    """Return a sentence for each wanted fault that the chosen bounds do not see."""
    sentences = []
    for fault in see:
        size = row.sizes[_label(fault)]
        if size <= abs(fault.size):
            continue
        text = "none is, however large; fit again with --recipe order=auto"
        if math.isfinite(size):
            text = f"it is from {size:.3g} on; fit again with see={fault.signal}:{fault.kind}:{size:.2g}"
        sentences.append(
            f"a {fault.kind} of {abs(fault.size):g} of {fault.signal} is not sure to be seen under any "
            f"bounds that explain these recordings: {text}"
        )
    return tuple(sentences)


def _pieces(problem: FitProblem) -> tuple[list[_Piece], list[str]]:
    """Return the pieces that are left out in turn, and for each row of the table "" or why it has none."""
    records, held_out = problem.training.records, problem.recipe.held_out
    pieces: list[_Piece] = []
    why: list[str] = []
    if not held_out:
        return pieces, why
    alone = len(records) == 1
    for number, own in enumerate(records):
        others, row = [*records[:number], *records[number + 1 :]], len(why)
        if others and excited(problem, others, records) >= EXCITED:
            pieces.append(_Piece(row, others, own))
            why.append("")
            continue
        blocks = _blocks(own, held_out, problem.recipe.window.horizon + 1)
        why += ["the others do not move all that it moves"] * (len(blocks) if alone else 1)
        for block, rest in enumerate(blocks):
            kept = [*records[:number], rest, *records[number + 1 :]]
            if excited(problem, kept, records) >= EXCITED:
                pieces.append(_Piece(row + block * alone, kept, own))
                why[row + block * alone] = ""
    return pieces, why


def _blocks(record: Record, held_out: float, least: int) -> Records:
    """Return the recording without each of its blocks in turn."""
    u, y, starts = record
    left, first = [], 0
    for block in left_out_parts([record], held_out, least):
        without = y.copy()
        without[first : first + len(block[1])] = np.nan
        left.append((u, without, starts))
        first += len(block[1])
    return left


def _fitted(problem: FitProblem, piece: _Piece, kind: str) -> Candidate | None:
    try:
        return candidate(problem, piece.others, kind)
    except ValueError:  # too few samples for the coefficients
        return None


@dataclass(frozen=True, eq=False)
class _Tried:
    """A Setting of a model that is fitted to all recordings.

    Fields: trial: with the states of the drift in its candidate, and the smallest bounds that explain all.
    """

    trial: Trial
    setting: Setting

    @classmethod
    def of(cls, problem: FitProblem, kind: str, setting: Setting) -> "_Tried | None":
        """Return the Setting with its smallest bounds; None where no bounds will do."""
        full, records = problem.fitted(kind), problem.training.records
        spec, G, walks = structured(full.spec, full.spread, setting)
        model = _with_bounds(spec, full.spread, G, walks)
        need = max(LEAST, *(least_factor(model, record) for record in records))
        if not math.isfinite(need):
            return None
        made = dataclasses.replace(full, spec=spec)
        trial = Trial(made, need * full.spread, (), math.nan, problem.training.days, walks=(G, need * walks))
        return cls(trial, setting)

    def model(self, wider: float) -> LinearSystem:
        """Return the model with bounds so many times the smallest."""
        assert self.trial.walks is not None, "there are bounds of disturbances, though maybe of none"
        G, walks = self.trial.walks
        return _with_bounds(self.trial.candidate.spec, wider * self.trial.bound, G, wider * walks)

    def left(
        self, pieces: Sequence[_Piece], fits: Sequence[Candidate | None], why: Sequence[str]
    ) -> "_Tried | None":
        """Return the same with the factors that the rows of the table ask for; None where none will do."""
        assert self.trial.walks is not None, "there are bounds of disturbances, though maybe of none"
        needs: dict[int, float] = {}
        for piece, fit in zip(pieces, fits, strict=True):
            if fit is None:
                continue
            spec, G, _ = structured(fit.spec, self.trial.bound, self.setting)
            need = least_factor(_with_bounds(spec, self.trial.bound, G, self.trial.walks[1]), piece.own)
            needs[piece.number] = max(need, needs.get(piece.number, 0.0))
        if math.inf in needs.values():
            return None
        lengths, rows = {piece.number: len(piece.own[1]) for piece in pieces}, []
        for number, text in enumerate(why):
            if not text and number not in needs:
                text = "the others are too short"
            every = np.full(lengths.get(number, 1), needs.get(number, math.nan))
            rows.append(LeftOut(None, every, text))
        return dataclasses.replace(self, trial=dataclasses.replace(self.trial, left=tuple(rows)))

    def sizes(
        self, safety: float, record: Record, faults: Sequence[Fault], least: float = math.inf
    ) -> list[float]:
        """Return the size of each fault from which on it is seen by the end of a recording; [] where their
        score is above `least`: one fault may say so alone.
        """
        sizes: list[float] = []
        for size in hidden_sizes(self.model(self.trial.factor * safety * (1 + 1e-6)), record, faults):
            sizes.append(size)
            if _score(sizes, faults[: len(sizes)]) > least:
                return []
        return sizes

    def widened(self, safety: float, record: Record, faults: Sequence[Fault]) -> float:
        """Return the safety, or so many steps above it that each fault is still seen by the end."""
        model, limit = self.model(self.trial.factor), math.inf
        for fault in faults:
            for sign in (1.0, -1.0):
                limit = min(limit, least_factor(model, added_fault(record, model, fault, sign)))
        steps = math.floor(math.log(limit / safety * (1 - 1e-6), WIDER))
        return round(safety * WIDER ** max(steps, 0), 3)

    def row(self, safety: float, sizes: Sequence[float], faults: Sequence[Fault]) -> Tradeoff:
        """Return the row of the table."""
        kind, factor = self.trial.candidate.kind, self.trial.factor
        bounds = (factor * safety * self.trial.bound).tolist()
        noise = dict(zip(self.trial.candidate.spec["outputs"], bounds, strict=True))
        named = dict(zip(map(_label, faults), sizes, strict=True))
        return Tradeoff(kind, *self.setting, noise, factor, safety, named, chosen=False)


def _with_bounds(
    spec: Mapping[str, Any], noise: np.ndarray, G: np.ndarray, walks: np.ndarray
) -> LinearSystem:
    """Return a model with bounds of sensors (p,) and of disturbances (g,)."""
    disturbance = None
    if len(walks):
        disturbance = (G, walks.tolist())
    return LinearSystem(**spec, noise=noise.tolist(), disturbance=disturbance)
