"""Multiple models: what is joined, how the input weights it, what is refused."""

import numpy as np
import pytest

import jaxbound as jb


def _pair():
    return [jb.interval_system([[a]], [[1 - a]], [[[c, c + 1]]], noise=n) for a, c, n in ((0.9, 1, 0.1), (0.5, 3, 0.2))]


def test_the_joined_system_holds_both_side_by_side():
    m = jb.MultiModel(_pair(), lambda u: np.stack([u[..., 0], 1 - u[..., 0]], -1))
    joined = m.joined()
    assert (joined.n, joined.m, joined.p, m.n) == (2, 1, 1, 2)
    assert joined.A.lo[0, 1] == joined.A.hi[1, 0] == 0 and joined.A.lo[0, 0] <= 0.9 <= joined.A.hi[0, 0]
    assert joined.C.lo.tolist() == [[1.0, 3.0]] and joined.C.hi.tolist() == [[2.0, 4.0]] and joined.noise[0] >= 0.2
    assert m.columns(np.array([[0.25], [1.0]])).lo.tolist() == [[0.25, 0.75], [1.0, 0.0]]


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: jb.MultiModel(_pair()[:1], len), "at least two models"),
        (lambda: jb.MultiModel([_pair()[0], jb.interval_system([[1]], None, [[1]])], len), "same number of inputs"),
        (lambda: jb.MultiModel([jb.LinearSystem([[1]], [[1]], [[1]], D=[[1]]), _pair()[0]], len), "feedthrough or an offset"),
        (lambda: jb.MultiModel(_pair(), lambda u: u).columns(np.ones((3, 1))), "weights must return shape"),
        (lambda: jb.MultiModel(_pair(), lambda u: np.ones((3, 2))).columns(np.ones((3, 1))), "sum to 1"),
        (lambda: jb.validate(jb.MultiModel(_pair(), len), np.ones((9, 1)), np.ones((9, 1)), method="sequential"), "use method='joint'"),
    ],
)
def test_bad_input_gets_a_sentence(call, says):
    with pytest.raises(ValueError, match=says):
        call()
