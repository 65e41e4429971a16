"""Every FAULT is decided twice: by XLA, and from the samples in NumPy, before anybody sees it.

XLA copies wrongly at times: a part of an array from the wrong place, a number that another thread has not
written yet. No bound on rounding covers that. So a FAULT is only what both say; where NumPy says no, the
window is UNDECIDED and a warning tells what to report. Of the CONSISTENT windows a few are looked at too: one
that NumPy refutes says that something is broken.

Each FAULT goes down this list until something confirms it:

1. A short way of the test, in NumPy with a stated error: `WindowTest.contradicted`.
2. The exact way of the test where it has one, in whole numbers: `WindowTest.exactly` (`replayed` is False).
3. The test's own kernels once more, evaluated primitive by primitive in NumPy: `sets.floats.kernel`.

The driver does so once all windows are judged (`drive.windows`, `decided_twice`). A test that keeps hints of
its search does so itself, block by block (`WindowTest.twice` is True, `Twice`): with them no search is needed
again.
"""

from collections.abc import Callable
from importlib.metadata import version
from typing import TypeAlias

import jax
import numpy as np

from jaxbound.consistency.interface import Array, Judged, WindowTest
from jaxbound.recordings.recording import NOWHERE
from jaxbound.sets.floats.kernel import is_outside_xla, outside_xla
from jaxbound.sets.floats.probe import is_searching
from jaxbound.sets.floats.status import Status
from jaxbound.text.warned import warn

__all__ = ["Doubtful", "Twice", "decided_twice", "warn_doubtful"]

SHARE = 2**15
"""One of so many CONSISTENT windows is looked at; none where there are fewer."""
LEAST = 8
"""The fewest that are looked at, in a row, where there are `SHARE` of them."""
Look: TypeAlias = Callable[[np.ndarray], np.ndarray]
"""Says without XLA which of some numbered windows contradict their bounds."""


class Doubtful(RuntimeWarning):
    """A proof by XLA is not confirmed outside XLA: the verdict is UNDECIDED."""


def decided_twice(
    test: WindowTest, judged: Judged, u: np.ndarray, y: np.ndarray, contradicted: Look
) -> Judged:
    """Return the verdicts of windows with those UNDECIDED that a second look does not confirm.

    Args:
        test: the WindowTest. judged: its verdicts. u (T, m), y (T, p): all samples. contradicted: of the
            numbers of the samples at which windows end, says which of these contradict their bounds: see
            `WindowTest.contradicted`.
    """
    status = judged.status.reshape(-1)
    faulty = NOWHERE
    if status.max(initial=0) == Status.FAULT:  # of nearly all recordings the maximum alone is asked for
        faulty = np.flatnonzero(status == Status.FAULT)
    if len(faulty):
        judged = _confirmed(test, judged, u, y, faulty, contradicted(faulty))
    some = _some_healthy(status)
    if not len(some):
        return judged
    wrong = np.asarray(np.atleast_2d(test.contradicted(u, y, some - test.horizon)).any(0))
    if wrong.any():
        _warn_of(some, wrong, "CONSISTENT")
        judged.status.reshape(-1)[some[wrong]] = Status.UNDECIDED
        judged.margin.reshape(-1)[some[wrong]] = 0
    return judged


def _confirmed(
    test: WindowTest, judged: Judged, u: np.ndarray, y: np.ndarray, faulty: np.ndarray, proved: np.ndarray
) -> Judged:
    """Return the verdicts without those FAULT, at samples `faulty`, that are not proved."""
    if proved.all():
        return judged
    judged, doubtful = test.withdrawn(judged, faulty, proved, u, y)
    if doubtful.any():
        _warn_of(faulty, doubtful, "FAULT")
    return judged


def _warn_of(ends: np.ndarray, doubtful: np.ndarray, verdict: str) -> None:
    """Warn of the doubtful ones among windows that end at samples `ends`."""
    first = int(ends[doubtful.argmax()])
    warn_doubtful(
        f"{int(doubtful.sum())} of {len(ends)} windows are {verdict} by XLA, the first of them ends at "
        f"sample {first}"
    )


def _some_healthy(status: np.ndarray) -> np.ndarray:
    """Return the ends of CONSISTENT windows in a short stretch, somewhere in many windows; none of few."""
    count = len(status) // SHARE
    if not count:
        return NOWHERE
    stretch = max(LEAST, count)
    first = int(np.random.default_rng(len(status)).integers(len(status) - stretch + 1))
    return first + np.flatnonzero(status[first : first + stretch] == Status.CONSISTENT)


class Twice:
    """Decides windows of a block a second time by what a search found for them: hints, with which no search
    is needed.

    Args:
        block: how many windows a block has.
    """

    def __init__(self, block: int) -> None:
        self.block = block
        self.passed = 0

    def decided(
        self, margin: Array, again: Callable[[np.ndarray], Array], contradicted: Look | None = None
    ) -> np.ndarray:
        """Return the margins of a block with 0 in place of a proof that NumPy does not confirm.

        Args:
            margin: (N,), its sign proved by XLA. again: of numbers of windows in the block, their margins,
                proved in NumPy.
            contradicted: a shorter way to see which of them are FAULT; what it does not see is asked of
                `again`.
        """
        margin = np.asarray(margin)
        if is_outside_xla():
            return margin
        faulty, doubtful = np.flatnonzero(margin < 0), NOWHERE
        if contradicted is not None:
            doubtful = self._some(margin)
            if len(doubtful):
                doubtful = doubtful[contradicted(doubtful)]
            if len(faulty):
                faulty = faulty[~contradicted(faulty)]
        if len(faulty):
            with outside_xla():
                # one size, so that the program is written down once
                proved = np.asarray(again(np.resize(faulty, max(self.block, len(faulty)))))[: len(faulty)]
            doubtful = np.concatenate([doubtful, faulty[~(proved < 0)]])
        if len(doubtful):
            margin = np.array(margin)
            margin[doubtful] = 0
            warn_doubtful(f"{len(doubtful)} windows of a block are decided by XLA")
        return margin

    def _some(self, margin: np.ndarray) -> np.ndarray:
        """Return the number of a CONSISTENT window, now and then."""
        self.passed += len(margin)
        if self.passed < SHARE:
            return np.zeros(0, np.int64)
        self.passed = 0
        return np.flatnonzero(margin > 0)[:1]


def warn_doubtful(what: str) -> None:
    """Warn of verdicts that NumPy does not confirm, with a line for a report unless nobody expects a proof of
    the device.
    """
    if is_searching():
        warn(
            f"{what}, on a device that was not examined: NumPy does not confirm it from the samples, so they "
            f"are UNDECIDED",
            Doubtful,
        )
        return
    versions = (
        f"jax {jax.__version__}, jaxlib {version('jaxlib')}, numpy {np.__version__}, {jax.default_backend()}"
    )
    warn(
        f"{what}: NumPy does not confirm it from the samples, so they are UNDECIDED. XLA may have computed "
        f"or copied wrongly; "
        f"please report it with the model, these samples and this line: {versions}",
        Doubtful,
    )
