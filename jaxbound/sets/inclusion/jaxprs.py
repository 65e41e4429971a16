"""Evaluate the jaxpr of a function over Intervals: equation by equation, through calls, branches and loops.

Beside the enclosures, every evaluation says whether it proved the function defined and continuous over the
box: derivatives speak about a function only there. It also follows where a number may be NaN (`undefined`),
which comparisons, is_finite and conversions observe: a program may turn NaN back into a number.
"""

import functools
import operator
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import Jaxpr, JaxprEqn, Literal

from jaxbound.sets.floats import rounding
from jaxbound.sets.floats.equations import bind, body, by_key, dtype_of, inexact, inner_jaxprs
from jaxbound.sets.inclusion.lifted import enclose, settled
from jaxbound.sets.inclusion.predicates import least, most, whole
from jaxbound.sets.inclusion.primitives import DEFINED, MOVED, RISING, RULES, STEADY, WHOLE
from jaxbound.sets.inclusion.tables import INTERP, is_interp
from jaxbound.sets.inclusion.undefined import OBSERVED, either, observes, possible
from jaxbound.sets.intervals.interval import Interval, computed

POINTWISE = {
    "abs",
    "neg",
    "max",
    "min",
    "select_n",
    "iota",
    "bitcast_convert_type",
    "argmax",
    "argmin",
    "is_finite",
}  # exact on numbers
LOOPS = 10_000
"""A while loop whose end depends on an interval is followed this far; one that may still run has any
result.
"""


Value: TypeAlias = Interval | jax.Array | np.ndarray


def evaluate(
    jaxpr: Jaxpr, consts: Sequence[Any], args: Sequence[Value]
) -> tuple[list[Value], bool | jax.Array]:
    """Return (outs, continuous): enclosures of the outputs of a jaxpr.

    Args:
        jaxpr, consts: as in a ClosedJaxpr.
        args: an array (exact) or an Interval for each input.

    Returns:
        outs: an array or an Interval for each output. continuous: True, or a boolean array (): proved over
            all of args.

    Encloses: the real function that the jaxpr writes down, its constants being the floats they are.
    """
    absent = [None if isinstance(x, Interval) else _absent(x) for x in args]
    outs, _, continuous = _follow(jaxpr, consts, [_door(x) for x in args], absent)
    return outs, continuous


def _door(x: Value) -> Value:
    """Return an argument that compiled code reads as it is; a bound that is NaN bounds nothing."""
    return computed(*rounding.readable_bounds(x.lo, x.hi)) if isinstance(x, Interval) and not whole(x) else x


def _follow(jaxpr, consts, args, absent):
    """Return (outs, absent, continuous).

    absent: None, or a boolean array (), True where a number of it may be NaN, for each of args and outs; what
    nobody observes is left out of a program that is compiled. The bounds of args are settled, whatever a loop
    or a branch made of them.
    """
    # a branch or a loop made these bounds: read once, as compiled code reads them
    args = [_computed(x) if isinstance(x, Interval) else x for x in args]
    known = lambda x: (_constant(x), _absent(x))
    env = dict(zip(jaxpr.constvars, map(known, consts), strict=True)) | dict(
        zip(jaxpr.invars, zip(args, absent, strict=True), strict=True)
    )
    read = lambda v: known(np.asarray(v.val, dtype_of(v))) if isinstance(v, Literal) else env[v]
    continuous = True
    for eqn in jaxpr.eqns:
        values, missing = zip(*map(read, eqn.invars), strict=True) if eqn.invars else ((), ())
        outs, found, fine = _apply(eqn, list(values), list(missing))
        env.update(zip(eqn.outvars, zip(outs, found, strict=True), strict=True))
        # a chain of continuous steps is continuous; one that may jump spoils all behind it
        continuous = continuous & fine
    outs, absent = zip(*map(read, jaxpr.outvars), strict=True) if jaxpr.outvars else ((), ())
    return list(outs), list(absent), continuous


