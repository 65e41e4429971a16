"""Every FAULT by XLA is decided again from the samples, in NumPy, before anybody sees it.

XLA copies wrongly at times: a part of an array from the wrong place, a number that another thread has not
written yet. No bound on rounding covers that. So a FAULT is only what both say; where NumPy says no, the
window is UNDECIDED and a warning tells what to report.

A test that searches hands the driver its hints, and each FAULT of a block is proved by them
(`WindowTest.refuted`); else the window is left open, and what no later search decides is asked of whole
numbers (`WindowTest.exactly`). Of a test without hints each FAULT is confirmed once all windows are judged
(`drive`), by a short way in NumPy with a stated error, then in whole numbers:
`WindowTest.contradicted`; without one its own kernels are evaluated once more, primitive by primitive in
NumPy. What proves each FAULT itself, as all tests of the package do that search or bisect, says so
(`WindowTest.confirms`).
"""

from importlib.metadata import version

import jax
import numpy as np

from jaxbound.sets.floats.probe import is_searching
from jaxbound.text.warned import warn


class Doubtful(RuntimeWarning):
    """A proof by XLA is not confirmed outside XLA: the verdict is UNDECIDED."""


def warn_of(ends: np.ndarray, faults: int) -> None:
    """Warn of the windows that end at these samples, of so many FAULT."""
    warn_doubtful(
        f"{len(ends)} of {faults} windows are FAULT by XLA, the first of them ends at sample {ends[0]}"
    )


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
