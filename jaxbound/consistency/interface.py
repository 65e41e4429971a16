"""The types that a family of relations, a test of windows and an observer have in common with every verb.

Whoever adds a family writes one file: a subclass of `Relations` whose `test` returns a `WindowTest`, or a
subclass of `Observer`. Everything that `detect`, `study`, parts, the fleet, `Monitor`, the shell and reports
ask of it is declared here, with a default wherever one is sound. A test sees blocks of windows, never a
recording: gaps, batches, devices, threads and progress belong to the driver (`drive`).
"""

# mypy: allow-empty-bodies
# of members that are declared for whoever checks types, and have their values elsewhere

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Hashable, Mapping, Sequence
from functools import cached_property, partial
from os import PathLike
from types import MappingProxyType
from typing import (
    TYPE_CHECKING,
    Any,
    ClassVar,
    Generic,
    Literal,
    NamedTuple,
    Protocol,
    Self,
    TypeAlias,
    TypeVar,
)

import jax
import numpy as np
from jax.typing import DTypeLike
from numpy.typing import ArrayLike

from jaxbound.consistency.reading import Block, Reading
from jaxbound.exact.frames import ExactFrame
from jaxbound.exact.linalg import Matrix
from jaxbound.models.region import Departure
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.read import recorded
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.signals import SignalModel
from jaxbound.sets.floats.kernel import tried_in_numpy
from jaxbound.sets.floats.probe import where_proofs_hold
from jaxbound.sets.floats.status import Status
from jaxbound.sets.intervals.interval import Interval
from jaxbound.text.objects import readable
from jaxbound.text.progress import Progress

METHODS = ("joint", "box")
GONE = {
    "paving": '"joint" decides the same windows exactly; with uncertain parameters, budget= boxes a window',
    "linearized": '"joint" neglects nothing; it decides the same windows with a proof',
}
"""{method of the papers that is none any more: the way on}; notebooks show what they see."""
OBSERVER = "observer"
MONITOR = "monitor"
"""The method of several tests behind one verdict."""
CLOSE = 0.6
"""Margins of an observer below this power of the roundoff, 4e-10 in float64, may change their sign with the
last digits of what it carries.
"""
TOGETHER = 32
"""Recordings that NumPy follows side by side in about the time of one."""
MARGINS = AUTO, BOUNDS, EXACT = "auto", "bounds", "exact"
"""What margins of windows may be, see `detect`; those of a Result are one of the last two."""
MANY = 2**17
"""Windows from which on easy ones pay for compiling what settles them."""

Array: TypeAlias = np.ndarray | jax.Array
Bounds: TypeAlias = Mapping[str, Array]
"""{"noise": (p,), ..}: the half-widths, or lowest and highest values, that verdicts rest on."""
Budget: TypeAlias = int | None
"""Effort for each window, a number of boxes; None: the default."""
Starts: TypeAlias = ArrayLike
"""Numbers of the samples that do not follow the one before."""
Arrays: TypeAlias = Sequence[Array]
Outputs: TypeAlias = Sequence[tuple[DTypeLike, float]]
"""((dtype, value where there is no window), ...), one for each array over samples."""
Outs: TypeAlias = Sequence[np.ndarray]
"""Arrays of `Outputs` over all samples."""
Columns: TypeAlias = Mapping[str, np.ndarray]
"""{name: (..., T) numbers} beside status and margin."""
Cases: TypeAlias = Sequence[tuple["WindowTest", np.ndarray]]
"""Tests, each with the starts of the windows that it judges."""
Result = TypeVar("Result", covariant=True)


class Run(Protocol):
    """Runs a jitted kernel(constants, *block) on all blocks, one a device, and returns a result for each."""

    def __call__(self, kernel: Callable[..., Result], blocks: Sequence[Arrays]) -> list[Result]:
        """Run a kernel."""