def _absent(x):
    """Return whether a constant may hold NaN, None if it holds none."""
    if isinstance(x, Interval) or not jnp.issubdtype(x.dtype, jnp.floating):
        return None
    if isinstance(x, jax.core.Tracer):
        return jnp.any(jnp.isnan(x))
    return jnp.asarray(True) if np.isnan(np.asarray(x)).any() else None


def refuse_unsupported(jaxpr: Jaxpr, name: str, advice: str) -> None:
    """Raise one error that names everything in a jaxpr that has no rule."""
    missing: set[str] = set()
    types: set[str] = set()
    _collect(jaxpr, missing, types)
    if types:
        raise NotImplementedError(
            f"inclusion works in float32 and float64, but {name} computes in {', '.join(sorted(types))}"
        )
    if missing:
        word = "primitive" if len(missing) == 1 else "primitives"
        raise NotImplementedError(
            f"inclusion has no rule for the {word} {', '.join(sorted(missing))}, used by {name}: {advice}"
        )


def _collect(jaxpr: Jaxpr, missing: set[str], types: set[str]) -> None:
    for eqn in jaxpr.eqns:
        name, variables = eqn.primitive.name, (*eqn.invars, *eqn.outvars)
        floats = [dtype_of(v) for v in variables if inexact(v.aval)]
        types |= {str(d) for d in floats if d not in (np.float32, np.float64)}
        if is_interp(eqn):  # as a whole, whatever JAX makes of it
            continue
        inner = inner_jaxprs(eqn)
        if inner is not None:
            for part in inner:
                _collect(part.jaxpr, missing, types)
        elif floats and (not any(name in t for t in (MOVED, RISING, RULES, POINTWISE)) or by_key(eqn)):
            missing.add(name)


def _constant(x):
    """Return a constant as itself if floats can say it, as an Interval otherwise (NaN, infinite, subnormal,
    unknown yet).
    """
    if isinstance(x, Interval) or not jnp.issubdtype(x.dtype, jnp.floating):
        return x
    if isinstance(x, jax.core.Tracer):
        return settled(x)
    host = np.asarray(x)
    plain = (np.abs(host) >= np.finfo(host.dtype).tiny) & np.isfinite(host) | (host == 0)
    return host if plain.all() else settled(jnp.asarray(host))


def _apply(eqn, values, absent):
    """Return (outs, absent, continuous) of one equation."""
    name, inner = eqn.primitive.name, body(eqn)
    if is_interp(eqn):
        name = INTERP
    elif inner is not None:
        return _follow(inner.jaxpr, inner.consts, values, absent)
    if name in CONTROL:
        return CONTROL[name](values, absent, eqn.params)
    if not any(isinstance(v, Interval) for v in values) and _exact(eqn):
        outs = bind(eqn, *values)
        made = name == "bitcast_convert_type" and inexact(
            eqn.outvars[0].aval
        )  # any bits: NaN, infinite and subnormal numbers too
        return (
            [settled(o) for o in outs] if made else outs,
            [jnp.any(jnp.isnan(o)) if made else None for o in outs],
            True,
        )
    about = {**eqn.params, "bind": lambda *v: bind(eqn, *v)[0], "numbers": [_number(v) for v in values]}
    about |= {
        "known": [not isinstance(v, Interval) for v in values],
        "same": len(values) == 2 and eqn.invars[0] is eqn.invars[1],
    }
    if name in MOVED:
        return _moved(eqn, values, absent)
    sets = [v if name == "scatter-add" and i == 1 else enclose(v) for i, v in enumerate(values)]
    if name == "sort":  # NaN comes last, infinities at the ends
        loose = lambda x, a: Interval(jnp.where(a, -jnp.inf, x.lo), jnp.where(a, jnp.inf, x.hi))
        sets = [x if a is None else loose(x, a) for x, a in zip(sets, absent, strict=True)]
    if name in RISING and not by_key(eqn):
        outs = [
            Interval(*ends)
            for ends in zip(bind(eqn, *(v.lo for v in sets)), bind(eqn, *(v.hi for v in sets)), strict=True)
        ]
    elif name in (rules := WHOLE if whole(sets[0]) else RULES):
        outs = [rules[name](*sets, **about)]
    else:
        kind = "integers or predicates" if whole(sets[0]) else "numbers"
        raise NotImplementedError(
            f"inclusion has no rule for the primitive {name} of {kind} that depend on an interval: write it "
            f"with others"
        )
    if name in OBSERVED and observes(eqn) and any(a is not None for a in absent):
        outs = [OBSERVED[name](enclose(outs[0]), sets, absent, **about)]
    asked = [table[name] for table in (DEFINED, STEADY) if name in table]
    doubt = either(*(~jnp.all(condition(enclose(outs[0]), *sets, **about)) for condition in asked))
    shown = [_computed(o) if isinstance(o, Interval) and not whole(o) else o for o in outs]
    found = [
        possible(name, enclose(o), sets, absent, about) if inexact(v.aval) else None
        for o, v in zip(outs, eqn.outvars, strict=True)
    ]
    return shown, found, True if doubt is None else ~doubt


