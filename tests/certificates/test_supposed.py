"""Faults of known sizes in exact simulations: the true one is never excluded, and lies among the sizes."""

from fractions import Fraction as F

import numpy as np
import pytest

import jaxbound as jb
from jaxbound.certificates.fault_size import FaultSize, Scale
from jaxbound.certificates.interface import certify
from jaxbound.certificates.supposed import pushes_of, with_fault
from jaxbound.sets.floats.status import Status

KINDS = {
    "bias": dict(output="y1"),
    "gain": dict(output="y1", kind="gain"),
    "times": dict(output="y1", times="u1"),
    "offset": dict(input="u1"),
    "actuator's gain": dict(input="u1", kind="gain"),
    "leak": dict(states=["x1"]),
}
A, B, C = [["0.6", "0.3"], ["-0.2", "0.5"]], [["0.7"], ["0.4"]], [[1, "0.5"], [0, 2]]
D = [[0], ["0.1"]]
OFFSET = {"u": [2], "y": [10, 0]}


def drawn(rng, bound):
    """Return a number within a bound, often at an end."""
    share = F(int(rng.integers(-8, 9)), 8)
    if rng.random() < 0.6:
        share = F(int(rng.choice([-1, 1])))
    return bound * share


def recorded(rng, model, kind, f, since, samples):
    """Return (u, y): a trajectory in fractions with a fault as `models.named_faults` defines it."""
    A, B, C, D = ([[F(v) for v in row] for row in getattr(model, k)] for k in "ABCD")
    x, us, ys = [F(int(v)) for v in rng.integers(-9, 9, 2)], [], []
    for k in range(samples):
        on, u = k >= since, F(int(rng.integers(1, 30)), 8)
        does = u + f * (on and kind == "offset") + u * f * (on and kind == "actuator's gain")
        y = []
        for i, row in enumerate(C):
            true = sum(c * v for c, v in zip(row, x, strict=True)) + D[i][0] * (does - 2)
            shown = F(OFFSET["y"][i]) + (1 + drawn(rng, model.tolerance[i])) * true
            if on and i == 0:
                shown += shown * f * (kind == "gain") + f * (kind == "bias") + f * u * (kind == "times")
            y.append(shown + drawn(rng, model.noise[i]) + drawn(rng, model.resolution[i]))
        w = drawn(rng, F("0.05"))
        x = [sum(a * v for a, v in zip(row, x, strict=True)) for row in A]
        x = [v + b[0] * (does - 2) + w for v, b in zip(x, B, strict=True)]
        x[0] += f * (on and kind == "leak")
        us.append([float(u)])
        ys.append(list(map(float, y)))
    return np.array(us), np.array(ys)


@pytest.mark.parametrize("tolerance", [("0.1", 0), (0, "0.02")])
@pytest.mark.parametrize("kind", KINDS)
def test_the_true_fault_is_never_excluded(kind, tolerance, rng):
    model = jb.LinearSystem(
        A,
        B,
        C,
        D,
        tolerance=tolerance,
        noise=["0.1", "0.01"],
        resolution=[0, "0.02"],
        offset=OFFSET,
        disturbance=([[1], [1]], "0.05"),
    )
    relations, weighed, inverted = jb.parity_relations(model, 2), 0, 0
    for _ in range(24):
        f, since = F(int(rng.integers(-300, 300)), 100), int(rng.integers(0, 3))
        certificate = certify(relations, *recorded(rng, model, kind, f, since, 3))
        if certificate.proves != Status.FAULT:
            continue
        stated = [{}, {"most": abs(f)}, {"least": abs(f), "sign": "+" if f > 0 else "-"}][weighed % 3]
        fault = jb.NamedFault("f", **KINDS[kind], **stated)
        found = Scale(certificate.window, certificate.h).weigh(fault, range(3))
        size, slip = found.size, F(1, 10**9)
        assert size is not None and abs(size) <= abs(f) * (1 + slip), (f, since, stated)
        if size * f > 0 and found.largest is not None:
            assert abs(found.largest) >= abs(f) * (1 - slip), (f, since, stated)
        weighed, inverted = weighed + 1, inverted + (size < -1)
    assert weighed > 5 and (kind != "gain" or inverted)