class WindowReading(Protocol):
    """Numbers by which kernels read a window, a PyTree of arrays."""

    @property
    def horizon(self) -> int:
        """A window has horizon + 1 samples."""

    @property
    def lags(self) -> int:
        """How many samples of u a window has."""


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
    None; departure: from the region of training, None: it is not known, or not asked for. by: of a monitor
    the numbers of the tests that speak, -1 where none does: of those that prove a FAULT, else of all, that of
    the least margin; names of all its tests, where they are asked for; statuses, test_margins: (T, tests) of
    each of them; else None. columns: {name: (..., T) numbers} that a test hands over beside; nobody on the
    way to a Result, a file or a page asks what they are.
    """

    status: np.ndarray
    margin: np.ndarray
    words: np.ndarray | None = None
    departure: Departure | None = None
    by: np.ndarray | None = None
    names: tuple[str, ...] = ()
    statuses: np.ndarray | None = None
    test_margins: np.ndarray | None = None
    columns: Columns = {}  # no proxy: verdicts are a PyTree

    @property
    def outside(self) -> np.ndarray:
        """(..., T): as of a Result, 0 inside the region of training; NaN where it is not known."""
        if self.departure is None:
            return np.full(np.shape(self.margin), np.nan)
        return self.departure.share


class Watch(NamedTuple):
    """One test of a monitor.

    Fields: name; relations: or an observer; when: its condition, `OTHERWISE`, or None: it always watches.
    about: how far it looks back and how wide its bounds are, in words.
    """

    name: str
    relations: Relations
    when: str | None = None
    about: str = "a test"


class Relations:
    """One family of relations between the samples of a window, or an observer in their place.

    A subclass states `model`, `horizon` and `test`; the other members have defaults.
    """

    remembers: ClassVar[bool] = False
    """Whether verdicts rest on all samples before, as those of an observer."""
    uncertain: ClassVar[bool] = False
    """Whether coefficients are polynomials in uncertain parameters, which a test may leave undecided."""
    untuned: ClassVar[str | None] = ""
    """Why `tune` takes no such relations, behind their name; None: it takes them."""

    @property
    def observes(self) -> bool:
        """Whether UNDECIDED is what healthy samples are: of an observer, and of a monitor with one."""
        if self.parts:
            return any(test.observes for test in self.parts.values())
        return self.remembers

    # Read-only for whoever asks. At run time they are plain defaults, since a property here would be in the
    # way of the field of a frozen dataclass, which needs `= field()` in place of such a default.
    if TYPE_CHECKING:

        @property
        def model(self) -> SignalModel:
            """The names of the signals, and the plant where there is one."""

        @property
        def horizon(self) -> int:
            """A window has horizon + 1 samples; of an observer, the samples before its first verdict."""

        @property
        def bounds(self) -> Bounds:
            """{name: numbers} that verdicts rest on; empty: nothing can be tuned."""

        @property
        def made(self) -> tuple[object, ...] | None:
            """How relations came from the model, beside horizon and bounds; None: no two can be told apart.

            Kept verdicts are found again by it. Without it none are kept.
            """

        @property
        def methods(self) -> tuple[str, ...]:
            """The methods of `test`, the usual one first."""

        @property
        def count(self) -> int:
            """The number of relations."""

        @property
        def lags(self) -> tuple[int, ...] | None:
            """The samples before its last at which a window looks; None: all of them."""

        @property
        def tested(self) -> str:
            """How combinations of relations are tested, in words; "": there are none."""

        @property
        def notes(self) -> tuple[str, ...]:
            """Sentences for whoever reads a report."""

        @property
        def searched(self) -> bool:
            """Whether a search decides the windows, which takes long enough for a thread of its own."""

        @property
        def restart(self) -> bool:
            """Whether an observer begins anew behind a FAULT; else FAULT stays until a gap."""

        @property
        def informed(self) -> bool:
            """Whether an observer knows more of the first sample of a recording than of one behind a gap."""

        @property
        def parts(self) -> Mapping[str, Relations]:
            """The tests of a monitor by their names; empty: this is one test."""

    else:
        bounds: Bounds = MappingProxyType({})
        made = lags = None
        parts: Mapping[str, Relations] = MappingProxyType({})
        methods = METHODS[:1]
        count = 1
        tested, notes = "", ()
        searched = informed = False
        restart = True

    @cached_property
    def watches(self) -> tuple[Watch, ...]:
        """The tests of a monitor; of others this test alone."""
        return (Watch("", self),)

    @property
    def linear(self) -> LinearRelations | None:
        """These relations where their coefficients are exact numbers, else None."""
        return None

    @property
    def observer(self) -> Observer[Any] | None:
        """This observer; None: these are windows."""
        return None

    @property
    def reach(self) -> int:
        """How many samples before its last the longest window has."""
        return self.horizon

    @property
    def looks_back(self) -> int | None:
        """How many samples before a sample its verdict depends on; None: on all."""
        return None if self.remembers else self.reach

    @property
    def latched(self) -> bool:
        """Whether a FAULT stays until a gap, as that of an observer that does not begin anew."""
        return self.remembers and not self.restart

    @property
    def span(self) -> dict[str, Any]:
        """How a model, `parity_relations` and `detectable` are asked for these windows: {"horizon": s}, or
        {"lags": lags}.
        """
        if self.lags is None:
            return {"horizon": self.horizon}
        return {"lags": self.lags}

    def of(self, model: LinearSystem) -> Self:
        """Return the same relations of a model with other numbers; by default themselves."""
        return self

    def named_like(self, model: LinearSystem) -> Self:
        """Return the same relations where their signals have names, else with those of a plant."""
        return self

    def recording(self, u: object, y: object = None, starts: Starts = ()) -> tuple[Self, Recording]:
        """Return (relations, Recording) of the samples that a user gives: see `Recording.of`.

        The relations are these. Where signals had no names, they are the same with the names of the samples.
        """
        return self, recorded(self.model, u, y, starts)

    def test(self, method: str, dtype: DTypeLike, budget: Budget = None) -> WindowTest | Observer[Any]:
        """Return the test by which a method decides windows of samples in a float dtype; see `detect`.

        Raises:
            ValueError: a method or budget that these relations cannot be tested by; see `refuse_options`.
        """
        raise NotImplementedError(f"{type(self).__name__} needs a method test(method, dtype, ..)")

    def reading(self, dtype: DTypeLike, method: str = "joint") -> WindowReading:
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

    def external(self, u: object, y: object = None, starts: Starts = ()) -> jax.Array:
        """Return the residuals (..., T, count), NaN where a window is incomplete; not rounded, for pictures.

        Raises:
            NotImplementedError: a family without residuals.
        """
        raise NotImplementedError(f"{type(self).__name__} has no residuals to show")

    def internal(self, u: object, y: object = None, starts: Starts = ()) -> Interval:
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

        @property
        def W(self) -> Matrix:
            """(count, (s+1)p + gs): the relations, independent of each other."""

        @property
        def K(self) -> Matrix:
            """(count, l): the inputs in the relations."""

        @property
        def circuits(self) -> Matrix:
            """Combinations of relations with the fewest samples, all of them; none: too many."""

        @property
        def circuits_known(self) -> Matrix:
            """The inputs in the circuits."""

        @property
        def frame(self) -> ExactFrame | None:
            """The numbers that the exchange search needs where circuits are too many, else None."""

    @property
    def linear(self) -> Self:
        """These relations."""
        return self

    @property
    def tested(self) -> str:
        """How many combinations of relations a window is tested by, in words."""
        if self.frame is None:
            return f"{len(self.circuits)} combinations tested"
        return "combinations too many to list, the worst is searched for"

    def strips(self, method: str) -> tuple[Matrix, Matrix]:
        """Return rows over (Y, w) and over U: of each relation ("box"), else of all circuits."""
        if method == "box":
            return self.W, self.K
        return self.circuits, self.circuits_known

    def reading(self, dtype: DTypeLike, method: str = "joint") -> Reading:
        """Return the Reading of all circuits ("joint") or of each relation alone ("box") in a float dtype."""
        raise NotImplementedError


def relations_of(
    given: object,
    verb: str,
    example: str,
    monitors: bool = True,
    watched: Callable[[Any], Relations] | None = None,
) -> Relations:
    """Return the relations, or the observer, that a user gives to a verb.

    Args:
        verb, example: name of the verb and how it is called, for the sentence that refuses anything else.
        monitors: whether the verb takes several tests. watched: what makes them of a plant, or of the path of
            its file; None: the verb takes none.

    Raises:
        TypeError: given is neither, or a monitor where one test is needed. What `watched` raises.
    """
    if isinstance(given, Relations):
        if given.parts and not monitors:
            # what is differentiated or narrowed has one horizon and one set of bounds
            one = example.replace("parity_relations(model)", f"monitor.parts[{next(iter(given.parts))!r}]")
            raise TypeError(f"{verb} takes one test, not a monitor of several: {one}")
        return given
    is_plant = hasattr(given, "A") or isinstance(given, str | PathLike)
    if is_plant and watched is not None:
        return watched(given)
    if is_plant and monitors:
        example = example.replace("parity_relations(model)", "jaxbound.monitor(model)")
    raise TypeError(f"{verb} needs relations, not {type(given).__name__}: {example}")


class WindowTest:
    """One way to decide windows of `horizon` + 1 samples.

    Args:
        relations: what is tested. method: as of `detect`. dtype: of the samples.

    A subclass states what its kernels take beside samples (`constants`) and how many windows they take at
    once (`block`), and judges blocks of them (`judge`). It may settle the windows that it leaves open by
    another way (`settle`). `block` must depend on shapes alone: else verdicts would depend on how a recording
    is cut.
    """

    gathered: ClassVar[bool] = True
    """Whether blocks are windows u (lags, m, N), y (s + 1, p, N); else stretches u (N + s, m), y (N + s,
    p)."""
    padded: ClassVar[bool] = True
    """Whether blocks are filled up to their size; else the last one is shorter."""
    sharded: ClassVar[bool] = True
    """Whether `judge` runs its kernels by `run`; else it is called on one device after the other."""
    threads: ClassVar[bool] = False
    """Whether several blocks are judged at once: where the host waits between two kernels."""
    remembers: ClassVar[Literal[False]] = False
    """An observer in its place does."""
    by_kernels: ClassVar[bool] = False
    """Whether `judge` computes by `kernel`s alone: few windows may then be evaluated in NumPy, seen once."""
    on_host: ClassVar[bool] = False
    """Whether `judge` is NumPy alone: nothing is compiled, and no probe asked for."""
    weight: int = 1
    """How many windows of a small test NumPy evaluates in the time of one of this."""
    by_strips: ClassVar[bool] = False
    """Whether margins are those of strips, down which an adversary of a study goes."""
    confirms: bool = False
    """Whether NumPy alone says FAULT, itself or by the hints of `judge`: nobody asks again."""
    short: int = 64
    """How many windows are judged at once where there are few."""
    easy_first: bool = True
    """Whether easy windows are settled before the search; else they are asked of what it leaves open."""
    columns: ClassVar[Mapping[str, tuple[DTypeLike, float]]] = MappingProxyType({})
    """{name: (dtype, value where there is no window)} of numbers that `judge` hands over behind the verdicts;
    so do those who settle windows in its place."""

    def __init__(self, relations: Relations, method: str, dtype: DTypeLike) -> None:
        self.relations, self.method, self.dtype = relations, method, np.dtype(dtype)
        self.horizon = relations.horizon
        self.placed: dict[tuple[jax.Device, ...], object] = {}  # `constants` on devices, as `drive` puts them
        self.outside: dict[str, object] = {}  # by `margins_are`, the test of windows outside of training

    @cached_property
    def kind(self) -> Hashable:
        """All by which its programs differ from those of other tests: one compilation serves a kind."""
        numbers = self.constants
        if numbers is None:
            numbers = self.reading
        shapes = tuple(np.shape(x) for x in jax.tree.leaves(numbers))
        return type(self), self.horizon, self.block, str(self.dtype), shapes

    @property
    def constants(self) -> object:
        """A PyTree of arrays that kernels take first; by default `reading`."""
        return self.reading

    @cached_property
    def reading(self) -> WindowReading:
        """The numbers by which kernels read a window: `relations.reading`."""
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
    def easy(self) -> Easy | None:
        """The tests that can settle easy windows before this one is asked, or behind it (`easy_first`) those
        that it leaves open; None: none.
        """
        return None

    @property
    def margins_are(self) -> str:
        """One of `MARGINS`: "exact", or "bounds" where easy windows are settled before their margins are
        known. Margins of CONSISTENT windows are then not above the exact ones, those of FAULT not below.
        """
        if not self.easy_first or self.easy is None:
            return EXACT
        return BOUNDS

    def measured(self) -> Self:
        """Return the same test with exact margins."""
        return self

    def under(self, relations: Relations) -> WindowTest:
        """Return the same test of the same relations under other bounds."""
        test = relations.test(self.method, self.dtype)
        assert not test.remembers, "they are relations of windows"
        return test

    @property
    def outputs(self) -> Outputs:
        """The arrays over samples that `judge` fills: by default status, margin and `columns`."""
        return (np.dtype(np.int8), Status.MISSING), (self.dtype, np.nan), *self.columns.values()

    def cases(self, u: np.ndarray, y: np.ndarray, starts: np.ndarray) -> Cases:
        """Return [(test, starts)]: the tests that judge windows, and the samples with which these start.

        Windows that are in no case stay MISSING.
        """
        return [(self, starts)] if len(starts) else []

    def judge(self, run: Run, blocks: Sequence[Block]) -> Sequence[Arrays]:
        """Judge blocks of windows.

        Args:
            run: of (kernel, blocks), runs a jitted kernel(constants, *block) on all blocks, one a device, and
                returns a result for each.
            blocks: [(u, y)].

        Returns:
            For each block the arrays of `outputs`, the windows on their last axis. One more array of bool
            may say which windows are left open; hints may follow, by which `refuted` proves each FAULT.
        """
        raise NotImplementedError

    def settle(self, u: np.ndarray, y: np.ndarray, outs: Outs, left: np.ndarray, progress: Progress) -> None:
        """Decide windows that were left open, in place.

        Args:
            u, y: all samples, end to end. outs: arrays of `outputs` over them. left: starts of the windows
                left open.
            progress: takes the share done.
        """

    def contradicted(self, u: np.ndarray, y: np.ndarray, starts: np.ndarray) -> np.ndarray | None:
        """Return (N,) bool: which windows contradict their bounds, from all samples u (T, m), y (T, p) and
        without XLA. None: there is no shorter way than the test's own kernels, evaluated in NumPy.
        """
        return None

    def refuted(self, u: np.ndarray, y: np.ndarray, *hints: np.ndarray) -> np.ndarray:
        """Return (N,) bool: which windows u (lags, m, N), y (s + 1, p, N), called FAULT, the hints of `judge`
        refute in NumPy, whatever they are.
        """
        raise NotImplementedError(f"{type(self).__name__} hands over no hints")

    def exactly(self, u: np.ndarray, y: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """Return (N,) margins in whole numbers, < 0 where FAULT is proved: of windows that `refuted` left
        open, and all that came after it.
        """
        return np.zeros(len(starts), self.dtype)

    def withdrawn(
        self, judged: Judged, at: np.ndarray, contradicted: np.ndarray, u: np.ndarray, y: np.ndarray
    ) -> tuple[Judged, np.ndarray]:
        """Put UNDECIDED in place of FAULT where nothing contradicts; return (the verdicts, at which of `at`).

        Args:
            at: ends of the windows that are FAULT. contradicted: of them, from `contradicted`. u, y: all
                samples.
        """
        gone = at[~contradicted]
        judged.status.reshape(-1)[gone] = Status.UNDECIDED
        judged.margin.reshape(-1)[gone] = 0
        return judged, ~contradicted

    def unproved(self, judged: Judged) -> Judged:
        """Return the verdicts with UNDECIDED in place of CONSISTENT, which a device says that nobody has
        examined.
        """
        consistent = judged.status == Status.CONSISTENT
        return judged._replace(status=np.where(consistent, np.int8(Status.UNDECIDED), judged.status))

    def judged(self, outs: Sequence[np.ndarray]) -> Judged:
        """Return the verdicts from the arrays of `outputs`, each (..., T).

        Tested alone, relations that all hold need not hold together: by "box" no window is CONSISTENT unless
        there is a single relation.
        """
        status, margin, *numbers = outs
        if self.method == "box" and self.relations.count > 1:
            status = np.where(status == Status.CONSISTENT, np.int8(Status.UNDECIDED), status)
        return Judged(status, margin, columns=dict(zip(self.columns, numbers, strict=True)))

    def margins(self, given: Recording) -> jax.Array:
        """Return the unproved margins (..., T) of a recording: differentiable, under jit, vmap and grad.

        NaN where there are no data, and at samples at which no window ends.
        """
        raise NotImplementedError(
            f"margins has no fast path for these relations and {self.method!r}: detect(...).margin has them"
        )


class LinearTest(WindowTest):
    """One way to decide windows of linear relations."""

    relations: LinearRelations

    @cached_property
    def reading(self) -> Reading:
        """The numbers by which kernels read a window: `relations.reading`."""
        return self.relations.reading(self.dtype, self.method)


class SignedTest(LinearTest):
    """One way to decide windows of linear relations by margins whose signs are the verdicts."""

    @property
    def outputs(self) -> Outputs:
        """The margins, NaN where a window has no data, 0 where nothing is proved; and `columns`."""
        return (self.dtype, np.nan), *self.columns.values()

    def judged(self, outs: Sequence[np.ndarray]) -> Judged:
        """Return the verdicts: the signs of the margins, MISSING where these are NaN."""
        margin, *numbers = outs
        consistent, undecided, fault = map(np.int8, (Status.CONSISTENT, Status.UNDECIDED, Status.FAULT))
        status = consistent * (margin > 0) + undecided * (margin == 0) + fault * (margin < 0)
        return super().judged((status, margin, *numbers))


def window_count(shape: tuple[int, ...], horizon: int) -> int:
    """Return how many windows recordings of (..., T) samples have, those across gaps among them."""
    *lead, length = shape
    return math.prod(lead) * max(length - horizon, 0)


def margins_for(margins: str, windows: int) -> str:
    """Return the margins that are meant, "bounds" or "exact": by "auto", of so many windows.

    Raises:
        ValueError: they are none of `MARGINS`.
    """
    if margins not in MARGINS:
        raise ValueError(f"margins must be one of {', '.join(MARGINS)}, not {margins!r}")
    if margins != AUTO:
        return margins
    if windows < MANY:
        return EXACT
    return BOUNDS


def with_margins(test: WindowTest | Observer[Any], margins: str, windows: int) -> WindowTest | Observer[Any]:
    """Return a test of so many windows whose margins are those that are meant, see `margins_for`."""
    if margins_for(margins, windows) == EXACT:
        return test.measured()
    return test


class Easy(NamedTuple):
    """Two tests that settle easy windows: of contiguous samples, None where that does not pay, and of windows
    that are gathered.
    """

    stretches: WindowTest | None
    windows: WindowTest


def refuse_options(method: str, budget: object, adaptive: bool = False) -> None:
    """Raise ValueError for a method or budget that relations cannot be tested by.

    Args:
        adaptive: whether they are decided by boxes, of which there may be more.
    """
    if method in GONE:
        raise ValueError(f"method {method!r} is gone: {GONE[method]}")
    if method not in METHODS:
        raise ValueError(f"method must be one of {', '.join(METHODS)}, not {method!r}")
    if budget is not None and not adaptive:
        raise ValueError(
            f"budget belongs to residuals and uncertain parameters; here {method!r} always finishes"
        )


Carry = TypeVar("Carry")
"""What an observer carries from sample to sample: a PyTree of NumPy arrays and numbers."""
Said = TypeVar("Said", bound=Verdicts)


class Observer(Relations, Generic[Carry]):
    """A state that is carried from sample to sample of a recording, where a WindowTest has a window.

    A subclass states `model`, `init` and `fold`; a gap ends what is carried. Every verb takes it where it
    takes relations: it is its own test.

    Fields beside those of Relations:
        signals: the model whose names the samples are read by; by default `model`.
        batched: whether `fold` takes recordings side by side, (..., T, .), by one carry; else recordings of a
            batch are followed one by one.
        weight: how many windows of a small test NumPy evaluates in the time of one sample; infinite where
            samples are compiled at once.
        begun: the carry that it begins with in place of `init`; None: none. See `continued`.
    """

    remembers: ClassVar[Literal[True]] = True
    batched: ClassVar[bool] = False
    weight: float = math.inf
    method: ClassVar[str] = OBSERVER
    begun: Carry | None = None

    if not TYPE_CHECKING:
        horizon = 0

    @property
    def observer(self) -> Self:
        """This observer."""
        return self

    @property
    def methods(self) -> tuple[str, ...]:
        """The one method of an observer."""
        return (self.method,)

    @property
    def span(self) -> dict[str, Any]:
        """No window."""
        return {"horizon": None, "lags": None}

    @cached_property
    def signals(self) -> SignalModel:
        """The model whose names the samples are read by."""
        return self.model

    @property
    def relations(self) -> Self:
        """This observer: a Result asks it for relations."""
        return self

    @property
    def margins_are(self) -> str:
        """One of `MARGINS`: those of an observer are exact."""
        return EXACT

    def measured(self) -> Self:
        """Return this observer, as of a `WindowTest`."""
        return self

    def typed(self, dtype: DTypeLike) -> Self:
        """Return the same observer for samples in a float dtype; most take every one as they are."""
        return self

    def init(self) -> Carry:
        """Return the carry before the first sample."""
        raise NotImplementedError

    def fold(self, carry: Carry, piece: Recording) -> tuple[Carry, Verdicts]:
        """Take the next samples; return (carry, verdicts (T,) of these samples)."""
        raise NotImplementedError

    def followed(self, carry: Carry, piece: Recording) -> tuple[Carry, Verdicts]:
        """Return the verdicts of `fold`, followed on the CPU where the device may only search: one wrong set
        would spoil all that come after it.
        """
        return self.either_way(partial(self.fold, carry, piece), piece)

    def either_way(self, fold: Callable[[], tuple[Carry, Said]], piece: Recording) -> tuple[Carry, Said]:
        """Return the carry and verdicts that `fold` returns: of few samples from NumPy, see `sparing`, unless
        one is so near to its bounds that compiled code may say otherwise.
        """
        *lead, samples, p = np.shape(piece.y)
        work = -(-math.prod(lead) // TOGETHER) * samples * self.weight

        def clear(said: tuple[Carry, Said]) -> bool:
            margin = said[1].margin
            return not (np.abs(margin) < np.finfo(margin.dtype).eps ** CLOSE).any()

        tried = tried_in_numpy(fold, work, (type(self), self.weight, p), clear)
        if tried is not None:
            return tried
        with where_proofs_hold():
            return fold()

    def begin(self) -> Carry:
        """Return the carry that the first sample meets: `begun`, or that of `init`."""
        return self.init() if self.begun is None else self.begun

    def continued(self, carry: Carry) -> Self:
        """Return the same observer, which begins with a carry that `fold` returned."""
        watch = copy.copy(self)
        watch.begun = carry
        return watch

    def recording(self, u: object, y: object = None, starts: Starts = ()) -> tuple[Self, Recording]:
        """Return (this observer, the Recording of its signals)."""
        return self, recorded(self.signals, u, y, starts).finite()

    def test(
        self,
        method: str = METHODS[0],
        dtype: DTypeLike | None = None,
        budget: Budget = None,
    ) -> Self:
        """Return this observer, which knows one method.

        Raises:
            ValueError: another method than its own (or "joint", the default of every verb), or a budget.
        """
        known = method in (METHODS[0], self.method)
        if not known or budget is not None:
            raise ValueError(
                "an observer or a monitor takes neither method nor budget: they belong to windows"
            )
        return self

    def margins(self, given: Recording) -> jax.Array:
        """Raise NotImplementedError: an observer has no derivative."""
        raise NotImplementedError(
            "margins are those of windows: detect(observer, ..).margin has what an observer says"
        )


Build: TypeAlias = Callable[[Any, int | None], Relations]
"""build(model, horizon or None) makes relations or an observer; it says itself which models it takes."""
FAMILIES: dict[str, Build] = {}
"""{method: how relations, or an observer, are built}, beside those of jaxbound."""


def family(method: str) -> Callable[[Build], Build]:
    """Register a family of relations for the shell: `jaxbound detect --method METHOD` tests by it.

    Args:
        method: the name. The decorated function takes (model, horizon or None) and returns relations or an
            observer.

    Raises:
        ValueError: a name that is taken.
    """
    if method in (*METHODS, OBSERVER, MONITOR, *FAMILIES):
        raise ValueError(f"the method {method!r} is there already: give another name")

    def register(build: Build) -> Build:
        FAMILIES[method] = build
        return build

    return register


class Open(WindowTest):
    """Says nothing of windows: they are UNDECIDED, with one margin for all."""

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

    def judge(self, run: Run, blocks: Sequence[Block]) -> Sequence[Arrays]:
        """Return UNDECIDED for all windows."""
        judged = []
        for _, y in blocks:
            status = np.full(y.shape[-1], Status.UNDECIDED, np.int8)
            judged.append((status, np.full(len(status), self.margin, self.dtype)))
        return judged
