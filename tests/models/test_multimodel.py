"""Multiple models: what is joined, how the input weights it, what is refused."""

import pickle
from fractions import Fraction

import numpy as np
import pytest

import jaxbound as jb


def _pair():
    return [
        jb.interval_system([[a]], [[1 - a]], [[[c, c + 1]]], noise=n)
        for a, c, n in ((0.9, 1, 0.1), (0.5, 3, 0.2))
    ]


def _linear(u):
    return np.stack([u[..., 0], 1 - u[..., 0]], -1)


def test_interval_systems_are_equal_where_every_number_is():
    one, other, wider = (
        jb.interval_system([["0.5", [0.1, hi]]] * 2, None, [[1, 1]], noise=0.1)
        for hi in (0.2, Fraction(1, 5), 0.3)
    )
    assert (
        one == other
        and hash(one) == hash(other)
        and one == pickle.loads(pickle.dumps(one))
        and one != wider
        and one != "model"
    )


def test_the_bounds_of_an_interval_system_are_not_written():
    model = jb.interval_system([[0.5]], None, [[1]], noise=0.1)
    for system in (
        model,
        jb.MultiModel([jb.LinearSystem([[0.5]], None, [[1]], noise=0.1), model], None).models[0],
    ):
        for bound in (system.noise, system.tolerance):
            with pytest.raises(ValueError, match="read-only"):
                bound[0] = 0


def test_the_joined_system_holds_both_side_by_side():
    m = jb.MultiModel(_pair(), _linear)
    joined = m.joined()
    assert (joined.n, joined.m, joined.p, m.n) == (2, 1, 1, 2)
    assert joined.A.lo[0, 1] == joined.A.hi[1, 0] == 0 and joined.A.lo[0, 0] <= 0.9 <= joined.A.hi[0, 0]
    assert (
        joined.C.lo.tolist() == [[1.0, 3.0]]
        and joined.C.hi.tolist() == [[2.0, 4.0]]
        and joined.noise[0] >= 0.2
    )
    assert joined.states == ("1.x1", "2.x1") and joined.moves is None
    assert m.columns(np.array([[0.25], [1.0]])).lo.round(12).tolist() == [[0.25, 0.75], [1.0, 0.0]]


def test_the_disturbance_of_each_model_is_kept():
    """One disturbance moves both states of the first model: what couples them stays, and the second model is
    certain.
    """
    first = jb.LinearSystem([[0.5, 0.1], [0, 0.3]], [[1], [1]], [[1, 0]], disturbance=([[1], [2]], [0.1]))
    second = jb.LinearSystem([[0.9]], [[2]], [[1]])
    m = jb.MultiModel([first, second], _linear).joined()
    assert m.w.lo.tolist() == [-0.1, -0.2, 0.0] and m.w.hi.tolist() == [0.1, 0.2, 0.0]
    E, K, H, d = m.moves
    assert E.shape == K.shape == (3, 3) and H.shape == (3, 1) and d.shape == (3,)
    x, u, w = np.array([1.0, -2.0, 3.0]), np.array([0.7]), 0.06
    after = np.array([0.5 - 0.2 + 0.7 + w, -0.6 + 0.7 + 2 * w, 2.7 + 1.4])
    rest = np.asarray(E.lo) @ x - np.asarray(K.lo) @ after + np.asarray(H.lo) @ u
    lo, hi = np.asarray(d.lo), np.asarray(d.hi)
    assert ((-hi - 1e-12 <= rest) & (rest <= -lo + 1e-12)).all()
    assert (hi > lo).sum() == 1  # a box of w would leave two rows uncertain


@pytest.mark.parametrize("given", [np.float64, np.float32])
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_weights_hold_all_numbers_within_a_few_ulps(given, dtype, rng):
    m = jb.MultiModel(_pair(), lambda u: _linear(u).astype(given))
    u = rng.uniform(0, 1, (50, 1)).astype(dtype)
    u[:2, 0] = 0, 1
    mu, said = m.mu(u), _linear(u).astype(given)
    assert mu.dtype == dtype and mu.shape == (50, 2)
    ulp = 8 * Fraction(float(max(np.finfo(dtype).eps, np.finfo(given).eps)))
    for lo, hi, w in zip(mu.lo.ravel(), mu.hi.ravel(), said.ravel(), strict=True):
        exact = Fraction(float(w))
        assert 0 <= Fraction(float(lo)) <= exact * (1 - ulp) and exact * (1 + ulp) <= Fraction(
            float(hi)
        ) <= exact * (1 + 8 * ulp) + Fraction(1, 10**30)


def test_weights_may_be_intervals():
    m = jb.MultiModel(_pair(), lambda u: jb.interval(np.maximum(_linear(u) - 0.1, 0), _linear(u) + 0.1))
    mu = m.mu(np.array([[0.5]]))
    assert (mu.lo <= 0.4).all() and (mu.hi >= 0.6).all() and (mu.hi - mu.lo < 0.21).all()


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: jb.MultiModel(_pair()[:1], len), "at least two models"),
        (
            lambda: jb.MultiModel([_pair()[0], jb.interval_system([[1]], None, [[1]])], len),
            "same number of inputs",
        ),
        (
            lambda: jb.MultiModel([jb.LinearSystem([[1]], [[1]], [[1]], D=[[1]]), _pair()[0]], len),
            "feedthrough or an offset",
        ),
        (lambda: jb.MultiModel(_pair(), lambda u: u).mu(np.ones((3, 1))), "weights must return shape"),
        (lambda: jb.MultiModel(_pair(), lambda u: np.ones((3, 2))).mu(np.ones((3, 1))), "sum to 1"),
        (lambda: jb.MultiModel(_pair(), lambda u: np.tile([1.5, -0.5], (3, 1))).mu(np.ones((3, 1))), ">= 0"),
        (lambda: jb.MultiModel(_pair(), lambda u: np.full((3, 2), np.nan)).mu(np.ones((3, 1))), "sum to 1"),
        (
            lambda: jb.MultiModel(_pair(), lambda u: jb.interval(np.zeros((3, 2)), np.full((3, 2), 0.4))).mu(
                np.ones((3, 1))
            ),
            "sum to 1",
        ),
        (
            lambda: jb.validate(
                jb.MultiModel(_pair(), len), np.ones((9, 1)), np.ones((9, 1)), method="sequential"
            ),
            "use method='joint'",
        ),
        (
            lambda: jb.validate(jb.MultiModel(_pair(), len, partial=True), np.ones((9, 1)), np.ones((9, 1))),
            r"\(\.\.\., T, 2, 1\)",
        ),
        (
            lambda: jb.validate(
                jb.MultiModel(_pair(), len, partial=True),
                np.ones((9, 1)),
                np.ones((9, 2, 1)),
                x0=jb.interval([0.0], [1.0]),
            ),
            "each of 2 states",
        ),
    ],
)
def test_bad_input_gets_a_sentence(call, says):
    with pytest.raises(ValueError, match=says):
        call()
