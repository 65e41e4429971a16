"""Banks: every relation has a verdict of its own, packed beside those of the others."""

import dataclasses
from collections.abc import Sequence
from functools import cached_property

import jax
import numpy as np
from jax.typing import DTypeLike

from jaxbound.consistency.folded import tested
from jaxbound.consistency.interface import (
    Arrays,
    Judged,
    LinearRelations,
    LinearTest,
    Outputs,
    Relations,
    Run,
)
from jaxbound.consistency.reading import Block, Reading, gather
from jaxbound.consistency.strips import StripsTest
from jaxbound.consistency.strips_on_host import HostStrips, host_strips
from jaxbound.consistency.unproved import stretch_block
from jaxbound.consistency.whole_numbers import exact_strip_margins
from jaxbound.recordings.recording import Recording
from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.floats.status import Status
from jaxbound.sets.strips.bank import PACKED, bank_verdicts, unpacked, verdict_dtypes
from jaxbound.sets.strips.strips import strips_of

MOST = 128
HIGH = np.uint32(0xAAAAAAAA)  # the high bit of every verdict; it is FAULT if the low one is set too


class BankTest(LinearTest):
    """Tests each relation of a bank alone: FAULT is a proof, CONSISTENT only with a single relation.

    Raises:
        NotImplementedError: constant tolerances. ValueError: too many relations.
    """

    by_kernels = True
    gathered = False

    def __init__(self, relations: LinearRelations, dtype: DTypeLike) -> None:
        super().__init__(relations, "box", dtype)
        if relations.model.constant_tolerance:
            raise NotImplementedError(
                "a bank is tested with tolerances drawn anew each sample: leave constant_tolerance out, it "
                "is wider then"
            )
        if relations.model.averages:
            raise NotImplementedError(
                "a bank looks at single samples: leave averages out, its bounds are wider then"
            )
        if relations.count > MOST:
            raise ValueError(
                f"a bank of {relations.count} relations is more than is tested at once, {MOST}: choose fewer "
                f"parts"
            )

    def under(self, relations: Relations) -> "BankTest":
        """Return the same test of a bank under other bounds."""
        assert relations.linear is not None, "it is a bank of such"
        return BankTest(relations.linear, self.dtype)

    @cached_property
    def reading(self) -> Reading:
        """How the kernel reads a window, and the strips of the bank."""
        r = self.relations
        every = strips_of(r.W, r.K, unrolled=MOST).astype(self.dtype)
        return dataclasses.replace(r.reading(self.dtype, "box"), shape=every)

    @property
    def block(self) -> int:
        """How many windows are judged at once."""
        return stretch_block(self.reading)

    @property
    def outputs(self) -> Outputs:
        """The packed arrays of `bank_verdicts`."""
        first, *others = verdict_dtypes(self.relations.count, self.dtype)
        return (first, np.nan), *((dtype, 0) for dtype in others)

    def judge(self, run: Run, blocks: Sequence[Block]) -> Sequence[Arrays]:
        """Return the packed verdicts of stretches of samples."""
        return run(bank_windows, blocks)

    def judged(self, outs: Sequence[np.ndarray]) -> Judged:
        """Return the verdicts of the whole bank, and those of its relations as words."""
        words, margin = unpacked(*outs)
        words = np.where(np.isnan(margin), np.uint32(0), words)
        return Judged(status_of_words(words, self.relations.count), margin, words)

    def contradicted(self, u: np.ndarray, y: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """Return (relations, N) bool: which relations contradict which windows, in NumPy; see
        `WindowTest.contradicted`.
        """
        return self._host.contradicted(u, y, starts)

    def withdrawn(
        self, judged: Judged, at: np.ndarray, contradicted: np.ndarray, u: np.ndarray, y: np.ndarray
    ) -> tuple[Judged, np.ndarray]:
        """Return the verdicts with UNDECIDED in place of FAULT for relations that are not contradicted; see
        `WindowTest.withdrawn`.
        """
        r, s = self.relations, self.horizon
        words = np.array(judged.words)
        last = (r.count - 1) % PACKED + 1  # relations in the last word: nothing is said of others
        words[-1] &= np.uint32(2 ** (2 * last) - 1)
        flat = words.reshape(len(words), -1)
        exact, doubtful = r.reading(self.dtype, "box"), np.zeros(len(at), bool)
        for number, proved in enumerate(contradicted):
            word, place = divmod(number, PACKED)
            shift = np.uint32(2 * place)
            open_ = np.flatnonzero(~proved & (flat[word, at] >> shift & np.uint32(3) == Status.FAULT))
            if not len(open_):
                continue
            windows = gather(u, y, at[open_] - s, self.lags, s)
            strip = r.W[number : number + 1], r.K[number : number + 1]
            open_ = open_[~(exact_strip_margins(r, exact, strip, *windows) < 0)]
            flat[word, at[open_]] ^= np.uint32(Status.FAULT ^ Status.UNDECIDED) << shift
            doubtful[open_] = True
        status = status_of_words(words, r.count)
        nothing = (judged.status == Status.FAULT) & (status != Status.FAULT)
        margin = np.where(nothing, 0, judged.margin).astype(judged.margin.dtype)
        return judged._replace(status=status, margin=margin, words=words), doubtful

    def unproved(self, judged: Judged) -> Judged:
        """Return the verdicts with UNDECIDED in place of CONSISTENT for every relation; see
        `WindowTest.unproved`.
        """
        words = np.array(judged.words)
        consistent = words & ~HIGH & ~(words >> np.uint32(1))  # the low bit of a verdict alone
        words ^= consistent | consistent << np.uint32(1)
        return super().unproved(judged._replace(words=words))

    @cached_property
    def _host(self) -> HostStrips:
        r = self.relations
        return host_strips(r.reading(np.float64, "box"), r.W, r.K)

    def margins(self, given: Recording) -> jax.Array:
        """Return the unproved margins (..., T) of the relation of each window that is tightest; see
        `WindowTest.margins`.
        """
        return StripsTest(self.relations, "box", self.dtype).margins(given)


@kernel
def bank_windows(reading: Reading, u: jax.Array, y: jax.Array) -> tuple[jax.Array, ...]:
    """Return the verdicts of every relation over a stretch and the margin of the tightest one, packed."""
    return bank_verdicts(tested(reading, *reading.columns(u, y)), y[reading.horizon :, 0])


def status_of_words(words: np.ndarray, count: int) -> np.ndarray:
    """Return the status (...) of a bank from its words: it proves FAULT, and CONSISTENT where it is a single
    relation.
    """
    fault = (words & (words << np.uint32(1)) & HIGH != 0).any(0)
    if count == 1:
        return np.asarray(words[0].astype(np.int8))
    spoken = np.where((words != 0).any(0), np.int8(Status.UNDECIDED), np.int8(Status.MISSING))
    return np.where(fault, np.int8(Status.FAULT), spoken)
