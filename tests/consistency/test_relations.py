"""Every family of relations, and every observer, has all members that verbs ask for, of their types."""

import inspect
from collections.abc import Mapping

import jax
import numpy as np
import pytest

import jaxbound as jb
from jaxbound.consistency import Observer, Relations, WindowTest
from jaxbound.consistency.interface import LinearRelations
from jaxbound.estimation import ValidationObserver

A, B, C = [[0.8, 1], [0, 0.2]], [[0], [1]], [[1, 0], [1, 1]]
BOUNDS = dict(tolerance=[0.02, 0.1], noise=[0.1, 0.01])
CERTAIN = jb.LinearSystem(A, B, C, **BOUNDS)
PUSHED = jb.LinearSystem(A, B, C, **BOUNDS, disturbance=([[1], [0.5]], 0.01))
AVERAGED = jb.LinearSystem(A, B, C, noise=[0.3, 0.2], averages={"y1": {3: 0.15}})
CONSTANT = jb.LinearSystem(A, B, C, **BOUNDS, constant_tolerance=True)
UNSURE = jb.LinearSystem(A, B, C, noise=0.1, uncertainties=[jb.Uncertainty("pole", A=[[0.1, 0], [0, 0]])])
MISSING_INPUT = jb.LinearSystem(A, B, C, **BOUNDS, unknown_inputs=[[1], [0]])
INTERVALS = jb.interval_system([[[0.89, 0.91]]], [[1]], [[1], [1]], noise=0.1)
SLOW, FAST = (jb.interval_system([[a]], [[1 - a]], [[1]], noise=0.1) for a in (0.9, 0.5))


def two_models():
    weights = lambda u: np.stack([u[..., 0] < 0, u[..., 0] >= 0], -1)
    return jb.MultiModel([SLOW, FAST], weights)


WINDOWS = {
    "certain": lambda: jb.parity_relations(CERTAIN),
    "searched": lambda: jb.parity_relations(PUSHED, 12),
    "disturbance": lambda: jb.parity_relations(PUSHED),
    "lags": lambda: jb.parity_relations(CERTAIN, lags=(0, 2, 5)),
    "averages": lambda: jb.parity_relations(AVERAGED, 4),
    "constant tolerance": lambda: jb.parity_relations(CONSTANT),
    "uncertain": lambda: jb.parity_relations(UNSURE),
    "unknown input": lambda: jb.parity_relations(MISSING_INPUT, 3),
    "residual": lambda: jb.residual(
        lambda z, u, y: y[0, 0] - z[0], jb.interval([0.0], [1.0]), inputs=(), outputs=("y1",)
    ),
    "bank": lambda: jb.structured_relations(CERTAIN),
    "redundancy": lambda: jb.redundancy(CERTAIN),
}
OBSERVERS = {
    "zonotope": lambda: jb.observer(PUSHED),
    "strips": lambda: jb.observer(PUSHED, method="strips"),
    "joint": lambda: jb.observer(PUSHED, method="joint"),
    "interval system": lambda: jb.observer(INTERVALS),
    "unknown input": lambda: jb.observer(MISSING_INPUT),
    "validation": lambda: ValidationObserver(INTERVALS),
    "validation of several models": lambda: ValidationObserver(two_models()),
}
DECLARED = {
    "horizon": int,
    "bounds": Mapping,
    "made": tuple | None,
    "methods": tuple,
    "lags": tuple | None,
    "notes": tuple,
    "searched": bool,
    "restart": bool,
    "latched": bool,
    "remembers": bool,
}
SIGNALS = {
    "inputs": tuple,
    "outputs": tuple,
    "m": int,
    "p": int,
    "columns": Mapping,
    "dt": float | int | None,
    "name": str,
}


@pytest.fixture(params=[*WINDOWS, *(f"observer, {name}" for name in OBSERVERS)])
def relations(request):
    name = request.param
    if name.startswith("observer, "):
        return OBSERVERS[name.removeprefix("observer, ")]()
    return WINDOWS[name]()


def test_a_family_has_every_declared_member_and_the_names_of_its_signals(relations):
    assert isinstance(relations, Relations)
    for name, kind in DECLARED.items():
        assert isinstance(getattr(relations, name), kind), name
    assert isinstance(relations.text(), str)
    for name, kind in SIGNALS.items():
        assert isinstance(getattr(relations.model, name), kind), name
    for signal in relations.model.outputs:
        assert relations.model.column(signal) and relations.model.unit(signal) == ""
    for name in ("recording", "test", "reading", "with_bounds", "external", "internal", "text"):
        declared = inspect.signature(getattr(Relations, name)).parameters
        stated = inspect.signature(getattr(type(relations), name)).parameters
        assert list(stated)[: len(declared)] == list(declared), name


def test_every_method_makes_a_test_and_no_other_does(relations):
    for method in relations.methods:
        test = relations.test(method, np.float64)
        assert isinstance(test, WindowTest | Observer) and test.method == method
        assert test.horizon == relations.horizon
    with pytest.raises(ValueError, match="method|neither"):
        relations.test("no such method", np.float64)


@pytest.mark.parametrize("name", OBSERVERS)
def test_an_observer_carries_a_pytree_of_arrays(name):
    watch = OBSERVERS[name]()
    leaves = jax.tree.leaves(watch.init())
    assert leaves and all(isinstance(np.asarray(leaf), np.ndarray) for leaf in leaves)
    assert watch.relations is watch and watch.remembers and watch.signals.inputs == watch.model.inputs


@pytest.mark.parametrize("name", WINDOWS)
def test_only_relations_with_exact_coefficients_are_linear(name):
    relations = WINDOWS[name]()
    linear = isinstance(relations, LinearRelations)
    assert linear == (name not in ("uncertain", "residual", "bank", "redundancy"))
    assert relations.searched == (linear and relations.frame is not None)
