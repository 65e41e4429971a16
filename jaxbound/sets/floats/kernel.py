"""Kernels: functions that XLA compiles, and that NumPy can evaluate in its place.

XLA copies wrongly at times, and no bound on rounding covers that. What proves something is therefore written
as a `kernel`, which is `jax.jit` and nothing else until somebody asks `outside_xla`: there the same program
is evaluated primitive by primitive in NumPy (`numpy_primitives`, `numpy_moves`), from the arrays on the host.
Nothing fuses, no loop is vectorised, no copy is left out.

Compiling takes seconds, evaluating a program for some hundred windows a tenth of one. So whoever judges few
windows, or samples, has them `tried_in_numpy` first, which counts work and no seconds: the same calls take
the same way on every machine. The last digits of exact margins depend on the way, and so whether a window
within rounding of its bounds is decided or UNDECIDED; what is decided is proved both ways.
"""

import contextlib
import inspect
import os
import threading
from collections import defaultdict, deque
from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from functools import lru_cache, partial, update_wrapper
from operator import itemgetter
from typing import Any, NamedTuple, TypeVar, overload

import jax
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, JaxprEqn, Literal

from jaxbound.sets.floats.equations import body, dtype_of, is_traced
from jaxbound.sets.floats.numpy_moves import MOVED, SMALL
from jaxbound.sets.floats.numpy_primitives import COMPUTED

T = TypeVar("T")
_state = threading.local()
AUTO, ALWAYS, NEVER = "auto", "always", "never"
FEW = 2**13
"""How much of one kind NumPy evaluates before XLA compiles its programs, in windows of a small test."""
CALL = 2**6
"""What a call counts for at least: NumPy takes as long for one window."""
FIRST = 2**9
"""How many windows of a stream NumPy judges, each by itself, before XLA compiles the programs of a search."""
STREAMS = 4
"""So many times, for streams that follow each other in a process."""
UNCOUNTED = "uncounted"
_mode = os.environ.get("JAXBOUND_COMPILE", AUTO)
_evaluated: defaultdict[Hashable, float] = defaultdict(float)


def compile(when: str = AUTO) -> None:
    """Say when this process compiles the programs by which `detect`, `observe` and `validate` judge.

    Others are told by the variable `JAXBOUND_COMPILE`. Proofs do not depend on it, exact margins by their
    last digits: NumPy evaluates the same programs under the same bounds of rounding. A window within rounding
    of its bounds may be decided one way and UNDECIDED the other. Where bounds of margins will do, NumPy's
    are exact.

    Args:
        when: "auto": once NumPy took about as long for one kind as compiling takes: behind 8 000 windows of a
            small test, some hundred of one that searches among many disturbances, 2 000 samples of a small
            observer. "always": at once. "never": except for windows, and samples of observers, within
            rounding of their bounds. Where windows are searched, Monitors, and pipes with them, compile
            behind their first 512 samples, which NumPy judges one by one. All that is written in parts
            (Parquet, fleets, studies, fits) compiles at once: its bytes are the same however it is cut. So
            does all that goes to another device than a CPU.

    Raises:
        ValueError: another word.

    Example:
        >>> import jaxbound as jb
        >>> jb.compile("always")  # a service that is to be fast from its second short recording on
        >>> jb.compile()
    """
    global _mode
    if when not in (AUTO, ALWAYS, NEVER):
        raise ValueError(f'when must be "auto", "always" or "never", not {when!r}')
    _mode = when
    _evaluated.clear()


def is_sparing() -> bool | str | None:
    """Say whether this thread may evaluate few windows in NumPy, as `sparing` was told; None: by nobody."""
    return getattr(_state, "sparing", None)


