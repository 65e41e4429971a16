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

from functools import lru_cache
from typing import TypeAlias

from jaxbound.exact import linalg
from jaxbound.models import window
from jaxbound.models.system import LinearSystem
from jaxbound.relations.polynomial import PolynomialMatrix, constant, nonzero_entries, stacked

Variable: TypeAlias = tuple[str, int | None]
"""(name of the parameter, lag; None if it keeps one value)."""


@lru_cache(maxsize=16)  # relations and certificates of one model ask for the same
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
    named = _variables(model, horizon)
    layout = _Columns(model, horizon, len(named))
    whole = _on_everything(model, horizon, named, layout)
    seen = [i for i in range(len(named)) if any(a[i] for a in whole.terms)]
    terms = {}
    for exponents, entries in whole.terms.items():
        terms[tuple(exponents[i] for i in seen)] = entries
    whole = PolynomialMatrix(whole.rows, layout.total, len(seen), terms)
    inputs, disturbances = layout.first["u"], layout.first["w"]
    E = whole.pick(columns=range(inputs))
    H = whole.pick(columns=range(inputs, disturbances))
    V = whole.pick(columns=range(disturbances, layout.total))
    return tuple(named[i] for i in seen), E, H, V


def _variables(model: LinearSystem, horizon: int) -> list[Variable]:
    """Return the variables: the varying parameters of each sample, then the constant ones."""
    named: list[Variable] = []
    for j in range(horizon + 1):
        named += [(u.name, j) for u in model.uncertainties if u.varying]
    return named + [(u.name, None) for u in model.uncertainties if not u.varying]


class _Columns:
    """The columns of all that acts on a window: the state, unknown inputs, inputs, disturbances.

    Fields: lags, width: samples of each signal, and numbers in a sample; first: column with which it begins;
    total.
    """

    def __init__(self, model: LinearSystem, horizon: int, variables: int) -> None:
        self.variables = variables
        self.lags = {
            "x": 1,
            "v": window.unknown_lags(model, horizon),
            "u": window.input_lags(model, horizon),
            "w": horizon,
        }
        self.width = {"x": model.n, "v": model.d, "u": model.m, "w": model.g}
        self.first: dict[str, int] = {}
        self.total = 0
        for signal, lags in self.lags.items():
            self.first[signal] = self.total
            self.total += lags * self.width[signal]

    def zeros(self, rows: int, columns: int) -> PolynomialMatrix:
        """Return a matrix of zeros."""
        return PolynomialMatrix(rows, columns, self.variables, {})

    def at(self, block: PolynomialMatrix, signal: str, lag: int) -> PolynomialMatrix:
        """Return a block that acts on one sample of a signal as a matrix that acts on everything."""
        left = self.first[signal] + lag * self.width[signal]
        right = self.total - left - block.columns
        return stacked([[self.zeros(block.rows, left), block, self.zeros(block.rows, right)]])


def _on_everything(
    model: LinearSystem, horizon: int, named: list[Variable], layout: _Columns
) -> PolynomialMatrix:
    """Return the outputs of a window on everything that acts on them, time-major."""
    count, n = len(named), model.n

    def now(letter: str, lag: int) -> PolynomialMatrix:
        """Return a matrix of the model at one sample."""
        out = constant(getattr(model, letter), count)
        for u in model.uncertainties:
            rows = u.on(letter)
            if rows is not None:
                alpha = [0] * count
                alpha[named.index((u.name, lag if u.varying else None))] = 1
                out += PolynomialMatrix(len(rows), len(rows[0]), count, {tuple(alpha): nonzero_entries(rows)})
        return out

    state = layout.at(constant(linalg.identity(n), count, n), "x", 0)
    outputs = []
    for j in range(horizon + 1):
        y = now("C", j) @ state if n else layout.zeros(model.p, layout.total)
        if j < layout.lags["u"] and model.m:
            y += layout.at(now("D", j), "u", j)
        if j < layout.lags["v"]:
            y += layout.at(constant(model.D_v, count), "v", j)
        outputs.append([y])
        if j < horizon and n:
            state = now("A", j) @ state
            if model.m:
                state += layout.at(now("B", j), "u", j)
            if model.g:
                state += layout.at(constant(model.G, count), "w", j)
            if model.d:
                state += layout.at(constant(model.F, count), "v", j)
    return stacked(outputs)
