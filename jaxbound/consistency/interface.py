"""What a way to decide windows is: the one interface that relations build, the driver runs and every verb
works with.

Whoever adds a test writes one file with one subclass. It sees blocks of windows, never a recording: gaps,
batches, devices, threads and progress are the driver's (`drive`).
"""

from collections.abc import Callable
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import jax
import numpy as np

from jaxbound.recordings.recording import Recording
from jaxbound.sets.floats.status import Status
from jaxbound.text.objects import readable

__all__ = ["METHODS", "Judged", "Observer", "Open", "WindowTest", "refuse_options"]

METHODS = ("joint", "box", "paving", "linearized")


@readable
class Judged(NamedTuple):
    """Verdicts (..., T): status, as int8; margin; words, of a bank the packed verdicts of its relations, else
    None.
    """

    status: np.ndarray
    margin: np.ndarray
    words: np.ndarray | None = None


class WindowTest:
    """One way to decide windows of `horizon` + 1 samples.

    Args:
        relations: what it tests. method: as of `detect`. dtype: of the samples.

    A subclass says what a kernel takes beside samples (`constants`), how many windows at once (`block`, a
    function of shapes alone, else verdicts would depend on the cut), and judges blocks of them (`judge`).
    What it leaves open it may settle by another way (`settle`).
    """

    gathered: ClassVar[bool] = (
        True  # blocks are windows u (lags, m, N), y (s + 1, p, N); else stretches u (N + s, m), y (N + s, p)
    )
    padded: ClassVar[bool] = True  # blocks are filled up to their size; else the last one is shorter
    sharded: ClassVar[bool] = (
        True  # `judge` runs its kernels by `run`; else it is called on one device after the other
    )
    threads: ClassVar[bool] = False  # several blocks at once: where the host waits between two kernels
    twice: ClassVar[bool] = False  # `judge` and `settle` decide each FAULT a second time themselves
    replayed: ClassVar[bool] = True  # or `contradicted` and `exactly` see whatever contradicts

    def __init__(self, relations: Any, method: str, dtype: Any) -> None:
        self.relations, self.method, self.dtype = relations, method, np.dtype(dtype)
        self.horizon = relations.horizon

    @property
    def constants(self) -> Any:
        """A PyTree of arrays that kernels take first."""
        return self.reading

    @cached_property
    def reading(self) -> Any:
        """How kernels read a window: from `relations.reading`."""
        return self.relations.reading(self.dtype, self.method)

    @property
    def lags(self) -> int:
        """How many samples of u a window has."""
        return self.reading.lags

    @property
    def block(self) -> int:
        """How many windows are judged at once."""
        raise NotImplementedError

    short: ClassVar[int] = 64
    """How many windows are judged at once where there are few."""

    @property
    def outputs(self) -> tuple:
        """((dtype, value where there is no window), ...): the arrays that `judge` fills."""
        return (np.dtype(np.int8), Status.MISSING), (self.dtype, np.nan)

    def cases(self, u: np.ndarray, y: np.ndarray, starts: np.ndarray) -> list:
        """Return [(test, starts)]: who judges which of the windows that start at these samples; the rest
        stays MISSING.
        """
        return [(self, starts)] if len(starts) else []

    def judge(self, run: Callable, blocks: list) -> list:
        """Judge blocks of windows.

        Args:
            run: of (kernel, blocks), runs a jitted kernel(constants, *block) on all blocks, one a device, and
                returns what it returns.
            blocks: [(u, y)].

        Returns:
            For each block the arrays of `outputs`, the windows on their last axis; one more of bool says
            which are left open.
        """
        raise NotImplementedError

    def write(self, outs: list, at: np.ndarray, found: tuple) -> None:
        """Write what was found of the windows that end at samples `at`."""
        for out, values in zip(outs, found, strict=True):
            out[at] = values

    def settle(
        self, u: np.ndarray, y: np.ndarray, outs: list, left: np.ndarray, again: Callable, progress: Callable
    ) -> None:
        """Decide windows that were left open, in place.

        Args:
            u, y: all samples, end to end. outs: arrays of `outputs` over them. left: starts of the windows
                left open. again: of (test,
            starts), judges windows by another test and returns the starts of those it leaves open. progress:
            takes the share done.
        """

    def contradicted(self, u: np.ndarray, y: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """Return (N,) bool: which windows are seen to contradict their bounds, from all samples u (T, m), y
        (T, p) and without XLA.

        What is not seen here is asked of `judge` and `settle`, with kernels evaluated in NumPy, unless
        `replayed` is False. See `twice`.
        """
        return np.zeros(len(starts), bool)

    def exactly(self, found: np.ndarray, u: np.ndarray, y: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """Return what `contradicted` found, with what it left open decided exactly; of tests that are not
        `replayed`.
        """
        return found

    def withdrawn(
        self, judged: Judged, at: np.ndarray, contradicted: np.ndarray, u: np.ndarray, y: np.ndarray
    ) -> tuple[Judged, np.ndarray]:
        """Return (the verdicts with UNDECIDED in place of FAULT where nothing contradicts, at which of the
        samples `at` there are such).

        Args:
            at: ends of the windows. contradicted: of them, from `contradicted`. u, y: all samples.
        """
        gone = at[~contradicted]
        judged.status.reshape(-1)[gone] = Status.UNDECIDED
        judged.margin.reshape(-1)[gone] = 0
        return judged, ~contradicted

    def judged(self, outs: list) -> Judged:
        """Return the verdicts from the arrays of `outputs`, each (..., T).

        Tested alone, relations that all hold need not hold together: no window is CONSISTENT by "box" but of
        a single relation.
        """
        status, margin = outs
        if self.method == "box" and self.relations.count > 1:
            status = np.where(status == Status.CONSISTENT, np.int8(Status.UNDECIDED), status)
        return Judged(status, margin)

    def margins(self, given: Recording) -> jax.Array:
        """Return the unproved margins (..., T) of a recording: differentiable, under jit, vmap and grad.

        NaN where there are no data, and at samples at which no window ends.
        """
        raise NotImplementedError(
            f"margins has no fast path for these relations and {self.method!r}: detect(...).margin has them"
        )


def refuse_options(
    method: str, budget: Any, compensation: Any, adaptive: bool = False, linear: bool = False
) -> None:
    """Raise ValueError for a method, budget or compensation that relations cannot be tested by.

    Args:
        adaptive: whether every method of theirs takes a budget. linear: whether they have something to
            neglect.
    """
    if method not in METHODS:
        raise ValueError(f"method must be one of {', '.join(METHODS)}, not {method!r}")
    if method == "linearized" and not linear:
        raise ValueError(
            "method 'linearized' is for models with uncertain parameters: use 'joint', which is exact here"
        )
    if method != "linearized" and np.any(np.asarray(compensation) != 0):
        raise ValueError(f"compensation belongs to method='linearized'; {method!r} neglects nothing")
    if budget is not None and method != "paving" and not adaptive:
        raise ValueError(f"budget belongs to method='paving'; {method!r} always finishes")


class Observer:
    """What carries something from sample to sample of one recording: a state that never forgets, where a
    WindowTest has a window.

    `Monitor` and `drive` take one in place of a test; a gap ends what is carried.

    remembers: of the relations that a Result names, tells these from windows: verdicts rest on all samples
    since it began, UNDECIDED is what healthy samples are, and what is carried goes with a recording that
    comes in parts.
    """

    remembers: ClassVar[bool] = True

    signals: Any  # of what model: names of inputs and outputs, dt

    def init(self) -> Any:
        """Return the carry before the first sample, a PyTree."""
        raise NotImplementedError

    def fold(self, carry: Any, piece: Recording) -> tuple[Any, Any]:
        """Take the next samples; return (carry, what is judged of them, with a .status (T,) as int8)."""
        raise NotImplementedError


class Open(WindowTest):
    """Says nothing of windows: they are UNDECIDED, with a margin that is given."""

    padded = sharded = False

    def __init__(self, test: WindowTest, margin: float) -> None:
        super().__init__(test.relations, test.method, test.dtype)
        self.margin, self._lags = margin, test.lags

    lags = property(lambda self: self._lags, doc="How many samples of u a window has.")
    block = 2**16
    constants = None

    def judge(self, run: Callable, blocks: list) -> list:
        """Return UNDECIDED for all windows."""
        count = lambda block: block[1].shape[-1]
        return [
            (np.full(count(b), Status.UNDECIDED, np.int8), np.full(count(b), self.margin, self.dtype))
            for b in blocks
        ]
