"""Set observers: at every sample an enclosure of the state from everything since the start, and a proof when
nothing is left of it.

A window forgets what came before it; an observer does not. The set of states that all samples so far allow is
carried on as a zonotope (`zonotope_steps`): moved by the model, met with what each sample says. Where it is
proved empty, no behaviour within the bounds explains the samples since it began: a FAULT.
"""

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, NoReturn

import jax
import numpy as np
from numpy.typing import ArrayLike

from jaxbound.consistency.drive import drive
from jaxbound.consistency.interface import Judged, Observer
from jaxbound.estimation import zonotope_steps as steps
from jaxbound.estimation.blocks import in_blocks
from jaxbound.estimation.lanes import emptied, joined
from jaxbound.estimation.second_look import decided_twice
from jaxbound.estimation.zonotope_numbers import (
    ROUNDED,
    first_set,
    free_numbers,
    least_horizon,
    numbers,
    price,
    start,
)
from jaxbound.models.intervals import as_intervals
from jaxbound.models.sensor import input_slip
from jaxbound.models.unknown_directions import unknown_directions, with_direct_states
from jaxbound.recordings.recording import Recording, Signals
from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.kernel import is_outside_xla
from jaxbound.sets.floats.probe import refuse_unverified
from jaxbound.sets.intervals.interval import Interval
from jaxbound.sets.zonotopes.zonotope import Zonotope
from jaxbound.text.objects import readable

__all__ = ["Observation", "ObserverState", "SetObserver", "observe", "observer"]

BLOCK = 32
"""Sets side by side in the one kernel there is: they should stay in the cache. It is filled up, since kernels
of other shapes round
otherwise: what is said of a recording would depend on what stands beside it."""
EVEN = 8
"""Recordings in a block are a multiple of it: vectors have no rest, so that a recording's place in it does
not matter.
"""
WEIGHTS = (1.0, 30.0, 1000.0)
"""Sets side by side where nothing else is asked for: one for what is sudden, two for what lasts and what is
slow.
"""
BESIDE = 128
"""Recordings side by side where many are evaluated in NumPy."""
PIECE = 16
"""Samples that the kernel is compiled for."""


@readable
@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Observation:
    """What `observe` found, time first.

    Fields:
        status (..., T) int8, see `Status`: FAULT is a proof that no behaviour explains all samples from
            `since` to this one. CONSISTENT that one does: a trajectory, of method "joint" with x0 alone.
            UNDECIDED: neither is proved. MISSING: nothing to test against (the state is not known yet), or no
                sample.
        margin (..., T): 1 - t, t the factor on the set before this sample and on its own bounds at which the
            two would just touch, by the worst output: < 0 where FAULT. It is about this sample given those
            before, not comparable with the margin of a window. NaN where nothing was tested.
        since (..., T) int: the first sample that the enclosure rests on; -1: there is none.
        state Interval (..., T, n): holds the state of every behaviour that explains the samples from `since`
            on, this one included; entire where there is none. Of a FAULT: what the samples before it allowed.
            NaN, like the others, where nothing is left: behind a FAULT that stays (restart=False).
        predicted Interval (..., T, p): what a perfect sensor would show as far as the samples before this one
        tell. output: with it.
    """

    status: Any
    margin: Any
    since: Any
    state: Interval
    predicted: Interval
    output: Interval


@readable
class ObserverState(NamedTuple):
    """What a set observer carries on. Fields: carry: of the kernels, recordings on the last axis; samples:
    how many there were.
    """

    carry: steps.Carry
    samples: np.int64