def explains(window, fault, size):
    """Return whether a fault does, from any sample on, by the exact window alone."""
    x = 1 / (1 + size) if fault.get("kind") == "gain" else size
    pushes = pushes_of(jb.NamedFault("f", **fault), window, x < 0 and "kind" in fault)
    return any(with_fault(window, push, x).solve().t <= 1 for push in pushes)


@pytest.mark.parametrize("fault", [KINDS["bias"], KINDS["offset"], KINDS["gain"]])
def test_both_ends_of_the_sizes_explain_and_none_beyond_does(fault, rng):
    model = jb.LinearSystem(A, B, C, D, tolerance=["0.02", 0], noise=["0.1", "0.1"], offset=OFFSET)
    relations, ends = jb.parity_relations(model, 2), 0
    for _ in range(20):
        certificate = certify(relations, *recorded(rng, model, "bias", F(3), int(rng.integers(0, 3)), 3))
        if certificate.proves != Status.FAULT:
            continue
        window = certificate.window
        found = Scale(window, certificate.h).weigh(jb.NamedFault("f", **fault), range(3))
        if found.size is None or found.largest is None or abs(found.largest) > 10**5:
            continue
        ends += 1

        step = F(1, 10**9) * (1 if found.size > 0 else -1)
        assert explains(window, fault, found.size) and explains(window, fault, found.largest)
        assert not explains(window, fault, found.size - step) and not explains(
            window, fault, found.largest + step
        )
    assert ends > 1


def test_windows_of_an_alarm_have_the_sizes_that_explain_each():
    sizes = [(0.5, 1.1), (0.3, None), (0.7, 0.9), (0.95, 3)]
    one, open_, inner, above = (FaultSize(None, F(str(a)), largest=b and F(str(b))) for a, b in sizes)
    both = one.and_of(inner)
    assert (both.size, both.largest, both.varies) == (F("0.7"), F("0.9"), False)
    assert one.and_of(open_).largest == F("1.1") and open_.and_of(one).size == F("0.5")
    assert inner.and_of(above).varies and above.and_of(inner).size == F("0.95")


def test_a_bias_beside_a_tolerance_is_one_of_the_reading():
    """A true value of 100, a sensor that shows 10 % less, and 50 too little: 40."""
    m = jb.LinearSystem(
        [[1]], None, [[1], [1]], tolerance=["0.1", 0], noise=["0.1", "0.1"], outputs=["a", "b"]
    )
    result = jb.detect(jb.parity_relations(m, 2), None, np.array([[40.0, 100]] * 6))
    for most in (None, 50):
        sizes = result.diagnose(4, faults=[jb.NamedFault("bias", output="a", most=most)]).sizes
        assert float(sizes["bias"]) == pytest.approx(-49.81), "y + 0.1 = 0.9 (100.1) - 49.81"


@pytest.mark.parametrize("f", [-0.9, 0.5, -1, -2])
def test_a_sensor_that_lost_gain_and_kept_its_noise_is_not_excluded(f):
    m = jb.LinearSystem([["0.9"]], [[1]], [[1], [1]], noise="0.1", outputs=["a", "b"])
    run = jb.simulate(m, np.ones((40, 1)), 0, x0=[10.0], at="vertices", faults=[jb.Fault("a", "gain", f, 20)])
    faultless = jb.simulate(m, np.ones((40, 1)), 0, x0=[10.0], at="vertices")
    left = run.y[20:, 0] - (1 + f) * (faultless.y[20:, 0] - faultless.noise[20:, 0])
    assert abs(abs(left) - 0.1).max() < 1e-12, "its noise is that of before"
    result = jb.detect(jb.parity_relations(m, 2), np.ones((40, 1)), np.asarray(run.y))
    fault = np.flatnonzero(result.status == Status.FAULT)
    for k in fault[:: len(fault) // 4]:
        found = result.diagnose(int(k), faults=[jb.NamedFault("gain", output="a", kind="gain")])
        size = found.sizes["gain"]
        assert size is not None and abs(size) <= abs(f) + 1e-9
        assert found.shares["gain"] == abs(size), "beside all of it, as nothing else is stated"
