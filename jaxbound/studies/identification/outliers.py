"""Numbers in healthy recordings that no neighbour explains: -999, 0 or a full scale for a missing sample.

A bound that covers such a number covers every fault below it, so a fit does not take one for noise unless it
is told. A sample is an outlier only where those before and behind it contradict it: it is left out of windows
like a missing one (an output is an absent row, an input one unknown more), coefficients are fitted without
it, and what the rest of a window says of it is compared with the errors of all other samples. A plant that
moves fast, a delay that the model does not have, a recorder that rounds: what they do shows in the samples
behind, too, so these are no outliers.

One sample in a hundred may be one, of one and the same number more; they matter where they make bounds ten
times as wide.
"""

import dataclasses
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from jaxbound.recordings.expressions import expression, is_expression
from jaxbound.recordings.hints import recorded_step
from jaxbound.recordings.means import every_of
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.signals import SignalModel
from jaxbound.sets.floats.one_thread import times
from jaxbound.studies.identification import regression
from jaxbound.studies.identification.records import Records
from jaxbound.studies.identification.structure import delayed
from jaxbound.text.names import listed
from jaxbound.text.quantities import factor

SHARE, MEANS, SAME = 0.01, 0.05, 0.1
"""The largest share of the samples of a signal that are outliers; that of means, each of which one sample may
spoil; that of one and the same number.
"""
TIMES = 10.0
"""Outliers matter that make bounds so many times as wide."""
HORIZON, NEAR = 15, 11
"""Of the windows in which samples are compared with their neighbours; samples around one whose median it is
far from.
"""
SEEN, RIDGE = 0.01, 1e-10
"""Least eigenvalue of the products of columns of a first state at the rows that are there, 1 at all of them;
added to these where inputs are unknown, too.
"""
STEADY = 3e-3
"""Share of the span of an output below which no bound is taken for a small one."""
LITTLE = 3.0
"""Inputs that contradict outputs by less than so many median errors of windows stay as they were recorded."""
CHUNK = 1_024
"""Windows that are looked at together."""

Marks = list[tuple[np.ndarray, np.ndarray]]
"""((T, m), (T, p)) bool a recording: samples of inputs and of outputs."""


class Outliers(NamedTuple):
    """Samples of recordings that no neighbour explains.

    Fields: marks: of these samples. times (p,): the factor by which bounds are smaller without them.
    """

    marks: Marks
    times: np.ndarray


def refuse_outliers(
    records: Records, signals: SignalModel, order: int, delay: int, again: Callable[[], Sequence[Recording]]
) -> list[str]:
    """Return a sentence on each signal with outliers that a condition on its column lets pass.

    Args:
        signals: their names and columns. order, delay: see `outliers`. again: reads the recordings once more,
            for the times of their samples.

    Raises:
        ValueError: other signals have outliers.
    """
    averaged = every_of(signals) is not None
    share = SHARE
    if averaged:
        share = MEANS
    result = outliers(records, order, delay, share)
    if result is None:
        return []
    condition = signals.columns.get("where", "")
    decided: frozenset[str] = frozenset()
    if condition:
        decided = frozenset(expression(condition).columns)
        condition = f"({condition}) and "
    sentences = []
    for (side, i, x), name in zip(_signals(records), (*signals.inputs, *signals.outputs), strict=True):
        odd = [pair[side][:, i] for pair in result.marks]
        marked = np.concatenate(odd)
        if not marked.any():
            continue
        numbers = listed(dict.fromkeys(f"{value:.6g}" for value in x[marked].tolist()), str)
        worst = int(np.argmax(result.times))
        sentence = (
            f"{name} is {numbers} in {marked.sum()} of {np.isfinite(x).sum()} samples "
            f"({_places(odd, again())}), which the samples around them contradict: bounds of "
            f"{signals.outputs[worst]} that hold for these, too, are "
            f"{factor(float(f'{result.times[worst]:.2g}'))} times as wide"
        )
        column = signals.column(name)
        if decided & set(_columns_of(column)):
            sentences.append(
                f"{sentence}; the condition lets them pass, so they count as measured; another one leaves "
                f"them out, --where, columns={{'where': ..}}"
            )
            continue
        term = _term(column)
        leaving = _leaving_out(term, column, x, marked, averaged)
        if leaving:
            leaving = f', or by a condition (--where, or `where` in a model file), "{condition}{leaving}"'
        raise ValueError(
            f"{sentence}, and hide every fault below. A number that stands for a missing sample must be left "
            f"out: leave the cell blank (NaN){leaving}. If they were measured, say so by a condition on the "
            f'column that they pass, like "{condition}{term} > -1e12"'
        )
    return sentences


