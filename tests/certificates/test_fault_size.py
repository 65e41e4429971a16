"""Sizes of named faults against linear programs by HiGHS, written out state by state, and numbers by hand."""

from fractions import Fraction

import highspy
import numpy as np
import pytest
from linear_programs import solver
from scipy.optimize import linprog

import jaxbound as jb
from jaxbound.certificates.fault_size import End, Scale
from jaxbound.certificates.interface import certify
from jaxbound.certificates.parameter_size import changed_window, found_size
from jaxbound.certificates.supposed import Side
from jaxbound.models.named_faults import NamedFault
from jaxbound.sets.floats.status import Status

PLANT = dict(
    A=[[0.8, 0.1], [0, 0.5]],
    B=[[0.5, 0], [0.1, 1]],
    C=[[1, 0], [1, 1]],
    D=[[0, 0.2], [0, 0]],
    noise=[0.1, 0.2],
    inputs=["heat", "cool"],
    states=["a", "b"],
)
FAULTS = (
    NamedFault("bias", output="y1"),
    NamedFault("sensor gain", output="y2", kind="gain"),
    NamedFault("offset", input="cool"),
    NamedFault("heat gain", input="heat", kind="gain"),
    NamedFault("leak", states={"a": -1, "b": "1/2"}),
    NamedFault("leak with the heat", states=["b"], times="heat"),
)
VARIANTS = {
    "plain": {},
    "disturbed": dict(disturbance=([[1], [0.3]], [[-0.02, 0.05]])),
    "means": dict(averages={"y1": {3: 0.04}}),
    "unknown input": dict(unknown_inputs=[[0], [1]]),
}


def smallest(model, u, y, fault, since):
    """Return the least |size| of a fault from a sample on that explains (u, y), or None: on either side of 0
    one linear program each, whose unknowns are all states, noises, disturbances, unknown inputs and x; one
    more of a sensor whose gain is below 0.
    """
    sizes = []
    for side in (1, -1, -2)[: 3 if fault.name == "sensor gain" else 2]:
        x = program_of(model, u, y, fault, since, side)
        if x is not None:
            sizes.append(1 / (1 + x) - 1 if fault.name == "sensor gain" else x)
    return min(sizes, key=abs, default=None)


def program_of(model, u, y, fault, since, side):
    """Return the x of least magnitude on one side, or None; of side -2 the least x below -1."""
    A, B, C, D, G, F = ([[float(v) for v in row] for row in getattr(model, k)] for k in "ABCDGF")
    s, n, p = len(y) - 1, 2, 2
    h = solver()
    infinite = highspy.kHighsInf
    add = lambda lo=-infinite, hi=infinite: (h.addVar(lo, hi), h.getNumCol() - 1)[1]
    lowest = -0.999999 if fault.name == "sensor gain" else -infinite
    x = add(*{1: (0, infinite), -1: (lowest, 0), -2: (-1e7, -1.000001)}[side])
    states = [[add() for _ in range(n)] for _ in range(s + 1)]
    noise = [[add(-float(b), float(b)) for b in model.noise] for _ in range(s + 1)]
    w = [[add(float(lo), float(hi)) for lo, hi in model.disturbance] for _ in range(s)]
    v = [[add() for _ in range(model.d)] for _ in range(s)]
    j = model.inputs.index(fault.input) if fault.input else None

    def share(k):
        if k < since:
            return 0.0
        if fault.name == "heat gain" or fault.times:
            return u[k][0]
        return 1.0

    def row(terms, value):
        terms = {i: c for i, c in terms.items() if c}
        h.addRow(value, value, len(terms), np.array(list(terms), np.int32), np.array(list(terms.values())))

    for k in range(s):
        for i in range(n):
            terms = {states[k + 1][i]: 1.0, x: 0.0}
            for a in range(n):
                terms[states[k][a]] = terms.get(states[k][a], 0) - A[i][a]
            for a, wa in enumerate(w[k]):
                terms[wa] = -G[i][a]
            for a, va in enumerate(v[k]):
                terms[va] = -F[i][a]
            if j is not None:
                terms[x] -= B[i][j] * share(k)
            terms[x] -= float(dict(fault.states).get("ab"[i], 0)) * share(k)
            row(terms, B[i][0] * u[k][0] + B[i][1] * u[k][1])
    for k in range(s + 1):
        for i in range(p):
            if np.isnan(y[k][i]):
                continue
            terms = {states[k][0]: C[i][0], states[k][1]: C[i][1], noise[k][i]: 1.0, x: 0.0}
            if j is not None:
                terms[x] += D[i][j] * share(k)
            if fault.output == model.outputs[i]:
                terms[x] += -y[k][i] * (k >= since) if fault.kind == "gain" else share(k)
            row(terms, y[k][i] - D[i][0] * u[k][0] - D[i][1] * u[k][1])
            if fault.name == "sensor gain" and fault.output == model.outputs[i] and k >= since:
                slope = float(model.noise[i]) * (1 if side > -2 else -1)
                h.changeColBounds(noise[k][i], -infinite, infinite)  # |noise| <= b |1 + x|
                for sign in (1.0, -1.0):
                    columns = np.array([noise[k][i], x], np.int32)
                    h.addRow(-infinite, slope, 2, columns, np.array([sign, -slope]))
    for average in model.averages:
        length = len(average.weights)
        for first in range(s + 2 - length):
            if not np.isnan(y[first : first + length, 0]).any():
                run = np.array([noise[k][0] for k in range(first, first + length)], np.int32)
                bound = float(average.bound)
                h.addRow(-bound, bound, length, run, np.full(length, 1 / length))
    h.changeColCost(x, 1.0 if side != -1 else -1.0)
    h.run()
    if h.getModelStatus() == highspy.HighsModelStatus.kInfeasible:
        return None
    assert h.getModelStatus() == highspy.HighsModelStatus.kOptimal
    return h.getSolution().col_value[x]


