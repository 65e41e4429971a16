"""The types that a family of relations, a test of windows and an observer have in common with every verb.

Whoever adds a family writes one file: a subclass of `Relations` whose `test` returns a `WindowTest`, or a
subclass of `Observer`. Everything that `detect`, `study`, parts, the fleet, `Monitor`, the shell and reports
ask of it is declared here, with a default wherever one is sound. A test sees blocks of windows, never a
recording: gaps, batches, devices, threads and progress belong to the driver (`drive`).
"""

import copy
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar, Generic, NamedTuple, Protocol, Self, TypeAlias, TypeVar

import jax
import numpy as np
from jax.typing import DTypeLike
from numpy.typing import ArrayLike

from jaxbound.exact.frames import ExactFrame
from jaxbound.exact.linalg import Matrix
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.signals import SignalModel
from jaxbound.sets.floats.status import Status
from jaxbound.text.objects import readable

__all__ = [
    "FAMILIES",
    "METHODS",
    "OBSERVER",
    "Judged",
    "LinearRelations",
    "Observer",
    "Open",
    "Reach",
    "Relations",
    "Verdicts",
    "WindowTest",
    "family",
    "refuse_options",
    "relations_of",
]

METHODS = ("joint", "box", "paving", "linearized")
OBSERVER = "observer"

Array: TypeAlias = np.ndarray | jax.Array
Bounds: TypeAlias = Mapping[str, Array]
"""{"noise": (p,), ..}: the half-widths, or lowest and highest values, that verdicts rest on."""
Budget: TypeAlias = int | tuple[float, int] | None
"""Effort for each window: a number of boxes, or (q, boxes) for "paving"; None: the default."""
Compensation: TypeAlias = ArrayLike
"""Of "linearized", a number that each relation may be off by, or one for each."""
Starts: TypeAlias = ArrayLike
"""Numbers of the samples that do not follow the one before."""
Block: TypeAlias = tuple[np.ndarray, np.ndarray]
"""Samples (u, y) of as many windows as are judged at once."""
Arrays: TypeAlias = Sequence[Array]
Kernel: TypeAlias = Callable[..., Any]
Run: TypeAlias = Callable[[Kernel, Sequence[Block]], list[Any]]
"""run(kernel, blocks) calls a jitted kernel(constants, *block) on all blocks, one a device."""
Progress: TypeAlias = Callable[[float], object]


class Reach(Protocol):
    """How far a verdict looks back: over horizon + 1 samples, or over all since an observer began."""

    @property
    def remembers(self) -> bool:
        """Whether verdicts rest on all samples before."""

    @property
    def horizon(self) -> int:
        """A window has horizon + 1 samples."""


class Verdicts(Protocol):
    """Verdicts of samples, as an observer's `fold` returns them."""

    @property
    def status(self) -> Array:
        """(..., T) int8, see `Status`."""

    @property
    def margin(self) -> Array:
        """(..., T), NaN where none is measured."""


@readable
class Judged(NamedTuple):
    """Verdicts (..., T): status, as int8; margin; words, of a bank the packed verdicts of its relations, else
    None.
    """

    status: np.ndarray
    margin: np.ndarray
    words: np.ndarray | None = None


