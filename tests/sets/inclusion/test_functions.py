"""A function written once more is found again; one that reads another value is another function."""

import functools
import importlib
import types

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbound as jb
from jaxbound.sets import pave
from jaxbound.sets.inclusion import functions
from jaxbound.sets.inclusion.functions import frozen
from jaxbound.sets.intervals.interval import interval

FACTOR = 2.0
WEIGHTS = np.array([1.0, 2.0])
BOX = interval([1.0, 2.0], [1.0, 2.0])


def helper(z):
    return FACTOR * z[0]


def twice(g):
    return lambda z: g(z) + g(z)


def value(f):
    """Return what f is at (1, 2), by an inclusion of it."""
    y = jb.inclusion(f)(BOX)
    assert abs(float(y.hi - y.lo)) < 1e-9
    return round(float(y.lo), 6)


def programs(caplog):
    return [m for m in caplog.messages if m.startswith("Finished XLA compilation")]


def verbs():
    """Return {verb: of k, a call with a function that is written anew}."""
    near = {"x": 0.2, "u": 0.1}
    y = [[1.0], [1.05], [1.3], [2.0]]
    return {
        "inclusion": lambda k: jb.inclusion(lambda z: k * z[0] + jnp.sin(z[1]))(BOX).lo,
        "pave": lambda k: (
            pave(lambda z: [k * z[0] + z[1]], interval([0.0, 0.0], [1.0, 1.0]), [2.0], q=3).evaluated
        ),
        "linearize": lambda k: (
            jb.linearize(lambda x, u: jnp.array([0.5 * u[0] - k * x[0] ** 2]), [1.0], [0.5], region=near).A
        ),
        "residual": lambda k: (
            jb.detect(
                jb.residual(
                    lambda z, u, y: y[1, 0] - (k + z[0]) * y[0, 0], interval([-0.1], [0.1]), horizon=1
                ),
                None,
                y,
            ).status
        ),
    }


@pytest.mark.compiled
@pytest.mark.parametrize(
    "verb",
    ["inclusion", "pave", *(pytest.param(v, marks=pytest.mark.long) for v in ("linearize", "residual"))],
)
def test_a_lambda_written_again_compiles_nothing(verb, caplog):
    call = verbs()[verb]
    first = call(1.0)
    with jax.log_compiles():
        again = call(1.0)
        assert not programs(caplog), programs(caplog)
        other = call(1.5)
    assert np.array_equal(np.asarray(first), np.asarray(again))
    assert programs(caplog) and not np.array_equal(np.asarray(first), np.asarray(other))


def test_another_value_anywhere_gives_its_own_answer(monkeypatch):
    """Closure, default, keyword default, global, global of a function that is called, argument of a partial,
    entry of an array: each of them may change between two calls of what looks the same.
    """
    times = lambda k: lambda z: k * z[0]
    nested = lambda k: lambda z: sum((lambda v: k * v)(v) for v in (z[0], z[1]))
    assert [value(times(k)) for k in (1.0, 1.0, 3.0)] == [1, 1, 3]
    assert [value(twice(times(k))) for k in (1.0, 3.0)] == [2, 6]
    assert [value(nested(k)) for k in (1.0, 3.0)] == [3, 9]
    assert [value(lambda z, k=k: k * z[0]) for k in (1.0, 3.0)] == [1, 3]
    assert [value(lambda z, *, k=k: k * z[0]) for k in (1.0, 3.0)] == [1, 3]
    assert [value(functools.partial(lambda a, z: a * z[0], k)) for k in (1.0, 3.0)] == [1, 3]
    assert [value(functools.partial(lambda z, a: a * z[0], a=k)) for k in (1.0, 3.0)] == [1, 3]
    seen = []
    for factor in (2.0, 5.0):
        monkeypatch.setitem(globals(), "FACTOR", factor)
        seen += [value(lambda z: FACTOR * z[1]), value(helper), value(lambda z: helper(z) + z[1])]
    assert seen == [4, 2, 4, 10, 5, 7]
    weights = np.array([1.0, 2.0])
    weighted = lambda z: jnp.sum(jnp.asarray(weights) * z)
    assert value(weighted) == 5
    weights[1] = 4
    assert value(weighted) == 9


