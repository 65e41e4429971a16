"""The part that failed: verdicts of every relation of a bank, and the single faults that can explain them.

A violated relation is a proof that something other than the faults it ignores has failed. So a single fault
stays a candidate while every violated relation reacts to it. A relation that holds exonerates nobody: a fault
may be too small to show in it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from jaxbound.certificates.interface import WindowCertificate
from jaxbound.consistency.interface import Judged
from jaxbound.diagnosis.detectability import OperatingRange, visible_sizes
from jaxbound.diagnosis.result import Result, result_of
from jaxbound.recordings.arrays import float_array
from jaxbound.recordings.expressions import find_column
from jaxbound.recordings.sample_axis import Place
from jaxbound.recordings.table import Data, as_table, is_table
from jaxbound.recordings.tabletime import unlabelled
from jaxbound.relations.decoupling import Signatures, signatures
from jaxbound.relations.redundancy import Redundancy
from jaxbound.sets.floats.status import Status
from jaxbound.sets.strips.bank import PACKED
from jaxbound.text.objects import readable


@readable
@dataclass(frozen=True, eq=False)
class BankResult(Result):
    """A Result with the verdict of each relation of a bank alone.

    Fields beside those of Result: signatures: which relation reacts to which fault; words (words, ..., T)
    uint32: the verdicts, packed.
    """

    signatures: Signatures = field(kw_only=True)
    words: np.ndarray = field(kw_only=True)

    @property
    def faults(self) -> tuple[str, ...]:
        """Names of the single faults, the last axis of `candidates`."""
        return self.signatures.faults

    def of(self, i: int) -> np.ndarray:
        """Return the status (..., T) int8 of relation i alone; FAULT and CONSISTENT are proofs."""
        count = len(self.signatures.relations)
        if not -count <= i < count:
            raise ValueError(f"the bank has the relations 0 to {count - 1}, not {i}")
        word, place = divmod(i % count, PACKED)
        return np.asarray(self.words[word] >> np.uint32(2 * place) & np.uint32(3)).astype(np.int8)

    @cached_property
    def violated(self) -> np.ndarray:
        """(..., T, R) bool: which relations are violated, each a proof."""
        count = len(self.signatures.relations)
        return np.stack([self.of(i) == Status.FAULT for i in range(count)], -1)

    @cached_property
    def candidates(self) -> np.ndarray:
        """(..., T, N) bool: which single faults can explain the violated relations; none where nothing is
        violated.

        Whichever single fault there is, it is among them: the others are excluded by proof.
        """
        # a fault is excluded by a violated relation that does not react to it
        excluded = self.violated.astype(np.float32) @ (~self.signatures.weak).astype(np.float32) > 0
        return np.asarray(~excluded & self.violated.any(-1, keepdims=True))

    def names(self, at: Place) -> tuple[str, ...]:
        """Return the names of the candidates of the window that ends at sample `at`, see `Result.explain`."""
        able = self.candidates[self._place(at)]
        return tuple(name for name, on in zip(self.faults, able, strict=True) if on)

    def candidates_from(
        self, sizes: Mapping[str, float], operating_range: OperatingRange = None
    ) -> np.ndarray:
        """Return the candidates (..., T, N) if a fault, where there is one, is constant and at least so large
        throughout the window.

        A relation that is proved to hold then exonerates every fault that it is guaranteed to see.

        Args:
            sizes: {fault: its smallest size}; a fault that is not named may be of any size. operating_range:
                as for `detectable`.

        Raises:
            ValueError: an unknown fault; residuals from elsewhere; an operating range that is missing.
        """
        if self.relations is None:
            raise ValueError("what size of a fault residuals from elsewhere are bound to see is not known")
        strange = sorted(set(sizes) - set(self.faults))
        if strange:
            raise ValueError(f"the model has no signal {strange[0]!r}: it has {', '.join(self.faults)}")
        able = self.candidates.copy()
        for i, visible in enumerate(visible_sizes(self.relations, operating_range)):
            holds = self.of(i) == Status.CONSISTENT
            for name, size in sizes.items():
                j = self.faults.index(name)
                if size >= visible[j]:
                    able[..., j] &= ~holds
        return able

    def remaining(self, start: int, end: int, recording: tuple[int, ...] = ()) -> tuple[str, ...]:
        """Return the names of the single faults that can explain every FAULT window that ends at a sample
        start <= k <= end.
        """
        fault = self.status[recording][start : end + 1] == Status.FAULT
        able = self.candidates[recording][start : end + 1][fault].all(0) & fault.any()
        return tuple(name for name, on in zip(self.faults, able, strict=True) if on)

    @property
    def hints(self) -> tuple[str, ...]:
        """Sentences for whoever acts on the verdicts, as of a Result; none for residuals from elsewhere."""
        if self.relations is None:
            return ()
        return super().hints

    def explain(self, at: Place) -> WindowCertificate:
        """Return the Certificate of the relation that is violated most in the window that ends at sample
        `at`, as `Result.explain`.

        Raises:
            ValueError: residuals from elsewhere, whose relations are not known.
        """
        if self.relations is None:
            raise ValueError(
                "residuals that were computed elsewhere have no certificate: ask .violated and .candidates"
            )
        return super().explain(at)


@result_of.register
def _(family: Redundancy, judged: Judged, result: Result) -> BankResult:
    assert judged.words is not None, "a bank is judged relation by relation"
    return BankResult(**vars(result), signatures=signatures(family), words=judged.words)


def words_of(statuses: np.ndarray) -> np.ndarray:
    """Pack statuses (R, ...) as `bank_verdicts` does."""
    words = np.zeros((-(-len(statuses) // PACKED), *statuses.shape[1:]), np.uint32)
    for i, status in enumerate(statuses):
        words[i // PACKED] |= status.astype(np.uint32) << np.uint32(2 * (i % PACKED))
    return words


def evaluate(residuals: Data, hull: Data, signatures: Data) -> BankResult:
    """Isolate from residuals that were computed elsewhere: those outside of what healthy data showed, and the
    faults that explain them.

    Args:
        residuals: (..., T, r), or a table with a column for each. NaN: that residual is missing.
        hull: (r, 2) lowest and highest healthy value of each residual, or (r,) its largest magnitude.
        signatures: Signatures, or a table (r, N) of 0 and 1, a DataFrame with the names of the faults:
            whether a fault acts on a residual. Rows of these two that are labelled are found by the names of
            the residuals, where these have some.

    Returns:
        A BankResult; FAULT says that a residual is outside its hull, as sure as the hull is. Its margin is 1
        - the largest factor on the hulls' half-widths at which the residual would just be inside; .candidates
            the faults that act on every residual outside.

    Raises:
        ValueError: shapes that do not fit, a hull with lo > hi or that is not finite, an infinite residual.

    Example:
        >>> res = evaluate([[0.1, 0.0], [0.1, 3.0]], [1.0, 1.0], [[1, 0], [1, 1]])
        >>> res.status, res.names(1)
        (array([1, 3], dtype=int8), ('f1', 'f2'))
    """
    residuals = as_table(residuals, "residuals")
    index, names = getattr(residuals, "index", None), None
    if is_table(residuals):
        names = list(residuals.columns)
    table = _signatures(_rows_of(signatures, names, "the table of signatures"))
    values = float_array(residuals, "residuals")
    if values.dtype not in (np.float32, np.float64):
        values = values.astype(float)
    lo, hi = _hulls(_rows_of(hull, names, "the hull"), values.shape)
    if np.isinf(values).any():
        raise ValueError(
            f"residuals has {int(np.isinf(values).sum())} infinite entries: mark what is missing as NaN"
        )
    if len(table.weak) != len(lo):
        raise ValueError(
            f"signatures need a row for each of {len(lo)} residuals: they have {len(table.weak)}"
        )
    outside, absent = (values < lo) | (values > hi), np.isnan(values)
    with np.errstate(divide="ignore", invalid="ignore"):
        factor = np.abs(values - 0.5 * (lo + hi)) / (0.5 * (hi - lo))
    # whatever rounding makes of a factor, it is above 1 outside alone
    factor = np.where(outside, np.maximum(factor, np.nextafter(1, 2)), np.minimum(np.nan_to_num(factor), 1))
    worst = np.where(absent, -np.inf, factor).max(-1)
    margin = np.where(absent.all(-1), np.nan, 1 - worst)
    whole = _statuses(np.asarray(absent.all(-1)), np.asarray(outside.any(-1)))
    words = words_of(np.moveaxis(_statuses(absent, outside), -1, 0))
    u = np.zeros((*values.shape[:-1], 0), values.dtype)
    return BankResult(whole, margin, "box", None, u, values, index, signatures=table, words=words)


def _statuses(absent: np.ndarray, outside: np.ndarray) -> np.ndarray:
    """Return MISSING where something is absent, else FAULT where it is outside, else CONSISTENT."""
    status = np.where(outside, Status.FAULT, Status.CONSISTENT)
    return np.where(absent, Status.MISSING, status).astype(np.int8)


def _hulls(hull: ArrayLike, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return the lowest and the highest healthy value of each residual, for residuals of a shape."""
    ends = np.asarray(hull, float)
    if ends.ndim == 1:
        ends = np.stack([-ends, ends], -1)
    if len(shape) < 2 or ends.shape != (shape[-1], 2):
        raise ValueError(
            f"residuals must have shape (..., T, r) and hull (r, 2) or (r,): they have {shape} and "
            f"{ends.shape}"
        )
    lo, hi = ends.T
    sound = np.isfinite(ends).all(1) & (lo <= hi)
    if not sound.all():
        raise ValueError(f"each hull needs lo <= hi, both finite: residual {int(np.argmin(sound))} has not")
    return lo, hi


def _rows_of(table: Data, names: list[str] | None, what: str) -> Data:
    """Return the rows of a labelled table in the order of names; anything else, a table without labels among
    it, as it is.
    """
    if isinstance(table, Signatures):
        return table
    table = as_table(table, what)
    if names is None or not hasattr(table, "iloc") or unlabelled(table.index):
        return table
    labels = list(table.index)
    return table.iloc[[labels.index(find_column(name, labels, what)) for name in names]]


def _signatures(table: Data) -> Signatures:
    """Read a table (r, N) of 0 and 1 as Signatures."""
    if isinstance(table, Signatures):
        return table
    numbers = np.asarray(table)
    if numbers.ndim != 2 or not np.isin(numbers, (0, 1)).all():
        raise ValueError(f"signatures must be a table (r, N) of 0 and 1: their shape is {numbers.shape}")
    faults = tuple(f"f{j + 1}" for j in range(numbers.shape[1]))
    if hasattr(table, "columns"):
        faults = tuple(map(str, table.columns))
    return Signatures(tuple(f"r{i + 1}" for i in range(len(numbers))), faults, numbers == 1, numbers == 1)