@contextlib.contextmanager
def sparing(active: bool | str | None = True) -> Iterator[None]:
    """Let few windows be evaluated in NumPy, on this thread, until the block ends.

    Args:
        active: False forbids it to all that is called within; None changes nothing; `UNCOUNTED`: whoever
            calls counts the windows.
    """
    before = is_sparing()
    # a block that forbids it is not to be overruled by what it calls
    if before is not False and active is not None:
        _state.sparing = active
    try:
        yield
    finally:
        _state.sparing = before


def spared(work: float, kind: Hashable) -> bool:
    """Return whether so much more of a kind is evaluated in NumPy, and count it: in windows of a small test.

    Raises:
        ValueError: `JAXBOUND_COMPILE` is no word that `compile` takes.
    """
    if _mode not in (AUTO, ALWAYS, NEVER):
        raise ValueError(f"JAXBOUND_COMPILE must be auto, always or never, not {_mode!r}")
    if _mode == ALWAYS or not is_sparing() or _platform() != "cpu":
        return False
    if is_sparing() == UNCOUNTED:
        return True
    # a call of one window costs NumPy as much as one of dozens
    _evaluated[kind] += max(work, CALL)
    return _mode == NEVER or _evaluated[kind] <= FEW


def first_in_numpy(samples: int, count: int, weight: float, kind: Hashable) -> int:
    """Return how many of the next windows of a stream, behind so many samples, are to be judged one by one
    under `UNCOUNTED`: the same ones, and so the same bytes, however a stream is cut and continued. A process
    with many streams of a kind compiles in the end. weight: of a window, in those of a small test.
    """
    if is_outside_xla() or is_sparing() is not None or _mode == ALWAYS or _platform() != "cpu":
        return 0  # whoever calls `sparing` has all samples at once
    if _mode == NEVER:
        return count
    key, few = ("first", kind), int(FIRST // weight)
    # few for each stream, and for all streams of the process together
    early = max(min(count, few - samples, int(STREAMS * few - _evaluated[key])), 0)
    _evaluated[key] += early
    return early


def compiles_later() -> bool:
    """Say whether what NumPy judges first on this thread is to be compiled in the end."""
    return _mode == AUTO and not is_outside_xla() and _platform() == "cpu"


def tried_in_numpy(
    job: Callable[[], T], work: float, kind: Hashable, believed: Callable[[T], bool] | None = None
) -> T | None:
    """Return the result of a job that is worth so many windows of a small test, evaluated in NumPy; None
    where it is to be compiled, a primitive of it is not written in NumPy, or what comes out is not believed.
    """
    if spared(work, kind):
        with outside_xla(), contextlib.suppress(NotImplementedError):
            out = job()
            if believed is None or believed(out):
                judged_by().add("NumPy")
                return out
    judged_by().add("XLA")
    return None


def judged_by() -> set[str]:
    """Return the set in which this thread notes who judges; it counts where `noted` collects them."""
    return getattr(_state, "ways", set())


@contextlib.contextmanager
def noted(ways: set[str] | None = None) -> Iterator[set[str]]:
    """Collect "NumPy", "XLA": by what this thread judges until the block ends.

    Args:
        ways: the set in which they are collected; None: a new one.
    """
    before = judged_by()
    _state.ways = set() if ways is None else ways
    try:
        yield _state.ways
    finally:
        _state.ways = before


def is_outside_xla() -> bool:
    """Say whether this thread evaluates kernels in NumPy."""
    return getattr(_state, "outside", False)


@contextlib.contextmanager
def outside_xla(active: bool = True) -> Iterator[None]:
    """Evaluate kernels in NumPy, on this thread, until the block ends. active: False evaluates them by XLA,
    as anywhere.
    """
    before = is_outside_xla()
    _state.outside = active
    try:
        with _on_the_host(active):
            yield
    finally:
        _state.outside = before


WIDE = {"xla_cpu_prefer_vector_width": 512}
"""The widest vectors that the processor has. XLA keeps to half of them, but takes samples apart with the
widest: an elementwise kernel then runs at half its speed or less. Bits of `consistency.strips` are the same;
what else is made wide may round other sums first where a block ends.
"""


def _on_the_host(active: bool) -> contextlib.AbstractContextManager[object]:
    """Return a context in which nothing that is proved outside XLA has passed through a card, if active."""
    if not active or _platform() == "cpu":
        return contextlib.nullcontext()
    try:
        return jax.default_device(jax.local_devices(backend="cpu")[0])
    except RuntimeError:  # a process without a CPU device
        return contextlib.nullcontext()


def _platform() -> str:
    """Return the platform that work goes to, as `jax.default_device` or JAX itself chose it."""
    chosen = jax.config.jax_default_device  # type: ignore[attr-defined]  # made at run time
    if chosen is None:
        return jax.default_backend()
    return str(getattr(chosen, "platform", chosen))


class Kernel:
    """A jitted function that `outside_xla` evaluates in NumPy. Build it with `kernel`; its other attributes
    are those of `jax.jit`.

    Args:
        wide: whether it is compiled for the widest vectors where it is the outermost one, which alone may
            have options.
    """

    def __init__(self, function: Callable, wide: bool = False, **how: Any) -> None:
        self._compiled = jax.jit(function, **how)
        self._wide = wide
        self._alone = jax.jit(function, compiler_options=WIDE, **how) if wide else self._compiled
        arguments = inspect.signature(function).parameters
        self._names = tuple(
            name for name, x in arguments.items() if x.kind in (x.POSITIONAL_ONLY, x.POSITIONAL_OR_KEYWORD)
        )
        numbers, names = how.get("static_argnums", ()), how.get("static_argnames", ())
        numbers = (numbers,) if isinstance(numbers, int) else tuple(numbers)
        names = (names,) if isinstance(names, str) else tuple(names)
        self._static = {*names, *(self._names[i] for i in numbers)}
        update_wrapper(self, function, updated=())  # a gradient of a kernel has that one's own attributes

    @property
    def wide(self) -> bool:
        """Whether it is compiled for the widest vectors: those of a CPU."""
        return self._wide and jax.default_backend() == "cpu"

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """Return the result of the function, arrays of JAX; outside XLA arrays of NumPy."""
        if not is_outside_xla() and not self.wide:
            return self._compiled(*args, **kwargs)
        given = self._arrays(args, kwargs)
        if is_traced(given):  # a part of a program that is being written down
            return self._compiled(*args, **kwargs)
        if not is_outside_xla():
            return self._alone(*args, **kwargs)
        # the very program that XLA would compile, written down once for each shape
        traced = self._compiled.trace(*args, **kwargs)
        out = evaluated(traced.jaxpr, given)
        return jax.tree.unflatten(jax.tree.structure(traced.out_info), out)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._compiled, name)

    def _arrays(self, args, kwargs):
        """Return the leaves of the arguments that are not static, in the order in which the program takes
        them.
        """
        names = (*self._names, *[""] * len(args))  # others have none
        placed = [x for name, x in zip(names, args, strict=False) if name not in self._static]
        named = {name: x for name, x in kwargs.items() if name not in self._static}
        return jax.tree.leaves((placed, named))


