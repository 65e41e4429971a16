"""Functions of a user, found again by what they compute: `lambda` written once more needs no new compilation.

JAX takes a function as the same where it is the same object. A `lambda` in a loop is another object each
time, and an object whose closure has changed is the same one. Both are mended here: a function is taken apart
into its code and every value that the code can read (defaults, closure, globals, those of functions that it
calls), and stands for a copy that reads these values and nothing else. Equal parts, the same copy.

Only values that are compared and copied exactly are taken: numbers, strings, arrays up to `LARGEST` bytes,
tuples of them, functions that read such values, `functools.partial`, and what Python, NumPy and JAX provide
under its own name. A function that reads anything else (a list, an object, a module of the user, a tracer),
or may write something outside, is left as it is: compiled for each object anew, as JAX does.
"""

import builtins
import dis
import struct
import sys
import threading
from collections.abc import Callable, Hashable, Mapping
from fractions import Fraction
from functools import lru_cache, partial
from operator import methodcaller
from types import CellType, CodeType, FunctionType, ModuleType
from typing import NamedTuple, TypeAlias, TypeVar, cast

import jax
import numpy as np

KEPT = 128
"""Functions that are found again, and whose programs are kept."""
LARGEST = 2**16
"""Bytes of an array that is compared and copied."""
DEEPEST = 16
"""Values within values."""
TRUSTED = frozenset(
    ("jax", "numpy", "jaxbound", "math", "cmath", "operator", "functools", "itertools", "builtins")
)
"""Packages whose members do not change."""
REFUSED_NAMES = frozenset(
    "breakpoint compile delattr eval exec globals id input locals open random setattr vars __import__".split()
)
REFUSED_STEPS = frozenset(
    "STORE_GLOBAL DELETE_GLOBAL STORE_NAME DELETE_NAME IMPORT_NAME IMPORT_STAR LOAD_BUILD_CLASS "
    "STORE_ATTR DELETE_ATTR STORE_SUBSCR DELETE_SUBSCR".split()
)
Array: TypeAlias = np.ndarray | jax.Array
Function: TypeAlias = Callable[..., object]


class _Unknown(Exception):
    """A value that cannot be compared and copied exactly."""


class _Part(NamedTuple):
    """A value. Fields: key: equal where values are; copy: the value, which nobody else changes."""

    key: Hashable
    copy: object


Compiled = TypeVar("Compiled")
Called = TypeVar("Called", bound=Function)


def frozen(f: Called) -> Called:
    """Return a function that computes what f computes now, the same one for equal functions; f itself where
    that cannot be told.

    Example:
        >>> double, same, triple = (frozen(lambda z, k=k: k * z) for k in (2.0, 2.0, 3.0))
        >>> double is same, double is triple, triple(2.0)
        (True, False, 6.0)
    """
    try:
        key, copy = _function_parts(f, 0)
    except _Unknown:
        if type(f) is not FunctionType:  # others may be equal to one another, as JAX sees them
            return f
        key, copy = f, f
    with _lock:
        if key not in _kept and len(_kept) == KEPT:
            _kept.clear()
            for kernel in _kernels:
                _forget(kernel)
        return cast(Called, _kept.setdefault(key, copy))


def forgets(kernel: Compiled) -> Compiled:
    """Register a kernel that takes functions as static arguments: a decorator. Its programs are forgotten
    each time when `KEPT` more functions were new.
    """
    _kernels.append(kernel)
    return kernel


_lock = threading.RLock()
_kept: dict[Hashable, object] = {}
_kernels: list[object] = []
_forget = methodcaller("clear_cache")


def _part(x: object, depth: int) -> _Part:
    """Return the parts of a value.

    Raises:
        _Unknown: a value that may change, or may not be compared.
    """
    if depth > DEEPEST:
        raise _Unknown
    kind = type(x)
    if kind in PLAIN:
        return _Part((kind, PLAIN[kind](x)), x)
    if isinstance(x, tuple) and kind is tuple:
        parts = [_part(v, depth + 1) for v in x]
        return _Part((kind, tuple(p.key for p in parts)), tuple(p.copy for p in parts))
    if isinstance(x, jax.Array | np.generic) or (isinstance(x, np.ndarray) and kind is np.ndarray):
        return _array_parts(x)
    if _provided(x):
        return _Part(("provided", id(x)), x)
    return _function_parts(x, depth)


def _named(values: Mapping[str, object], depth: int) -> _Part:
    """Return the parts of values with names, in their order."""
    parts = {name: _part(v, depth + 1) for name, v in values.items()}
    return _Part(tuple((name, p.key) for name, p in parts.items()), {n: p.copy for n, p in parts.items()})


