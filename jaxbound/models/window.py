"""A window as one static equation: the two static forms, exact.

| paper | here | |
|---|---|---|
| C_{s,0} | O | rows of the outputs on the first state, ((s+1)p, n) |
| H_{s,0} | H | rows of the outputs on the inputs, ((s+1)p, l) |
| | V | rows of the outputs on the disturbances w_k .. w_{k+s-1}, ((s+1)p, gs) |
| L_0, M, N | L, M, N | outputs on all states; dynamics; inputs |

Rows are time-major: y_k, then y_{k+1}, ... The inputs are u_k .. u_{k+s-1}, and u_{k+s} too if the model has feedthrough D.

Source: Adrot, Maquin, Ragot 2000, (3), (10), (12).
"""

from fractions import Fraction

from jaxbound.sets import exact

__all__ = ["disturbance_form", "first_form", "input_lags", "observability", "second_form", "unknowns"]

ZERO = Fraction(0)


def input_lags(model, horizon):
    """Return how many samples of u a window of s + 1 outputs depends on: s, or s + 1 with feedthrough."""
    return horizon + 1 if model.has_feedthrough else horizon


def observability(model, horizon):
    """Return O alone; the O of a shorter horizon are its first rows."""
    return tuple(row for block in _outputs_on_state(model, horizon) for row in block)


def _outputs_on_state(model, horizon):
    """Return C, CA, .., CA^s."""
    out = [model.C]
    for _ in range(horizon):
        out.append(exact.matmul(out[-1], model.A))
    return out


def first_form(model, horizon):
    """Return (O, H) with Y = O x_k + H U for an exact plant. Source: (3)."""
    lags, free = input_lags(model, horizon), []
    outputs_on_state = _outputs_on_state(model, horizon)
    responses = [model.D] + [exact.matmul(block, model.B) for block in outputs_on_state[:-1]] if model.m else []
    for j in range(horizon + 1):
        for i in range(model.p):
            free.append(tuple(responses[j - k][i][c] if j >= k else ZERO for k in range(lags) for c in range(model.m)))
    return tuple(row for block in outputs_on_state for row in block), tuple(free)


def disturbance_form(model, horizon):
    """Return V with Y = O x_k + H U + V w for an exact plant."""
    power, responses = model.C, []  # C A^j G
    for _ in range(horizon):
        responses.append(exact.matmul(power, model.G) if model.g else tuple(() for _ in range(model.p)))
        power = exact.matmul(power, model.A)
    zero = (ZERO,) * model.g
    return tuple(
        tuple(x for k in range(horizon) for x in (responses[j - 1 - k][i] if k < j else zero))
        for j in range(horizon + 1)
        for i in range(model.p)
    )


def unknowns(model, horizon):
    """Return (E, K): all that bounds speak of in a window, on its unknowns and inputs, for an exact plant.

    The rows are the (s+1)p true outputs Y and the gs disturbances w, which count as rows of their own: (Y, w) = E (x_k, w) + K U,
    E = [O V; 0 I], K = [H; 0].
    """
    O, H = first_form(model, horizon)
    V = disturbance_form(model, horizon)
    count = model.g * horizon
    own = tuple((ZERO,) * model.n + tuple(Fraction(int(i == j)) for j in range(count)) for i in range(count))
    lags = model.m * input_lags(model, horizon)
    return tuple(o + v for o, v in zip(O, V, strict=True)) + own, H + ((ZERO,) * lags,) * count


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
