"""Tolerances that are constant over a window: against a linear program that knows gains and states, and
against a grid of gains.
"""

from fractions import Fraction

import jax
import numpy as np
import pytest
from oracles import Program
from systems import paper

import jaxbound as jb
from jaxbound.models import window
from jaxbound.sets import Status

SIGMA, RHO = np.array([0.02, 0.1]), np.array([0.1, 0.01])


def model(**change):
    return paper(constant_tolerance=True, **change)


def draw(rng, s, count, scale, spoiled=0.5):
    """Return (u (N, s + 1, 1), y (N, s + 1, 2)) of section 5 with a constant theta, which a part of the
    windows draws anew each sample.
    """
    O, H = forms(s)
    x, u = rng.normal(size=(count, 2)) * scale, rng.uniform(-1, 1, (count, s + 1, 1))
    true = (x @ O.T + u[:, :s, 0] @ H.T).reshape(count, s + 1, 2)
    theta = np.broadcast_to(rng.uniform(-1, 1, (count, 1, 2)), true.shape)
    theta = np.where(rng.random((count, 1, 1)) < spoiled, rng.uniform(-1, 1, true.shape), theta)
    return u, (1 + SIGMA * theta) * true + RHO * rng.uniform(-1, 1, true.shape)


def forms(s):
    return [np.array([[float(x) for x in row] for row in a]) for a in window.first_form(paper(), s)]


def verdicts(u, y, m=None, **options):
    s = y.shape[1] - 1
    res = jb.detect(jb.parity_relations(m or model(), horizon=s), u, y, **options)
    return res.status[:, -1], res.margin[:, -1]


def violation(u, y, t=1.0):
    """Return the least e for which some state and gains keep g (d -+ t rho) on their sides of O x + H u, to e
    rho. HiGHS.

    Nothing of this is ours: (1 + theta) (O x + H u) + delta = y, divided by 1 + theta = 1 / g, is linear in x
    and g.
    """
    s = y.shape[1] - 1
    O, H = forms(s)
    rows, out = len(O), []
    rho = np.tile(RHO, s + 1)
    gain = np.tile(np.eye(2), (s + 1, 1))
    bound = 1 / (1 + t * SIGMA), 1 / (1 - t * SIGMA)
    for ui, yi in zip(u[:, :s, 0], y.reshape(len(y), rows), strict=True):
        above = np.hstack([-O, gain * (yi - t * rho)[:, None], -rho[:, None]])
        below = np.hstack([O, -gain * (yi + t * rho)[:, None], -rho[:, None]])
        box = np.hstack([np.zeros((2, 2)), np.eye(2), np.zeros((2, 1))])
        drive, free = H @ ui, np.full(2 * rows, -np.inf)
        program = Program(np.vstack([above, below, box]), np.r_[np.zeros(4), 1.0])
        out.append(program.solve(np.r_[free, bound[0]][None], np.r_[drive, -drive, bound[1]][None])[0])
    return np.array(out)