def _computed(x: Interval) -> Interval:
    return computed(x.lo, x.hi)


def _exact(eqn: JaxprEqn) -> bool:
    """Return whether a primitive of numbers is computed without rounding."""
    name, avals = eqn.primitive.name, [v.aval for v in (*eqn.invars, *eqn.outvars)]
    if name in MOVED or name in RISING or name in POINTWISE or not any(map(inexact, avals)):
        return True
    if name != "convert_element_type":
        return False
    (x,), (y,) = eqn.invars, eqn.outvars
    old, new = dtype_of(x), dtype_of(y)
    return (
        not inexact(y.aval)
        or jnp.issubdtype(old, jnp.bool_)
        or inexact(x.aval)
        and new.itemsize >= old.itemsize
        or _small(x)
    )


def _small(v):
    return isinstance(v, Literal) and abs(v.val) <= 2**24


def _number(value: object) -> float | None:
    """Return a value as a float if it is one number that is known while tracing, else None."""
    return float(value.ravel()[0]) if isinstance(value, np.ndarray | np.generic) and value.size == 1 else None


def _moved(eqn, values, absent):
    """Move the lower and the upper bounds alike, and where they may be NaN; a gather beyond the end fills
    with NaN.
    """
    places = MOVED[eqn.primitive.name]
    moved = range(len(values)) if places is None else places
    if any(isinstance(v, Interval) for i, v in enumerate(values) if i not in moved):
        raise NotImplementedError(
            f"inclusion cannot follow {eqn.primitive.name} where an index depends on an interval: use "
            f"jnp.where"
        )
    # what says where things go is no set
    ready = [enclose(v) if i in moved else v for i, v in enumerate(values)]
    lower, upper = (
        bind(eqn, *(getattr(v, end) if i in moved else v for i, v in enumerate(ready)))
        for end in ("lo", "hi")
    )
    outs = [Interval(*pair) for pair in zip(lower, upper, strict=True)]
    floating = [inexact(v.aval) for v in eqn.outvars]
    found = either(*(a for i, a in enumerate(absent) if i in moved))
    if (
        eqn.primitive.name == "gather"
        and floating[0]
        and eqn.params["mode"] == jax.lax.GatherScatterMode.FILL_OR_DROP
    ):
        gone = [jnp.isnan(o.lo) for o in outs]
        outs = [
            Interval(jnp.where(g, jnp.inf, o.lo), jnp.where(g, -jnp.inf, o.hi))
            for o, g in zip(outs, gone, strict=True)
        ]
        found = either(found, *map(jnp.any, gone))
    shown = [_computed(o) if f else o for o, f in zip(outs, floating, strict=True)]
    return shown, [found if f else None for f in floating], True


