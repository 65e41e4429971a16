"""Evaluate the jaxpr of a function over Intervals: equation by equation, through calls, branches and loops.

Beside the enclosures, every evaluation says whether it proved the function defined and continuous over the box: derivatives
speak about a function only there.
"""

import functools
import operator

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import ClosedJaxpr, Literal

from jaxbound.sets.interval import Interval
from jaxbound.sets.lifted import enclose, least, most, settled, whole
from jaxbound.sets.primitives import CONTINUOUS, MOVED, RISING, RULES, WHOLE

__all__ = ["bind", "body", "evaluate", "refuse_unsupported"]

CALLS = {"jit", "pjit", "closed_call", "core_call", "remat", "remat2", "checkpoint", "custom_jvp_call", "custom_vjp_call",
         "custom_vjp_call_jaxpr"}  # fmt: skip
POINTWISE = {"abs", "neg", "max", "min", "select_n", "iota", "bitcast_convert_type", "argmax", "argmin", "is_finite"}  # exact on numbers
LOOPS = 10_000
"""A while loop whose end depends on an interval is followed this far; one that may still run has any result."""


def evaluate(jaxpr, consts, args):
    """Return (outs, continuous): enclosures of the outputs of a jaxpr.

    Args:
        jaxpr, consts: as in a ClosedJaxpr.
        args: an array (exact) or an Interval for each input.

    Returns:
        outs: an array or an Interval for each output. continuous: True, or a boolean array (): proved over all of args.

    Encloses: the real function that the jaxpr writes down, its constants being the floats they are.
    """
    env = dict(zip(jaxpr.constvars, map(_constant, consts), strict=True)) | dict(zip(jaxpr.invars, args, strict=True))
    read = lambda v: _constant(np.asarray(v.val, v.aval.dtype)) if isinstance(v, Literal) else env[v]
    continuous = True
    for eqn in jaxpr.eqns:
        outs, fine = _apply(eqn, [read(v) for v in eqn.invars])
        env.update(zip(eqn.outvars, outs, strict=True))
        continuous = continuous & fine
    return [read(v) for v in jaxpr.outvars], continuous


def body(eqn):
    """Return the ClosedJaxpr that a call evaluates, or None."""
    if eqn.primitive.name not in CALLS:
        return None
    inner = next(eqn.params[k] for k in ("jaxpr", "call_jaxpr", "fun_jaxpr") if k in eqn.params)
    return inner if isinstance(inner, ClosedJaxpr) else ClosedJaxpr(inner, ())


def bind(eqn, *values, **changed):
    """Apply the primitive of an equation to numbers; always a list of outputs."""
    out = eqn.primitive.bind(*values, **{**eqn.params, **changed})
    return out if eqn.primitive.multiple_results else [out]


def refuse_unsupported(jaxpr, name, advice):
    """Raise one error that names everything in a jaxpr that has no rule."""
    missing, types = set(), set()
    _collect(jaxpr, missing, types)
    if types:
        raise NotImplementedError(f"inclusion works in float32 and float64, but {name} computes in {', '.join(sorted(types))}")
    if missing:
        word = "primitive" if len(missing) == 1 else "primitives"
        raise NotImplementedError(f"inclusion has no rule for the {word} {', '.join(sorted(missing))}, used by {name}: {advice}")


def _collect(jaxpr, missing, types):
    for eqn in jaxpr.eqns:
        name, variables = eqn.primitive.name, [v.aval for v in (*eqn.invars, *eqn.outvars)]
        types |= {str(a.dtype) for a in variables if _inexact(a) and a.dtype not in (np.float32, np.float64)}
        inner = [*_jaxprs(eqn.params)] if name in CONTROL else [body(eqn)] if body(eqn) else None
        if inner is not None:
            for part in inner:
                _collect(part.jaxpr, missing, types)
        elif any(map(_inexact, variables)) and (not any(name in t for t in (MOVED, RISING, RULES, POINTWISE)) or _by_key(eqn)):
            missing.add(name)


def _by_key(eqn):
    """True for a sort that moves other arrays along."""
    return eqn.primitive.name == "sort" and len(eqn.invars) > 1


def _jaxprs(params):
    for value in params.values():
        yield from (v for v in (value if isinstance(value, tuple) else (value,)) if isinstance(v, ClosedJaxpr))


def _inexact(aval):
    return hasattr(aval, "dtype") and jnp.issubdtype(aval.dtype, jnp.inexact)


