"""An uncertain, disturbed linear differential equation over one step: its matrices, and a bound of all they
leave out.

With held inputs v, parameters pi that keep their value over the step and |r| <= R at any time,

    dz/dt = A z + B v + c + sum_k pi_k (A_k z + B_k v + c_k) + r
    (1)
    z+ = A_d z + B_d v + Phi c + sum_k pi_k (L_k z + M_k v + l_k) + e,
    |e| <= I (R + sum_k |pi_k| |A_k| d)                                                            (2)
    d = I (R + sum_k |pi_k| max |A_k z + B_k v + c_k|),   I = integral of |exp(A t)| over the step  (3)

(2) is the variation of constants formula; L_k, M_k, l_k are the derivatives of the exponential by the
parameter, and d bounds how far z leaves the path that (1) has with pi = r = 0. Everything is in Fractions.

Source: Van Loan 1978 for the blocks whose exponentials hold the integrals.
"""

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from jaxbound.exact.exponential import absolute_integral, exponential
from jaxbound.exact.linalg import rational
from jaxbound.models.conversion import hold


@dataclass(frozen=True)
class Affine:
    """constant + matrix zeta + sum_k pi_k (shift_k + change_k zeta) + r: a function of zeta = (z, v) in a
    box.

    Fields, arrays of Fractions: constant (k,), matrix (k, N), shift (k, q), change (k, q, N), remainder (k,)
    the bound of |r|, low, high (N,) the box, spread (q,) the bound of |pi|.
    """

    constant: np.ndarray
    matrix: np.ndarray
    shift: np.ndarray
    change: np.ndarray
    remainder: np.ndarray
    low: np.ndarray
    high: np.ndarray
    spread: np.ndarray


def held(g: Affine, n: int, dt: Fraction) -> Affine:
    """Return the Affine of z+ for one of dz/dt, over a step dt with held inputs; zeta has n states first.

    Encloses: every solution that stays in the box of g over the step; the matrices are decimals, what they
    round away is in the remainder.
    """
    N, q = g.matrix.shape[1], len(g.spread)
    rest = np.concatenate([g.matrix[:, n:], g.constant[:, None]], axis=1)
    X, error = hold(g.matrix[:, :n], rest, dt)
    derivative = np.full((n, q, N + 1), Fraction(0), object)
    M = _square(g.matrix, g.constant)
    for k in range(q):
        # exp([[M, N], [0, M]]) has the derivative of exp(M) in the direction N at its upper right
        direction = _square(g.change[:, k], g.shift[:, k])
        block, e = exponential(np.block([[M, direction], [0 * M, M]]) * dt)
        derivative[:, k], error = block[:n, N + 1 :], max(e, error)
    through = absolute_integral(g.matrix[:, :n], dt)
    # (3), of which (2) takes what a parameter does along the way
    strayed = through @ (g.remainder + _largest(g) @ g.spread)
    turned = (abs(g.change[:, :, :n]) @ strayed) @ g.spread
    stepped = Affine(
        constant=X[:n, N],
        matrix=X[:n, :N],
        shift=derivative[:, :, N],
        change=derivative[:, :, :N],
        remainder=through @ (g.remainder + turned),
        low=g.low,
        high=g.high,
        spread=g.spread,
    )
    return decimals(stepped, error)


def _square(matrix: np.ndarray, constant: np.ndarray) -> np.ndarray:
    """Return [matrix, constant] with rows of zeros below, as many as make it square."""
    rows = np.concatenate([matrix, constant[:, None]], axis=1)
    count, width = rows.shape
    return np.concatenate([rows, np.full((width - count, width), Fraction(0), object)])


def _largest(g: Affine) -> np.ndarray:
    """Return the bounds (k, q) of |shift + change zeta| over the box."""
    middle, radius = (g.low + g.high) / 2, (g.high - g.low) / 2
    return np.asarray(abs(g.shift + g.change @ middle) + abs(g.change) @ radius)


def decimals(g: Affine, error: Fraction | int = 0) -> Affine:
    """Return g with its matrices rounded to decimals of floats; what is rounded away, and an error of each
    number, goes to the remainder.

    The shift is left out: a parameter that pushes without a signal is counted to the remainder too.
    """
    near = np.vectorize(lambda x: rational(float(x)), otypes=[object])
    matrix, change = near(g.matrix), near(g.change)
    off = abs(g.matrix - matrix) + error, abs(g.change - change) + error
    radii = np.maximum(abs(g.low), abs(g.high))
    # each number of a matrix is off by so much, times the largest signal of the box
    more = off[0] @ radii + error + (off[1] @ radii + abs(g.shift) + error) @ g.spread
    return Affine(g.constant, matrix, 0 * g.shift, change, g.remainder + more, g.low, g.high, g.spread)