def _as(value, kind):
    """Return `value` in the form of `kind`: an Interval if that is one, of its type."""
    value = enclose(value) if isinstance(kind, Interval) else value
    return jax.tree.map(lambda v, k: jax.lax.convert_element_type(v, k.dtype), value, kind)


def _steady(step, carry):
    """Return the carry of a loop in a form that its step keeps: an Interval wherever one can arise."""
    carry = [enclose(c) if inexact(c) else c for c in carry]
    while True:
        after = jax.eval_shape(step, carry)
        grown = [enclose(c) if isinstance(a, Interval) else c for c, a in zip(carry, after, strict=True)]
        if all(type(c) is type(g) for c, g in zip(carry, grown, strict=True)):
            return [jax.tree.map(jnp.asarray, c) for c in grown]
        # each round makes one more of them an Interval: it ends with the last
        carry = grown


def _marked(values, absent):
    """Return the mark of each value of a loop's carry; None for values that are never NaN."""
    return [
        jnp.asarray(False if a is None else a) if inexact(v) else None
        for v, a in zip(values, absent, strict=True)
    ]


def _scan(values, absent, params):
    (consts, carry, xs), (no_consts, no_carry, no_xs) = (
        _split_values(v, *_scan_counts(params)) for v in (values, absent)
    )
    inner, count = params["jaxpr"], len(carry)
    one = lambda carry, x, away: _follow(
        inner.jaxpr, inner.consts, [*consts, *carry, *x], [*no_consts, *away, *no_xs]
    )
    # any slice will do: types and forms are all that is looked at
    first = jax.tree.map(lambda v: jnp.zeros(v.shape[1:], v.dtype), xs)
    carry = _steady(lambda carry: one(carry, first, _marked(carry, [None] * count))[0][:count], carry)

    def step(state, x):
        carry, away = state
        outs, found, fine = one(carry, x, away)
        after = [_as(o, c) for o, c in zip(outs, carry, strict=False)], _marked(carry, found[:count])
        return after, (outs[count:], _marked(outs[count:], found[count:]), jnp.asarray(fine))

    start = carry, _marked(carry, no_carry)
    (carry, away), (ys, found, fine) = jax.lax.scan(step, start, xs, params["length"], params["reverse"])
    return [*carry, *ys], [*away, *jax.tree.map(jnp.any, found)], jnp.all(fine)


def _scan_counts(params):
    """Return how many of the values of a scan are constants, and how many are its carry; jax 0.12 says it in
    another form.
    """
    if "num_consts" in params:
        return params["num_consts"], params["num_carry"]
    consts, carry, _ = params["ft_in"].unpack()
    return len(consts), len(carry)


def _split_values(values, *counts):
    out = []
    for n in counts:
        out.append(values[:n])
        values = values[n:]
    return *out, values