def case(variant, rng, s=5, lost=False):
    """Return a model of a variant and samples of a window in which one of its faults begins."""
    model = jb.LinearSystem(**PLANT, **VARIANTS[variant], faults=FAULTS)
    u = rng.uniform(0.5, 2, (s + 1, 2)).round(3)
    fault, since = FAULTS[rng.integers(len(FAULTS))], rng.choice([0, 3])
    size = rng.choice([-1, 1]) * rng.uniform(0.7, 1.5)
    A, B, C, D = (np.array(PLANT[letter], float) for letter in "ABCD")
    x, y = rng.normal(size=2), np.zeros((s + 1, 2))
    for k in range(s + 1):
        on = size * (k >= since)
        done = u[k] + on * np.array([u[k, 0] * (fault.kind == "gain"), fault.kind == "offset"])
        y[k] = C @ x + D @ (done if fault.input else u[k]) + on * np.array([fault.kind == "bias", 0])
        y[k, 1] *= 1 + on * (fault.name == "sensor gain")
        leak = on * np.array([float(dict(fault.states).get(name, 0)) for name in "ab"])
        x = A @ x + B @ (done if fault.input else u[k]) + leak * (u[k, 0] if fault.times else 1)
    y += 0.02 * rng.uniform(-1, 1, y.shape)
    if lost:
        y[2, 1] = np.nan
    return model, u, y.round(3)


@pytest.mark.parametrize("variant", VARIANTS)
def test_smallest_sizes_are_those_of_linear_programs(variant, rng):
    weighed = excluded = 0
    for trial in range(8):
        model, u, y = case(variant, rng, lost=trial == 3)
        certificate = certify(jb.parity_relations(model, 5), u, y)
        if certificate.proves != Status.FAULT:
            continue
        scale = Scale(certificate.window, certificate.h)
        for fault in FAULTS:
            for since in (0, 3):
                size, exact = smallest(model, u, y, fault, since), scale.weigh(fault, (since,)).size
                assert (size is None) == (exact is None), (fault.name, since, size, exact)
                if size is None:
                    excluded += 1
                else:
                    weighed += 1
                    assert float(exact) == pytest.approx(size, rel=1e-5, abs=1e-6)
    assert weighed > 2 and excluded > 2


STATIC = dict(A=None, B=None, C=None, D=[[1]], noise="1/10", inputs=["u"])


