"""Which part failed? Verdicts of every relation of a bank, and the single faults that can explain them.

A violated relation is a proof that something other than the faults it ignores has failed. So a single fault
stays a candidate while every violated relation reacts to it. A relation that holds exonerates nobody: a fault
may be too small to show in it.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from jaxbound.consistency.bank import HIGH
from jaxbound.diagnosis.detectability import visible_sizes
from jaxbound.diagnosis.result import Result, result_of
from jaxbound.recordings.arrays import floats
from jaxbound.recordings.expressions import find_column
from jaxbound.recordings.table import as_table, is_table
from jaxbound.recordings.tabletime import unlabelled
from jaxbound.relations.decoupling import Signatures, signatures
from jaxbound.relations.redundancy import Redundancy
from jaxbound.sets.floats.status import Status
from jaxbound.sets.strips.bank import PACKED
from jaxbound.text.objects import readable

__all__ = ["BankResult", "evaluate", "words_of"]


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
        i %= count
        return (self.words[i // PACKED] >> np.uint32(2 * (i % PACKED)) & np.uint32(3)).astype(np.int8)

    @cached_property
    def violated(self) -> np.ndarray:
        """(..., T, R) bool: which relations are violated, each a proof."""
        return np.stack([self.of(i) == Status.FAULT for i in range(len(self.signatures.relations))], -1)

    @cached_property
    def candidates(self) -> np.ndarray:
        """(..., T, N) bool: which single faults can explain the violated relations; none where nothing is
        violated.

        Whichever single fault there is, it is among them: the others are excluded by proof.
        """
        high = self.words & (self.words << np.uint32(1)) & HIGH
        patterns, which = np.unique(np.stack([w.ravel() for w in high]), axis=1, return_inverse=True)
        count = len(self.signatures.relations)
        violated = np.array(
            [patterns[i // PACKED] >> np.uint32(2 * (i % PACKED) + 1) & np.uint32(1) for i in range(count)],
            bool,
        ).T
        able = ~(violated.astype(int) @ (~self.signatures.weak).astype(int)).astype(bool) & violated.any(
            1, keepdims=True
        )
        return able[which.ravel()].reshape(*self.status.shape, -1)

    def names(self, at: Any) -> tuple[str, ...]:
        """Return the names of the candidates of the window that ends at index `at`."""
        return tuple(name for name, on in zip(self.faults, self.candidates[at], strict=True) if on)

    def candidates_from(self, sizes: Mapping[str, float], operating_range: Any = None) -> np.ndarray:
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
        if strange := sorted(set(sizes) - set(self.faults)):
            raise ValueError(f"the model has no signal {strange[0]!r}: it has {', '.join(self.faults)}")
        least, out = visible_sizes(self.relations, operating_range), self.candidates.copy()
        for i, row in enumerate(least):
            holds = self.of(i) == Status.CONSISTENT
            for name, size in sizes.items():
                j = self.faults.index(name)
                if size >= row[j]:
                    out[..., j] &= ~holds
        return out

    def remaining(self, start: int, end: int, recording: tuple = ()) -> tuple[str, ...]:
        """Return the names of the single faults that can explain every FAULT window that ends at a sample
        start <= k <= end.
        """
        fault = self.status[recording][start : end + 1] == Status.FAULT
        able = self.candidates[recording][start : end + 1][fault].all(0) & fault.any()
        return tuple(name for name, on in zip(self.faults, able, strict=True) if on)

    @property
    def hints(self) -> tuple[str, ...]:
        """Sentences for whoever acts on the verdicts, as of a Result; none for residuals from elsewhere."""
        return () if self.relations is None else super().hints

    def explain(self, at: int | tuple[int, ...]) -> Any:
        """Return the Certificate of the relation that is violated most in the window that ends at index `at`,
        as `Result.explain`.

        Raises:
            ValueError: residuals from elsewhere, whose relations are not known.
        """
        if self.relations is None:
            raise ValueError(
                "residuals that were computed elsewhere have no certificate: ask .violated and .candidates"
            )
        return super().explain(at)


@result_of.register
def _(bank: Redundancy, judged, *about, **more):
    method, relations, u, y, index, starts = about
    table = signatures(bank)
    return BankResult(
        judged.status,
        judged.margin,
        method,
        relations,
        u,
        y,
        index,
        starts,
        signatures=table,
        words=judged.words,
        **more,
    )


def words_of(statuses: np.ndarray) -> np.ndarray:
    """Pack statuses (R, ...) as `bank_verdicts` does."""
    words = np.zeros((-(-len(statuses) // PACKED), *statuses.shape[1:]), np.uint32)
    for i, status in enumerate(statuses):
        words[i // PACKED] |= status.astype(np.uint32) << np.uint32(2 * (i % PACKED))
    return words


def evaluate(residuals: Any, hull: Any, signatures: Any) -> BankResult:
    """Isolate from residuals that were computed elsewhere: which are outside what healthy data showed, and
    what faults explain that?

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
    index, names = getattr(residuals, "index", None), list(residuals.columns) if is_table(residuals) else None
    hull, signatures = (
        _rows_of(x, names, what) for x, what in ((hull, "the hull"), (signatures, "the table of signatures"))
    )
    residuals, hull = floats(residuals, "residuals"), np.asarray(hull, float)
    residuals = residuals if residuals.dtype in (np.float32, np.float64) else residuals.astype(float)
    r = residuals.shape[-1] if residuals.ndim > 1 else -1
    hull = np.stack([-hull, hull], -1) if hull.ndim == 1 else hull
    if hull.shape != (r, 2):
        raise ValueError(
            f"residuals must have shape (..., T, r) and hull (r, 2) or (r,): they have {residuals.shape} and "
            f"{hull.shape}"
        )
    if not (np.isfinite(hull).all() and (hull[:, 0] <= hull[:, 1]).all()):
        raise ValueError(
            f"each hull needs lo <= hi, both finite: residual {int(np.argmin(hull[:, 0] <= hull[:, 1]))} has "
            f"not"
        )
    if np.isinf(residuals).any():
        raise ValueError(
            f"residuals has {int(np.isinf(residuals).sum())} infinite entries: mark what is missing as NaN"
        )
    table = signatures if isinstance(signatures, Signatures) else _table(signatures)
    if table.weak.shape[0] != r:
        raise ValueError(f"signatures need a row for each of {r} residuals: they have {table.weak.shape[0]}")
    lo, hi = hull.T
    outside = (residuals < lo) | (residuals > hi)
    with np.errstate(divide="ignore", invalid="ignore"):
        factor = np.abs(residuals - 0.5 * (lo + hi)) / (0.5 * (hi - lo))
    factor = np.where(outside, np.maximum(factor, np.nextafter(1, 2)), np.minimum(np.nan_to_num(factor), 1))
    absent = np.isnan(residuals)
    status = np.where(absent, Status.MISSING, np.where(outside, Status.FAULT, Status.CONSISTENT)).astype(
        np.int8
    )
    worst = np.where(absent, -np.inf, factor).max(-1)
    whole = np.where(
        absent.all(-1), Status.MISSING, np.where(outside.any(-1), Status.FAULT, Status.CONSISTENT)
    ).astype(np.int8)
    margin = np.where(absent.all(-1), np.nan, 1 - worst)
    nothing = np.zeros((*residuals.shape[:-1], 0), residuals.dtype)
    return BankResult(
        whole,
        margin,
        "box",
        None,
        nothing,
        residuals,
        index,
        signatures=table,
        words=words_of(np.moveaxis(status, -1, 0)),
    )


def _rows_of(given, names, what):
    """Return the rows of a labelled table in the order of names; anything else, a table without labels among
    it, as it is.
    """
    given = given if isinstance(given, Signatures) else as_table(given, what)
    if names is None or not hasattr(given, "iloc") or unlabelled(given.index):
        return given
    labels = list(given.index)
    return given.iloc[[labels.index(find_column(name, labels, what)) for name in names]]


def _table(given):
    """Read a table (r, N) of 0 and 1 as Signatures."""
    names = tuple(map(str, given.columns)) if hasattr(given, "columns") else None
    numbers = np.asarray(given)
    if numbers.ndim != 2 or not np.isin(numbers, (0, 1)).all():
        raise ValueError(f"signatures must be a table (r, N) of 0 and 1: their shape is {numbers.shape}")
    names = names or tuple(f"f{j + 1}" for j in range(numbers.shape[1]))
    return Signatures(tuple(f"r{i + 1}" for i in range(len(numbers))), names, numbers == 1, numbers == 1)