def _while(values, absent, params):
    """Follow a loop; where its end depends on an interval, collect every state in which it may stop. Under
    vmap each entry ends alone.
    """
    counts = params["cond_nconsts"], params["body_nconsts"]
    (cond_consts, body_consts, carry), (no_cond, no_body, away) = (
        _split_values(v, *counts) for v in (values, absent)
    )
    cond, inner = params["cond_jaxpr"], params["body_jaxpr"]
    test = lambda carry, away: _follow(cond.jaxpr, cond.consts, [*cond_consts, *carry], [*no_cond, *away])[0][
        0
    ]
    step = lambda carry, away: _follow(inner.jaxpr, inner.consts, [*body_consts, *carry], [*no_body, *away])
    nowhere = lambda carry: _marked(carry, [None] * len(carry))
    carry = _steady(lambda c: step(c, nowhere(c))[0], carry)
    away = _marked(carry, away)

    def turn(going, carry, away):
        """Return the state after one more step of the entries that may go on; a mark stays."""
        outs, found, fine = step(carry, away)
        outs = [_where(going, _as(o, c), c) for o, c in zip(outs, carry, strict=True)]
        return outs, _also(away, _marked(carry, found)), fine

    if not isinstance(jax.eval_shape(test, carry, away), Interval):

        def once(state):
            carry, away, fine = turn(test(*state[:2]), *state[:2])
            return carry, away, state[2] & fine

        carry, away, fine = jax.lax.while_loop(
            lambda state: jnp.any(test(*state[:2])), once, (carry, away, jnp.asarray(True))
        )
        return carry, away, fine
    carry = [enclose(c) for c in carry]
    away = _marked(carry, away)

    def stopped(going, carry, ended):
        """Add the states in which the loop may stop to those that were met before."""
        return [_hull_where(~going.lo, c, e) for c, e in zip(carry, ended, strict=True)]

    def follow(state):
        carry, away, ended, fine, count = state
        going = test(carry, away)
        ended = stopped(going, carry, ended)
        carry, away, continuous = turn(going.hi, carry, away)
        return carry, away, ended, fine & continuous & jnp.all(going.lo == going.hi), count + 1

    # empty intervals, which a hull leaves alone
    nothing = [
        Interval(jnp.full_like(c.lo, most(c.dtype)), jnp.full_like(c.hi, least(c.dtype))) for c in carry
    ]
    running = lambda state: jnp.any(test(*state[:2]).hi) & (state[4] < LOOPS)
    start = carry, away, nothing, jnp.asarray(True), 0
    carry, away, ended, fine, _ = jax.lax.while_loop(running, follow, start)
    going = test(carry, away)
    ended = stopped(going, carry, ended)
    # a loop that is still going after so many turns may end in anything
    anything = [
        Interval(jnp.full_like(c.lo, least(c.dtype)), jnp.full_like(c.hi, most(c.dtype))) for c in carry
    ]
    ended = [_hull_where(going.hi, a, e) for a, e in zip(anything, ended, strict=True)]
    return ended, _also(away, [jnp.any(going.hi)] * len(away)), fine & ~jnp.any(going.hi)


def _also(marks, others):
    """Return marks that are set where others are, too."""
    return [None if m is None else m | other for m, other in zip(marks, others, strict=True)]


def _where(chosen, x, y):
    """Choose x or y; the axes of `chosen` are the first ones of theirs."""
    return jax.tree.map(
        lambda a, b: jnp.where(jnp.expand_dims(chosen, tuple(range(chosen.ndim, jnp.ndim(a)))), a, b), x, y
    )


def _hull_where(possible, x, y):
    """Return the hull of y and, where possible, x."""
    return _where(possible, Interval(jnp.minimum(x.lo, y.lo), jnp.maximum(x.hi, y.hi)), y)


def _cond(values, absent, params):
    index, operands, away = values[0], values[1:], absent[1:]
    branches = [lambda ops, away, b=b: _follow(b.jaxpr, b.consts, ops, away) for b in params["branches"]]
    if isinstance(index, Interval):
        found = [branch(operands, away) for branch in branches]
        outs = [
            RULES["select_n"](index, *map(enclose, cases))
            for cases in zip(*(outs for outs, *_ in found), strict=True)
        ]
        gone = [either(*cases) for cases in zip(*(gone for _, gone, _ in found), strict=True)]
        return outs, gone, functools.reduce(operator.and_, (fine for *_, fine in found), index.lo == index.hi)
    shapes = [jax.eval_shape(lambda ops, b=b: b(ops, away)[0], operands) for b in branches]
    sets = [any(isinstance(o, Interval) or inexact(o) for o in outs) for outs in zip(*shapes, strict=True)]

    def chosen(branch):
        def run(ops, away):
            outs, gone, fine = branch(ops, away)
            outs = [enclose(o) if s else jnp.asarray(o) for o, s in zip(outs, sets, strict=True)]
            return outs, _marked(outs, gone), jnp.asarray(fine)

        return run

    return jax.lax.switch(index, list(map(chosen, branches)), operands, away)


CONTROL: dict[str, Callable[..., Any]] = {"scan": _scan, "while": _while, "cond": _cond}
