"""A function prepared so that the derivative that JAX takes of it is that of its mathematics.

Custom rules and stop_gradient may state another derivative than the function has; they are dropped. max, min
and clamp become selections by a comparison, which an interval can decide. Tables (jnp.interp) have one
primitive for their slope.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax.extend.core import ClosedJaxpr, Jaxpr, JaxprEqn, Literal

from jaxbound.sets.floats.equations import bind, body, dtype_of
from jaxbound.sets.inclusion.tables import interpolated, is_interp


def plain(jaxpr: Jaxpr, consts: Sequence[Any], args: Sequence[Any]) -> list[Any]:
    """Evaluate a jaxpr on numbers like JAX does, with the primitives replaced whose derivative would not
    serve.
    """
    env = dict(zip(jaxpr.constvars, consts, strict=True)) | dict(zip(jaxpr.invars, args, strict=True))
    read = lambda v: jnp.asarray(v.val, dtype_of(v)) if isinstance(v, Literal) else env[v]
    for eqn in jaxpr.eqns:
        env.update(zip(eqn.outvars, _apply(eqn, [read(v) for v in eqn.invars]), strict=True))
    return [read(v) for v in jaxpr.outvars]


def _apply(eqn: JaxprEqn, values: list[Any]) -> Sequence[Any]:
    name, inner = eqn.primitive.name, body(eqn)
    if is_interp(eqn):
        return [interpolated(*values)]
    if inner is not None:
        return plain(inner.jaxpr, inner.consts, values)
    if name == "stop_gradient":
        return values
    if name in SELECTED and jnp.issubdtype(values[0].dtype, jnp.floating):
        return [SELECTED[name](*values, **eqn.params)]
    return bind(eqn, *values, **{k: _plain_param(v) for k, v in eqn.params.items() if _holds_jaxpr(v)})


def _holds_jaxpr(value: object) -> bool:
    return (
        isinstance(value, ClosedJaxpr)
        or isinstance(value, tuple)
        and any(isinstance(v, ClosedJaxpr) for v in value)
    )


def _plain_param(value):
    if isinstance(value, tuple):
        return tuple(map(_plain_param, value))
    return jax.make_jaxpr(lambda *args: plain(value.jaxpr, value.consts, args))(*value.in_avals)


def _greater(x: jax.Array, y: jax.Array, **_: object) -> jax.Array:
    return jnp.where(x > y, x, y)


def _less(x: jax.Array, y: jax.Array, **_: object) -> jax.Array:
    return jnp.where(x < y, x, y)


def _clamp(low: jax.Array, x: jax.Array, high: jax.Array, **_: object) -> jax.Array:
    return _less(_greater(x, low), high)


def _reduced_by_halves(pick: Callable[[jax.Array, jax.Array], jax.Array]) -> Callable[..., jax.Array]:
    """Reduce along axes by comparing halves."""

    def reduce(x, axes, **_):
        for axis in sorted(axes, reverse=True):
            while (count := x.shape[axis]) > 1:
                part = lambda a, b, x=x, axis=axis: jax.lax.slice_in_dim(x, a, b, axis=axis)
                best = pick(part(0, count // 2), part(count // 2, count // 2 * 2))
                x = jnp.concatenate([best, part(count - 1, count)], axis) if count % 2 else best
            x = jnp.squeeze(x, axis)
        return x

    return reduce


def _error_function(f: Callable[[jax.Array], jax.Array], sign: int) -> Callable[..., jax.Array]:
    """Return erf or erfc, whose derivative has 2 / sqrt(pi) in it: as JAX writes it, a float beside it."""
    g = jax.custom_jvp(f)

    @g.defjvp
    def rule(primals, tangents):
        (x,), (dx,) = primals, tangents
        quarter = jnp.arctan(jnp.ones_like(x))  # of pi
        return f(x), sign * jnp.exp(-jnp.square(x)) / jnp.sqrt(quarter) * dx

    return lambda x, **_: g(x)


SELECTED: dict[str, Callable[..., jax.Array]] = {
    "max": _greater,
    "min": _less,
    "clamp": _clamp,
    "reduce_max": _reduced_by_halves(_greater),
    "reduce_min": _reduced_by_halves(_less),
    "erf": _error_function(jax.lax.erf, 1),
    "erfc": _error_function(jax.lax.erfc, -1),
}