def weighed(fault, u=0.5, y=1.0, **model):
    m = jb.LinearSystem(**{**STATIC, **model}, faults=[fault])
    c = certify(jb.parity_relations(m, 0), np.array([[u]]), np.array([[y]]))
    return Scale(c.window, c.h).weigh(fault)


@pytest.mark.parametrize(
    "fault, size",
    [
        (NamedFault("b", output="y1"), Fraction(2, 5)),
        (NamedFault("o", input="u"), Fraction(2, 5)),
        (NamedFault("g", input="u", kind="gain"), Fraction(4, 5)),
        (NamedFault("s", output="y1", kind="gain"), Fraction(4, 5)),
        (NamedFault("t", output="y1", times="u"), Fraction(4, 5)),
        (NamedFault("m", input="u", most=0.5), Fraction(2, 5)),
        (NamedFault("l", input="u", sign="+", least=0.45), Fraction(9, 20)),
        (NamedFault("d", input="u", sign="+", least=0.3), Fraction(2, 5)),
    ],
)
def test_sizes_by_hand(fault, size):
    assert abs(weighed(fault).size - size) < Fraction(1, 10**12)


@pytest.mark.parametrize("stated", [dict(sign="-"), dict(most=0.3), dict(least=0.7)])
def test_a_size_beyond_its_sign_or_bounds_is_excluded_and_told(stated):
    found = weighed(NamedFault("o", input="u", **stated))
    assert found.size is None and abs(found.beyond - Fraction(2, 5)) < Fraction(1, 10**12)


def test_the_gain_of_a_sensor_stated_too_small_is_excluded():
    gain = lambda **stated: weighed(NamedFault("s", output="y1", kind="gain", **stated)).size
    assert gain(most=0.7) is None and gain(sign="-") is None
    assert abs(gain(most=0.9, sign="+") - Fraction(4, 5)) < Fraction(1, 10**12)
    assert gain(sign="-", most=1) is None and gain(least=1).numerator > 0


def test_what_cannot_be_weighed_says_why():
    with pytest.raises(NotImplementedError, match="its gain shows in the bounds on averages of y1"):
        means = dict(A=[[0.5]], B=[[1]], C=[[1]], D=None, averages={"y1": {2: 0.01}})
        m = jb.LinearSystem(**{**STATIC, **means})
        c = certify(jb.parity_relations(m, 3), np.ones((4, 1)), np.array([[2.0]] * 3 + [[9]]))
        Scale(c.window, c.h).weigh(NamedFault("s", output="y1", kind="gain"))
    m = jb.LinearSystem([[0.5]], [[1]], [[1]], noise=0.1, inputs=["u"])
    c = certify(jb.parity_relations(m, 1), np.ones((2, 1)), np.array([[1.0], [9]]))
    with pytest.raises(NotImplementedError, match="a sample of u is missing"):
        Scale(c.window, c.h).weigh(NamedFault("t", output="y1", times="u"))


SQUARE = dict(D=[[1, 1]], inputs=["cool", "cool2"], columns={"cool2": "= cool*cool"})


def of_square(u=0.5, y=1.5, **stated):
    m = jb.LinearSystem(**{**STATIC, **SQUARE})
    c = certify(jb.parity_relations(m, 0), np.array([[u, u * u]]), np.array([[y]]))
    return Scale(c.window, c.h).weigh(NamedFault("o", input="cool", **stated))


def test_an_actuator_moves_what_is_computed_from_its_column():
    # f + (0.5 + f)^2 - 0.5^2 = 2 f + f^2 has to reach 1.5 - 0.75 - 0.1, from above or from below
    assert abs(float(of_square().size) - (1.65**0.5 - 1)) < 1e-11
    assert abs(float(of_square(sign="-").size) + 1.65**0.5 + 1) < 1e-11
    assert of_square(y=-0.4).size is None  # 2 f + f^2 is not below -1


def test_what_an_actuator_can_do_excludes_a_size():
    assert of_square(between=[0, 0.7]).size is None
    assert abs(float(of_square(between=[0, 0.7]).beyond) - (1.65**0.5 - 1)) < 1e-11
    assert of_square(between=[-3, 0.7]).size < -2  # the other side of the square