def _columns_of(column: str) -> tuple[str, ...]:
    if is_expression(column):
        return expression(column).columns
    return (column,)


def _term(column: str) -> str:
    """Return a column as a term of a condition."""
    if is_expression(column):
        return f"({expression(column).text})"
    if column.isidentifier():
        return column
    return f"`{column}`"


def _leaving_out(term: str, column: str, x: np.ndarray, odd: np.ndarray, averaged: bool) -> str:
    """Return the condition that leaves these samples out of those of a signal; "" where there is no short
    one. averaged: samples are means of what the condition is asked about.
    """
    values, rest = np.unique(x[odd]), x[~odd & ~np.isnan(x)]
    if len(values) == 1 and not averaged and not is_expression(column):
        return f"{term} != {values[0]:.15g}"
    if values[-1] < rest.min():
        return f"{term} > {_short_between(values[-1], rest.min())}"
    if values[0] > rest.max():
        return f"{term} < {_short_between(values[0], rest.max())}"
    return ""


def _short_between(a: float, b: float) -> str:
    """Return a number between two others with few digits."""
    for digits in range(1, 17):
        text = f"{(a + b) / 2:.{digits}g}"
        if min(a, b) < float(text) < max(a, b):
            return f"{float(text):.15g}"
    return repr((a + b) / 2)


def _places(odd: list[np.ndarray], recordings: Sequence[Recording]) -> str:
    """Return the times of marked samples, of several recordings with their names."""
    places = []
    for number, (mark, recording) in enumerate(zip(odd, recordings, strict=True), 1):
        if mark.any():
            at = listed((recording.label(int(k)) for k in np.flatnonzero(mark)), str)
            whose = f"{recording.source or f'recording {number}'}: " * (len(odd) > 1)
            places.append(f"{whose}{at}")
    return "; ".join(places)


@np.errstate(all="ignore")  # coefficients of next to no data explode
def outliers(records: Records, order: int, delay: int, share: float = SHARE) -> Outliers | None:
    """Return the Outliers of recordings; None: there are none that matter, or too few samples to say.

    Args:
        order, delay: of the model that neighbours are compared by, the order 1 at least. share: the largest
            one of the samples of a signal that are outliers.
    """
    marks = _candidates(records, share)
    look = _looked(records, marks, order, delay)
    if look is None:
        return None
    marks = _named(records, _times_off(look), share)
    if not any(mark.any() for pair in marks for mark in pair):
        return None
    without, whole = _looked(records, marks, order, delay), _looked(records, _none(records), order, delay)
    if without is None or whole is None:
        return None
    factors = whole.needs() * whole.spread / (np.maximum(without.needs(), without.floor) * without.spread)
    if not (factors >= TIMES).any():
        return None
    return Outliers(marks, factors)


def _none(records: Records) -> Marks:
    return [(np.zeros(u.shape, bool), np.zeros(y.shape, bool)) for u, y, _ in records]


def _signals(records: Records) -> Iterator[tuple[int, int, np.ndarray]]:
    """Yield (side, number, samples of all recordings) of each signal."""
    for side in (0, 1):
        for i in range(records[0][side].shape[1]):
            yield side, i, np.concatenate([record[side][:, i] for record in records])


def _set_marks(marks: Marks, side: int, i: int, odd: np.ndarray) -> None:
    """Set the marks of a signal to those of its samples in all recordings."""
    first = 0
    for pair in marks:
        column = pair[side][:, i]
        column[:] = odd[first : first + len(column)]
        first += len(column)