@pytest.mark.parametrize(
    ("s", "count"), [(1, 90), *(pytest.param(s, 900, marks=pytest.mark.long) for s in (1, 2, 4))]
)
def test_the_verdicts_are_those_of_the_linear_program_in_states_and_gains(rng, s, count):
    u, y = (
        np.concatenate(x)
        for x in zip(*(draw(rng, s, count // 3, scale) for scale in (0.5, 3, 30)), strict=True)
    )
    status, _ = verdicts(u, y)
    e = violation(u, y)
    clear = abs(e) > 1e-7
    assert (status[clear & (e < 0)] == Status.CONSISTENT).all() and (
        status[clear & (e > 0)] == Status.FAULT
    ).all()
    assert clear.mean() > 0.95 and 0.1 < (e > 0).mean() < 0.9
    assert (status != Status.UNDECIDED).mean() >= 0.99


@pytest.mark.parametrize("s", [1, pytest.param(4, marks=pytest.mark.long)])
def test_no_window_that_a_grid_of_gains_explains_is_a_fault(rng, s):
    u, y = draw(rng, s, 200, 2.0, spoiled=1.0)
    r = jb.parity_relations(paper(), horizon=s)
    circuits, K = ([[float(x) for x in row] for row in a] for a in (r.circuits, r.circuits_known))
    circuits, reach = np.array(circuits), u[:, :s, 0] @ np.array(K).T
    explained = np.zeros(len(y), bool)
    for a in np.linspace(-1, 1, 9):
        for b in np.linspace(-1, 1, 81):
            g = np.tile(1 / (1 + SIGMA * [a, b]), s + 1)
            off = abs((y.reshape(len(y), -1) * g) @ circuits.T - reach)
            explained |= (off <= abs(circuits * g) @ np.tile(RHO, s + 1)).all(1)
    status, _ = verdicts(u, y)
    assert explained.any() and (status[explained] == Status.CONSISTENT).all()
    assert (status == Status.FAULT).any()


@pytest.mark.parametrize(("s", "at"), [(1, "vertices"), pytest.param(4, "uniform", marks=pytest.mark.long)])
def test_a_healthy_recording_with_one_theta_an_output_is_never_a_fault(rng, s, at):
    m = model(resolution=0.001)
    u = np.repeat(rng.uniform(-1, 1, (40, 1)), 50, 0) * 10
    healthy = jb.simulate(m, u, jax.random.key(rng.integers(2**31)), at=at)
    assert (np.ptp(np.asarray(healthy.theta), axis=0) == 0).all() and (
        abs(np.asarray(healthy.theta)) <= SIGMA
    ).all()
    res = jb.detect(jb.parity_relations(m, horizon=s), u, healthy.y)
    assert (
        res.counts["FAULT"] == 0
        and res.counts["MISSING"] == s
        and res.counts["CONSISTENT"] > 0.99 * (len(u) - s)
    )


def test_a_constant_theta_explains_less_than_one_drawn_anew(rng):
    u, y = draw(rng, 1, 500, 30.0)
    anew, _ = verdicts(u, y, paper())
    status, _ = verdicts(u, y)
    assert (anew == Status.CONSISTENT).all() and 0.1 < (status == Status.FAULT).mean() < 0.7
    alone, _ = verdicts(u, y, method="box")
    assert (status[alone == Status.FAULT] == Status.FAULT).all() and not (alone == Status.CONSISTENT).any()


@pytest.mark.parametrize("s", [1, pytest.param(4, marks=pytest.mark.long)])
def test_the_margin_is_the_factor_at_which_the_program_changes_its_mind(rng, s):
    u, y = draw(rng, s, 40, 2.0)
    status, margin = verdicts(u, y)
    assert ((margin > 0) == (status == Status.CONSISTENT)).all()
    t = 1 - margin
    usable = t < 5  # beyond, the tolerance of an output would pass 1
    assert usable.sum() > 20
    for k in np.flatnonzero(usable):
        assert violation(u[k : k + 1], y[k : k + 1], t[k])[0] < 1e-7  # some gains reach t
    reached = np.array([violation(u[k : k + 1], y[k : k + 1], t[k] / 1.4)[0] for k in np.flatnonzero(usable)])
    assert (reached > 0).mean() > 0.8  # and seldom much less


def test_missing_samples_are_left_out_and_a_missing_input_may_be_anything(rng):
    u, y = draw(rng, 1, 300, 30.0)
    whole, _ = verdicts(u, y)
    gap = y.copy()
    gap[:, 1, 0] = np.nan
    less, _ = verdicts(u, gap)
    assert (whole[less == Status.FAULT] == Status.FAULT).all() and (less == Status.CONSISTENT).any()
    blind = u.copy()
    blind[:, 0] = np.nan
    silent, _ = verdicts(blind, y)
    assert (silent[whole == Status.CONSISTENT] == Status.CONSISTENT).all()
    assert (whole[silent == Status.FAULT] == Status.FAULT).all()
    nothing, margin = verdicts(u, np.full_like(y, np.nan))
    assert (nothing == Status.MISSING).all() and np.isnan(margin).all()


@pytest.mark.parametrize("dtype", [np.float32, pytest.param(np.float64, marks=pytest.mark.long)])
def test_readings_exactly_at_their_bounds_are_never_a_fault(rng, dtype):
    s, count = 1, 2000
    O, H = forms(s)
    x, u = (
        rng.normal(size=(count, 2)) * 10.0 ** rng.uniform(-2, 3, (count, 1)),
        rng.uniform(-1, 1, (count, s + 1, 1)).astype(dtype),
    )
    true = (x @ O.T + u[:, :s, 0] @ H.T).reshape(count, s + 1, 2)
    y = (1 + SIGMA * rng.choice([-1, 1], (count, 1, 2))) * true + RHO * rng.choice([-1, 1], true.shape)
    status, _ = verdicts(u, y.astype(dtype))
    assert not (status == Status.FAULT).any()


def test_without_tolerance_the_verdicts_are_those_of_the_plain_test(rng):
    u, y = draw(rng, 1, 300, 1.0)
    plain, margin = verdicts(u, y, paper(tolerance=0))
    status, ours = verdicts(u, y, model(tolerance=0))
    assert (status == plain).all() and np.allclose(margin, ours, atol=1e-3)


@pytest.mark.parametrize("s", [1, pytest.param(2, marks=pytest.mark.long)])
def test_disturbances_keep_their_place(rng, s):
    change = dict(disturbance=([[0], [1]], [[0, Fraction(1, 10)]]))
    u, y = draw(rng, s, 300, 10.0, spoiled=0.6)
    without, _ = verdicts(u, y)
    status, _ = verdicts(u, y, model(**change))
    assert (without[status == Status.FAULT] == Status.FAULT).all() and (status == Status.FAULT).any()
    still, _ = verdicts(u, y, model(disturbance=([[0], [1]], 0)))
    assert (still == without).all()


def test_recordings_of_any_length_share_their_verdicts(rng):
    u, y = draw(rng, 1, 1000, 10.0)
    status, margin = verdicts(u, y)
    part, size = verdicts(u[:37], y[:37])
    assert (part == status[:37]).all() and np.allclose(size, margin[:37], rtol=1e-9)


def test_what_a_constant_tolerance_cannot_do_is_said():
    r = jb.parity_relations(model(), horizon=1)
    with pytest.raises(NotImplementedError, match="margins has no fast path for constant_tolerance"):
        jb.margins(r, np.zeros((3, 1)), np.zeros((3, 2)))
    with pytest.raises(ValueError, match="constant_tolerance must be True or False, not 'yes'"):
        paper(constant_tolerance="yes")


def test_a_model_file_keeps_the_field(tmp_path):
    for value in (True, False):
        m = paper(constant_tolerance=value)
        jb.save_model(m, tmp_path / "m.toml")
        assert jb.load_model(tmp_path / "m.toml").constant_tolerance is value


def test_a_plant_without_states_is_judged():
    tank = jb.LinearSystem(
        None, None, None, [[2], [1]], tolerance=["1/10", 0], noise=0.1, constant_tolerance=True
    )
    u = np.arange(1.0, 9)[:, None]
    y = np.hstack([2 * u, u])
    y[5, 0] += 8
    for method, healthy in (("joint", jb.Status.CONSISTENT), ("box", jb.Status.UNDECIDED)):
        status = jb.detect(jb.parity_relations(tank, 1), u, y, method=method).status
        assert (status[5:7] == jb.Status.FAULT).all() and (status[[1, 2, 3, 4, 7]] == healthy).all()
