"""Seconds and bytes that relations cost, from sizes alone: nobody waits for work that does not end.

Exact numbers grow with the window: powers of A have as many digits as samples, determinants as many as their
rows have together. The constants were measured on one core of a desk computer; they are right within a factor
of three or so, which is all that is asked of them.
"""

from math import comb

from jaxbound.exact.price import SECONDS
from jaxbound.models import window
from jaxbound.models.system import LinearSystem
from jaxbound.text.quantities import rough_duration

BYTES = 2e9
"""What relations may take at most, beside `SECONDS`."""
LONGEST = 10**12  # of a horizon in what is computed here: beyond, floats would overflow


def elimination_seconds(model: LinearSystem, horizon: int, unknown: int = 0) -> float:
    """Return how long the exact elimination of a window takes, with so many more unknown inputs."""
    s = min(horizon, model.n)
    rows, columns = (s + 1) * model.p, model.n + (model.d + unknown) * s
    rank = min(rows, columns)
    growing: float = (_digits(model) * (s + 1) * rank / 160) ** 1.2
    return 1e-6 * rank * rows * (rows + columns) * (1 + growing)


def relation_cost(model: LinearSystem, horizon: int) -> tuple[float, float]:
    """Return (seconds, bytes) that `parity_relations` takes."""
    s = min(horizon, LONGEST)
    if model.uncertainties:
        # measured: monomials alone decide, whatever the sizes of the matrices
        terms = _terms(model, s)
        return 4e-3 * terms, 1e3 * terms
    rows = (s + 1) * model.p + model.g * s
    for bounded in model.averages:
        rows += s + bounded.weighted_sum(model.outputs).measured  # no more runs than samples
    columns = model.n + model.g * s + model.d * window.unknown_lags(model, s)
    known, left = model.m * window.input_lags(model, s), max(rows - columns, 0)
    sparse = 2.5e-6 * columns * min(columns, rows) * rows * (1 + _digits(model) * s / 100 * (model.g > 0))
    seconds = (
        _power_seconds(model, s) + elimination_seconds(model, s) + sparse + 8e-6 * left * (columns + known)
    )
    return seconds, 16.0 * rows * (rows + known) + 150.0 * left * (columns + known)


def affordable(model: LinearSystem, horizon: int) -> None:
    """Raise ValueError if relations of this horizon would take too long or too much memory."""

    def fits(s: int) -> bool:
        seconds, size = relation_cost(model, s)
        return seconds <= SECONDS and size <= BYTES

    if fits(horizon):
        return
    low, high = 0, min(horizon, LONGEST)
    # costs rise with the horizon: the longest one that fits is told in the refusal
    while high - low > 1:
        middle = (low + high) // 2
        if fits(middle):
            low = middle
        else:
            high = middle
    seconds, size = relation_cost(model, horizon)
    needs = f"{rough_duration(seconds)} and {size / 1e9:.2g} GB"
    named, window_of = str(horizon), f"a window of {model.n} states, {model.p} outputs"
    if horizon >= LONGEST:
        named = f"beyond {LONGEST:.0e}"
    if model.g:
        window_of += f" and {model.g} disturbances"
    do = "a model with fewer states is needed"
    if low and fits(low):
        do = f"choose a horizon of at most {low}"
        if model.uncertainties:
            do = f"leave some uncertainties out, let them be constant, or {do}"
    raise ValueError(f"horizon {named} is too long: exact relations for {window_of} would take {needs}; {do}")


def refuse_many_states(model: LinearSystem) -> None:
    """Raise ValueError if even the shortest useful horizon would take too long to find."""
    seconds = _power_seconds(model, model.n) + 2e-7 * (model.p + 1) * model.p * float(model.n) ** 3
    if seconds > SECONDS:
        raise ValueError(
            f"a model of {model.n} states is too large: to find its shortest useful horizon in exact numbers "
            f"would take "
            f"{rough_duration(seconds)}; reduce the model first"
        )


def _power_seconds(model: LinearSystem, s: int) -> float:
    """Return how long C A, .., C A^s take."""
    return 1e-7 * s * model.p * model.n**2 * (1 + _digits(model) * s / 300)


def _digits(model: LinearSystem) -> float:
    """Return how many decimal digits a number of A has, from its longest denominator and numerator."""
    longest = 1
    for row in (*model.A, *model.C, *model.F):
        for x in row:
            longest = max(longest, x.numerator.bit_length(), x.denominator.bit_length())
    return 1 + longest * 0.15


def _terms(model: LinearSystem, s: int) -> float:
    """Return at least roughly how many monomials a window of an uncertain model has: they multiply from
    sample to sample.
    """

    def acting(letter: str, varying: bool) -> int:
        return sum(u.varying is varying and u.on(letter) is not None for u in model.uncertainties)

    per_sample, constant = acting("A", True), acting("A", False) + acting("C", False)
    # each varying parameter of A acts anew at every sample; floats end at 10^308, hence 900
    grown: float = (1.0 + per_sample) ** min(s, 900 / (1 + per_sample))
    of_constant = comb(min(s, 10**4) + constant, constant)
    return grown * of_constant * (1 + acting("C", True)) + (s + 1) * len(model.uncertainties)
