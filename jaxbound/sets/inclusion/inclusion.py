"""Inclusion functions: enclose the range of any JAX function over a box.

    natural      every primitive evaluated over Intervals
    mean_value   f(c) + J (z - c), c the middle of the box, J enclosing the derivatives all over it
    best         the intersection of both, and of natural over the faces to which a derivative with a sign
    pins each bound

Source: Moore, Kearfott, Cloud 2009, chapters 5 and 6.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.equations import is_traced
from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.floats.probe import refuse_unverified
from jaxbound.sets.floats.unrolled import stored
from jaxbound.sets.inclusion.derivatives import plain
from jaxbound.sets.inclusion.functions import forgets, frozen
from jaxbound.sets.inclusion.jaxprs import Value, evaluate, refuse_unsupported
from jaxbound.sets.inclusion.lifted import enclose, settled
from jaxbound.sets.intervals.interval import Interval, add, intersection, interval, matmul, mid, sub
from jaxbound.text.objects import readable

Tree = TypeVar("Tree")

METHODS = ("natural", "mean_value", "best")


def inclusion(f: Callable[..., Any], method: str = "natural") -> Inclusion:
    """Return F with F(box) enclosing {f(z) : z in box}.

    Args:
        f: any JAX function of arrays: elementwise mathematics, matrix products, indexing, where, reductions,
            scan, loops and branches, jit, vmap and custom derivatives inside. Its constants are taken as the
            floats they are.
        method: "natural"; "mean_value", whose excess width shrinks with the square of the width of the box;
            "best", never wider than "natural" and at 2 m more evaluations for m outputs.

    Returns:
        An Inclusion: called like f, with Intervals wherever a set is meant. Arrays and numbers are points. It
        vmaps and jits; a second call with boxes of the same shape does not trace f again, nor does one of the
        same function written once more (a `lambda` in a loop): `functions` says what is found again. What
        it reads beside its arguments counts as it is at the call.

    Raises:
        ValueError: an unknown method. TypeError: f cannot be called.

    Encloses: every value of the real function f over the part of the box where it is defined, in float32 and
    float64, compiled
        or not. A NaN or an infinity inside, of which f makes a number again (nan_to_num, nanmax,
        where(isnan(...), ...)), counts with what f makes of it, wherever it may arise. Where continuity over
        the whole box is not proved (an undecided where, floor across a step, a division by an interval with
        0), "mean_value" and "best" are "natural".

    Example:
        >>> import jax.numpy as jnp
        >>> f = lambda z: z[0] * jnp.sin(z[1]) - z[0]
        >>> for method in ("natural", "best"):
        ...     y = inclusion(f, method)(interval([1.0, 0.0], [2.0, 1.0]))
        ...     print(f"[{y.lo:.3f}, {y.hi:.3f}]")
        [-2.000, 0.683]
        [-2.000, -0.159]
    """
    if method not in METHODS:
        raise ValueError(f"method must be one of {', '.join(METHODS)}, not {method!r}")
    if not callable(f):
        raise TypeError(f"inclusion needs a function of arrays, not {type(f).__name__}")
    try:
        hash(f)
    except TypeError:
        return Inclusion(lambda *args, **options: f(*args, **options), method)
    return Inclusion(f, method)


@readable
@dataclass(frozen=True)
class Inclusion:
    """An inclusion function, built by `inclusion`: call it on Intervals and points."""

    f: Callable[..., Any]
    method: str

    def __call__(self, *args: object, **options: object) -> Any:
        """Return the enclosure: f's own structure with an Interval for each float array.

        Raises:
            ValueError: NaN or lo > hi in a box. NotImplementedError: f uses a primitive without a rule, or
                half precision.
        """
        return _run(_enclose, self, args, options)

    def continuous(self, *args: object, **options: object) -> jax.Array:
        """Return a boolean array (): True where f is proved to be defined and continuous all over the box.

        Raises:
            As the call.
        """
        return _run(_continuous, self, args, options)

    def jacobian(self, *args: object, **options: object) -> Interval:
        """Return an Interval (m, n) that holds the derivatives of all m float outputs by all n numbers of the
        Interval arguments.

        Entire where f is not proved to be defined and continuous over the box. Kinks of abs, max, min and
        clamp count with all slopes between those of their sides, so that f(x) - f(y) is in J (x - y) for any
        two points x, y of the box.

        Raises:
            As the call.
        """
        return _run(_jacobian, self, args, options)


def _run(kernel: Callable[..., Any], F: Inclusion, args: tuple[Any, ...], options: dict[str, Any]) -> Any:
    """Call a compiled kernel; a refusal while tracing comes out as the one sentence that it is."""
    refuse_unverified(args, options)
    leaves, structure = jax.tree.flatten((args, options), is_leaf=lambda x: isinstance(x, Interval))
    sets = tuple(isinstance(x, Interval) for x in leaves)
    if not is_traced(args, options):
        F = Inclusion(frozen(F.f), F.method)
    try:
        return kernel(F, _in_one_dtype([_leaf(x) for x in leaves], sets), structure, sets)
    except NotImplementedError as e:
        raise NotImplementedError(*e.args) from None


def _in_one_dtype(leaves, sets):
    """Return the leaves with all Intervals of floats in the wider of their types, so that one vector can hold
    them.
    """
    real = [s and jnp.issubdtype(x.dtype, jnp.floating) for s, x in zip(sets, leaves, strict=True)]
    dtype: Any = (
        jnp.result_type(*(x.dtype for x, r in zip(leaves, real, strict=True) if r)) if any(real) else None
    )
    wider = lambda x: x if x.dtype == dtype else jax.tree.map(lambda v: rounding.widened(v, dtype), x)
    return [wider(x) if r else x for x, r in zip(leaves, real, strict=True)]


def _leaf(x):
    if isinstance(x, Interval):
        if jnp.shape(x.lo) != jnp.shape(x.hi):
            raise ValueError(
                f"lo and hi of an Interval must have one shape: {jnp.shape(x.lo)} and {jnp.shape(x.hi)}"
            )
        return x if is_traced(x) else interval(x.lo, x.hi)
    if isinstance(x, bool | int | np.integer | np.bool_):
        return x
    if isinstance(x, jax.core.Tracer):
        return settled(x) if jnp.issubdtype(x.dtype, jnp.floating) else x
    host = np.asarray(x)
    if host.dtype.kind != "f":
        if host.dtype.kind not in "iub" and not jnp.issubdtype(
            getattr(x, "dtype", host.dtype), jax.dtypes.prng_key
        ):
            raise TypeError(f"inclusion takes Intervals, arrays and numbers, not {type(x).__name__}")
        return x
    if np.isnan(host).any():
        raise ValueError(
            f"a point must be a number, not NaN: {np.isnan(host).sum()} of {host.size} entries violate it"
        )
    if np.isinf(host).any():
        return settled(jnp.asarray(host))
    exact = (
        host.dtype == jax.dtypes.canonicalize_dtype(host.dtype)
        and ((abs(host) >= np.finfo(host.dtype).tiny) | (host == 0)).all()
    )
    return x if exact else interval(host)


def _spec(x):
    if isinstance(x, Interval):
        return jax.ShapeDtypeStruct(x.shape, x.dtype)
    return jax.ShapeDtypeStruct(x.shape, x.dtype, weak_type=x.aval.weak_type)


class _Traced:
    """The jaxpr of f for arguments of one form, and its float inputs and outputs as vectors."""

    def __init__(self, f, leaves, structure, sets):
        name = getattr(f, "__name__", "f")
        call = lambda *leaves: (lambda args, options: f(*args, **options))(
            *jax.tree.unflatten(structure, leaves)
        )
        closed, self.shape = jax.make_jaxpr(call, return_shape=True)(*map(_spec, leaves))
        refuse_unsupported(
            closed.jaxpr, "the function" if name == "<lambda>" else name, "write it with others"
        )
        self.jaxpr, self.consts, self.leaves = closed.jaxpr, closed.consts, leaves
        self.free = [i for i, x in enumerate(leaves) if sets[i] and jnp.issubdtype(x.dtype, jnp.floating)]
        self.real = [
            i for i, v in enumerate(closed.jaxpr.outvars) if jnp.issubdtype(v.aval.dtype, jnp.floating)
        ]

    def outputs(self, leaves: Sequence[Value]) -> tuple[list[Value], jax.Array]:
        """Return (outs, continuous) over the leaves."""
        outs, continuous = evaluate(self.jaxpr, self.consts, leaves)
        for i in self.real:
            outs[i] = found = enclose(outs[i])
            continuous = continuous & ~jnp.any(found.is_empty)  # a constant NaN, say: nowhere defined
        return outs, jnp.asarray(continuous)

    def vector(self) -> Interval:
        """Return the Interval (n,) of all numbers that vary."""
        return _joined([self.leaves[i] for i in self.free])

    def spread(self, z, point=lambda i, x: x):
        """Return the leaves with those that vary cut out of z, an Interval or an array (n,)."""
        out, start = [point(i, x) for i, x in enumerate(self.leaves)], 0
        for i in self.free:
            out[i], start = _part(z, start, self.leaves[i].shape)
        return out

    def jacobian(self) -> Interval:
        """Return the Interval (m, n) of the derivatives."""
        others = [x for i, x in enumerate(self.leaves) if i not in self.free]

        def flat(z, *others):
            rest = iter(others)
            outs = plain(
                self.jaxpr, self.consts, self.spread(z, lambda i, x: None if i in self.free else next(rest))
            )
            return jnp.concatenate([outs[i].ravel() for i in self.real])

        z = self.vector()
        slopes = jax.make_jaxpr(jax.jacfwd(flat))(_spec(z), *map(_spec, others))
        refuse_unsupported(slopes.jaxpr, "the derivative", "method='natural' needs no derivative")
        J, *_ = evaluate(slopes.jaxpr, slopes.consts, [z, *others])[0]
        J = enclose(J)
        none = J.is_empty  # the formula of the derivative has no value there: the derivative may have any
        return Interval(jnp.where(none, -jnp.inf, J.lo), jnp.where(none, jnp.inf, J.hi))


def _joined(parts: Sequence[Interval]) -> Interval:
    return jax.tree.map(lambda *ends: jnp.concatenate([e.ravel() for e in ends]), *parts)


@forgets
@kernel(static_argnums=(0, 2, 3))
def _continuous(F, leaves, structure, sets):
    return _Traced(F.f, leaves, structure, sets).outputs(leaves)[1]


@forgets
@kernel(static_argnums=(0, 2, 3))
def _jacobian(F, leaves, structure, sets):
    traced = _Traced(F.f, leaves, structure, sets)
    _, continuous = traced.outputs(leaves)
    J = traced.jacobian()
    return Interval(jnp.where(continuous, J.lo, -jnp.inf), jnp.where(continuous, J.hi, jnp.inf))


@forgets
@kernel(static_argnums=(0, 2, 3))
def _enclose(F, leaves, structure, sets):
    traced = _Traced(F.f, leaves, structure, sets)
    if F.method == "natural" or not traced.free or not traced.real:
        outs, _ = traced.outputs(leaves)
    else:
        outs = _sharpened(traced, F.method == "best")
    return jax.tree.unflatten(jax.tree.structure(traced.shape), outs)


def _sharpened(traced, best):
    """Return the outputs by the mean value form, or by the best of all forms, where f is continuous; else by
    natural evaluation.

    One batched evaluation of f serves the whole box, its middle and the faces to which derivatives with a
    sign pin the bounds.
    """
    z = traced.vector()
    # stored: the compiler would work J out again for each of its uses
    J, c = stored(traced.jacobian()), mid(z)
    m = J.shape[0]
    boxes = [jax.tree.map(lambda v: v[None], x) for x in (z, Interval(c, c))]
    if best:
        boxes += _faces(z, J)
    boxes = jax.tree.map(lambda *v: jnp.concatenate(v), *boxes)
    outs, continuous = jax.vmap(lambda box: traced.outputs(traced.spread(box)))(boxes)
    images = jax.vmap(lambda *parts: _joined(parts))(*(outs[i] for i in traced.real))
    fixed = z.lo == z.hi
    away = sub(z, Interval(c, c))
    away = Interval(jnp.where(fixed, 0, away.lo), jnp.where(fixed, 0, away.hi))
    sharp = add(images[1], matmul(J, away))
    if best:
        pinned = Interval(jnp.diagonal(images.lo[2 : 2 + m]), jnp.diagonal(images.hi[2 + m :]))
        sharp = intersection(intersection(images[0], sharp), pinned)
    usable = continuous[0] & ~jnp.any(z.is_empty)
    sharp = jax.tree.map(lambda new, old: jnp.where(usable & ~jnp.isnan(new), new, old), sharp, images[0])
    outs, start = [jax.tree.map(lambda v: v[0], o) for o in outs], 0
    for i in traced.real:
        outs[i], start = _part(sharp, start, outs[i].shape)
    return outs


def _faces(z: Interval, J: Interval) -> tuple[Interval, Interval]:
    """Return the box without what a derivative with a sign spares, for the lower bound of each output, then
    for the upper one.
    """
    rising = J.lo >= 0
    falling = (J.hi <= 0) & ~rising
    at_lo, at_hi = (jnp.broadcast_to(end, J.shape) for end in (z.lo, z.hi))
    low = Interval(jnp.where(falling, at_hi, at_lo), jnp.where(rising, at_lo, at_hi))
    return low, Interval(jnp.where(rising, at_hi, at_lo), jnp.where(falling, at_lo, at_hi))


def _part(z: Tree, start: int, shape: Sequence[int]) -> tuple[Tree, int]:
    """Return the numbers of z from `start` that fill a shape, and where they end."""
    stop = start + math.prod(shape)
    return jax.tree.map(lambda v: v[start:stop].reshape(shape), z), stop
