"""Windows that look at the outputs at some samples only: long memory with few rows.

A row that is not looked at is no row: the state is eliminated from those that are left. Inputs and
disturbances act at every step between, so they count at every step.
"""

from collections.abc import Sequence
from fractions import Fraction

from jaxbound.exact import linalg
from jaxbound.exact.linalg import Matrix, Vector
from jaxbound.models import window
from jaxbound.models.arguments import whole_lags
from jaxbound.models.system import LinearSystem

ZERO = Fraction(0)


def checked_lags(model: LinearSystem, horizon: int | None, form: str, lags: Sequence[int]) -> tuple[int, ...]:
    """Return lags in order, or refuse them."""
    whole = whole_lags(lags)
    if horizon is not None or form != "first":
        superfluous = "form" if horizon is None else "horizon"
        raise ValueError(f"lags say by themselves how long a window is: leave {superfluous} out")
    if model.uncertainties:
        raise ValueError(
            "lags are for models without uncertainties: over many samples uncertain parameters have too many "
            "products"
        )
    return whole


def lagged(model: LinearSystem, horizon: int, lags: Sequence[int]) -> tuple[Matrix, Matrix]:
    """Return relations W Y = K U of an exact plant, without disturbances, over the outputs at some samples
    only.
    """
    rows = window.window_rows(model, horizon, tuple(lags))
    # disturbances act at every step, and are joined to the relations behind this
    seen = [i for i in rows.seen if i < rows.readings]
    free, H = window.unbounded(model, horizon), window.first_form(model, horizon)[1]
    shortest = linalg.minimal_span(linalg.left_null_space([free[i] for i in seen]))
    whole = []
    for row in map(linalg.presentable, shortest):
        whole.append(over_all_rows(row, seen, model, horizon)[: rows.readings])
    if not whole or not H[0]:
        return tuple(whole), ((),) * len(whole)
    return tuple(whole), linalg.matmul(whole, H)


def over_all_rows(row: Vector, seen: Sequence[int], model: LinearSystem, horizon: int) -> Vector:
    """Return coefficients of the rows that are seen as coefficients of all rows of a window."""
    whole = [ZERO] * len(window.window_rows(model, horizon))
    for i, coefficient in zip(seen, row, strict=True):
        whole[i] = coefficient
    return tuple(whole)