class Relations:
    """One family of relations between the samples of a window, or an observer in their place.

    A subclass states `model`, `horizon` and `test`; the other members have defaults.
    """

    remembers: ClassVar[bool] = False
    """Whether verdicts rest on all samples before, as those of an observer."""

    # Read-only for whoever asks. At run time they are plain defaults, since a property here would be in the
    # way of the field of a frozen dataclass, which needs `= field()` in place of such a default.
    if TYPE_CHECKING:

        @property
        def model(self) -> SignalModel:
            """The names of the signals, and the plant where there is one."""
            raise NotImplementedError

        @property
        def horizon(self) -> int:
            """A window has horizon + 1 samples; of an observer, the samples before its first verdict."""
            raise NotImplementedError

        @property
        def bounds(self) -> Bounds:
            """{name: numbers} that verdicts rest on; empty: nothing can be tuned."""
            raise NotImplementedError

        @property
        def made(self) -> tuple[object, ...] | None:
            """How relations came from the model, beside horizon and bounds; None: nothing tells them apart.

            Verdicts that are kept are known again by it; without it none are kept.
            """
            raise NotImplementedError

        @property
        def methods(self) -> tuple[str, ...]:
            """The methods of `test`, the usual one first."""
            raise NotImplementedError

        @property
        def count(self) -> int:
            """The number of relations."""
            raise NotImplementedError

        @property
        def lags(self) -> tuple[int, ...] | None:
            """The samples before its last at which a window looks; None: all of them."""
            raise NotImplementedError

        @property
        def notes(self) -> tuple[str, ...]:
            """Sentences for whoever reads a report."""
            raise NotImplementedError

        @property
        def searched(self) -> bool:
            """Whether a search decides the windows, which takes long enough for a thread of its own."""
            raise NotImplementedError

        @property
        def restart(self) -> bool:
            """Whether what remembers begins anew behind a FAULT; else FAULT stays until a gap."""
            raise NotImplementedError

    else:
        bounds: Bounds = MappingProxyType({})
        made = lags = None
        methods = METHODS[:1]
        count = 1
        notes = ()
        searched = False
        restart = True

    @property
    def latched(self) -> bool:
        """Whether a FAULT stays until a gap, as that of an observer that does not begin anew."""
        return self.remembers and not self.restart

    def recording(self, u: Any, y: Any = None, starts: Starts = ()) -> tuple[Self, Recording]:
        """Return (relations, Recording) of the samples that a user gives: see `Recording.of`.

        The relations are these, or, where names of signals were missing, the same with those of the samples.
        """
        return self, Recording.of(self.model, u, y, starts)

    def test(
        self, method: str, dtype: DTypeLike, budget: Budget = None, compensation: Compensation = 0.0
    ) -> "WindowTest | Observer[Any]":
        """Return the test by which a method decides windows of samples in a float dtype; see `detect`.

        Raises:
            ValueError: a method, budget or compensation that these relations cannot be tested by; see
                `refuse_options`.
        """
        raise NotImplementedError(f"{type(self).__name__} needs a method test(method, dtype, ..)")

    def reading(self, dtype: DTypeLike, method: str = "joint") -> Any:
        """Return the numbers by which kernels read a window, as a PyTree of arrays in a float dtype.

        Raises:
            NotImplementedError: a family whose tests state their `constants` themselves.
        """
        raise NotImplementedError(f"the tests of {type(self).__name__} state their constants themselves")

    def with_bounds(self, bounds: Mapping[str, jax.typing.ArrayLike]) -> Self:
        """Return the same relations under other bounds, those of `bounds` among them.

        Raises:
            NotImplementedError: a family without bounds that may change.
        """
        raise NotImplementedError(f"{type(self).__name__} has no bounds that may be changed or tuned")

    def external(self, u: Any, y: Any = None, starts: Starts = ()) -> jax.Array:
        """Return the residuals (..., T, count), NaN where a window is incomplete; not rounded, for pictures.

        Raises:
            NotImplementedError: a family without residuals.
        """
        raise NotImplementedError(f"{type(self).__name__} has no residuals to show")

    def internal(self, u: Any, y: Any = None, starts: Starts = ()) -> Any:
        """Return the Interval (..., T, count) that bounds allow each residual; not rounded, for pictures.

        Raises:
            NotImplementedError: a family without residuals.
        """
        raise NotImplementedError(f"{type(self).__name__} has no residuals to show")

    def text(self) -> str:
        """Return the relations as a reader would write them, one a line."""
        return type(self).__name__


class LinearRelations(Relations):
    """Relations W (Y, w) = K U with exact coefficients, Y, w and U the samples of a window."""

    if TYPE_CHECKING:

        @property
        def model(self) -> LinearSystem:
            """The plant."""
            raise NotImplementedError

        @property
        def W(self) -> Matrix:
            """(count, (s+1)p + gs): the relations, independent of each other."""
            raise NotImplementedError

        @property
        def K(self) -> Matrix:
            """(count, l): the inputs in the relations."""
            raise NotImplementedError

        @property
        def circuits(self) -> Matrix:
            """Combinations of relations with the fewest samples, all of them; none: too many."""
            raise NotImplementedError

        @property
        def circuits_known(self) -> Matrix:
            """The inputs in the circuits."""
            raise NotImplementedError

        @property
        def frame(self) -> ExactFrame | None:
            """The numbers that the exchange search needs where circuits are too many, else None."""
            raise NotImplementedError


