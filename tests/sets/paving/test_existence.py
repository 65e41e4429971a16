"""The steps behind a proof of existence: error bounds against exact rationals, and proofs whose conclusion is
known.
"""

from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbound as jb
from jaxbound.sets import Status, interval
from jaxbound.sets.paving import existence


def exactly(a):
    return [[Fraction(float(x)) for x in row] for row in a]


@pytest.mark.parametrize("compiled", [False, True])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_products_are_within_their_error_bound(rng, dtype, compiled):
    times = jax.jit(existence._times) if compiled else existence._times
    for spread in (0, 3, 30 if dtype == np.float64 else 12):
        for k in (1, 2, 7) if compiled else (7,):  # uncompiled, each size is a dozen small programs
            A, B = (rng.normal(size=s) * 10.0 ** rng.uniform(-spread, spread, s) for s in ((4, k), (k, 4)))
            if k > 1:  # the sum cancels
                A[:, -1], B[-1] = A[:, 0], -B[0]
            A, B = A.astype(dtype), B.astype(dtype)
            product, error = map(np.asarray, times(A, B))
            a, b = exactly(A), exactly(B)
            for i in range(4):
                for j in range(4):
                    true = sum((a[i][m] * b[m][j] for m in range(k)), Fraction(0))
                    assert abs(Fraction(float(product[i, j])) - true) <= Fraction(float(error[i, j]))


def test_upper_bounds_of_products_are_above_them(rng):
    for _ in range(50):
        A, B = (10.0 ** rng.uniform(-320, 100, s) for s in ((3, 4), (4, 2)))
        above, a, b = np.asarray(existence._upper(A, B)), exactly(A), exactly(B)
        for i in range(3):
            for j in range(2):
                assert Fraction(float(above[i, j])) >= sum(a[i][m] * b[m][j] for m in range(4))


@pytest.mark.parametrize(("m", "n"), [(1, 1), (2, 2), (1, 3), (2, 3), (3, 2)])
def test_the_inverse_is_near_enough_to_one(rng, m, n):
    J, inverse = rng.normal(size=(m, n)), jax.jit(existence._right_inverse)
    P = np.asarray(inverse(J, np.ones(n)))
    product = J @ P if n >= m else P @ J
    assert abs(product - np.eye(min(m, n))).max() < 1e-6
    frozen = np.asarray(inverse(J, np.r_[np.ones(n - 1), 0.0]))
    assert (frozen[-1] == 0).all()  # a variable of no width is not moved
    assert (np.asarray(inverse(np.zeros((m, n)), np.ones(n))) == 0).all()


@pytest.mark.parametrize(
    ("f", "top", "target"),
    [
        (lambda z: [z[0] ** 2], (), [1.0]),  # solved by z = 1
        pytest.param(
            lambda z: [z[0] ** 2 + z[1], z[0] - z[1]],  # by z = (1, 1)
            (3.0,),
            [2.0, 0.0],
            marks=(pytest.mark.long, pytest.mark.compiled),
        ),
    ],
)
def test_a_solution_on_the_edge_of_the_box_is_not_claimed_from_outside(f, top, target):
    for inside, want in ((1.0 + 1e-9, Status.CONSISTENT), (1.0 - 1e-9, Status.FAULT)):
        assert jb.pave(f, interval([0.0] * len(target), [inside, *top]), target).status == want


def test_a_variable_of_no_width_is_a_constant():
    f = lambda z: [z[0] * z[1]]
    found = jb.pave(f, interval([0.5, 0.0], [0.5, 1.0]), [[0.25], [0.75]])
    assert found.status.tolist() == [Status.CONSISTENT, Status.FAULT]
    assert np.asarray(found.witness.lo)[0, 0] <= 0.5 <= np.asarray(found.witness.hi)[0, 0]


def test_a_false_derivative_rule_is_not_believed():
    @jax.custom_jvp
    def liar(x):
        return x * x + 1

    liar.defjvp(lambda primals, tangents: (liar(*primals), 100 * tangents[0]))
    f = lambda z: [liar(z[0]) + jax.lax.stop_gradient(z[1])]
    found = jb.pave(f, interval([-1.0, -1.0], [1.0, 1.0]), [[-0.1], [1.75]])
    assert found.status.tolist() == [Status.FAULT, Status.CONSISTENT]


def test_kinks_are_no_obstacle():
    f = lambda z: [jnp.abs(z[0]) + jnp.maximum(z[1], 0.3)]
    found = jb.pave(f, interval([-1.0, -1.0], [1.0, 1.0]), [[0.75], [0.2]])
    assert found.status.tolist() == [Status.CONSISTENT, Status.FAULT]


@pytest.mark.parametrize(
    ("f", "kind"),
    [
        (lambda z: z[0] + z[1], False),
        (lambda z: jnp.sin(z), False),
        (lambda z: [jb.sets.sqr(z[0])], True),
        (lambda z: [z[0].mid + 0 * z[0].wid], True),
    ],
)
def test_functions_of_numbers_and_of_intervals_are_told_apart(f, kind):
    assert existence.is_interval_function(f, jnp.zeros(2), ()) is kind