def observer(
    model: Any,
    order: float | None = None,
    weight: float | Sequence[float] = WEIGHTS,
    restart: bool = True,
    x0: Interval | Zonotope | None = None,
    horizon: int | None = None,
    method: str = "zonotope",
    window: int = 32,
    constraints: int = 8,
) -> "SetObserver":
    """Return an observer of a model, for `observe`, `detect`, `Monitor` and the shell.

    Args:
        model: a LinearSystem (uncertain parameters, tolerance, noise, disturbance, unknown inputs) or an
            `interval_system`. Unknown inputs are taken out of each sample by as many outputs as show them,
            what is left is tested. States that they move unseen are entire ("joint" refuses these). A sample
            where too few outputs are there for it ends the enclosure. Bounds of averages are used by "joint"
            alone, of runs that lie in a window and without unknown inputs; the others look at single samples.
        order: generators of the zonotope for each state, >= 1: more is sharper and slower. With constraints,
            how many more there are than these. None: 20; 5 with constraints.
        weight: of the samples' bounds in the gain, > 0. 1 makes the set least, in the sum of squares of its
            generators; above 1 the observer believes a sample less and remembers longer, so that lasting and
            slow faults show. Several numbers: as many sets side by side, whose verdicts and intervals hold
            together; they cost as much more.
        restart: True: the sample after a contradiction begins anew, MISSING until the state is known again.
            False: a FAULT stays until a gap, since what contradicts once contradicts for good.
        x0: Interval (n,) or Zonotope that holds the state at the very first sample; it need not be narrow.
            None: it can be anything, and is found from the first horizon + 1 samples in a row that are whole.
        horizon: of these; None: the least that shows all states.
        method: "zonotope", fast. "strips": one set, least after every sample, whatever weight is. "joint":
            with the zonotopes, every window of up to `window` samples is tested exactly, its first state
            within what the samples before it allow: sees what lasts and what is slow almost as well as all
            samples together could, and costs .3 to 5 milliseconds a sample. With x0 it says CONSISTENT where
            it has a trajectory through all samples. "constrained": a constrained zonotope, which keeps the
            last equations of samples and what is left of older ones: nearly as sharp as "joint", in a half to
                a third of its time; one set, whatever weight is.
        window: samples, even; of "joint" alone. constraints: equations that are kept, >= 1; of "constrained"
            alone.

    Raises:
        ValueError: states that the outputs do not show and no x0, an x0 that is not bounded or does not fit,
            an order below 1, a weight that is not positive; unknown inputs that explain whatever the outputs
            show, or with parameters that act on C.
        TypeError: no model.

    Encloses: every state of every behaviour within the bounds that explains all samples since it began.

    Source: Alamo, Bravo, Camacho 2005; Combastel 2015; Girard 2005; see `zonotope_steps`. Unknown inputs:
    `models.unknown_directions`.

    Example:
        >>> import jaxbound as jb
        >>> m = jb.LinearSystem([[0.9]], [[1]], [[1]], noise=0.1, disturbance=([[1]], 0.01))
        >>> found = jb.detect(jb.observer(m), [[1.0]] * 4, [[0.0], [1.0], [1.9], [5.0]])
        >>> [jb.Status(s).name for s in found.status]
        ['MISSING', 'UNDECIDED', 'UNDECIDED', 'FAULT']
    """
    return _made(method, window, constraints, model, order, weight, restart, x0, horizon)


def observe(
    model: Any,
    u: Any,
    y: Any = None,
    order: float | None = None,
    weight: float | Sequence[float] = WEIGHTS,
    restart: bool = True,
    x0: Interval | Zonotope | None = None,
    horizon: int | None = None,
    starts: ArrayLike = (),
    method: str = "zonotope",
    window: int = 32,
    constraints: int = 8,
) -> Observation:
    """Enclose the state at every sample by what all samples since the start allow, and prove where nothing is
    left.

    Args:
        model, order, weight, restart, x0, horizon, method, window, constraints: as for `observer`.
        u: (..., T, m) or None.
        y: (..., T, p), tables as for `detect`; recordings on leading axes run side by side. A missing output
            says nothing; a missing input begins anew.
        starts: as for `detect`: the observer begins anew there.

    Returns:
        An Observation.

    Raises:
        ValueError: as `observer`, and shapes that do not fit. RuntimeError: where rounding has not been
            verified.

    Encloses: as `observer`.

    Example:
        >>> import jaxbound as jb
        >>> m = jb.LinearSystem([[0.9]], [[1]], [[1]], noise=0.1, disturbance=([[1]], 0.01))
        >>> jb.observe(m, [[1.0]] * 4, [[0.0], [1.0], [1.9], [5.0]]).predicted.hi[3].round(2)
        array([2.81])
    """
    watch = _made(method, window, constraints, model, order, weight, restart, x0, horizon, True)
    _, given = watch.recording(u, y, starts)
    return drive(watch, given)


METHODS: dict[str, type["SetObserver"]] = {}
"""What `method` may be beside "zonotope" and "strips": classes, each from a file of its own."""