@overload
def kernel(function: Callable[..., Any]) -> Kernel: ...
@overload
def kernel(function: None = None, **how: Any) -> Callable[[Callable[..., Any]], Kernel]: ...
def kernel(
    function: Callable[..., Any] | None = None, **how: Any
) -> Kernel | Callable[[Callable[..., Any]], Kernel]:
    """Return a `Kernel`: a decorator, with the arguments of `jax.jit`, `wide`, or none."""
    if function is None:
        return lambda f: Kernel(f, **how)
    return Kernel(function, **how)


def evaluated(program: ClosedJaxpr, args: Sequence[Any]) -> list[np.ndarray]:
    """Return the outputs of a program, evaluated in NumPy.

    Raises:
        NotImplementedError: a primitive of it is not written in NumPy.
    """
    # a number of Python gets the type that the program was traced with
    given = [np.asarray(x, dtype_of(v)) for x, v in zip(args, program.jaxpr.invars, strict=True)]
    with np.errstate(all="ignore"):
        return _closed(program)()(*given)


class _Step(NamedTuple):
    """One equation. Fields: function; fetched: its inputs, of all numbers; where these are found, and its
    outputs go; whether it has one output; numbers of large arrays that nothing needs afterwards.
    """

    function: Callable
    fetched: Callable
    inputs: tuple[int, ...]
    outputs: tuple[int, ...]
    single: bool
    done: tuple[int, ...] = ()


