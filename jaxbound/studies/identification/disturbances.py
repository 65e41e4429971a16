"""Disturbances of a fit: process noise and slow offsets beside the noise of sensors, and their trade-off.

A model that is only noise of sensors asks for wide ones where it errs over many samples; one whose states may
wander hides every lasting fault. Each Setting says how large a disturbance is in shares of the sensors'
noise; the smallest bounds of a Setting are those of a trajectory that explains each recording from start to
end (`trajectories`). Each recording in turn is explained by a fit that has not seen it, and where the others
do not move as it does by fits that lack a third of it: the largest factor widens all bounds. That Setting is
chosen under whose bounds the smallest fault is seen; where the faults that are wanted are larger than that,
the bounds become wider until these are just seen, for the days that nobody recorded.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from jaxbound.models.arguments import listed_argument
from jaxbound.models.faults import Fault
from jaxbound.models.system import LinearSystem
from jaxbound.studies.identification.candidates import LEAST, Candidate, FitProblem, candidate
from jaxbound.studies.identification.fit_result import Tradeoff
from jaxbound.studies.identification.left_out import EXCITED, LeftOut, Trial, excited, widest
from jaxbound.studies.identification.records import Record, Records, parted
from jaxbound.studies.identification.trajectories import (
    SMALLER,
    GivenUp,
    added_fault,
    hidden_sizes,
    least_factor,
    refuse_kind,
)
from jaxbound.text.names import listed

__all__ = [
    "SETTINGS",
    "Disturbed",
    "Setting",
    "chosen_disturbances",
    "refuse_unseen",
    "structured",
    "wanted_biases",
    "wanted_faults",
]


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
SEE = "[jb.Fault('T1', 'bias', 2.5)]"
"""An example of these."""


@dataclass(frozen=True, eq=False)
class Disturbed:
    """The choice of a fit with disturbances.

    Fields:
        trial: the chosen one; its candidate has the states of the drift.
        G (n, g), walks (g,): how disturbances act, and their smallest bounds.
        safety: by which bounds are wider on top of what recordings that are left out ask for: as asked for,
            or as much more as the wanted faults allow.
        rows: a Tradeoff of each that was looked at. sentences: on what is not seen.
    """

    trial: Trial
    G: np.ndarray
    walks: np.ndarray
    safety: float
    rows: tuple[Tradeoff, ...]
    sentences: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class _Piece:
    """A recording, and what a fit sees that has not seen it, or has not seen a part of it.

    Fields: number: of the row of the table that it belongs to.
    """

    number: int
    others: Records
    own: Record


def wanted_faults(
    disturbances: str | None,
    see: Fault | Sequence[Fault],
    average: int | None,
    follow: float | str,
    compares: bool,
) -> tuple[Fault, ...]:
    """Return the faults that are wanted; refuse what does not go together.

    Args:
        compares: whether windows are compared. Others: see `fit`.
    """
    if isinstance(see, Fault):
        see = (see,)
    faults = listed_argument("see", see, SEE)
    if not all(isinstance(fault, Fault) for fault in faults):
        raise ValueError(f"see must be a fault, or a list of them, like {SEE}, not {see!r}")
    if disturbances is None:
        if faults and len(wanted_biases(faults)) < 2:
            raise ValueError(
                "see says which disturbances are chosen: give disturbances='auto' with it; without, biases "
                "of two outputs or more say in which ratio their bounds are"
            )
        return faults
    if disturbances != "auto":
        raise ValueError(f"disturbances must be auto, or left out, not {disturbances!r}")
    if average is not None:
        raise ValueError("average is for bounds of sensors alone: leave it out, or the disturbances")
    if follow:
        raise ValueError("follow widens bounds of sensors alone: leave it out, or the disturbances")
    if compares:
        raise ValueError(
            "test = 'auto' compares windows whose sensors alone err: leave it out, or the disturbances"
        )
    for fault in faults:
        refuse_kind(fault)
    return faults


def wanted_biases(faults: Sequence[Fault]) -> dict[str, float]:
    """Return {signal: the least size of a bias of it that is wanted}."""
    sizes: dict[str, float] = {}
    for fault in faults:
        if fault.kind == "bias" and fault.size:
            sizes[fault.signal] = min(abs(fault.size), sizes.get(fault.signal, math.inf))
    return sizes


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


def chosen_disturbances(
    problem: FitProblem,
    kinds: Sequence[str],
    records: Records,
    held_out: float,
    safety: float,
    see: Sequence[Fault],
    report: Callable[[float], object],
) -> Disturbed:
    """Return the Disturbed under whose bounds, as wide as recordings that are left out ask for, and safety on
    top, the smallest faults are seen.

    Args:
        see: faults that are wanted, biases and drifts; none: a bias of each output that was always there, and
            one that begins in the middle of a recording. report: called with the share of the work done.
    """
    longest = max(records, key=lambda record: len(record[1]))
    pieces, why = _pieces(problem, records, held_out)
    faults = list(see)
    if not see:
        for start in (0, len(longest[1]) // 2):
            for name, span in zip(problem.about["outputs"], problem.spans, strict=True):
                faults.append(Fault(name, "bias", float(span), start))
    best: Disturbed | None = None
    least, rows = math.inf, []
    ended: list[str] = []
    for number, kind in enumerate(kinds):
        full = candidate(problem, records, kind)
        fits = [_fitted(problem, piece, kind) for piece in pieces]
        for at, setting in enumerate(SETTINGS):
            report((number + at / len(SETTINGS)) / len(kinds))
            try:
                tried = _Tried.of(full, setting, records)
                if tried is None:
                    continue
                if tried.sees_less(safety, longest, faults, least):  # wider bounds see less still
                    continue
                left = tried.left(pieces, fits, why)
                if left is None:
                    continue
                factor = widest(left)
                sizes = tried.sizes(factor * safety, longest, faults)
            except GivenUp as end:
                ended.append(f"process {setting.process:g} and drift {setting.drift:g} by {kind!r}: {end}")
                continue
            rows.append(tried.row(factor, safety, sizes, faults))
            score = _score(sizes, faults)
            if best is None or score < least:
                least = score
                trial = Trial(tried.candidate, tried.bound, left, score)
                best = Disturbed(trial, tried.G, tried.walks, safety, (), ())
                chosen, winner = len(rows) - 1, tried
    if best is None and ended:
        raise ValueError(f"no disturbances could be judged, {ended[0]}; {SMALLER}")
    if best is None:
        raise ValueError(
            "no disturbances up to the size of the sensors' noise explain these recordings: look at the "
            "recordings, or choose another order"
        )
    factor, sentences, used = rows[chosen].factor, _unseen(rows[chosen], see), safety
    if ended:
        sentences += (
            f"{len(ended)} of {len(SETTINGS) * len(kinds)} disturbances were not compared, first {ended[0]}; "
            f"{SMALLER}",
        )
    if see and not _unseen(rows[chosen], see):
        try:
            used = winner.widened(factor, safety, longest, see)
            sizes = winner.sizes(factor * used, longest, faults)
        except GivenUp as end:
            used = safety
            sentences += (f"safety stays {safety:g}, whatever the wanted faults allow: {end}; {SMALLER}",)
    if used == safety:
        rows[chosen] = rows[chosen]._replace(chosen=True)
    else:
        rows.append(winner.row(factor, used, sizes, faults)._replace(chosen=True))
        sentences += (
            f"safety is {used:g} in place of {safety:g}: bounds so wide still show the wanted faults; "
            f"it stays as it is without --see, see=()",
        )
    return Disturbed(best.trial, best.G, best.walks, used, tuple(rows), sentences)


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
        text = "none is, however large; fit again with --order auto, order='auto'"
        if math.isfinite(size):
            text = f"it is from {size:.3g} on; fit again with --see {fault.signal}:{fault.kind}:{size:.2g}"
        sentences.append(
            f"a {fault.kind} of {abs(fault.size):g} of {fault.signal} is not sure to be seen under any "
            f"bounds that explain these recordings: {text}"
        )
    return tuple(sentences)


def _pieces(problem: FitProblem, records: Records, held_out: float) -> tuple[list[_Piece], list[str]]:
    """Return the pieces that are left out in turn, and for each row of the table "" or why it has none."""
    if not held_out:
        return [], []
    pieces: list[_Piece] = []
    why: list[str] = []
    for number, own in enumerate(records):
        others = [*records[:number], *records[number + 1 :]]
        if others and excited(problem, others, records) >= EXCITED:
            pieces.append(_Piece(number, others, own))
            why.append("")
            continue
        blocks = _blocks(own, held_out, problem.horizon + 1)
        unseen: list[_Piece] = []
        for block, rest in enumerate(blocks):
            kept = [*records[:number], rest, *records[number + 1 :]]
            if excited(problem, kept, records) >= EXCITED:
                row = number
                if len(records) == 1:
                    row = block
                unseen.append(_Piece(row, kept, own))
        pieces += unseen
        if len(records) > 1:
            why.append("")
            if not unseen:
                why[-1] = "the others do not move all that it moves"
            continue
        for block in range(len(blocks)):
            why.append("the others do not move all that it moves")
            if any(piece.number == block for piece in unseen):
                why[-1] = ""
    return pieces, why


def _blocks(record: Record, held_out: float, least: int) -> Records:
    """Return the recording without each of its blocks in turn."""
    u, y, starts = record
    left, first = [], 0
    for block in parted([record], held_out, least):
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

    Fields: candidate: with the states of the drift. bound (p,), walks (g,): the smallest bounds that explain
    all. G (n, g).
    """

    candidate: Candidate
    setting: Setting
    bound: np.ndarray
    G: np.ndarray
    walks: np.ndarray

    @classmethod
    def of(cls, full: Candidate, setting: Setting, records: Records) -> "_Tried | None":
        """Return the Setting with its smallest bounds; None where no bounds will do."""
        spec, G, walks = structured(full.spec, full.spread, setting)
        unit = cls(Candidate(full.kind, spec, full.spread), setting, full.spread, G, walks)
        model = unit.model(1.0)
        need = max(LEAST, *(least_factor(model, record) for record in records))
        if not math.isfinite(need):
            return None
        return cls(unit.candidate, setting, need * full.spread, G, need * walks)

    def model(self, wider: float) -> LinearSystem:
        """Return the model with bounds so many times the smallest."""
        return _with_bounds(self.candidate.spec, wider * self.bound, self.G, wider * self.walks)

    def left(
        self, pieces: Sequence[_Piece], fits: Sequence[Candidate | None], why: Sequence[str]
    ) -> tuple[LeftOut, ...] | None:
        """Return the factors that the rows of the table ask for; None where no factor will do."""
        needs: dict[int, float] = {}
        reasons = list(why)
        for piece, fit in zip(pieces, fits, strict=True):
            if fit is None:
                if piece.number not in needs:
                    reasons[piece.number] = "the others are too short"
                continue
            spec, G, _ = structured(fit.spec, self.bound, self.setting)
            need = least_factor(_with_bounds(spec, self.bound, G, self.walks), piece.own)
            needs[piece.number] = max(need, needs.get(piece.number, 0.0))
            reasons[piece.number] = ""
        if math.inf in needs.values():
            return None
        lengths = [1] * len(why)
        for piece in pieces:
            lengths[piece.number] = len(piece.own[1])
        rows = []
        for number, (text, samples) in enumerate(zip(reasons, lengths, strict=True)):
            rows.append(LeftOut(None, np.full(samples, needs.get(number, math.nan)), text))
        return tuple(rows)

    def sizes(self, wider: float, record: Record, faults: Sequence[Fault]) -> list[float]:
        """Return the size of each fault from which on it is seen by the end of a recording."""
        return list(hidden_sizes(self.model(wider * (1 + 1e-6)), record, faults))

    def sees_less(self, wider: float, record: Record, faults: Sequence[Fault], least: float) -> bool:
        """Return whether the score of these sizes is above `least`: one fault may say so alone."""
        sizes: list[float] = []
        if math.isinf(least):
            return False
        for size in hidden_sizes(self.model(wider * (1 + 1e-6)), record, faults):
            sizes.append(size)
            if _score(sizes, faults[: len(sizes)]) > least:
                return True
        return False

    def widened(self, factor: float, safety: float, record: Record, faults: Sequence[Fault]) -> float:
        """Return the safety, or so many steps above it that each fault is still seen by the end."""
        model, limit = self.model(factor), math.inf
        for fault in faults:
            for sign in (1.0, -1.0):
                limit = min(limit, least_factor(model, added_fault(record, model, fault, sign)))
        steps = math.floor(math.log(limit / safety * (1 - 1e-6), WIDER))
        return round(safety * WIDER ** max(steps, 0), 3)

    def row(self, factor: float, safety: float, sizes: Sequence[float], faults: Sequence[Fault]) -> Tradeoff:
        """Return the row of the table."""
        outputs = self.candidate.spec["outputs"]
        named = {}
        for fault, size in zip(faults, sizes, strict=True):
            named[_label(fault)] = size
        noise = dict(zip(outputs, (factor * safety * self.bound).tolist(), strict=True))
        kind = self.candidate.kind
        return Tradeoff(kind, *self.setting, noise, factor, safety, named, chosen=False)


def _with_bounds(
    spec: Mapping[str, Any], noise: np.ndarray, G: np.ndarray, walks: np.ndarray
) -> LinearSystem:
    """Return a model with bounds of sensors (p,) and of disturbances (g,)."""
    disturbance = None
    if len(walks):
        disturbance = (G, walks.tolist())
    return LinearSystem(**spec, noise=noise.tolist(), disturbance=disturbance)
