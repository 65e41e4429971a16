"""What proves that a point lies in a zonotope or outside of it: checks of given candidates, in float64 on the host.

The question is always whether some x in [-1, 1]^q has M x = d, for a set that its matrix M (m, q) holds and points d. Whatever found the
candidates (`zonotopes.search`), on whatever device and in whatever precision, has no part in the proof. NumPy's products are plain sums of
products in some order, fused or not: `rounding.product_error` bounds them; that is the premise here.

**Outside** (`gauge_above`). Any l with l'd > sum_j |l' M_j|. In floats both sides together are off by at most
gamma (|l|'|d| + sum_j |l|'|M_j|) + floor (1 + max|l|)(1 + max|M| + max|d|), that of a sum of m + q products. d, a difference of two floats
rounded once, is off by u |d|, which gamma holds as well.

**Inside** (`gauge_below`). Let R be such that every row sum of |1 - M R| is at most rho < 1 and x any point, r = d - M x. Then y with
M R y = r exists, max|y| <= max|r| / (1 - rho), and M (x + R y) = d: x_j moves by at most reach_j max|y|, reach_j = sum_i |R_ji|.
So min max|x| <= max_j (|x_j| + reach_j max|r| / (1 - rho)). A set that is flat, or flat but for rounding, has no such R.
"""

from dataclasses import dataclass

import numpy as np

from jaxbound.sets.floats import rounding

__all__ = ["Image", "gauge_above", "gauge_below", "image", "vertices"]

UP = 1 + 2.0**-48
"""More than the few roundings, each of 2^-53, of what it multiplies."""


@dataclass(frozen=True, eq=False)
class Image:
    """M [-1, 1]^q for each of S sets, rows scaled by powers of two so that no entry exceeds 1, with what the proofs need of it.

    Fields: M (S, m, q) and powers (S, m), M = 2^powers times the rows given; R (S, q, m), a right inverse, nearly; reach (S, q) = row sums
    of |R|; loss (S,), at least every row sum of |1 - M R|, inf where that is of no use; sums (S, m), row sums of |M|.
    """

    M: np.ndarray
    powers: np.ndarray
    R: np.ndarray
    reach: np.ndarray
    loss: np.ndarray
    sums: np.ndarray

    def scaled(self, d):
        """Return points d (S, N, m) in the rows' own scale; NaN for a number that it would turn into 0 or infinity."""
        with np.errstate(over="ignore", under="ignore"):
            out = np.ldexp(d, self.powers[:, None])
        return np.where(((out == 0) & (d != 0)) | ~np.isfinite(out), np.nan, out)

    def of(self, sets):
        """Return the Image of some of the sets, by number."""
        return Image(*(x[sets] for x in (self.M, self.powers, self.R, self.reach, self.loss, self.sums)))


def image(M):
    """Build the Image of matrices M (S, m, q), any finite floats."""
    M = np.asarray(M, float)
    S, m, q = M.shape
    top = abs(M).max(2, initial=0)
    powers = np.where(top > 0, -np.frexp(top)[1], 0)
    M = np.ldexp(M, powers[..., None])
    R = _right_inverse(M)
    with np.errstate(all="ignore"):
        gamma, floor = rounding.product_error(q + 2, float)
        off = abs(M @ R - np.eye(m)) + gamma * (abs(M) @ abs(R) + 1) + 2 * floor * (1 + abs(R).max((1, 2), initial=0))[:, None, None]
        loss = off.sum(2).max(1, initial=0) * (1 + rounding.product_error(m, float)[0])
        reach = abs(R).sum(2) * (1 + rounding.product_error(m, float)[0])
        return Image(M, powers, R, reach, np.where(loss < 0.5, loss, np.inf), abs(M).sum(2))


