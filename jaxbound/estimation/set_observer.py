"""Set observers: at every sample an enclosure of the state from everything since the start, and a proof when
nothing is left of it.

A window forgets what came before it; an observer does not. The set of states that all samples so far allow is
carried on as a zonotope (`zonotope_steps`): moved by the model, met with what each sample says. Where it is
proved empty, no behaviour within the bounds explains the samples since it began: a FAULT.

An observer is a value. What it carries goes in and comes out of `fold`; an observer that goes on, or that
encloses states as well, is another value (`dataclasses.replace`) that shares the numbers of its plant.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, Generic, NamedTuple, Self

import jax
import numpy as np
from jax.typing import DTypeLike

from jaxbound.certificates.interface import WindowCertificate, window_certificate
from jaxbound.consistency.interface import Array, Budget, Judged, Observer
from jaxbound.consistency.twice import warn_doubtful
from jaxbound.estimation import zonotope_steps as steps
from jaxbound.estimation.blocks import chosen, in_blocks, recordings_of
from jaxbound.estimation.lanes import emptied, joined
from jaxbound.estimation.observation import Observation, State
from jaxbound.estimation.observed_plant import ObservedModel, ObservedPlant, observed_plant
from jaxbound.estimation.piece import Piece
from jaxbound.estimation.short_proof import ObservedResult, short_proof
from jaxbound.estimation.zonotope_numbers import ROUNDED, FirstSet
from jaxbound.models.sensor import input_slip
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.signals import SignalModel, signals_of
from jaxbound.relations.bounds import Bounds, model_bounds
from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.kernel import is_outside_xla, outside_xla, sparing
from jaxbound.sets.floats.probe import refuse_unverified
from jaxbound.sets.floats.status import Status
from jaxbound.sets.intervals.interval import Interval
from jaxbound.text.objects import readable

BLOCK = 32
"""Sets side by side in the one kernel there is: they should stay in the cache. It is filled up, since kernels
of other shapes round otherwise: what is said of a recording would depend on what stands beside it."""
EVEN = 8
"""Recordings in a block are a multiple of it: vectors have no rest, so that a recording's place in it does
not matter.
"""
BESIDE = 128
"""Recordings, or stretches of them, side by side where many are evaluated in NumPy."""
LENGTHS = (4, 16, 64, 256, 1024, 4096)
"""Samples before a FAULT that are followed once more."""
AGAIN = 2**17
"""Samples, of stretches side by side, that are held for it."""
PIECE = 16
"""Samples that the kernel is compiled for."""


@readable
class ObserverState(NamedTuple):
    """The sets that an observer carries on, and its place in time.

    Fields: carry: of the kernels, recordings on the last axis; samples: how many there were.
    """

    carry: steps.ZonotopeCarry
    samples: np.int64


@readable
@dataclass(frozen=True, eq=False, kw_only=True)
class SetObserver(Observer[State], Generic[State]):
    """Carries the set of states that all samples since the start allow. Build it with `observer`.

    Fields: plant: the model with all that follows from it; order; weights; restart; x0: the set of the first
    state, or None; enclosures: whether `fold` returns an Observation, else verdicts alone; begun: the state
    that it begins with where it goes on, or None.
    """

    batched: ClassVar[bool] = True
    untuned: ClassVar[str | None] = None
    hulls: ClassVar[bool] = False  # whether it needs the enclosures of states itself

    plant: ObservedPlant = field(repr=False)
    order: float
    weights: np.ndarray
    restart: bool
    x0: FirstSet | None = field(default=None, repr=False)
    enclosures: bool = False
    begun: State | None = field(default=None, repr=False)

    @property
    def model(self) -> ObservedModel:
        """The model that is observed."""
        return self.plant.model

    @property
    def signals(self) -> SignalModel:
        """The model, or Signals with the names of an `interval_system`."""
        return signals_of(self.model)

    @property
    def informed(self) -> bool:
        """Whether it knows the first state of a recording."""
        return self.x0 is not None

    @property
    def horizon(self) -> int:
        """How many samples at the start have no verdict."""
        if self.x0 is not None:
            return 0
        return self.plant.past

    @property
    def first_box(self) -> np.ndarray | None:
        """(n, 2) lowest and highest of each first state that x0 allows, rounded outward; None without x0."""
        if self.x0 is None:
            return None
        center, generators, box = (np.asarray(x, np.float64) for x in self.x0[:3])
        # outward: a certificate takes these ends as bounds of the first state
        reach = (np.abs(generators).sum(1) + box) * ROUNDED
        return np.stack([np.nextafter(center - reach, -np.inf), np.nextafter(center + reach, np.inf)], 1)

    @property
    def bounds(self) -> Bounds:
        """Those of the model, as of relations; of an `interval_system` {"tolerance", "noise"} (p,)."""
        if isinstance(self.model, LinearSystem):
            return model_bounds(self.model)
        return {"tolerance": self.plant.system.tolerance, "noise": self.plant.system.noise}

    @property
    def made(self) -> tuple[object, ...]:
        """The choices that verdicts depend on beside the model: they name verdicts that are kept."""
        first = None if self.x0 is None else tuple(self.x0)
        return "observer", self.order, self.weights, self.restart, first, self.horizon

    @property
    def weight(self) -> int:  # type: ignore[override]
        """How many windows of a small test NumPy evaluates in the time of one sample."""
        return 3 + self.plant.system.n * self.plant.system.p // 3

    def _rows(self) -> dict[str, str]:
        """Return the lines that `readable` shows."""
        weights = " ".join(f"{weight:g}" for weight in self.weights)
        return {
            "model": repr(self.model),
            "order": f"{self.order:g}",
            "weights": weights,
            "restart": str(self.restart),
            "horizon": str(self.horizon),
            "enclosures": str(self.enclosures),
        }

    def test(
        self,
        method: str = "joint",
        dtype: DTypeLike | None = None,
        budget: Budget = None,
    ) -> Self:
        """Return the observer that gives verdicts alone; an observer knows one method.

        Raises:
            ValueError: another method than "observer" (or "joint", the default), or a budget.
        """
        return super().test(method, dtype, budget).telling(enclosures=False)

    def telling(self, enclosures: bool) -> Self:
        """Return the same observer, whose `fold` returns an Observation, or verdicts alone."""
        return replace(self, enclosures=enclosures)

    def continued(self, carry: State) -> Self:
        """Return the same observer, which begins with a carry that `fold` returned."""
        return replace(self, begun=carry)

    def of(self, model: LinearSystem) -> Self:
        """Return the same observer of another model of as many states.

        Raises:
            ValueError: as `observer`.
        """
        horizon = None
        if self.plant.start is not None:
            horizon = self.plant.past
        return replace(self, plant=observed_plant(model, horizon, self.x0 is not None), begun=None)

    @cached_property
    def _first_state(self) -> ObserverState:
        """The state of zonotopes that have seen nothing."""
        n, sets = self.plant.system.n, len(self.weights)
        # the order is generators for each state
        sizes = n, int(self.order * n), self.plant.system.p, self.plant.system.m, self.plant.past
        carry = steps.unknown(sizes, self.weights.astype(self.plant.dtype))
        if self.x0 is not None:
            c, G, r = (np.repeat(x[..., None], sets, -1) for x in self.x0.padded(n)[:3])
            # kernels take as many generators as the order allows, whatever x0 has
            G = np.pad(G, [(0, 0), (0, sizes[1] - G.shape[1]), (0, 0)])
            carry = carry._replace(c=c, G=G, r=r, age=np.zeros_like(carry.age))
        return ObserverState(carry, np.int64(0))

    def fold(self, carry: State, piece: Recording) -> tuple[State, Observation | Judged]:
        """Take the next samples (..., T, .) of a recording, or of recordings side by side; return (carry,
        Observation or Judged).

        A FAULT that is not proved outside XLA is UNDECIDED, and a warning tells of it. Then the observer goes
        on knowing nothing: the set that XLA carried is not to be trusted.
        """
        lead, samples = self.side_by_side(carry, piece)
        state, found = self.found(carry, samples)
        fault = np.asarray(found.status) == Status.FAULT
        if fault.any() and not is_outside_xla():
            gone = self._doubtful(carry, samples, fault)
            if gone.any():
                warn_doubtful(
                    f"{gone.sum()} samples are FAULT by an observer in XLA, the first of them is sample "
                    f"{gone.any(1).argmax()} of its piece"
                )
                status = np.where(gone, np.int8(Status.UNDECIDED), found.status)
                margin = np.where(gone, 0, found.margin).astype(found.margin.dtype)
                found = found._replace(status=status, margin=margin)
                nothing: Any = replace(self, x0=None, begun=None).begin()  # a NamedTuple
                state = nothing._replace(samples=state.samples)
        return state, self._verdicts(found, lead, len(samples.fresh), carry)

    def _doubtful(self, carry: State, samples: Piece, fault: np.ndarray) -> np.ndarray:
        """Return (T, N) bool: which of the FAULTs (T, N) are not proved outside XLA, see `consistency.twice`.

        The last samples before a FAULT are followed once more, the kernels evaluated in NumPy: 4 of them,
        then 16, and so on up to 4096, as far back as it began, knowing nothing of the state before. A
        contradiction among them stands. What is left is followed from where the observer began: behind a gap,
        or behind a FAULT, again knowing nothing, so that no set of before a gap is believed twice. Only a
        FAULT that rests on samples of a piece before, which nobody keeps, begins with the set that was
        carried to there.
        """
        numbers, behind = np.arange(len(fault))[:, None], self._behind_faults(carry, fault) & ~samples.fresh
        anew, first = samples.fresh | behind, fault
        if not self.restart:  # of a FAULT that stays, the first
            anew, first = samples.fresh, fault & ~behind
        # of each sample the last one at which the observer began anew
        begins = np.maximum.accumulate(np.where(anew, numbers, 0))
        ends = np.argwhere(first)
        rounds = [(len(fault), 1)]
        if self.plant.start is not None:  # samples show the state
            rounds = [*((length, min(BESIDE, AGAIN // length)) for length in LENGTHS), *rounds]
        for length, beside in rounds:
            begin, gone = np.maximum(begins[tuple(ends.T)], ends[:, 0] - length + 1), np.ones(len(ends), bool)
            for part in range(0, len(ends), beside):
                some = slice(part, part + beside)
                gone[some] = ~self._again(carry, samples, begin[some], ends[some])
            ends = ends[gone]
        gone = np.zeros(fault.shape, bool)
        gone[tuple(ends.T)] = True
        # a FAULT that stays goes as a whole
        whole = np.take_along_axis(gone, np.maximum.accumulate(np.where(first, numbers, 0)), 0)
        return np.asarray(whole & fault)

    def _behind_faults(self, carry: State, fault: np.ndarray) -> np.ndarray:
        """Return (T, N): which samples follow a FAULT (T, N) of the recording; carry: before them."""
        before = np.asarray(carry.carry.empty).reshape(-1, len(self.weights)).any(1)
        return np.concatenate([np.broadcast_to(before, fault[:1].shape), fault[:-1]])

    def _again(self, carry: State, samples: Piece, begin: np.ndarray, ends: np.ndarray) -> np.ndarray:
        """Return (K,) bool: which FAULTs the samples from begin (K,) on show. ends (K, 2): their samples, and
        their recordings.
        """
        last, numbers = ends.T
        # shorter stretches repeat their last sample: all lie in one array
        rows = np.minimum(begin + np.arange((last - begin).max() + 1)[:, None], last)
        some = jax.tree.map(lambda x: np.moveaxis(np.moveaxis(x, -1, 1)[rows, numbers], 1, -1), samples)
        some.fresh[0] |= begin > 0  # what is carried to the first sample of all is the only set believed
        # a NamedTuple, whatever fields a method has
        own: Any = recordings_of(carry, self._count(carry), numbers)
        if len(begin) == 1:  # windows begin where they began
            own = own._replace(samples=carry.samples + begin[0])
        state: State = own
        with outside_xla():
            _, found = self.found(state, some)
        shown = np.asarray(found.status) == Status.FAULT
        return np.asarray((shown & (begin + np.arange(len(rows))[:, None] <= last)).any(0))

    def _count(self, carry: State) -> int:
        """Return how many recordings a carry follows."""
        return int(carry.carry.age.shape[-1]) // len(self.weights)

    def enclosed(self, recording: Recording) -> Observation | Judged:
        """Return the verdicts of `fold` on a recording, decided once: FAULTs are proved already."""

        def once() -> tuple[State, Observation | Judged]:
            carry = self.begin()
            lead, samples = self.side_by_side(carry, recording)
            after, found = self.found(carry, samples)
            return after, self._verdicts(found, lead, len(samples.fresh), carry)

        with sparing():
            return self.either_way(once, recording)[1]

    def found(self, carry: State, samples: Piece) -> tuple[State, steps.Found]:
        """Return (state, Found) of samples, decided once."""
        state: Any = carry  # a NamedTuple
        after, found = self._followed(carry.carry, samples)
        return state._replace(carry=after, samples=carry.samples + len(samples.fresh)), found

    def side_by_side(self, carry: State, piece: Recording) -> tuple[tuple[int, ...], Piece]:
        """Return (leading shape, samples) of a piece."""
        piece.finite()
        u, y = np.asarray(piece.u), np.asarray(piece.y)
        *lead, T, p = y.shape
        count = int(np.prod(lead))
        if self._count(carry) not in (1, count):
            raise ValueError(f"this observer follows {self._count(carry)} recordings, y holds {count}")

        def time_first(x: np.ndarray) -> np.ndarray:
            # recordings on the last axis: vector code runs along it
            return np.moveaxis(x.reshape(count, T, x.shape[-1]), 0, -1).astype(self.plant.dtype)

        fresh = np.zeros((T, count), bool)
        fresh[np.asarray(piece.starts, np.int64)] = True
        if piece.excluded is not None:
            fresh |= piece.excluded[:, None]
        # what a recorder rounded stays rounded, however exactly kernels compute
        unit = max(float(rounding.unit(y.dtype)), float(rounding.unit(self.plant.dtype)))
        slip = time_first(input_slip(u))
        return tuple(lead), self.plant.read(time_first(u), time_first(y), slip, fresh, unit)

    def _followed(
        self, carry: steps.ZonotopeCarry, samples: Piece
    ) -> tuple[steps.ZonotopeCarry, steps.Found]:
        """Return (carry, Found (T, .., N)) of zonotopes that follow samples, in blocks."""
        lanes, count = len(self.weights), samples.fresh.shape[-1]
        room = max(BLOCK // lanes // EVEN, 1) * EVEN
        if is_outside_xla() and count > room:
            room = max(room, BESIDE)  # NumPy rounds alike whatever is beside
        followed = carry.age.shape[-1] // lanes

        def job(block: np.ndarray) -> tuple[steps.ZonotopeCarry, steps.Found]:
            return self._block(recordings_of(carry, followed, block), chosen(samples, block))

        def together(*parts: Array) -> np.ndarray:
            return np.concatenate(parts, -1)[..., : count * lanes]

        after, found = jax.tree.map(together, *in_blocks(job, count, room))
        return after, joined(found, lanes)

    def _block(self, carry: steps.ZonotopeCarry, samples: Piece) -> tuple[steps.ZonotopeCarry, steps.Found]:
        """Follow some recordings side by side, piece by piece; the carry stays where it was worked out."""
        if not is_outside_xla():
            refuse_unverified()
        T = len(samples.fresh)
        numbers, start = self.plant.placed
        wanted = self.enclosures or self.hulls
        whole = samples.filled(-(-max(T, 1) // PIECE) * PIECE)
        parts: list[steps.Found] = []
        for first in range(0, max(T, 1), PIECE):
            carry, verdicts = steps.follow_lanes(
                numbers,
                start,
                carry,
                whole.cut(first, first + PIECE),
                min(PIECE, T - first),
                len(self.weights),
                wanted or not is_outside_xla(),
                self.restart,
            )
            if not wanted:  # what is left out is not fetched from its device
                nothing = np.zeros((PIECE, 0, *verdicts.margin.shape[1:]), verdicts.margin.dtype)
                verdicts = verdicts._replace(states=nothing, outputs=nothing)
            parts.append(verdicts)
        # fetched when all are under way: the host prepares one while another is worked out
        return carry, jax.tree.map(lambda *pieces: np.concatenate(pieces)[:T], *parts)

    def _verdicts(
        self, found: steps.Found, lead: tuple[int, ...], T: int, before: State
    ) -> Observation | Judged:
        """Return the Observation, or the verdicts, of arrays with time first and recordings last.

        Args:
            before: the state before these samples.
        """

        def shaped(x: Array) -> np.ndarray:
            x = np.moveaxis(np.asarray(x), -1, 0)
            return x.reshape(*lead, T, *x.shape[2:])

        status, margin, age = shaped(found.status), shaped(found.margin), shaped(found.age)
        if not self.enclosures:
            return Judged(status, margin)
        # sets count their samples; readers ask for the number of the first one
        since = np.where(age > 0, int(before.samples) + np.arange(T) - age + 1, -1)
        gone = np.zeros(found.status.shape, bool)
        if not self.restart:  # behind a FAULT that stays nothing is left
            fault = np.asarray(found.status) == Status.FAULT
            gone = fault & self._behind_faults(before, fault)
        found = emptied(found, gone)
        n, p = self.plant.system.n, self.plant.system.p
        state = _interval_of_ends(shaped(found.states), n)
        outputs = shaped(found.outputs)
        return Observation(
            status,
            margin,
            since,
            jax.tree.map(lambda end: end[..., : self.model.n], state),
            predicted=_interval_of_ends(outputs[..., : 2 * p], p),
            output=_interval_of_ends(outputs[..., 2 * p :], p),
        )


@readable
@dataclass(frozen=True, eq=False, kw_only=True)
class ZonotopeObserver(SetObserver[ObserverState]):
    """Carries zonotopes alone, one for each weight. Build it with `observer`.

    Fields: as of SetObserver.
    """

    def init(self) -> ObserverState:
        """Return the state of an observer that has seen nothing."""
        return self._first_state


def _interval_of_ends(ends: np.ndarray, width: int) -> Interval:
    """Return the Interval of ends -lo, hi, one behind the other."""
    return Interval(-ends[..., :width], ends[..., width:])


@window_certificate.register(SetObserver)
def _(
    observer: SetObserver[Any], result: ObservedResult, at: tuple[int, ...], status: Status
) -> WindowCertificate:
    return short_proof(observer.model, observer.first_box, result, at, status)