def _made(method, window, constraints, model, order, weight, *given):
    """Return the observer of a method."""
    if method not in ("zonotope", "strips", *METHODS):
        raise ValueError(f"method must be one of zonotope, strips, {', '.join(METHODS)}, not {method!r}")
    kind, own = (
        METHODS.get(method, SetObserver),
        {"joint": {"window": window}, "constrained": {"constraints": constraints}},
    )
    order = kind.usual_order if order is None else order
    return kind(model, order, 1.0 if method == "strips" else weight, *given, **own.get(method, {}))


@readable
class SetObserver(Observer[ObserverState]):
    """Carries the set of states that all samples since the start allow. Build it with `observer`.

    Fields: model; order; weights; restart; horizon: samples without a verdict at the start, or None;
    enclosures: whether `fold` returns an Observation, else verdicts alone.
    """

    batched = True
    model: Any
    restart: bool
    horizon: int
    hulls = False  # whether it needs the enclosures of states, and what is read, itself
    _carried: Any = None  # what it begins with where it goes on
    usual_order = 20.0

    def __init__(
        self,
        model: Any,
        order: float,
        weight: Any,
        restart: bool,
        x0: Any,
        horizon: int | None,
        enclosures: bool = False,
    ) -> None:
        refuse_unverified()
        self.model, self.order, self.restart, self.enclosures = model, float(order), bool(restart), enclosures
        self._plant = with_direct_states(model) if getattr(model, "d", 0) else model
        self._system = system = as_intervals(self._plant, unknown_inputs=True)
        self._unknown = unknown_directions(self._plant) if getattr(model, "d", 0) else None
        self.signals = model if hasattr(model, "column") else Signals(system.inputs, system.outputs, {})
        if not order >= 1:
            raise ValueError(f"the order of an observer must be at least 1: it is {order!r}")
        self.weights = np.atleast_1d(np.asarray(weight, np.float64))
        if (
            self.weights.ndim > 1
            or not len(self.weights)
            or not ((self.weights > 0) & np.isfinite(self.weights)).all()
        ):
            raise ValueError(f"weight must be a positive number, or several: it is {weight!r}")
        self._x0 = None if x0 is None else first_set(x0, getattr(model, "n", 0), self.order, self._dtype)
        if horizon is not None and (
            isinstance(horizon, bool) or not isinstance(horizon, (int, np.integer)) or horizon < 0
        ):
            raise ValueError(f"horizon must be a whole number >= 0, not {horizon!r}")
        price(system.n, system.p, horizon)
        h = least_horizon(self._plant, system, self._unknown) if horizon is None else int(horizon)
        if (
            horizon is None and h is not None and h * system.p > system.n
        ):  # more than the least that was priced
            price(system.n, system.p, h)
        self._start = None if h is None else start(self._plant, system, h, self._dtype, self._unknown)
        if self._start is None and x0 is None:
            if h is None:
                raise ValueError(
                    "the outputs do not show all states, however long one looks: give x0, bounds of the "
                    "first state"
                )
            raise ValueError(
                f"{h + 1} samples do not show all states, or the parameters are too uncertain for it: give x0"
            )
        self._past = 0 if self._start is None or h is None else h
        self.horizon = 0 if x0 is not None else self._past

    @property
    def first_box(self) -> np.ndarray | None:
        """(n, 2) lowest and highest of each first state that x0 allows, rounded outward; None without x0."""
        if self._x0 is None:
            return None
        c, G, r = (np.asarray(x, np.float64) for x in self._x0)
        reach = (np.abs(G).sum(1) + r) * ROUNDED
        return np.stack([np.nextafter(c - reach, -np.inf), np.nextafter(c + reach, np.inf)], 1)

    @cached_property
    def bounds(self) -> dict:
        """{"tolerance", "noise"} (p,): of the sensors, as of relations."""
        return {"tolerance": self._system.tolerance, "noise": self._system.noise}

    @property
    def made(self) -> tuple:
        """What verdicts depend on beside the model: by it what is kept of them is known again."""
        return "observer", self.order, self.weights, self.restart, self._x0, self.horizon

    @property
    def relations(self) -> "SetObserver":
        """What a Result calls relations: this observer."""
        return self

    def recording(self, u: Any, y: Any = None, starts: ArrayLike = ()) -> tuple["SetObserver", Recording]:
        """Return (this observer, the Recording of its signals)."""
        return self, Recording.of(self.signals, u, y, starts).finite()

    def test(
        self, method: str = "joint", dtype: Any = None, budget: Any = None, compensation: ArrayLike = 0.0
    ) -> "SetObserver":
        """Return the observer that gives verdicts alone; an observer knows one method.

        Raises:
            ValueError: another method than "observer" (or "joint", the default), a budget or a compensation.
        """
        if (
            method not in ("joint", self.method)
            or budget is not None
            or np.any(np.asarray(compensation) != 0)
        ):
            raise ValueError(
                "an observer takes neither method nor budget nor compensation: they belong to windows"
            )
        return self.telling(enclosures=False)

    def telling(self, enclosures: bool) -> "SetObserver":
        """Return the same observer, whose `fold` returns an Observation, or verdicts alone."""
        watch = copy.copy(self)
        watch.enclosures = enclosures
        return watch

    def margins(self, given: Recording) -> NoReturn:
        """Raise NotImplementedError: an observer has no derivative."""
        raise NotImplementedError(
            "margins are those of windows: detect(observer, ..).margin has what an observer says"
        )

    @property
    def _dtype(self):
        return np.dtype(jax.dtypes.canonicalize_dtype(np.float64))

    @cached_property
    def _numbers(self):
        free = free_numbers(self._unknown, self._plant, self._system.n == self.model.n, self._dtype)
        return numbers(self._plant, self._system, self._dtype, free)

    @cached_property
    def _placed(self):
        """What kernels take of the model, where they run: it is not copied for each sample."""
        return jax.device_put((self._numbers, self._start))

    def __getstate__(self) -> dict[str, Any]:
        return {
            name: x for name, x in vars(self).items() if name != "_placed"
        }  # to another process, with other devices

    @cached_property
    def _generators(self):
        return int(self.order * self._system.n)

    def init(self) -> Any:
        """Return the state before the first sample."""
        return self._fresh() if self._carried is None else self._carried

    def _fresh(self):
        m = self._system
        carry = steps.unknown((m.n, self._generators, m.p, m.m, self._past), self.weights.astype(self._dtype))
        if self._x0 is not None:
            carry = _known(
                carry, *(np.pad(x, ((0, m.n - self.model.n), *[(0, 0)] * (x.ndim - 1))) for x in self._x0)
            )
        return ObserverState(carry, np.int64(0))

    @property
    def shown_after(self) -> float:
        """How many samples have passed when a sample alone can contradict those before; inf where samples do
        not show the state.
        """
        return np.inf if self._start is None else self._past

    def continued(self, carry: Any) -> "SetObserver":
        """Return the same observer, which begins with what was carried, as `fold` returns it."""
        watch = copy.copy(self)
        watch._carried = carry
        return watch

    def fold(self, carry: Any, piece: Recording) -> tuple[Any, Any]:
        """Take the next samples (..., T, .) of a recording, or of recordings side by side; return (carry,
        Observation or Judged).
        """
        return decided_twice(self, carry, piece)

    def judged(self, carry: Any, piece: Recording) -> tuple[Any, Any]:
        """Return what `fold` does, by XLA alone: its FAULTs are decided once."""
        lead, count, given = self._given(carry, piece)
        past, found, _ = self._followed(carry.carry, count, *given)
        T = len(found.status)
        return ObserverState(past, carry.samples + T), self._told(found, lead, T, carry)

    def _given(self, carry, piece):
        """Return (leading shape, how many recordings, (u, y, slip of u, all (T, ., N), fresh (T, N), unit
        roundoff of y)) of a piece.
        """
        piece.finite()
        u, y = np.asarray(piece.u), np.asarray(piece.y)
        *lead, T, p = y.shape
        count = int(np.prod(lead))
        followed = carry.carry.c.shape[-1] // len(self.weights)
        if followed not in (1, count):
            raise ValueError(f"this observer follows {followed} recordings, y holds {count}")
        last = lambda x: (
            np.moveaxis(x.reshape(count, T, x.shape[-1]), 0, -1) if count > 1 else x.reshape(T, -1, 1)
        ).astype(self._dtype)
        fresh = np.zeros((T, count), bool)
        fresh[np.asarray(piece.starts, np.int64)] = True
        if piece.excluded is not None:
            fresh |= piece.excluded[:, None]
        rounded = max(float(rounding.unit(y.dtype)), float(rounding.unit(self._dtype)))
        return lead, count, (last(u), last(y), last(input_slip(u)), fresh, np.asarray(rounded, self._dtype))

    def _followed(self, past, count, u, y, slip, fresh, rounded):
        """Return (Carry, Found (T, .., N), the Read or nothing) of samples as of `_given`; a carry of one
        recording is that of all.
        """
        lanes, room = len(self.weights), self._room
        room = (
            max(room, BESIDE) if is_outside_xla() and count > room else room
        )  # NumPy rounds alike whatever is beside
        if count == 1:  # nothing to cut: who follows a recording sample by sample is in a hurry
            full = lambda x: np.repeat(np.asarray(x), room, -1)
            past, found, known = self._block(
                jax.tree.map(full, past), [full(x) for x in (u, y, slip, fresh)], rounded
            )
            past = jax.tree.map(lambda x: np.array(np.asarray(x)[..., ::room]), past)
            known = jax.tree.map(lambda x: x[..., :1], known)
            return past, joined(steps.Found(*(x[..., ::room, None] for x in found))), known
        past = jax.tree.map(lambda x: np.asarray(x).reshape(*x.shape[:-1], lanes, x.shape[-1] // lanes), past)
        past = jax.tree.map(lambda x: np.repeat(x, count // x.shape[-1], -1), past)
        beside = lambda x: x.reshape(*x.shape[:-2], x.shape[-2] * x.shape[-1])
        cut = lambda block: jax.tree.map(lambda x: beside(x[..., block]), past)
        job = lambda block: self._block(cut(block), [x[..., block] for x in (u, y, slip, fresh)], rounded)
        done = in_blocks(job, count, room)
        split = lambda x: np.asarray(x).reshape(*x.shape[:-1], lanes, room)
        together = lambda *parts: np.concatenate([split(x) for x in parts], -1)[..., :count]
        pasts, founds, reads = zip(*done, strict=True)
        past, found = (jax.tree.map(together, *parts) for parts in (pasts, founds))
        known = jax.tree.map(lambda *parts: np.concatenate(parts, -1)[..., :count], *reads)
        return jax.tree.map(beside, past), joined(found), known

    @cached_property
    def _room(self):
        """How many recordings a block has."""
        return max(BLOCK // len(self.weights) // EVEN, 1) * EVEN

    def _block(self, carry, samples, rounded):
        """Follow some recordings side by side, piece by piece; return (Carry, where it was worked out, Found,
        Read or None).
        """
        T, first, (numbers, start) = len(samples[0]), 0, self._placed
        parts: list = []
        how = len(self.weights), 2 if self.enclosures else int(self.hulls), self.restart, self.hulls
        while first < T or not parts:
            stop = min(first + PIECE, T)
            given = (*(_filled(x[first:stop], PIECE) for x in samples), rounded)
            carry, *found = steps.follow(numbers, start, carry, given, stop - first, *how)
            parts.append(jax.tree.map(lambda x: np.asarray(x)[: stop - first], found))  # noqa: B023
            first = stop
        found, known = parts[0] if len(parts) == 1 else jax.tree.map(lambda *x: np.concatenate(x), *parts)
        return carry, found, known

    def _told(self, found, lead, T, carry):
        """Return the Observation, or the verdicts, of arrays with time first and recordings last, behind what
        was carried.
        """
        shaped = lambda x: (np.moveaxis(x, -1, 0) if x.shape[-1] > 1 else x).reshape(*lead, T, *x.shape[1:-1])
        status, margin, age = (shaped(x) for x in found[:3])
        if not self.enclosures:
            return Judged(status, margin)
        since = np.where(age > 0, int(carry.samples) + np.arange(T) - age + 1, -1)
        before: Any = (
            None if self.restart else np.asarray(carry.carry.empty).reshape(len(self.weights), -1).any(0)
        )
        found = emptied(found, before)
        n, p = self._system.n, self._system.p
        ends = lambda x, width: Interval(-x[..., :width], x[..., width:])
        states, outputs = shaped(found.states), shaped(found.outputs)
        state = jax.tree.map(lambda x: x[..., : self.model.n], ends(states, n))
        return Observation(
            status, margin, since, state, ends(outputs[..., : 2 * p], p), ends(outputs[..., 2 * p :], p)
        )


def _filled(x, length):
    """Return x with zeros behind, up to a length."""
    out = np.zeros((length, *x.shape[1:]), x.dtype)
    out[: len(x)] = x
    return out


def _known(carry, c, G, r):
    """Return the carry of a first sample whose state is in a set."""
    each = lambda x: np.repeat(x[..., None], len(carry.age), -1)
    full = np.pad(G, ((0, 0), (0, carry.G.shape[1] - G.shape[1])))
    return carry._replace(c=each(c), G=each(full), r=each(r), age=np.zeros_like(carry.age))
