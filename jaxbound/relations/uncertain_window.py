"""A window of a model with uncertain parameters as one static equation, exact: Y = E(v) X + H(v) U + V(v) w.

| paper | here |
|---|---|
| O_h(v), h = s + 1 | the first columns of E, on the state x_k; then those on unknown inputs |
| Gamma(v) | H |
| theta_{i,k}, vartheta_i | variables ("name", lag) and ("name", None) |

A parameter that varies is one variable for each sample at which it matters, one that is constant is one
variable.

Source: Ploix, Adrot 2006, (1), (4).
"""

from fractions import Fraction
from typing import TypeAlias

from jaxbound.exact.linalg import Matrix
from jaxbound.models import window
from jaxbound.models.system import LinearSystem
from jaxbound.relations.polynomial import PolynomialMatrix, constant, stacked

__all__ = ["Variable", "uncertain_window"]

Variable: TypeAlias = tuple[str, int | None]
"""(name of the parameter, lag; None if it keeps one value)."""


def uncertain_window(
    model: LinearSystem, horizon: int
) -> tuple[tuple[Variable, ...], PolynomialMatrix, PolynomialMatrix, PolynomialMatrix]:
    """Return (variables, E, H, V): PolynomialMatrices with (s+1)p rows, time-major, in variables within [-1,
    1].

    Returns:
        variables: ((name, lag or None), ..), the varying ones time-major, then the constant ones; only those
            that matter.
        E: on x_k and the unknown inputs; H: on the inputs; V: on the disturbances, each in the order of
            `models.window`.
    """
    s, n, p = horizon, model.n, model.p
    lags = {"u": window.input_lags(model, s), "w": s, "v": window.unknown_lags(model, s)}
    width = {"u": model.m, "w": model.g, "v": model.d}
    first = {"x": 0, "v": n}
    first["u"] = n + lags["v"] * width["v"]
    first["w"] = first["u"] + lags["u"] * width["u"]
    total = first["w"] + lags["w"] * width["w"]
    named: list[Variable] = [(u.name, j) for j in range(s + 1) for u in model.uncertainties if u.varying]
    named += [(u.name, None) for u in model.uncertainties if not u.varying]
    count, number = len(named), {name: i for i, name in enumerate(named)}

    def now(letter, nominal, lag):
        """Return a matrix of the model at one sample."""
        out = constant(nominal, count)
        for u in model.uncertainties:
            rows = u.on(letter)
            if rows is not None:
                alpha = tuple(int(i == number[u.name, lag if u.varying else None]) for i in range(count))
                out += PolynomialMatrix(len(rows), len(rows[0]), count, {alpha: _entries(rows)})
        return out

    def at(block, signal, lag):
        """Return a block that acts on one sample of a signal as a matrix that acts on everything."""
        left = first[signal] + lag * width.get(signal, 0)
        return stacked(
            [[_zero(block.rows, left, count), block, _zero(block.rows, total - left - block.columns, count)]]
        )

    identity = tuple(tuple(Fraction(int(i == j)) for j in range(n)) for i in range(n))
    state, outputs = at(constant(identity, count, n), "x", 0), []
    for j in range(s + 1):
        y = now("C", model.C, j) @ state if n else _zero(p, total, count)
        if j < lags["u"] and model.m:
            y += at(now("D", model.D, j), "u", j)
        if j < lags["v"]:
            y += at(constant(model.D_v, count), "v", j)
        outputs.append([y])
        if j < s and n:
            state = now("A", model.A, j) @ state
            for letter, signal, matrix in (("B", "u", model.B), ("G", "w", model.G), ("F", "v", model.F)):
                if width[signal]:
                    state += at(
                        now(letter, matrix, j) if letter == "B" else constant(matrix, count), signal, j
                    )
    whole = stacked(outputs)
    seen = [i for i in range(count) if any(a[i] for a in whole.terms)]
    terms = {tuple(a[i] for i in seen): entries for a, entries in whole.terms.items()}
    whole = PolynomialMatrix(whole.rows, total, len(seen), terms)
    E, H, V = (
        whole.pick(columns=range(*span))
        for span in ((0, first["u"]), (first["u"], first["w"]), (first["w"], total))
    )
    return tuple(named[i] for i in seen), E, H, V


def _entries(rows: Matrix) -> dict[tuple[int, int], Fraction]:
    return {(i, j): x for i, row in enumerate(rows) for j, x in enumerate(row) if x}


def _zero(rows: int, columns: int, count: int) -> PolynomialMatrix:
    return PolynomialMatrix(rows, columns, count, {})