def _right_inverse(M):
    """Return R (S, q, m) with M R nearly 1, of least norm; the pseudo-inverse where there is none."""
    S, m, q = M.shape
    if not m or not q:
        return np.zeros((S, q, m))
    turned = M.swapaxes(1, 2)
    R, bad = np.zeros((S, q, m)), np.ones(S, bool)
    with np.errstate(all="ignore"):
        if m <= q:
            R = turned @ _inverse(M @ turned)[0]
            R = 2 * R - R @ (M @ R)  # a Newton step: what is lost by squaring the condition
            bad = ~(abs(M @ R - np.eye(m)).sum(2).max(1) < 2.0**-10)
        if bad.any():
            R[bad] = np.linalg.pinv(M[bad])
    return R


def _inverse(W):
    """Return (inverses of W (N, m, m), which of them there are)."""
    try:
        return np.linalg.inv(W), np.ones(len(W), bool)
    except np.linalg.LinAlgError:
        regular = np.linalg.slogdet(W)[0] != 0
        return np.linalg.inv(np.where(regular[:, None, None], W, np.eye(W.shape[1]))), regular


def gauge_above(image, d, l):
    """Return lower bounds (S, N) of the gauges of d (S, N, m), from any directions l (S, N, m); above 1 only where outside is proved."""
    S, m, q = image.M.shape
    gamma, floor = rounding.product_error(m + q + 4, float)
    with np.errstate(all="ignore"):
        size = abs(l).max(2, initial=0)
        l = np.ldexp(l, np.where((size > 0) & (size < np.inf), -np.frexp(size)[1], 0)[..., None])
        ahead, width = (l * d).sum(2), abs(l @ image.M).sum(2)
        slack = (gamma * (abs(l) @ image.sums[..., None] + (abs(l) * abs(d)).sum(2)[..., None]))[..., 0]
        slack += floor * 2 * (3 + abs(d).max(2, initial=0))
        bound = np.maximum((ahead - slack) / (width + slack) / UP, 0)
        bound = np.where(ahead - width > slack, np.maximum(bound, 1 + 2.0**-52), np.minimum(bound, 1))
        return np.where(np.isfinite(ahead) & np.isfinite(slack), bound, 0)


def gauge_below(image, d, x):
    """Return upper bounds (S, N) of the gauges of d (S, N, m), from any points x (S, N, q); at most 1 only where inside is proved."""
    S, m, q = image.M.shape
    gamma, floor = rounding.product_error(q + 4, float)
    with np.errstate(all="ignore"):
        size = abs(x).max(2, initial=0)[..., None]
        error = gamma * (size * image.sums[:, None] + abs(d)) + floor * 2 * (1 + size)
        left = (abs(d - x @ image.M.swapaxes(1, 2)) + error).max(2, initial=0) / (1 - image.loss[:, None]) * UP
        bound = (abs(x) + image.reach[:, None] * left[..., None]).max(2, initial=0) * UP
        bound = np.where(np.isfinite(bound) & np.isfinite(image.loss)[:, None], bound, np.inf)
        return np.where(abs(d).max(2, initial=0) == 0, 0, bound)


def vertices(M, d, x, s):
    """Return (x, l): the vertices of both programs that the near-optimal x (N, q) and freedom s (N, q) point to; no claim.

    The m - 1 freest entries are unknown, the others are at +-t: m equations for them and t. The last row of the inverse is l.

    Args: M (m, q) or (N, m, q); d (N, m).
    """
    N, m = d.shape
    free = np.argsort(-s, axis=1, kind="stable")[:, : m - 1]
    sign = np.where(x < 0, -1.0, 1.0)
    np.put_along_axis(sign, free, 0, 1)
    chosen = np.take_along_axis(np.broadcast_to(M, (N, *M.shape[-2:])), free[:, None], 2)
    W = np.concatenate([chosen, (M @ sign[..., None] if M.ndim == 3 else (sign @ M.T)[..., None])], 2)
    with np.errstate(all="ignore"):
        inverse, regular = _inverse(W)
        y = inverse @ d[..., None]
        y += inverse @ (d[..., None] - W @ y)
        out = sign * y[:, -1]
        np.put_along_axis(out, free, y[:, :-1, 0], 1)
    return np.where(regular[:, None], out, x), np.where(regular[:, None], inverse[:, -1], 0)
