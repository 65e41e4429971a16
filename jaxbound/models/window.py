"""A window as one static equation: the two static forms, exact.

| paper | here | |
|---|---|---|
| C_{s,0} | O | rows of the outputs on the first state, ((s+1)p, n) |
| H_{s,0} | H | rows of the outputs on the inputs, ((s+1)p, l) |
| L_0, M, N | L, M, N | outputs on all states; dynamics; inputs |

Rows are time-major: y_k, then y_{k+1}, ... The inputs are u_k .. u_{k+s-1}, and u_{k+s} too if the model has feedthrough D.

Source: Adrot, Maquin, Ragot 2000, (3), (10), (12).
"""

from fractions import Fraction

from jaxbound.sets import exact

__all__ = ["first_form", "input_lags", "second_form"]

ZERO = Fraction(0)


def input_lags(model, horizon):
    """Return how many samples of u a window of s + 1 outputs depends on: s, or s + 1 with feedthrough."""
    return horizon + 1 if model.has_feedthrough else horizon


def first_form(model, horizon):
    """Return (O, H) with Y = O x_k + H U for an exact plant. Source: (3)."""
    lags = input_lags(model, horizon)
    power, free = exact.matrix([[int(i == j) for j in range(model.n)] for i in range(model.n)]), []
    outputs_on_state = []  # C A^j
    for _ in range(horizon + 1):
        outputs_on_state.append(exact.matmul(model.C, power))
        power = exact.matmul(model.A, power)
    responses = [model.D] + [exact.matmul(block, model.B) for block in outputs_on_state[:-1]] if model.m else []
    for j in range(horizon + 1):
        for i in range(model.p):
            free.append(tuple(responses[j - k][i][c] if j >= k else ZERO for k in range(lags) for c in range(model.m)))
    return tuple(row for block in outputs_on_state for row in block), tuple(free)


def second_form(model, horizon):
    """Return (L, M, N, F) with Y = L X + F U and M X = N U for an exact plant, X = (x_k, .., x_{k+s}). Source: (10)-(12)."""
    n, m, lags = model.n, model.m, input_lags(model, horizon)
    L, F, M, N = [], [], [], []
    for j in range(horizon + 1):
        for i in range(model.p):
            L.append(_blocks(horizon + 1, n, {j: model.C[i]}))
            F.append(_blocks(lags, m, {j: model.D[i]}) if j < lags else (ZERO,) * (lags * m))
    for j in range(horizon):
        for i in range(n):
            M.append(_blocks(horizon + 1, n, {j: model.A[i], j + 1: tuple(Fraction(-int(i == c)) for c in range(n))}))
            N.append(_blocks(lags, m, {j: tuple(-x for x in model.B[i])}))
    return tuple(L), tuple(M), tuple(N), tuple(F)


def _blocks(count, width, filled):
    return tuple(x for j in range(count) for x in filled.get(j, (ZERO,) * width))