def test_an_output_that_is_computed_from_the_column_was_recorded_wrong():
    # q = fan T = 2, fan = 0.5: 2 + 4 f beside 2 (0.5 + f), within 0.1
    found = weighed(NamedFault("o", input="u"), u=0.5, y=2.0, D=[[2]], columns={"y1": "= u*T"})
    assert abs(found.size + Fraction(9, 20)) < Fraction(1, 10**12)


@pytest.mark.parametrize("column", ["= sqrt(u)", "= u**3", "= u*T + 1"])
def test_a_column_that_is_not_followed_is_refused(column):
    with pytest.raises(NotImplementedError, match="y1 is computed from the same column"):
        weighed(NamedFault("o", input="u"), columns={"y1": column})


def explained(A, u, y, noise, x, since):
    """Return whether a first state explains y with the column c + x from a sample on: x+ = A x + c + c^2 / 2,
    each reading leaves an interval of first states.
    """
    low, high, drive, power = None, None, Fraction(0), Fraction(1)
    for k, reading in enumerate(y):
        ends = (reading - noise - drive) / power, (reading + noise - drive) / power
        low = ends[0] if low is None else max(low, ends[0])
        high = ends[1] if high is None else min(high, ends[1])
        c = u[k] + x * (k >= since)
        drive, power = A * drive + c + c * c / 2, power * A
    return low <= high


def test_sizes_that_are_squared_are_those_of_fractions(rng):
    weighed = excluded = 0
    model = jb.LinearSystem([["1/2"]], [[1, "1/2"]], [[1]], noise="1/10", **SQUARE | {"D": None})
    relations = jb.parity_relations(model, 4)
    for _ in range(6):
        u = rng.integers(0, 16, 5) / 8
        since, f, x, y = int(rng.integers(0, 3)), rng.uniform(-1, 1), rng.normal(), []
        for k in range(5):
            y.append(round(x + rng.uniform(-0.05, 0.05) + (k == 4) * rng.choice([0, 0, 0.5]), 3))
            c = u[k] + f * (k >= since)
            x = x / 2 + c + c * c / 2
        certificate = certify(relations, np.stack([u, u * u], 1), np.array(y)[:, None])
        if certificate.proves != Status.FAULT:
            continue
        scale = Scale(certificate.window, certificate.h)
        size = scale.weigh(NamedFault("o", input="cool"), (since,)).size
        case = Fraction(1, 2), list(map(Fraction, u)), list(map(Fraction, y)), Fraction(1, 10)
        if size is None:
            excluded += 1
            tried = [Fraction(i, 50) for i in range(-200, 201)]
        else:
            weighed += 1
            assert explained(*case[:3], Fraction("0.1000000001"), size, since)
            tried = [size * i / 50 * sign for i in range(50) for sign in (1, -1)]
        assert not any(explained(*case, x, since) for x in tried)
    assert weighed and excluded


FOULED = NamedFault("fouled", A=[[0, 1], [0, 0]], B=[[0, "1/2"], [0, 0]], most=0.6)
SCALE = NamedFault("scale", C=[[0, 0], [1, 1]], sign="+", most=0.8)


def explained_with(model, u, y, fault, size, since):
    """Return whether HiGHS finds states and disturbances that explain y, matrices others from a sample on."""
    A, B, C, G = (np.array(getattr(model, letter), float) for letter in "ABCG")
    s, n, p, g = len(y) - 1, 2, 2, G.shape[1]
    step, seen = [], []
    for k in range(s + 1):
        change = {letter: np.array(rows, float) for letter, rows in fault.coefficients.items()}
        now = {"A": A, "B": B, "C": C}
        if k >= since:
            now = {letter: rows + size * change.get(letter, 0 * rows) for letter, rows in now.items()}
        row = np.zeros((p, n * (s + 1) + g * s))
        row[:, n * k : n * (k + 1)] = now["C"]
        seen.append((row, y[k] - np.array(model.D, float) @ u[k]))
        if k < s:
            row = np.zeros((n, n * (s + 1) + g * s))
            row[:, n * k : n * (k + 1)], row[:, n * (k + 1) : n * (k + 2)] = now["A"], -np.eye(n)
            row[:, n * (s + 1) + g * k : n * (s + 1) + g * (k + 1)] = G
            step.append((row, -now["B"] @ u[k]))
    rows, middle = np.concatenate([row for row, _ in seen]), np.concatenate([value for _, value in seen])
    width = np.tile(np.array(model.noise, float), s + 1) + 1e-9
    ends = [(None, None)] * (n * (s + 1)) + [tuple(map(float, pair)) for pair in model.disturbance] * s
    found = linprog(
        np.zeros(rows.shape[1]),
        np.concatenate([rows, -rows]),
        np.concatenate([middle + width, width - middle]),
        np.concatenate([row for row, _ in step]),
        np.concatenate([value for _, value in step]),
        bounds=ends,
    )
    return found.status == 0