class _Steps:
    """A jaxpr as a list of functions of NumPy arrays: calls are written out, what stands there twice is
    worked out once, what nobody needs is left out.

    Args:
        fixed: how many of its inputs stay as they are from one evaluation to the next.
    """

    def __init__(self, jaxpr: Jaxpr, fixed: int) -> None:
        self._known: list[Any] = []  # by number: literals and constants, and None for what is worked out
        self._large: set[int] = set()
        self._places: dict[Hashable, Any] = {}  # of literals, and of the outputs of equations
        scope: dict[Any, int] = {}
        inputs = [self._number(v, scope) for v in (*jaxpr.constvars, *jaxpr.invars)]
        steps = self._written_out(jaxpr, scope)
        self._outputs = [self._number(v, scope) for v in jaxpr.outvars]
        self._fixed, self._moving = inputs[:fixed], inputs[fixed:]
        moving, needed = set(self._moving), {*self._outputs, *inputs}
        for step in steps:
            if not moving.isdisjoint(step.inputs):
                moving.update(step.outputs)
        self._once: deque[_Step] = deque()
        self._each: deque[_Step] = deque()
        for step in reversed(steps):
            if needed.isdisjoint(step.outputs):
                continue
            done = {*step.inputs, *step.outputs} - needed
            needed |= done
            part = self._once if moving.isdisjoint(step.outputs) else self._each
            part.appendleft(step._replace(done=tuple(done & moving & self._large)))

    def over(self, *fixed: np.ndarray) -> Callable[..., list[np.ndarray]]:
        """Return the function of the inputs that are not fixed; what follows from the others alone is worked
        out here.
        """
        values = list(self._known)
        _follow(self._once, values, self._fixed, fixed)

        def run(*args: np.ndarray) -> list[np.ndarray]:
            _follow(self._each, values, self._moving, args)
            return [values[i] for i in self._outputs]

        return run

    def _new(self, value=None):
        self._known.append(value)
        return len(self._known) - 1

    def _number(self, v, scope):
        if isinstance(v, Literal):
            value = np.asarray(v.val, dtype_of(v))
            return self._places.setdefault((value.tobytes(), value.shape, value.dtype), self._new(value))
        if v not in scope:
            scope[v] = self._new()
            if v.aval.size > SMALL:
                self._large.add(scope[v])
        return scope[v]

    def _written_out(self, jaxpr, scope):
        """Return the steps of a jaxpr, those of the calls in it among them. scope: numbers of its
        variables.
        """
        steps = []
        for eqn in jaxpr.eqns:
            inputs = tuple(self._number(v, scope) for v in eqn.invars)
            called = body(eqn)
            if called is None:
                key = eqn.primitive, inputs, tuple(eqn.params.values())
                if key in self._places:
                    scope.update(zip(eqn.outvars, self._places[key], strict=True))
                    continue
                self._places[key] = outputs = tuple(self._number(v, scope) for v in eqn.outvars)
                single = not eqn.primitive.multiple_results
                steps.append(_Step(_function(eqn), _fetched(inputs), inputs, outputs, single))
                continue
            inner = dict(
                zip(called.jaxpr.constvars, (self._new(np.asarray(x)) for x in called.consts), strict=True)
            )
            inner.update(zip(called.jaxpr.invars, inputs, strict=True))
            steps += self._written_out(called.jaxpr, inner)
            results = [self._number(v, inner) for v in called.jaxpr.outvars]
            scope.update(zip(eqn.outvars, results, strict=True))
        return steps