def relations_of(given: object, verb: str, example: str) -> Relations:
    """Return the relations, or the observer, that a user gives to a verb.

    Args:
        verb, example: name of the verb and how it is called, for the sentence that refuses anything else.

    Raises:
        TypeError: given is neither.
    """
    if not isinstance(given, Relations):
        raise TypeError(f"{verb} needs relations, not {type(given).__name__}: {example}")
    return given


class WindowTest:
    """One way to decide windows of `horizon` + 1 samples.

    Args:
        relations: what it tests. method: as of `detect`. dtype: of the samples.

    A subclass says what a kernel takes beside samples (`constants`), how many windows at once (`block`, a
    function of shapes alone, else verdicts would depend on the cut), and judges blocks of them (`judge`).
    What it leaves open it may settle by another way (`settle`).
    """

    gathered: ClassVar[bool] = True
    """Blocks are windows u (lags, m, N), y (s + 1, p, N); else stretches u (N + s, m), y (N + s, p)."""
    padded: ClassVar[bool] = True
    """Blocks are filled up to their size; else the last one is shorter."""
    sharded: ClassVar[bool] = True
    """`judge` runs its kernels by `run`; else it is called on one device after the other."""
    threads: ClassVar[bool] = False
    """Several blocks at once: where the host waits between two kernels."""
    twice: ClassVar[bool] = False
    """`judge` and `settle` decide each FAULT a second time themselves."""
    replayed: ClassVar[bool] = True
    """Or `contradicted` and `exactly` see whatever contradicts."""
    short: ClassVar[int] = 64
    """How many windows are judged at once where there are few."""

    def __init__(self, relations: Relations, method: str, dtype: DTypeLike) -> None:
        self.relations, self.method, self.dtype = relations, method, np.dtype(dtype)
        self.horizon = relations.horizon
        self.placed: dict[tuple[jax.Device, ...], Any] = {}  # `constants` on devices, as `drive` puts them

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
        return int(self.reading.lags)

    @property
    def block(self) -> int:
        """How many windows are judged at once."""
        raise NotImplementedError

    @property
    def outputs(self) -> tuple[tuple[np.dtype, float], ...]:
        """((dtype, value where there is no window), ...): the arrays that `judge` fills."""
        return (np.dtype(np.int8), Status.MISSING), (self.dtype, np.nan)

    def cases(
        self, u: np.ndarray, y: np.ndarray, starts: np.ndarray
    ) -> Sequence[tuple["WindowTest", np.ndarray]]:
        """Return [(test, starts)]: who judges which of the windows that start at these samples; the rest
        stays MISSING.
        """
        return [(self, starts)] if len(starts) else []

    def judge(self, run: Run, blocks: list[Block]) -> list[Any]:
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

    def write(self, outs: list[np.ndarray], at: np.ndarray, found: tuple[np.ndarray, ...]) -> None:
        """Write what was found of the windows that end at samples `at`."""
        for out, values in zip(outs, found, strict=True):
            out[at] = values

    def settle(
        self,
        u: np.ndarray,
        y: np.ndarray,
        outs: list[np.ndarray],
        left: np.ndarray,
        again: Callable[["WindowTest", np.ndarray], np.ndarray],
        progress: Progress,
    ) -> None:
        """Decide windows that were left open, in place.

        Args:
            u, y: all samples, end to end. outs: arrays of `outputs` over them. left: starts of the windows
                left open.
            again: of (test, starts), judges windows by another test and returns the starts of those it leaves
                open; all of them where blocks are stretches.
            progress: takes the share done.
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

    def judged(self, outs: list[np.ndarray]) -> Any:
        """Return the verdicts from the arrays of `outputs`, each (..., T): a Judged, of a test whose windows
        are not decided another value.

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
    method: str, budget: object, compensation: Compensation, adaptive: bool = False, linear: bool = False
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


Carry = TypeVar("Carry")
"""What an observer carries from sample to sample: a PyTree of NumPy arrays and numbers."""


