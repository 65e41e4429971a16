"""The equations of a jaxpr: what one calls, and how its primitive is applied."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, JaxprEqn, Literal, Var

CALLS = {
    "jit",
    "pjit",
    "closed_call",
    "core_call",
    "remat",
    "remat2",
    "checkpoint",
    "custom_jvp_call",
    "custom_vjp_call",
    "custom_vjp_call_jaxpr",
}
LOOPS_AND_BRANCHES = ("scan", "while", "cond")


def body(eqn: JaxprEqn) -> ClosedJaxpr | None:
    """Return the ClosedJaxpr that a call evaluates, or None."""
    if eqn.primitive.name not in CALLS:
        return None
    inner = next(eqn.params[k] for k in ("jaxpr", "call_jaxpr", "fun_jaxpr") if k in eqn.params)
    return inner if isinstance(inner, ClosedJaxpr) else ClosedJaxpr(inner, ())


def bind(eqn: JaxprEqn, *values: Any, **changed: Any) -> list[Any]:
    """Apply the primitive of an equation to numbers; always a list of outputs."""
    out = eqn.primitive.bind(*values, **{**eqn.params, **changed})
    return out if eqn.primitive.multiple_results else [out]


def inner_jaxprs(eqn: JaxprEqn) -> list[ClosedJaxpr] | None:
    """Return the jaxprs that a call, a branch or a loop evaluates; None for a primitive."""
    if eqn.primitive.name in LOOPS_AND_BRANCHES:
        given = (x if isinstance(x, tuple) else (x,) for x in eqn.params.values())
        return [x for values in given for x in values if isinstance(x, ClosedJaxpr)]
    called = body(eqn)
    return None if called is None else [called]


def by_key(eqn: JaxprEqn) -> bool:
    """True for a sort that moves other arrays along."""
    return eqn.primitive.name == "sort" and len(eqn.invars) > 1


def inexact(aval: object) -> bool:
    """True for an array of floats or complex numbers."""
    return hasattr(aval, "dtype") and jnp.issubdtype(aval.dtype, jnp.inexact)


def dtype_of(v: Var | Literal) -> np.dtype:
    """Return the type of the numbers of a variable."""
    return v.aval.dtype  # type: ignore[attr-defined]  # every variable here is an array


def is_traced(*trees: object) -> bool:
    """Return whether anything in these PyTrees is traced: inside jit, vmap, grad or scan."""
    return any(isinstance(x, jax.core.Tracer) for x in jax.tree.leaves(trees))