def _candidates(records: Records, share: float) -> Marks:
    """Return the samples that may be outliers: of each signal those that are exactly its lowest number, its
    highest or 0, where these are few, and those that are farthest from the median around them.
    """
    marks = _none(records)
    for side, i, x in _signals(records):
        present = int((~np.isnan(x)).sum())
        if not present:
            continue
        odd = np.zeros(len(x), bool)
        for value in (np.nanmin(x), np.nanmax(x), 0.0):
            same = x == value
            if same.sum() <= SAME * present:
                odd |= same
        far = np.concatenate([_from_median(record[side][:, i]) for record in records])
        farthest = np.argsort(-far, kind="stable")[: int(share * present)]
        odd[farthest[far[farthest] > 0]] = True
        _set_marks(marks, side, i, odd)
    return marks


def _from_median(x: np.ndarray) -> np.ndarray:
    """Return how far each sample is from the median of those around it; 0 where it is missing."""
    around = np.pad(x, NEAR // 2, constant_values=np.nan)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a stretch without any
        middle = np.nanmedian(np.lib.stride_tricks.sliding_window_view(around, NEAR), 1)
    return np.asarray(np.nan_to_num(abs(x - middle)))


class _Part(NamedTuple):
    """A recording, standardised, inputs as late as they act.

    Fields: u, y; unknown (T, m), absent (T, p): its marks; first: where windows begin.
    """

    u: np.ndarray
    y: np.ndarray
    unknown: np.ndarray
    absent: np.ndarray
    first: np.ndarray

    @property
    def some(self) -> "_Part":
        """The part with a few of its windows, spread evenly."""
        return self._replace(first=self.first[:: len(self.first) // CHUNK + 1])

    def around(self, marks: np.ndarray) -> "_Part":
        """Return the part with the windows alone that hold marked samples, (T, .) bool."""
        if not len(self.first):
            return self
        held = regression.in_windows(np.asarray(marks.any(1)), HORIZON)
        return self._replace(first=self.first[held[self.first] > 0])

    @property
    def windows(self) -> Iterator[np.ndarray]:
        """The samples (N, s + 1) of windows, some at a time."""
        for begin in range(0, len(self.first), CHUNK):
            yield self.first[begin : begin + CHUNK, None] + np.arange(HORIZON + 1)


@dataclass(frozen=True, eq=False)
class _Look:
    """Recordings under coefficients that were fitted without what is marked in them.

    Fields: theta, order: see `regression.least_squares`. delay; parts; spread (p,): of outputs; floor (p,):
    in spreads, below it no bound is small.
    """

    theta: np.ndarray
    order: int
    delay: int
    parts: list[_Part]
    spread: np.ndarray
    floor: np.ndarray

    def errors(self, part: _Part, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return (left, lost): the errors (N, s + 1, p) that the best first state and unknown inputs leave of
        rows that are there, and, where inputs are known, of marked ones; nan elsewhere, and where too little
        is there.
        """
        u = np.where(part.unknown[at], 0.0, part.u[at])
        return self._errors(u, part.y[at], part.absent[at], part.unknown[at])

    def _errors(
        self, u: np.ndarray, y: np.ndarray, absent: np.ndarray, unknown: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        count, m, p = u.shape[1], u.shape[2], y.shape[2]
        response = regression.responses(self.theta, u, p, self.order, True)
        free, _ = np.linalg.qr(response.free.reshape(count * p, -1))
        each = np.append(np.eye(count * m), np.zeros((1, count * m)), 0).reshape(count * m + 1, count, m)
        moved = regression.responses(self.theta, each, p, self.order, True).driven.reshape(len(each), -1)
        rows = (y - response.driven).reshape(len(y), -1)
        there = ~(np.isnan(y) | absent).reshape(rows.shape)
        unknown = unknown.reshape(len(y), -1)
        number, errors = unknown.sum(1), np.full(rows.shape, np.nan)
        for many in np.unique(number):
            some = np.flatnonzero(number == many)
            which = np.argsort(~unknown[some], 1, kind="stable")[:, :many]
            inputs = (moved[:-1] - moved[-1])[which].swapaxes(1, 2)
            errors[some] = _unexplained(rows[some], there[some], free, inputs)
        errors = abs(errors)
        left = np.where(there, errors, np.nan)
        lost = np.where(there | (number > 0)[:, None], np.nan, errors)
        return left.reshape(y.shape), lost.reshape(y.shape)

    def likely(self) -> "_Look":
        """Return the look without marks of inputs that contradict little where they are as recorded."""
        if not any(part.unknown.any() for part in self.parts):
            return self
        some = np.concatenate([self._as_recorded(part.some) for part in self.parts])
        some = some[~np.isnan(some).any(1)]
        if not len(some):
            return self
        usual, parts = np.maximum(np.median(some, 0), self.floor), []
        for part in self.parts:
            off, around = np.zeros(len(part.y)), part.around(part.unknown)
            beyond = np.fmax.reduce(self._as_recorded(around) / usual, 1, initial=0.0)
            np.fmax.at(off, around.first[:, None] + np.arange(HORIZON + 1), beyond[:, None])
            parts.append(part._replace(unknown=part.unknown & (off >= LITTLE)[:, None]))
        return dataclasses.replace(self, parts=parts)

    def _as_recorded(self, part: _Part) -> np.ndarray:
        """Return the largest error (N, p) of each output in windows with inputs as they were recorded."""
        part = part._replace(unknown=np.zeros_like(part.unknown))
        needs = [np.zeros((0, len(self.spread)))]
        for at in part.windows:
            needs.append(np.fmax.reduce(self.errors(part, at)[0], 1))
        return np.concatenate(needs)

    def needs(self) -> np.ndarray:
        """Return the largest error (p,) of each output, in spreads, in any window."""
        largest = np.zeros(len(self.spread))
        for part in self.parts:
            for at in part.windows:
                left, _ = self.errors(part, at)
                largest = np.fmax(largest, np.fmax.reduce(left, (0, 1)))
        return largest

    def contradicted(self, part: _Part, usual: np.ndarray) -> np.ndarray:
        """Return (T, p): how many times the usual errors (p,) what is marked is off, whatever window it is
        looked at in.
        """
        off = np.full(part.y.shape, np.inf)
        for at in part.around(part.absent).windows:
            _, lost = self.errors(part, at)
            np.fmin.at(off, (at[..., None], np.arange(part.y.shape[1])), lost / usual)
        return np.where(np.isfinite(off), off, 0.0)

    def restored(self, part: _Part, usual: np.ndarray) -> np.ndarray:
        """Return (T, m): how many times the usual errors (p,) outputs are off where the marked inputs of one
        number are as recorded.
        """
        off = np.zeros(part.u.shape)
        sample, signal = np.nonzero(part.unknown)
        begins = np.zeros(len(part.y), bool)
        begins[part.first] = True
        before = sample[:, None] - np.arange(HORIZON + 1)
        cell, ago = np.nonzero((before >= 0) & begins[np.maximum(before, 0)])
        for begin in range(0, len(cell), CHUNK):
            one, lag = cell[begin : begin + CHUNK], ago[begin : begin + CHUNK]
            at = (sample[one] - lag)[:, None] + np.arange(HORIZON + 1)
            number = part.u[sample[one], signal[one]][:, None, None]
            own = signal[one][:, None, None] == np.arange(part.u.shape[1])
            unknown = part.unknown[at] & ~(own & (part.u[at] == number))
            u = np.where(unknown, 0.0, part.u[at])
            left, _ = self._errors(u, part.y[at], part.absent[at], unknown)
            need = np.fmax.reduce(left / usual, (1, 2), initial=0.0)
            np.fmax.at(off, (sample[one], signal[one]), need)
        return off


def _unexplained(rows: np.ndarray, there: np.ndarray, free: np.ndarray, inputs: np.ndarray) -> np.ndarray:
    """Return the errors (N, R) of rows that are explained by columns of the first state, free (R, n), and of
    unknown inputs, (N, R, k), by least squares of the rows that are there.
    """
    if not inputs.shape[2] and there.all():
        return np.asarray(rows - times(times(rows, free), free.T))
    columns = np.concatenate([np.broadcast_to(free, (len(rows), *free.shape)), inputs], 2)
    present = columns * there[..., None]
    products = present.swapaxes(1, 2) @ present
    if inputs.shape[2]:
        known = np.full(len(rows), columns.shape[2] < columns.shape[1])
        products += RIDGE * np.eye(columns.shape[2])
    else:
        known = np.linalg.eigvalsh(products)[:, 0] > SEEN
        products[~known] = np.eye(columns.shape[2])
    about = present.swapaxes(1, 2) @ np.where(there, rows, 0.0)[..., None]
    errors = rows - (columns @ np.linalg.solve(products, about))[..., 0]
    errors[~known] = np.nan
    return np.asarray(errors)


def _looked(records: Records, marks: Marks, order: int, delay: int) -> _Look | None:
    """Return the _Look at recordings without what is marked; None where too few samples are left."""
    blank, late = [], []
    for (u, y, starts), (odd_u, odd_y) in zip(records, marks, strict=True):
        blank.append((np.where(odd_u, np.nan, u), np.where(odd_y, np.nan, y), starts))
        late.append((odd_u.astype(float), y, starts))
    blank, late, records = (delayed(x, delay) for x in (blank, late, records))
    scales = regression.scales_of(blank)
    steps = regression.windows_of(blank, scales, order)
    theta_rows = order * (scales.u.size + scales.y.size) + scales.u.size + 1
    if len(steps.y) < 2 * theta_rows:
        return None
    theta = regression.least_squares(steps, order, direct=True)
    parts = []
    for (u, y, starts), (unknown, _, _), (_, absent) in zip(records, late, marks, strict=True):
        unknown = unknown == 1.0
        first = regression.windows_without(np.asarray(np.isnan(u).any(1)), starts, HORIZON)
        u, y = (u - scales.u) / scales.u_spread, (y - scales.y) / scales.y_spread
        parts.append(_Part(u, y, unknown, absent, first))
    floor = []
    for i in range(len(scales.y)):
        recorded, kept = (np.concatenate([r[1][:, i] for r in x]) for x in (records, blank))
        floor.append(max(_step(recorded, kept), STEADY * (np.fmax.reduce(kept) - np.fmin.reduce(kept))))
    return _Look(theta, order, delay, parts, scales.y_spread, np.array(floor) / scales.y_spread)


def _step(recorded: np.ndarray, kept: np.ndarray) -> float:
    """Return the step of a recorder, by the samples that are kept; of an output that takes two values the
    least difference between any.
    """
    different = np.unique(kept[~np.isnan(kept)])
    if len(different) > 2:
        return recorded_step(kept)
    different = np.unique(recorded[~np.isnan(recorded)])
    return float(np.diff(different).min(initial=np.inf))


def _times_off(look: _Look) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return ((T, m), (T, p)) a recording: how many times the largest error of all other samples one that is
    marked is off; 0 of others.
    """
    look = look.likely()
    usual = np.maximum(look.needs(), look.floor)
    late, off = look.delay - 1, []
    for part in look.parts:
        by_input = np.zeros(part.u.shape)
        by_input[: len(part.u) - late] = look.restored(part, usual)[late:]
        off.append((by_input, np.where(part.absent, look.contradicted(part, usual), 0.0)))
    return off


def _named(records: Records, off: list[tuple[np.ndarray, np.ndarray]], share: float) -> Marks:
    """Return the samples that are outliers: of each signal those of the number that is farthest off, and of
    the next ones as long as these are few.
    """
    marks = _none(records)
    for side, i, x in _signals(records):
        beyond = np.concatenate([pair[side][:, i] for pair in off])
        present, odd = int((~np.isnan(x)).sum()), np.zeros(len(x), bool)
        numbers = x[beyond >= TIMES]
        for number in dict.fromkeys(numbers[np.argsort(-beyond[beyond >= TIMES], kind="stable")].tolist()):
            joined = odd | (x == number)
            most = share
            if not odd.any():
                most = SAME
            if joined.sum() > max(most * present, 1):
                break
            odd = joined
        _set_marks(marks, side, i, odd)
    return marks