class Observer(Relations, Generic[Carry]):
    """A state that is carried from sample to sample of a recording, where a WindowTest has a window.

    A subclass states `model`, `init` and `fold`; a gap ends what is carried. Every verb takes it where it
    takes relations: it is its own test.

    Fields beside those of Relations:
        signals: the model whose names the samples are read by; by default `model`.
        batched: whether `fold` takes recordings side by side, (..., T, .), by one carry; else recordings of a
            batch are followed one by one.
        begun: the carry that it begins with in place of `init`; None: none. See `continued`.
    """

    remembers: ClassVar[bool] = True
    batched: ClassVar[bool] = False
    method: ClassVar[str] = OBSERVER
    begun: Carry | None = None

    if not TYPE_CHECKING:
        horizon = 0

    @property
    def methods(self) -> tuple[str, ...]:
        """The one method of an observer."""
        return (self.method,)

    @cached_property
    def signals(self) -> SignalModel:
        """The model whose names the samples are read by."""
        return self.model

    @property
    def relations(self) -> Self:
        """What a Result calls relations: this observer."""
        return self

    def init(self) -> Carry:
        """Return the carry before the first sample."""
        raise NotImplementedError

    def fold(self, carry: Carry, piece: Recording) -> tuple[Carry, Verdicts]:
        """Take the next samples; return (carry, verdicts (T,) of these samples)."""
        raise NotImplementedError

    def begin(self) -> Carry:
        """Return the carry that the first sample meets: `begun`, or that of `init`."""
        return self.init() if self.begun is None else self.begun

    def continued(self, carry: Carry) -> Self:
        """Return the same observer, which begins with a carry that `fold` returned."""
        watch = copy.copy(self)
        watch.begun = carry
        return watch

    def recording(self, u: Any, y: Any = None, starts: Starts = ()) -> tuple[Self, Recording]:
        """Return (this observer, the Recording of its signals)."""
        return self, Recording.of(self.signals, u, y, starts).finite()

    def test(
        self,
        method: str = METHODS[0],
        dtype: DTypeLike | None = None,
        budget: Budget = None,
        compensation: Compensation = 0.0,
    ) -> Self:
        """Return this observer, which knows one method.

        Raises:
            ValueError: another method than its own (or "joint", the default of every verb), a budget or a
                compensation.
        """
        known = method in (METHODS[0], self.method)
        if not known or budget is not None or np.any(np.asarray(compensation) != 0):
            raise ValueError(
                "an observer takes neither method nor budget nor compensation: they belong to windows"
            )
        return self

    def margins(self, given: Recording) -> jax.Array:
        """Raise NotImplementedError: an observer has no derivative."""
        raise NotImplementedError(
            "margins are those of windows: detect(observer, ..).margin has what an observer says"
        )


FAMILIES: dict[str, Callable[[Any, int | None], Relations]] = {}
"""{method: how relations, or an observer, of a model and a horizon are built}, beside those of jaxbound."""


def family(method: str) -> Callable[[Callable[[Any, int | None], Relations]], Any]:
    """Register a family of relations for the shell: `jaxbound detect --method METHOD` tests by it.

    Args:
        method: the name. What is decorated takes (model, horizon or None) and returns relations or an
            observer.

    Raises:
        ValueError: a name that is taken.
    """
    if method in (*METHODS, OBSERVER, *FAMILIES):
        raise ValueError(f"the method {method!r} is there already: give another name")

    def register(build: Callable[[Any, int | None], Relations]) -> Callable[[Any, int | None], Relations]:
        FAMILIES[method] = build
        return build

    return register


class Open(WindowTest):
    """Says nothing of windows: they are UNDECIDED, with a margin that is given."""

    padded = sharded = False
    block = 2**16
    constants = None

    def __init__(self, test: WindowTest, margin: float) -> None:
        super().__init__(test.relations, test.method, test.dtype)
        self.margin, self._lags = margin, test.lags

    @property
    def lags(self) -> int:
        """How many samples of u a window has."""
        return self._lags

    def judge(self, run: Run, blocks: list[Block]) -> list[Any]:
        """Return UNDECIDED for all windows."""
        return [self._undecided(y.shape[-1]) for _, y in blocks]

    def _undecided(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        status = np.full(count, Status.UNDECIDED, np.int8)
        return status, np.full(count, self.margin, self.dtype)