def test_the_copy_knows_nothing_of_what_changes_later():
    """A new shape traces anew: by the values that the function was found with."""
    first, second = np.array([2.0]), np.array([2.0])
    make = lambda weights: frozen(lambda z: jnp.sum(z) * weights[0])
    one, same = make(first), make(second)
    assert one is same
    first[0] = 7
    assert same(np.ones(3)) == 6 and make(second) is same and make(first) is not same


@pytest.mark.parametrize(
    "pair",
    [
        (0.0, -0.0),
        (1, 1.0),
        (1, True),
        (np.float32(1), np.float64(1)),
        ((1,), (1.0,)),
        ("a", b"a"),
        (1, 1 + 0j),
    ],
    ids=str,
)
def test_values_that_only_compare_equal_are_told_apart(pair):
    one, other = (frozen(lambda z, k=k: (z, k)) for k in pair)
    assert one is not other
    for f, k in zip((one, other), pair, strict=True):
        assert repr(f(0)[1]) == repr(k)


def test_numbers_that_are_not_equal_to_themselves_are_found():
    make = lambda: frozen(lambda z, k=float("nan"): k)
    assert make() is make()


class Counter:
    def __init__(self):
        self.factor = 1.0

    def __call__(self, z):
        return self.factor * z[0]

    def method(self, z):
        return self.factor * z[0]


def test_what_may_change_unseen_is_left_as_it_is():
    values, count, thing = [2.0], 0, Counter()
    module = types.ModuleType("plant")
    module.gain = 2.0

    def counting(z):
        nonlocal count
        count += 1
        return z[0]

    def inner(z):
        def deeper():
            nonlocal count
            count += 1

        deeper()
        return z[0]

    def writing(z):
        global FACTOR
        FACTOR = 3.0
        return z[0]

    attributes = lambda z: attributes.gain * z[0]
    attributes.gain = 2.0
    draws = np.random.default_rng(0)
    functions_ = [
        lambda z: values[0] * z[0],
        lambda z: thing.factor * z[0],
        lambda z: module.gain * z[0],
        lambda z: draws.normal() * z[0],
        lambda z: np.random.default_rng(0).normal() * z[0],
        lambda z: globals()["FACTOR"] * z[0],
        lambda z: not_there * z[0],  # noqa: F821
        counting,
        inner,
        writing,
        attributes,
        thing,
        thing.method,
        jax.jit(lambda z: FACTOR * z[0]),
        functools.lru_cache(lambda z: FACTOR * z[0]),
    ]
    for number, f in enumerate(functions_):
        assert frozen(f) is f, number
    user_jit = jax.jit(helper)
    kept = lambda z: user_jit(z)
    assert frozen(kept) is kept
    traced = []
    jax.make_jaxpr(lambda k: traced.append((g := lambda z: k * z[0], frozen(g))))(1.0)
    assert traced[0][0] is traced[0][1]


@pytest.mark.compiled
def test_programs_of_many_functions_are_forgotten(monkeypatch):
    monkeypatch.setattr(functions, "KEPT", 5)
    functions._kept.clear()
    enclose = importlib.import_module("jaxbound.sets.inclusion.inclusion")._enclose
    enclose.clear_cache()
    most = 0
    for k in range(12):
        assert value(lambda z, k=float(k): k * z[0]) == k
        most = max(most, enclose._cache_size())
    assert len(functions._kept) <= 5
    assert 0 < most <= 7


def test_a_thousand_functions_leave_a_bounded_number():
    for k in range(1000):
        frozen(lambda z, k=k: k * z)
    assert 0 < len(functions._kept) <= functions.KEPT
