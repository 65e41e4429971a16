"""Windows whose first state lies in what came before: proofs are those of linear programs over all samples,
rounding included.
"""

import json
from fractions import Fraction

import jax
import numpy as np
import pytest
from observer_case import PLANT, fault_free, jumps_near_the_boundary, program, published, recorded

import jaxbound as jb
from jaxbound.recordings.recording import Recording
from jaxbound.sets import zonotope

JOINT = {"method": "joint", "window": 8, "order": 6}
"""Of one size, and 24 recordings side by side, or one: what these tests share is compiled once."""


@pytest.mark.long(by_day="test_what_is_proved_near_the_boundary_is_refuted_by_programs")
def test_without_anything_forgotten_it_encloses_the_exact_hull(shared):
    """CORA's linearSysDT example, 20 samples in one window: the hull of the linear program over all of
    them.
    """
    case = json.loads(shared("external/observer_2dim.json").read_text())[0]
    model, u, y, x0 = published(case)
    state = jb.observe(model, u, y, x0=x0, **JOINT | {"window": 20}).state
    exact = np.array(case["exact_hull_lp_here"]["x_19"]).T
    lo, hi = np.asarray(state.lo)[-1], np.asarray(state.hi)[-1]
    print(exact[0] - lo, hi - exact[1])
    assert (lo <= exact[0] + 1e-12).all() and (exact[1] - 1e-12 <= hi).all()
    np.testing.assert_allclose([lo, hi], exact, atol=1e-8)


@pytest.mark.usefixtures("searched_in_numpy")
def test_it_proves_what_programs_over_all_samples_refute_and_nothing_else():
    proved, possible, wider = jumps_near_the_boundary(**JOINT)
    assert possible >= 10 and proved >= 0.9 * possible
    assert len(wider) > 5 and np.mean(wider) < 1.25


@pytest.mark.long(by_day="estimation/test_laid_end_to_end::test_random_plants_laid_end_to_end")
@pytest.mark.parametrize("plant", [8, 3, 0, 1, 2])
def test_the_state_of_fault_free_recordings_is_inside_and_nothing_is_a_fault(rng, plant):
    """Unstable, stable and integrating plants, in float64 at their vertices, in float32 with x64 off."""
    assert fault_free(rng, [plant], 24, 30, **JOINT) == 24 * 30


@pytest.mark.long(by_day="estimation/test_laid_end_to_end::test_random_plants_laid_end_to_end")
def test_two_hundred_thousand_fault_free_samples(rng):
    assert fault_free(rng, range(96), 64, 40, **JOINT) > 200_000


@pytest.mark.long(by_day="test_it_proves_what_programs_over_all_samples_refute_and_nothing_else")
def test_widths_of_a_published_demonstration_are_the_exact_ones(shared, rng):
    """ZETA's demo_linear_estimation, drawn anew: windows of 8 samples beside linear programs over all 31."""
    case = json.loads(shared("external/set_estimation.json").read_text())["zeta_linear_estimation"]
    w, v = case["w_radius"][0], case["v_radius"][0]
    model = jb.LinearSystem(case["A"], None, case["C"], noise=str(v), disturbance=([[1, 0], [0, 1]], str(w)))
    u, first = np.zeros((31, 0)), zonotope(case["x0_center"], case["x0_generators"])
    y = np.array(
        jb.simulate(model, u, jax.random.key(30), x0=np.array(case["true_x0"], float), at="uniform").y
    )
    state = jb.observe(model, None, y, x0=first, order=10, method="joint", window=8).state
    corner = np.abs(case["x0_generators"]).sum(1)
    box = case["x0_center"] - corner, case["x0_center"] + corner
    for k in (20, 30):
        lo, hi = program(model, u, y[: k + 1], box)
        assert (state.lo[k] <= lo + 1e-9).all() and (hi - 1e-9 <= state.hi[k]).all()
        np.testing.assert_allclose([state.lo[k], state.hi[k]], [lo, hi], rtol=1e-5)