def _fetched(places: tuple[int, ...]) -> Callable:
    """Return the function that takes a list to the entries at some places."""
    if len(places) > 1:
        return itemgetter(*places)
    return itemgetter(slice(places[0], places[0] + 1) if places else slice(0))


def _follow(steps: Iterable[_Step], values: list[Any], places: list[int], args: Sequence[np.ndarray]) -> None:
    """Put inputs in their places, and work out what follows from them."""
    for number, x in zip(places, args, strict=True):
        values[number] = x
    for function, fetched, _, outputs, single, done in steps:
        out = function(*fetched(values))
        if single:
            values[outputs[0]] = out
        else:
            for number, x in zip(outputs, out, strict=True):
                values[number] = x
        for number in done:
            values[number] = None


_steps = lru_cache(maxsize=512)(_Steps)


def _function(eqn: JaxprEqn) -> Callable:
    """Return an equation as a function of NumPy arrays."""
    name = eqn.primitive.name
    if name == "scan":
        return _scan(eqn)
    if name not in PRIMITIVES:
        raise NotImplementedError(f"the primitive {name} of JAX is not written in NumPy")
    return PRIMITIVES[name](eqn.params)


def _closed(program: ClosedJaxpr, fixed: int = 0) -> Callable[..., Callable[..., list[np.ndarray]]]:
    """Return the function of the first inputs of a program that returns the function of the others."""
    steps, consts = _steps(program.jaxpr, len(program.consts) + fixed), list(map(np.asarray, program.consts))
    return partial(steps.over, *consts)


def _while(params):
    asked, moved = params["cond_nconsts"], params["body_nconsts"]
    test, step = _closed(params["cond_jaxpr"], asked), _closed(params["body_jaxpr"], moved)

    def run(*args):
        going, move, carry = test(*args[:asked]), step(*args[asked : asked + moved]), [*args[asked + moved :]]
        while np.any(which := going(*carry)[0]):
            moved_on = move(*carry)
            carry = moved_on if not np.ndim(which) else _where_going(which, moved_on, carry)
        return carry

    return run


def _where_going(going, new, old):
    """Return the carry of loops side by side, that of those which have ended as it was."""
    beside = lambda x: going.reshape(going.shape + (1,) * (x.ndim - going.ndim))
    return [np.where(beside(x), x, kept) for x, kept in zip(new, old, strict=True)]


def _scan(eqn):
    inner, length, backward = eqn.params["jaxpr"], eqn.params["length"], eqn.params["reverse"]
    # how many constants and carries there are stands in other places from version to version: what is stacked
    # has an axis more
    whole = lambda outside, avals: sum(v.aval.ndim == x.ndim for v, x in zip(outside, avals, strict=True))
    carried = whole(eqn.outvars, inner.out_avals)
    constants = whole(eqn.invars, inner.in_avals) - carried
    step, stacked = _closed(inner, constants), inner.out_avals[carried:]

    def run(*args):
        move, carry, rows = (
            step(*args[:constants]),
            list(args[constants : constants + carried]),
            args[constants + carried :],
        )
        outs = [np.empty((length, *x.shape), x.dtype) for x in stacked]
        for k in reversed(range(length)) if backward else range(length):
            found = move(*carry, *(x[k] for x in rows))
            carry = found[:carried]
            for out, x in zip(outs, found[carried:], strict=True):
                out[k] = x
        return [*carry, *outs]

    return run


def _cond(params):
    branches = [_closed(branch) for branch in params["branches"]]
    return lambda which, *args: branches[min(max(int(which), 0), len(branches) - 1)]()(*args)


PRIMITIVES = {**COMPUTED, **MOVED, "while": _while, "cond": _cond}
"""{name of a primitive: of the parameters of an equation, the function of NumPy arrays that it stands
for}.
"""