@pytest.mark.parametrize(
    "variant, fault, size, since", [("plain", FOULED, -0.4, 0), ("disturbed", SCALE, 0.5, 2)]
)
def test_a_parameter_that_explains_is_found_and_does_by_a_linear_program(variant, fault, size, since, rng):
    model = jb.LinearSystem(**PLANT, **VARIANTS[variant])
    u = rng.uniform(0.5, 2, (6, 2)).round(3)
    A, B, C, D = (np.array(PLANT[letter], float) for letter in "ABCD")
    x, y = np.array([1.0, 2.0]), np.zeros((6, 2))
    for k in range(6):
        now = {"A": A, "B": B, "C": C}
        if k >= since:
            for letter, rows in fault.coefficients.items():
                now[letter] = now[letter] + size * np.array(rows, float)
        y[k] = now["C"] @ x + D @ u[k]
        x = now["A"] @ x + now["B"] @ u[k]
    y = y.round(3)
    certificate = certify(jb.parity_relations(model, 5), u, y)
    assert certificate.proves == Status.FAULT
    found = found_size(certificate.window, fault, range(6))
    assert 0 < found.size / Fraction(size) <= 1 + Fraction(1, 64)
    assert explained_with(model, u, y, fault, float(found.size), found.since)
    assert not explained_with(model, u, y, fault, 0, 0)
    changed = changed_window(certificate.window, fault, found.size, found.since)
    assert changed.explained_by(found.z)


def test_a_parameter_that_is_not_found_is_left_open():
    model = jb.LinearSystem(**PLANT, faults=[FOULED, NamedFault("bias", output="y1")])
    certificate = certify(jb.parity_relations(model, 3), np.ones((4, 2)), np.array([[1.0, 1]] * 3 + [[1, 9]]))
    found = certificate.diagnose()
    assert found.sizes == {"bias": None}
    assert "left open: fouled (none of " in str(found) and "no proof" in str(found)
    assert "states that nobody knows" in jb.isolability(model, model.faults, horizon=3).unweighed["fouled"]


def test_a_root_at_the_end_of_stated_sizes_is_no_exclusion():
    m = jb.LinearSystem(
        None, None, None, [[1, 1]], noise="1/10", inputs=["cool", "cool2"], columns={"cool2": "= cool*cool"}
    )
    c = certify(jb.parity_relations(m, 0), np.zeros((1, 2)), np.array([[0.85]]))
    (found,) = c.diagnose([NamedFault("o", input="cool", least="1/3", most="1/2")]).explains
    assert found.size == Fraction(1, 2)


def test_the_first_size_that_an_end_keeps_is_found_behind_its_kinks(rng):
    """Against values on a fine grid: below the size that is found all are negative."""
    number = lambda least: Fraction(int(rng.integers(least, 9)), 4)
    behind = 0
    for _ in range(40):
        bent = [(number(1), Side(number(-8), number(-8), sigma=Fraction(1, 3))) for _ in range(2)]
        end = End((), Side(number(-8), number(-8)), 1, bent)
        found, kinks = end.next_kept(Fraction(0)), [-side.a / side.b for _, side in bent if side.b]
        least = 9 if found is None else found
        assert not [t for k in range(300) if (t := Fraction(k, 32)) < least and end.at(t) >= 0]
        assert found is None or end.at(found) >= 0
        behind += bool(found) and any(0 < kink < found for kink in kinks)
    assert behind > 1