def near_the_boundary(rng, N, T, seed):
    """Return (proved, refuted, tried): recordings whose errors are up to a few hundredths beyond what
    programs over all samples explain.
    """
    x0 = [-5.0, -5.0], [5.0, 5.0]
    u, _, y = recorded(PLANT, T, seed, N, at="vertices")
    y[:, T // 2 :, 0] += rng.uniform(-0.05, 0.1, (N, 1)) * rng.choice([-1, 1], (N, 1))
    found = jb.observe(PLANT, u, y, x0=jb.interval(*x0), restart=False, **JOINT | {"window": T})
    proved = refuted = 0
    for j in range(N):
        wrong = bool(found.status[j, -1] == jb.Status.FAULT)
        exact = program(PLANT, u[j], y[j], x0)
        assert not (wrong and exact is not None), f"recording {j} of seed {seed} is explained"
        if exact is not None:  # nothing was forgotten: the hull is exact
            lo, hi = found.state.lo[j, -1], found.state.hi[j, -1]
            assert (lo <= exact[0] + 1e-9).all() and (exact[1] - 1e-9 <= hi).all()
            np.testing.assert_allclose([lo, hi], exact, atol=1e-6)
        proved, refuted = proved + wrong, refuted + (exact is None)
    return proved, refuted, N


@pytest.mark.usefixtures("searched_in_numpy")
def test_what_is_proved_near_the_boundary_is_refuted_by_programs(rng):
    proved, refuted, tried = near_the_boundary(rng, 24, 8, 21)
    print(f"{proved} of {refuted} contradictions proved, of {tried} recordings")
    assert 5 < refuted < 19 and proved >= 0.95 * refuted


@pytest.mark.long(by_day="test_it_proves_what_programs_over_all_samples_refute_and_nothing_else")
def test_five_thousand_cases_near_the_boundary(rng):
    proved, refuted, tried = np.sum([near_the_boundary(rng, 250, 12, seed) for seed in range(20)], 0)
    print(f"{proved} of {refuted} contradictions proved, of {tried} recordings")
    assert refuted > 1000 and proved >= 0.97 * refuted


def test_the_set_in_which_a_trajectory_begins_lies_in_x0_in_float32_too(rng):
    model = jb.LinearSystem([["0.5"]], None, [[1]], noise="0.3")
    out = 0
    for center, radius in rng.uniform(1, 200, (50, 2)):
        first = zonotope([center], [[radius]])
        with jax.enable_x64(False):
            observer = jb.observer(model, x0=first, method="joint", window=4)
            begun = observer.init()
            path = observer._first_path(begun._replace(mark=observer._mark(begun, 0)))
        assert path.c.dtype == np.float32
        (c,), ((side,),) = np.float64(path.c[..., 0]), np.float64(path.S[..., 0])
        out += Fraction(c) + abs(Fraction(side)) > Fraction(center) + Fraction(radius)
        out += Fraction(c) - abs(Fraction(side)) < Fraction(center) - Fraction(radius)
    assert out == 0


@pytest.mark.usefixtures("searched_in_numpy")
@pytest.mark.parametrize("order", [1, 20])
def test_a_first_set_of_many_generators_makes_no_behaviour_consistent_that_begins_beside_it(order):
    """Samples say that both states are at least .6, the set that their sum is at most 1.1."""
    model = jb.LinearSystem([[1, 0], [0, 1]], None, [[1, 0], [0, 1]], noise="0.3")
    first = zonotope([0, 0], [[0.5, 0.5, 0.05], [0.5, -0.5, 0.05]])
    options = {"x0": first, "method": "joint", "window": 4, "order": order, "weight": 1000.0}
    status = jb.observe(model, None, np.full((8, 2), 0.9), **options).status
    assert not (status == jb.Status.CONSISTENT).any()


@pytest.mark.usefixtures("searched_in_numpy")
def test_consistent_is_a_trajectory_through_all_samples(rng):
    """Where it is said a program over all samples has a solution; healthy recordings mostly have it, also
    beyond the first window.
    """
    x0 = [-5.0, -5.0], [5.0, 5.0]
    u = rng.normal(size=(24, 16, 1))
    found = jb.simulate(PLANT, u, jax.random.key(8), x0=rng.uniform(-3, 3, (24, 2)), at="uniform")
    y = np.array(found.y)
    y[12:, 8:, 0] += np.linspace(0, 0.3, 12)[:, None]
    status = jb.observe(PLANT, u, y, x0=jb.interval(*x0), restart=False, **JOINT).status
    said = np.asarray(status) == jb.Status.CONSISTENT
    print(
        f"CONSISTENT: {said[:12, 4:].mean():.2f} of healthy samples, {said[12:, -1].sum()} of 12 faulty "
        f"recordings at their end"
    )
    assert said[:12, 4:].mean() > 0.5 and not said[:, :4].any()
    for j in range(24):
        if said[j].any():
            k = int(np.flatnonzero(said[j])[-1])
            assert program(PLANT, u[j, : k + 1], y[j, : k + 1], x0) is not None


def test_in_pieces_and_in_a_batch_it_says_the_same(rng):
    u, _, y = recorded(PLANT, 40, 5, N=24, at="uniform")
    y[1, 20:] += 3
    whole = jb.observe(PLANT, u, y, **JOINT)
    watch = jb.observer(PLANT, **JOINT).telling(enclosures=True)
    for j in range(2):
        carry, pieces = watch.init(), []
        for a, b in ((0, 7), (7, 8), (8, 23), (23, 40)):
            carry, told = watch.fold(carry, Recording.of(PLANT, u[j, a:b], y[j, a:b]))
            pieces.append(told)
        pieces = jax.tree.map(lambda *x: np.concatenate(x), *pieces)
        for a, b in zip(jax.tree.leaves(pieces), jax.tree.leaves(whole), strict=True):
            np.testing.assert_allclose(
                a, b[j], rtol=1e-6, atol=1e-6
            )  # other blocks, other last digits of the search
    assert (whole.status[1] == jb.Status.FAULT).any() and not (whole.status[0] == jb.Status.FAULT).any()


@pytest.mark.usefixtures("searched_in_numpy")
def test_strips_beside_a_parallelotope_make_enclosures_narrower_and_none_wider(monkeypatch):
    u, _, y = recorded(PLANT, 20, 5, N=2, at="uniform")
    width = lambda: (lambda x: np.asarray(x.hi - x.lo)[:, 2:])(jb.observe(PLANT, u, y, **JOINT).state)
    strips = width()
    monkeypatch.setattr(
        "jaxbound.estimation.joint_observer.lasting", lambda A, C, steps: np.zeros((0, len(A)))
    )
    ratio = strips / width()
    print(ratio.min(), np.median(ratio), ratio.max())
    assert ratio.min() < 0.95 and ratio.max() < 1 + 1e-5


def test_what_is_slow_is_seen_that_zonotopes_and_windows_miss():
    """A disturbed, slow plant and a sensor that drifts; taken in pieces, as a monitor would."""
    slow = jb.LinearSystem(
        [["0.99", "0.005"], ["0.005", "0.98"]],
        [["0.01"], [0]],
        [[1, 0]],
        noise="0.5",
        disturbance=([[1], [1]], "0.01"),
    )
    u, _, y = recorded(slow, 96, 1, at="uniform")
    y[:, 0] += 0.03 * np.maximum(np.arange(96) - 24, 0)

    def fault(**how):
        watch, status = jb.observer(slow, restart=False, **how).telling(enclosures=True), []
        carry = watch.init()
        for k in range(0, 96, 16):
            carry, told = watch.fold(carry, Recording.of(slow, u[k : k + 16], y[k : k + 16]))
            status.append(told.status)
        return np.concatenate(status) == jb.Status.FAULT

    joint, alone = fault(**JOINT), fault(order=JOINT["order"])
    print(joint.argmax(), alone.argmax(), alone.any())
    assert joint.any() and joint.argmax() > 24 and not alone[: joint.argmax() + 1].any()


def test_what_it_cannot_take_is_said():
    for match, more in (
        ("even number", {"window": 5}),
        ("even number", {"window": True}),
        ("an observer is one of", {"method": "kalman"}),
        ('"joint" sees at least as much', {"method": "constrained"}),
    ):
        with pytest.raises(ValueError, match=match):
            jb.observer(PLANT, **{"method": "joint", **more})
    assert jb.observer(PLANT, method="strips").weights.tolist() == [1.0]