def _constant(x):
    """Return a constant as itself if floats can say it, as an Interval otherwise (NaN: empty; a subnormal number; unknown yet)."""
    if isinstance(x, Interval) or not jnp.issubdtype(x.dtype, jnp.floating):
        return x
    if isinstance(x, jax.core.Tracer):
        return settled(x)
    host = np.asarray(x)
    plain = (np.abs(host) >= np.finfo(host.dtype).tiny) | (host == 0)
    return host if plain.all() else settled(jnp.asarray(host))


def _apply(eqn, values):
    """Return (outs, continuous) of one equation."""
    name, inner = eqn.primitive.name, body(eqn)
    if inner is not None:
        return evaluate(inner.jaxpr, inner.consts, values)
    if name in CONTROL:
        return CONTROL[name](values, eqn.params)
    if not any(isinstance(v, Interval) for v in values) and _exact(eqn):
        return bind(eqn, *values), True
    if name in MOVED:
        return _moved(eqn, values), True
    about = {**eqn.params, "bind": lambda *v: bind(eqn, *v)[0], "numbers": [_number(v) for v in values]}
    about |= {"known": [not isinstance(v, Interval) for v in values], "same": len(values) == 2 and eqn.invars[0] is eqn.invars[1]}
    sets = [v if name == "scatter-add" and i == 1 else enclose(v) for i, v in enumerate(values)]
    if name in RISING and not _by_key(eqn):
        outs = [Interval(*ends) for ends in zip(bind(eqn, *(v.lo for v in sets)), bind(eqn, *(v.hi for v in sets)), strict=True)]
    elif name in (rules := WHOLE if whole(sets[0]) else RULES):
        outs = [rules[name](*sets, **about)]
    else:
        kind = "integers or predicates" if whole(sets[0]) else "numbers"
        raise NotImplementedError(
            f"inclusion has no rule for the primitive {name} of {kind} that depend on an interval: write it with others"
        )
    return outs, jnp.all(CONTINUOUS[name](enclose(outs[0]), *sets, **about)) if name in CONTINUOUS else True


def _exact(eqn):
    """True if a primitive of numbers is computed without rounding."""
    name, avals = eqn.primitive.name, [v.aval for v in (*eqn.invars, *eqn.outvars)]
    if name in MOVED or name in RISING or name in POINTWISE or not any(map(_inexact, avals)):
        return True
    if name != "convert_element_type":
        return False
    old, new = avals
    return not _inexact(new) or old.dtype == bool or _inexact(old) and new.dtype.itemsize >= old.dtype.itemsize or _small(eqn.invars[0])


def _small(v):
    return isinstance(v, Literal) and abs(v.val) <= 2**24


def _number(value):
    """Return a value as a float if it is one number that is known while tracing, else None."""
    return float(value.ravel()[0]) if isinstance(value, np.ndarray | np.generic) and value.size == 1 else None


def _moved(eqn, values):
    """Move the lower and the upper bounds alike."""
    places = MOVED[eqn.primitive.name]
    moved = range(len(values)) if places is None else places
    if any(isinstance(v, Interval) for i, v in enumerate(values) if i not in moved):
        raise NotImplementedError(f"inclusion cannot follow {eqn.primitive.name} where an index depends on an interval: use jnp.where")
    ready = [enclose(v) if i in moved else v for i, v in enumerate(values)]
    ends = (bind(eqn, *(getattr(v, end) if i in moved else v for i, v in enumerate(ready))) for end in ("lo", "hi"))
    return [Interval(*pair) for pair in zip(*ends, strict=True)]


def _as(value, kind):
    """Return `value` in the form of `kind`: an Interval if that is one, of its type."""
    value = enclose(value) if isinstance(kind, Interval) else value
    return jax.tree.map(lambda v, k: jax.lax.convert_element_type(v, k.dtype), value, kind)


def _steady(step, carry):
    """Return the carry of a loop in a form that its step keeps: an Interval wherever one can arise."""
    carry = [enclose(c) if _inexact(c) else c for c in carry]
    while True:
        after = jax.eval_shape(step, carry)
        grown = [enclose(c) if isinstance(a, Interval) else c for c, a in zip(carry, after, strict=True)]
        if all(type(c) is type(g) for c, g in zip(carry, grown, strict=True)):
            return [jax.tree.map(jnp.asarray, c) for c in grown]
        carry = grown


