"""Descriptor systems and decoupled parameters, as models with unknown inputs: exact trajectories and the
paper's own inverse route.
"""

import json
from fractions import Fraction

import numpy as np
import pytest
from oracles import times
from systems import paper

import jaxbound as jb
from jaxbound.exact import linalg
from jaxbound.models.uncertainty import Uncertainty


def draw(rng, *shape):
    return [[Fraction(int(x)) for x in row] for row in rng.integers(-4, 5, shape)]


def test_eliminating_unknown_inputs_and_going_back_gives_the_same_relations(shared):
    """(4a), then (5)-(7): the singular system of the example has the relations of the system with the unknown
    input.
    """
    s = json.loads(shared("golden/ragot1993.json").read_text())["system"]
    m = jb.LinearSystem(s["A"], s["B"], s["C"], unknown_inputs=s["F"])
    E = linalg.left_null_space(m.F)
    d = jb.LinearSystem(linalg.matmul(E, m.A), linalg.matmul(E, m.B), s["C"], E=E)
    assert (d.n, d.d) == (4, 1)
    assert jb.redundancy(d).rows == jb.redundancy(m).rows


def equations(rng, r, n):
    """Return E and A (r, n), the last row of E zero: that equation, without x+, leaves the states free."""
    while True:
        E, A = draw(rng, r, n), draw(rng, r, n)
        E[-1] = [Fraction(0)] * n
        if linalg.rank(E) == r - 1 and linalg.rank([*E[:-1], A[-1]]) == r:
            return E, A


@pytest.mark.parametrize("square", [True, False])
def test_a_trajectory_of_the_descriptor_system_is_one_of_the_model(square, rng):
    """Equations with and without x+; the trajectory is made by choosing z freely and adjusting u so that
    every equation holds.
    """
    n, p, T = 4, 3, 6
    r = n if square else 3
    for _ in range(5):
        E, A = equations(rng, r, n)
        C, D = draw(rng, p, n), draw(rng, p, r)
        B = [[Fraction(int(i == j)) for j in range(r)] for i in range(r)]
        z = [draw(rng, n, 1) for _ in range(T + 1)]
        u = [[a[0] - b[0] for a, b in zip(times(E, z[k + 1]), times(A, z[k]), strict=True)] for k in range(T)]
        y = [
            [a[0] + b[0] for a, b in zip(times(C, z[k]), times(D, [[v] for v in u[k]]), strict=True)]
            for k in range(T)
        ]
        m = jb.LinearSystem(A, B, C, D, E=E, noise="1e-9")
        assert m.n == linalg.rank(E) and m.d == n - m.n - 1  # one equation without x+ solves for one unknown
        for k in range(3, T):
            for h, K in zip(*jb.redundancy(m).windows(), strict=True):
                s = len(h) // p - 1
                flat = lambda rows, s=s, k=k: [x for row in rows[k - s : k + 1] for x in row]
                known = flat(u)[: len(K)]
                assert sum(a * b for a, b in zip(h, flat(y), strict=True)) == sum(
                    a * b for a, b in zip(K, known, strict=True)
                )


def test_a_regular_e_is_inverted_and_names_are_kept():
    m = jb.LinearSystem([[1, 2], [3, 4]], [[2], [4]], [[1, 0]], E=[[2, 0], [0, 4]], states=("a", "b"))
    assert (
        m.A == ((Fraction(1, 2), 1), (Fraction(3, 4), 1))
        and m.B == ((1,), (1,))
        and m.states == ("a", "b")
        and m.d == 0
    )
    mixed = jb.LinearSystem([[1, 0]], None, [[1, 0]], E=[[1, -1]], states=("a", "b"))
    assert mixed.states == ("x1",) and mixed.d == 1


@pytest.mark.parametrize(
    "change, said",
    [
        (
            dict(A=[[1, 0], [1, 0]], E=[[1, 0], [0, 0]]),
            "an equation without x. restricts the states themselves",
        ),
        (
            dict(E=[[1, 0, 0], [0, 0, 0]]),
            r"A must have shape \(2, 3\) to fit E, \(2, 3\): its shape is \(2, 2\)",
        ),
        (dict(E=[[1, 0], [0, "x"]]), "E: 'x' is not a finite number"),
        (
            dict(A=[[1, 0], [0, 1]], E=[[1, 0], [0, 0]], disturbance=([[0], [1]], 1)),
            "puts a disturbance into an output",
        ),
        (
            dict(E=[[1, 0], [0, 1]], uncertainties=[Uncertainty("k", A=[[1, 0], [0, 0]])]),
            "E and uncertainties do not go together",
        ),
        (dict(decouple=("k",)), "decouple names 'k', but the uncertainties are none"),
    ],
)
def test_what_is_no_model_is_refused(change, said):
    with pytest.raises(ValueError, match=said):
        jb.LinearSystem(**(dict(A=[[1, 0], [0, 1]], B=None, C=[[1, 0], [0, 1]], noise=1) | change))