PLAIN: dict[type, Callable[..., Hashable]] = {
    type(None): repr,
    type(...): repr,
    bool: bool,
    int: int,
    str: str,
    bytes: bytes,
    float: partial(struct.pack, "d"),
    complex: lambda x: struct.pack("dd", x.real, x.imag),
    Fraction: lambda x: (x.numerator, x.denominator),
    slice: repr,
    range: repr,
}


def _array_parts(x: Array | np.generic) -> _Part:
    """Return the parts of an array, a copy that cannot be written."""
    if isinstance(x, jax.core.Tracer) or x.dtype.kind not in "biufc" or x.nbytes > LARGEST:
        raise _Unknown
    where = ""
    if isinstance(x, jax.Array):
        if x.weak_type or len(x.devices()) > 1:
            raise _Unknown
        where = str(x.sharding)
    host = np.array(x)
    key = type(x), where, host.dtype.str, host.shape, host.tobytes()
    if isinstance(x, np.ndarray):
        host.flags.writeable = False
        return _Part(key, host)
    return _Part(key, x)


def _provided(x: object) -> bool:
    """Return whether a value is a member of a trusted package, under its own name there."""
    if isinstance(x, ModuleType):
        parts = x.__name__.split(".")
        return parts[0] in TRUSTED and "random" not in parts and sys.modules.get(x.__name__) is x
    module, name = getattr(x, "__module__", None), getattr(x, "__name__", None)
    if isinstance(x, np.ufunc):
        module = "numpy"
    if not isinstance(module, str) or not isinstance(name, str) or module.split(".")[0] not in TRUSTED:
        return False
    if name in REFUSED_NAMES:
        return False
    return getattr(sys.modules.get(module), name, None) is x


def _function_parts(f: object, depth: int) -> _Part:
    """Return the parts of a function of the user's, or of a `partial` of one.

    Raises:
        _Unknown: anything else, or a function that reads or writes something unknown.
    """
    if type(f) is partial and not f.__dict__:
        inner, args, named = _part(f.func, depth + 1), _part(f.args, depth), _named(f.keywords, depth)
        copy = partial(cast(Function, inner.copy), *cast(tuple[object, ...], args.copy))
        copy = partial(copy, **cast(dict[str, object], named.copy))
        return _Part((partial, inner.key, args.key, named.key), copy)
    if not isinstance(f, FunctionType) or f.__dict__:
        raise _Unknown
    everything = f.__globals__
    if everything.get("__builtins__", builtins) not in (builtins, vars(builtins)):
        raise _Unknown
    values = {}
    for name in _read(f.__code__):
        if name in everything:
            values[name] = everything[name]
        elif not _provided(getattr(builtins, name, None)):
            raise _Unknown
    try:
        cells = tuple(cell.cell_contents for cell in f.__closure__ or ())
    except ValueError:  # empty
        raise _Unknown from None
    defaults, inside = _part(f.__defaults__, depth + 1), _part(cells, depth + 1)
    outside, options = _named(values, depth + 1), _named(f.__kwdefaults__ or {}, depth + 1)
    own = {"__builtins__": builtins, "__name__": everything.get("__name__")}
    own.update(cast(dict[str, object], outside.copy))
    closure = tuple(CellType(v) for v in cast(tuple[object, ...], inside.copy))
    of_positions = cast(tuple[object, ...] | None, defaults.copy)
    same = FunctionType(f.__code__, own, f.__name__, of_positions, closure)
    if f.__kwdefaults__:
        same.__kwdefaults__ = cast(dict[str, object], options.copy)
    reads = defaults.key, inside.key, outside.key, options.key
    return _Part((FunctionType, f.__code__, f.__name__, everything.get("__name__"), *reads), same)


@lru_cache(maxsize=4 * KEPT)
def _read(code: CodeType) -> tuple[str, ...]:
    """Return the names that some code, and code within it, reads outside of itself, in order.

    Raises:
        _Unknown: it writes outside, or reads what has no name.
    """
    outer, names, waiting = set(code.co_freevars), set(), [code]
    while waiting:
        part = waiting.pop()
        if REFUSED_NAMES & set(part.co_names):
            raise _Unknown
        for step in dis.get_instructions(part):
            if step.opname in REFUSED_STEPS:
                raise _Unknown
            if step.opname in ("STORE_DEREF", "DELETE_DEREF") and step.argval in outer:
                raise _Unknown
            if step.opname in ("LOAD_GLOBAL", "LOAD_NAME"):
                names.add(step.argval)
        waiting += [x for x in part.co_consts if isinstance(x, CodeType)]
    return tuple(sorted(names))