def _scan(values, params):
    consts, carry, xs = _split(values, *_counts(params))
    inner = params["jaxpr"]
    one = lambda carry, x: evaluate(inner.jaxpr, inner.consts, [*consts, *carry, *x])
    x = jax.tree.map(lambda v: jax.ShapeDtypeStruct(v.shape[1:], v.dtype), xs)
    carry = _steady(lambda carry: one(carry, jax.tree.map(lambda v: jnp.zeros(v.shape, v.dtype), x))[0][: len(carry)], carry)

    def step(carry, x):
        outs, fine = one(carry, x)
        return [_as(o, c) for o, c in zip(outs, carry, strict=False)], (outs[len(carry) :], jnp.asarray(fine))

    carry, (ys, fine) = jax.lax.scan(step, carry, xs, params["length"], params["reverse"])
    return [*carry, *ys], jnp.all(fine)


def _counts(params):
    """Return how many of the values of a scan are constants, and how many are its carry; jax 0.12 says it in another form."""
    if "num_consts" in params:
        return params["num_consts"], params["num_carry"]
    consts, carry, _ = params["ft_in"].unpack()
    return len(consts), len(carry)


def _split(values, *counts):
    out = []
    for n in counts:
        out.append(values[:n])
        values = values[n:]
    return *out, values


def _while(values, params):
    """Follow a loop; where its end depends on an interval, collect every state in which it may stop."""
    cond_consts, body_consts, carry = _split(values, params["cond_nconsts"], params["body_nconsts"])
    cond, inner = params["cond_jaxpr"], params["body_jaxpr"]
    test = lambda carry: evaluate(cond.jaxpr, cond.consts, [*cond_consts, *carry])[0][0]
    step = lambda carry: evaluate(inner.jaxpr, inner.consts, [*body_consts, *carry])
    carry = _steady(lambda c: step(c)[0], carry)
    if not isinstance(jax.eval_shape(test, carry), Interval):

        def turn(state):
            outs, fine = step(state[0])
            return [_as(o, c) for o, c in zip(outs, state[0], strict=True)], state[1] & fine

        return jax.lax.while_loop(lambda state: test(state[0]), turn, (carry, jnp.asarray(True)))
    carry = [enclose(c) for c in carry]

    def follow(state):
        carry, ended, fine, count = state
        going = test(carry)
        outs, continuous = step(carry)
        ended = [_hull_where(~going.lo, c, e) for c, e in zip(carry, ended, strict=True)]
        fine = fine & continuous & (going.lo == going.hi)
        return [_as(o, c) for o, c in zip(outs, carry, strict=True)], ended, fine, count + 1

    nothing = [Interval(jnp.full_like(c.lo, most(c.dtype)), jnp.full_like(c.hi, least(c.dtype))) for c in carry]
    running = lambda state: test(state[0]).hi & (state[3] < LOOPS)
    carry, ended, fine, _ = jax.lax.while_loop(running, follow, (carry, nothing, jnp.asarray(True), 0))
    going = test(carry)
    ended = [_hull_where(~going.lo, c, e) for c, e in zip(carry, ended, strict=True)]
    anything = [Interval(jnp.full_like(c.lo, least(c.dtype)), jnp.full_like(c.hi, most(c.dtype))) for c in carry]
    return [_hull_where(going.hi, a, e) for a, e in zip(anything, ended, strict=True)], fine & ~going.hi


def _hull_where(possible, x, y):
    """Return the hull of y and, where possible, x."""
    joined = Interval(jnp.minimum(x.lo, y.lo), jnp.maximum(x.hi, y.hi))
    return jax.tree.map(lambda j, e: jnp.where(possible, j, e), joined, y)


def _cond(values, params):
    index, operands = values[0], values[1:]
    branches = [lambda ops, b=b: evaluate(b.jaxpr, b.consts, ops) for b in params["branches"]]
    if isinstance(index, Interval):
        found = [branch(operands) for branch in branches]
        outs = [RULES["select_n"](index, *map(enclose, cases)) for cases in zip(*(outs for outs, _ in found), strict=True)]
        return outs, functools.reduce(operator.and_, (fine for _, fine in found), index.lo == index.hi)
    shapes = [jax.eval_shape(lambda ops, b=b: b(ops)[0], operands) for b in branches]
    sets = [any(isinstance(o, Interval) or _inexact(o) for o in outs) for outs in zip(*shapes, strict=True)]

    def chosen(branch):
        def run(ops):
            outs, fine = branch(ops)
            return [enclose(o) if s else jnp.asarray(o) for o, s in zip(outs, sets, strict=True)], jnp.asarray(fine)

        return run

    return jax.lax.switch(index, list(map(chosen, branches)), operands)


CONTROL = {"scan": _scan, "while": _while, "cond": _cond}
