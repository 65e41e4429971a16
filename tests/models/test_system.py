"""The model at its door: exact decimals in, sentences out."""

from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest
from systems import PAPER, paper

import jaxbound as jb


def test_a_float_means_its_shortest_decimal():
    m = jb.LinearSystem([[0.8]], [[0.1]], [[1e-3]], noise=0.7, tolerance=0.02)
    assert (m.A[0][0], m.B[0][0], m.C[0][0]) == (Fraction(4, 5), Fraction(1, 10), Fraction(1, 1000))
    assert (m.noise, m.tolerance) == ((Fraction(7, 10),), (Fraction(1, 50),))


def test_float32_means_its_own_shortest_decimal():
    assert jb.LinearSystem(np.array([[0.8]], np.float32), None, [[1]]).A[0][0] == Fraction(4, 5)


@pytest.mark.parametrize("number", [Fraction(1, 3), "1/3"])
def test_exact_numbers_are_taken_as_they_are(number):
    m = jb.LinearSystem([[number]], None, [[Decimal("0.25")]], noise=number, offset={"y": [number]})
    assert m.A[0][0] == m.noise[0] == m.offset["y"][0] == Fraction(1, 3) and m.C[0][0] == Fraction(1, 4)


def test_sizes_and_default_names():
    m = paper()
    assert (m.n, m.m, m.p, m.dt) == (2, 1, 2, 0.01)
    assert (m.inputs, m.outputs, m.states) == (("u1",), ("y1", "y2"), ("x1", "x2"))


def test_without_b_there_are_no_inputs():
    m = paper(B=None)
    assert m.m == 0 and m.inputs == () and not m.has_feedthrough


def test_feedthrough_is_a_d_that_is_not_zero():
    assert not paper().has_feedthrough and not paper(D=[[0], [0]]).has_feedthrough and paper(D=[[0], [1]]).has_feedthrough


def test_one_bound_serves_every_output():
    assert paper(noise=0.5, tolerance=0.1, resolution=0.01).noise == (Fraction(1, 2),) * 2


@pytest.mark.parametrize("change, message", [
    (dict(A=[[1, 2, 3], [4, 5, 6]]), r"A must be square, one row per state: its shape is \(2, 3\)"),
    (dict(B=[[1], [2], [3]]), r"B must have shape \(2, 1\) .* its shape is \(3, 1\)"),
    (dict(C=[[1, 0, 0]]), r"C must have shape \(1, 2\) .* its shape is \(1, 3\)"),
    (dict(D=[[1]]), r"D must have shape \(2, 1\) .* its shape is \(1, 1\)"),
    (dict(C=[]), "the model has no output"),
    (dict(A=[[1, 2], [3]]), "A: rows have different lengths"),
    (dict(A=[[float("nan"), 0], [0, 1]]), "A: nan is not a finite number"),
    (dict(B=[["one"], [0]]), "B: 'one' is not a finite number"),
    (dict(noise=[0.1, -0.1]), "noise must be >= 0: output 'y2' has -0.1"),
    (dict(tolerance=[1, 0]), "tolerance is relative and must be below 1 .* 'y1' has 1"),
    (dict(noise=[0.1, 0.2, 0.3]), "noise needs one number, or one for each of y1, y2: 3 given"),
    (dict(resolution=float("inf")), "resolution: inf is not a finite number"),
    (dict(dt=0), "dt must be a positive number of seconds, not 0"),
    (dict(outputs=("a", "a")), "outputs must have different names"),
    (dict(outputs=("u1", "b")), "a signal name may stand for one signal only: 'u1' is used twice"),
    (dict(outputs=("a",)), "outputs needs 2 names, one for each: 1 given"),
    (dict(offset={"x": [1]}), r"offset has the fields 'u' and 'y', not \['x'\]"),
    (dict(offset={"y": [1]}), "offset y needs one number, or one for each of y1, y2: 1 given"),
    (dict(units={"y7": "K"}), "units speaks of 'y7', but the model knows only"),
    (dict(columns={"speed": "n"}), "columns speaks of 'speed', but the model knows only"),
])  # fmt: skip
def test_a_model_that_does_not_fit_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        jb.LinearSystem(**{**PAPER, **change})


@pytest.mark.parametrize("bound, pairs", [
    (0.1, [("-1/10", "1/10")] * 2), ([0.1, "1/3"], [("-1/10", "1/10"), ("-1/3", "1/3")]),
    ([[0, 0.2], [-1, 0]], [("0", "1/5"), ("-1", "0")]),
])  # fmt: skip
def test_a_disturbance_has_a_pair_of_exact_bounds_a_column(bound, pairs):
    m = paper(disturbance=([[1, 0], [0.5, 2]], bound))
    assert [tuple(map(str, pair)) for pair in m.disturbance] == pairs
    assert (m.g, m.G) == (2, ((1, 0), (Fraction(1, 2), 2)))


@pytest.mark.parametrize("disturbance, message", [
    ([[1], [0]], "G of the disturbance needs one row per state"),
    (3, "disturbance needs a pair"),
    (([[1]], 0.1), "G of the disturbance needs one row per state"),
    (([[1], [0]], [0.1, 0.2]), "needs one number, or one .* for each of 1 columns of G, not 2"),
    (([[1], [0]], -0.1), "disturbance 1: the bound must be >= 0, not -0.1"),
    (([[1], [0]], [[0.2, 0.1]]), r"disturbance 1: lo must be <= hi, not \[0.2, 0.1\]"),
    (([[1], [0]], [[0, 1, 2]]), "disturbance 1: a bound is one number or a pair"),
    (([[1], [0]], float("inf")), "disturbance 1: .*not a finite number"),
])  # fmt: skip
def test_a_disturbance_that_does_not_fit_is_refused(disturbance, message):
    with pytest.raises(ValueError, match=message):
        paper(disturbance=disturbance)


def test_units_and_columns_are_found_by_name():
    m = paper(units={"y1": "K"}, columns={"u1": "valve"})
    assert (m.unit("y1"), m.unit("y2"), m.column("u1"), m.column("y1")) == ("K", "", "valve", "y1")