def test_a_decoupled_parameter_may_take_any_value(rng):
    """Detection stays silent whatever the parameter does, which its bound would not have allowed."""
    k = Uncertainty("k", A=[[1, 0], [2, 0]], B=[[1], [2]], between=["-1/10", "1/10"])
    given = dict(A=[["1/2", 1], [0, "1/5"]], B=[[0], [1]], C=[[1, 0], [1, 1], [0, 1]], noise="1/100")
    m = jb.LinearSystem(**given, uncertainties=[k], decouple="k")
    assert m.uncertainties == () and m.d == 1 and [row[0] * 2 for row in m.F] == [m.F[1][0], 2 * m.F[1][0]]
    x, y, u = np.array([1.0, -1.0]), [], rng.normal(size=(300, 1))
    for now in u:
        y.append(np.array([x[0], x.sum(), x[1]]))
        v = rng.uniform(-3, 3) * (x[0] + now[0])
        x = np.array([0.5 * x[0] + x[1], 0.2 * x[1] + now[0]]) + v * np.array([1.0, 2.0])
    y = np.array(y) + rng.uniform(-0.009, 0.009, (300, 3))
    short = slice(0, 12)  # before an unlucky parameter lets the plant explode
    assert (jb.detect(jb.parity_relations(m, 2), u[short], y[short]).status[2:] == jb.Status.CONSISTENT).all()
    certain = jb.LinearSystem(**given)
    assert (
        jb.detect(jb.parity_relations(certain, 2), u[short], y[short]).status[2:] == jb.Status.FAULT
    ).any()


def test_one_of_two_parameters_is_decoupled():
    a, b = Uncertainty("a", A=[[1, 0], [0, 0]]), Uncertainty("b", A=[[0, 0], [1, 2]], C=[[0, 0], [2, 4]])
    m = paper(uncertainties=[a, b], decouple=("b",))
    assert [u.name for u in m.uncertainties] == ["a"] and m.F == ((0,), (1,)) and m.D_v == ((0,), (2,))


def test_a_model_file_may_decouple_and_be_a_descriptor(tmp_path):
    text = """dt = 1
decouple = ["k"]
states = ["a", "b"]
[[outputs]]
name = "y"
noise = 0.1
[[uncertainty]]
name = "k"
A = [[1, 0], [0, 0]]
[matrices]
A = [[1, 0], [0, 1]]
C = [[1, 1]]
"""
    path = tmp_path / "m.toml"
    path.write_text(text)
    assert jb.load_model(path).F == ((1,), (0,))
    path.write_text(
        text.replace('decouple = ["k"]', "").replace(
            '[[uncertainty]]\nname = "k"\nA = [[1, 0], [0, 0]]\n', ""
        )
        + "E = [[1, 0]]\n"
    )
    with pytest.raises(ValueError, match=r"A must have shape \(1, 2\)"):
        jb.load_model(path)
    path.write_text(path.read_text().replace("A = [[1, 0], [0, 1]]", "A = [[1, 0]]"))
    m = jb.load_model(path)
    assert (m.n, m.d, m.states) == (1, 1, ("a",))
    jb.save_model(m, path)
    again = jb.load_model(path)
    assert (again.A, again.F, again.D_v, again.C) == (m.A, m.F, m.D_v, m.C)


def test_one_state_of_a_descriptor_system_may_be_named_by_a_text():
    assert jb.LinearSystem([[1]], [[1]], [[1]], E=[[2]], states="level").states == ("level",)


@pytest.mark.parametrize("names", [("a",), ("a", "b", "c")])
def test_a_descriptor_system_with_a_wrong_number_of_names_is_refused(names):
    with pytest.raises(ValueError, match=f"states needs 2 names, one for each: {len(names)} given"):
        jb.LinearSystem([[1, 0], [0, 1]], None, [[1, 1]], E=[[1, 0], [0, 1]], states=names)
