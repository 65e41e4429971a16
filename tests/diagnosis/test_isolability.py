"""Which named faults windows tell apart, against linear programs over both behaviours side by side."""

import highspy
import numpy as np
import pytest
from linear_programs import is_feasible, solver

import jaxbound as jb

PLANT = dict(A=[[0.8, 0.1], [0, 0.5]], B=[[0.5], [1]], C=[[1, 0], [1, 1]], noise=[0.1, 0.2], inputs=["heat"])
STATES = dict(states=["a", "b"], disturbance=([[1], [0.3]], [[-0.02, 0.05]]))
FAULTS = (
    jb.NamedFault("y1 is off", output="y1"),
    jb.NamedFault("y2 is off", output="y2", sign="+", most=0.5),
    jb.NamedFault("valve is off", input="heat"),
    jb.NamedFault("leak", states=["b"]),
)
S = 3


@pytest.fixture(scope="module")
def apart():
    return jb.isolability(jb.LinearSystem(**PLANT, **STATES), FAULTS, horizon=S)


def one_recording(fault, size, other=None, since=0):
    """Return whether a fault of a size and another one of any size that it may have, from a sample on, fit
    one recording: the states, noises and disturbances of both behaviours are the unknowns.
    """
    A, B, C = (np.array(PLANT[letter], float) for letter in "ABC")
    h, infinite = solver(), highspy.kHighsInf
    add = lambda lo=-infinite, hi=infinite: (h.addVar(lo, hi), h.getNumCol() - 1)[1]
    bounded = other is not None and other.most is not None
    x = add(0, 0) if other is None else add(0, float(other.most)) if bounded else add()

    def row(terms, value):
        h.addRow(value, value, len(terms), np.array(list(terms), np.int32), np.array(list(terms.values())))

    readings = []
    for about, on in ((fault, lambda k: size), (other, None)):
        drive = B[:, 0] * bool(about and about.input) + np.array([0, 1]) * bool(about and about.states)
        states = [[add(), add()] for _ in range(S + 1)]
        of_fault = []
        for k in range(S + 1):
            acts = on is not None or k >= since
            if k < S:
                w = add(-0.02, 0.05)
                for i in range(2):
                    terms = {states[k + 1][i]: 1.0, states[k][0]: -A[i, 0], states[k][1]: -A[i, 1]}
                    terms[w] = -[1, 0.3][i]
                    if on is None and drive[i] and acts:
                        terms[x] = -drive[i]
                    row(terms, drive[i] * size if on else 0.0)
            for i in range(2):
                noise = add(*[(-0.1, 0.1), (-0.2, 0.2)][i])
                biased = bool(about and about.output == f"y{i + 1}")
                terms = {states[k][0]: C[i, 0], states[k][1]: C[i, 1], noise: 1.0}
                if on is None and biased and acts:
                    terms[x] = 1.0
                of_fault.append((terms, size * biased if on else 0.0))
        readings.append(of_fault)
    for (one, shift), (two, _) in zip(*readings, strict=True):
        row(one | {j: -v for j, v in two.items()}, -shift)
    return is_feasible(h)


def test_a_named_fault_is_seen_from_the_size_of_linear_programs_on(apart):
    for fault in FAULTS:
        size = apart.detectable[fault.name]
        if size is None:
            assert one_recording(fault, 1e4)
        else:
            assert one_recording(fault, 0.9999 * float(size))
            assert not one_recording(fault, 1.0001 * float(size))


def test_faults_that_may_be_taken_for_each_other_fit_one_recording(apart):
    explained = told = 0
    for fault in FAULTS:
        seen = apart.detectable[fault.name]
        if seen is None:
            continue
        for other in FAULTS:
            if other is fault:
                continue
            sizes = [2 * float(seen)] if fault.sign else [2 * float(seen), -2 * float(seen)]
            fits = any(one_recording(fault, a, other, since) for a in sizes for since in range(S + 1))
            assert fits == ((fault.name, other.name) in apart.explained), (fault.name, other.name)
            explained, told = explained + fits, told + (not fits)
    assert explained and told


def test_what_depends_on_readings_is_left_out_with_the_reason():
    model = jb.LinearSystem(**PLANT, **STATES)
    faults = (
        jb.NamedFault("scale", output="y1", kind="gain"),
        jb.NamedFault("share", input="heat", kind="gain"),
    )
    apart = jb.isolability(model, faults, horizon=S)
    assert apart.unweighed == {
        "scale": "it depends on the readings of y1",
        "share": "it depends on heat, whose range is not stated",
    }
    with pytest.raises(NotImplementedError, match="without tolerances"):
        jb.isolability(model.replace(tolerance=0.01), FAULTS, horizon=S)
