"""Inputs are exact; where they are narrowed to float32, for float32 outputs or without x64, what they lose
raises no fault.
"""

import contextlib

import jax
import numpy as np
import pytest

import jaxbound as jb

LEVEL = 1e6  # float32 numbers around it are 0.06 apart
STEPS = 0.03 * np.arange(14)
DRIVEN = dict(A=[[0.5]], B=[[1]], C=[[1]], offset={"u": [1000000], "y": [0]})
PLANTS = {
    "certain": DRIVEN,
    "disturbance": DRIVEN | dict(disturbance=([[1]], "1e-9")),
    "constant tolerance": DRIVEN | dict(tolerance="1e-9", constant_tolerance=True),
    "uncertain": DRIVEN | dict(uncertainties=[jb.Uncertainty("a", A=[["1e-9"]])]),
}
TWICE = DRIVEN | dict(C=[[1], [1]], offset={"u": [1000000], "y": [0, 0]})


def no_fault(judge, outputs=1, off=True):
    """Judge x+ = 0.5 x + (u - LEVEL), y = x, without any error: u in float64 beside y in float32, and both in
    float64 with x64 off.

    off: whether x64 is tried off too, which compiles all again: the one door that narrows by it is that of
    all families.
    """
    x = [1.0]
    for v in STEPS[:-1]:
        x.append(0.5 * x[-1] + v)
    u, y = LEVEL + STEPS[:, None], np.repeat(np.array(x)[:, None], outputs, 1)
    for context, given in ((contextlib.nullcontext(), y.astype(np.float32)), (jax.enable_x64(False), y))[
        : 1 + off
    ]:
        with context:
            status = np.asarray(judge(u, given))
        assert not (status == jb.Status.FAULT).any(), status


def growth(z, u, y):
    return y[1, 0] - 0.5 * y[0, 0] - (u[0, 0] - LEVEL) - z[0]


def test_a_residual_does_not_take_narrowed_inputs_as_exact():
    no_fault(lambda u, y: jb.detect(jb.residual(growth, jb.interval([-1e-4], [1e-4]), 1), u, y).status)


@pytest.mark.parametrize("method", ["box"])
def test_no_method_takes_narrowed_inputs_as_exact(method):
    no_fault(
        lambda u, y: jb.detect(jb.parity_relations(jb.LinearSystem(**DRIVEN), 1), u, y, method=method).status
    )


@pytest.mark.parametrize("name, horizon", [*((name, 1) for name in PLANTS), ("certain", 10)])
def test_no_plant_takes_narrowed_inputs_as_exact(name, horizon):
    relations = jb.parity_relations(jb.LinearSystem(**PLANTS[name]), horizon)
    no_fault(lambda u, y: jb.detect(relations, u, y).status, off=name == "disturbance")


def test_a_bank_does_not_take_narrowed_inputs_as_exact():
    no_fault(
        lambda u, y: jb.detect(jb.structured_relations(jb.LinearSystem(**TWICE)), u, y).status, outputs=2
    )


def test_a_monitor_does_not_take_narrowed_inputs_as_exact():
    def judge(u, y):
        mon = jb.Monitor(jb.parity_relations(jb.LinearSystem(**DRIVEN), 1), dtype=np.float32)
        return mon.run(mon.init(), u, y)[1].status

    no_fault(judge)


def test_validate_does_not_take_narrowed_inputs_as_exact():
    no_fault(lambda u, y: jb.validate(jb.LinearSystem(**TWICE), u, y).status, outputs=2)


def test_unknown_inputs_does_not_take_narrowed_inputs_as_exact():
    model = jb.LinearSystem(**DRIVEN, unknown_inputs=[[1]])

    def judge(u, y):
        values = jb.unknown_inputs(model, u, y).values
        return np.where(
            (values.lo > 0) | (values.hi < 0), jb.Status.FAULT, jb.Status.CONSISTENT
        )  # of 0, the true value

    no_fault(judge)
