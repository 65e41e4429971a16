"""The plant of a model: exact matrices, parameters within bounds, and what acts on it unmeasured."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import cast

import numpy as np

from jaxbound.exact.linalg import Matrix, Number, zeros
from jaxbound.models.numbers import entries_of, exact_matrix, number
from jaxbound.models.uncertainty import Uncertainty, centred, influences
from jaxbound.models.unknown import Bounded, Given, decoupled, unbounded_inputs


@dataclass(frozen=True)
class Plant:
    """x+ = A x + B u + G w + F v, y = C x + D u + D_v v, every number exact. Build it with `plant`; the
    fields are those of a LinearSystem.

    A, B, C, D are at the middle of the bounds of the uncertainties; w is within the pairs of `disturbance`, v
    has no bound; dt in seconds.
    """

    A: Matrix
    B: Matrix
    C: Matrix
    D: Matrix
    G: Matrix
    disturbance: tuple[tuple[Fraction, Fraction], ...]
    F: Matrix
    D_v: Matrix
    uncertainties: tuple[Uncertainty, ...]
    dt: float

    @property
    def n(self) -> int:
        """Number of states."""
        return len(self.A)

    @property
    def m(self) -> int:
        """Number of inputs."""
        return len(self.D[0])

    @property
    def p(self) -> int:
        """Number of outputs."""
        return len(self.C)

    @property
    def g(self) -> int:
        """Number of disturbances."""
        return len(self.disturbance)

    @property
    def d(self) -> int:
        """Number of unknown inputs."""
        return len(self.D_v[0])


def refuse_state_space(A: object) -> None:
    """Raise TypeError if A is a state-space object of another package, which has a door of its own."""
    if not (hasattr(A, "A") and hasattr(A, "C")):
        return
    package = type(A).__module__.split(".")[0]
    door = {"scipy": "from_scipy"}.get(package, "from_control")
    raise TypeError(
        f"LinearSystem takes matrices, not a {type(A).__name__} of {package}: "
        f"jaxbound.{door}(system, dt, noise=..) builds the model of it"
    )


def plant(
    given: Given,
    dt: Number,
    uncertainties: Uncertainty | Sequence[Uncertainty],
    decouple: str | Sequence[str],
) -> Plant:
    """Check the arguments of a LinearSystem that speak of its plant and return them exactly.

    Raises:
        ValueError: shapes that do not fit, a number that is not finite, a negative bound, a dt that is not
            positive.
    """
    exact_A = entries_of("A", given.A)
    n = len(exact_A)
    if n and len(exact_A[0]) != n:
        raise ValueError(f"A must be square, one row per state: its shape is ({n}, {len(exact_A[0])})")
    direct = entries_of("D", given.D)
    if not n and not direct:
        raise ValueError("A must be square, one row per state; a model without states needs D (y = D u)")
    exact_C = entries_of("C", given.C)
    if not exact_C and not n:
        exact_C = zeros(len(direct), 0)  # y = D u, and D says how many outputs there are
    p = len(exact_C)
    if p == 0:
        raise ValueError("the model has no output: C needs at least one row")
    exact_B = entries_of("B", given.B) or zeros(n, 0)
    m = len(exact_B[0]) if n else len(direct[0])
    exact_D = direct or zeros(p, m)
    _refuse_shape("B", exact_B, (n, m))
    _refuse_shape("C", exact_C, (p, n))
    _refuse_shape("D", exact_D, (p, m))
    parameters = influences(uncertainties, {"A": (n, n), "B": (n, m), "C": (p, n), "D": (p, m)})
    G, pairs = _disturbance(given.disturbance, n)
    F, D_v = unbounded_inputs(given.unknown_inputs, n, p)
    # behind the shapes: a coefficient that does not fit would be split into columns of another plant
    trusted, F, D_v = decoupled(parameters, decouple, F, D_v)
    exact_dt = number("dt", dt)
    if not 0 < exact_dt <= Fraction(sys.float_info.max):
        raise ValueError(f"dt must be a positive number of seconds, not {str(dt)[:40]}")
    period = float(exact_dt)
    return Plant(
        A=centred(exact_A, parameters, "A"),
        B=centred(exact_B, parameters, "B"),
        C=centred(exact_C, parameters, "C"),
        D=centred(exact_D, parameters, "D"),
        G=G,
        disturbance=pairs,
        F=F,
        D_v=D_v,
        uncertainties=trusted,
        dt=period,
    )


def _refuse_shape(field: str, a: Matrix, shape: tuple[int, int]) -> None:
    """Raise ValueError for a matrix, if it has rows, of another shape."""
    if a and (len(a), len(a[0])) != shape:
        raise ValueError(
            f"{field} must have shape {shape} to fit A, B and C: its shape is {(len(a), len(a[0]))}"
        )


def _disturbance(given: Bounded | None, n: int) -> tuple[Matrix, tuple[tuple[Fraction, Fraction], ...]]:
    """Return G (n, g) and g pairs (lo, hi)."""
    if given is None:
        return ((),) * n, ()
    try:
        G, bound = given
    except (TypeError, ValueError):
        raise ValueError(
            "disturbance needs a pair (G, bound): how it acts on the states, and how large it can be"
        ) from None
    rows = exact_matrix("G of the disturbance", G)
    if len(rows) != n:
        raise ValueError(f"G of the disturbance needs one row per state ({n}): it has {len(rows)}")
    g = len(rows[0])
    if isinstance(bound, str) or not np.iterable(bound):
        bounds = [bound] * g
    else:
        bounds = list(cast("Sequence[Number]", bound))
    if len(bounds) != g:
        raise ValueError(
            f"the bound of the disturbance needs one number, or one (or a pair [lo, hi]) for each of {g} "
            f"columns of G, not {len(bounds)}"
        )
    return rows, tuple(_pair(f"disturbance {j + 1}", b) for j, b in enumerate(bounds))


def _pair(where: str, bound: Number | Sequence[Number]) -> tuple[Fraction, Fraction]:
    """Return (lo, hi) from a pair, or from a number for both sides."""
    if isinstance(bound, str) or not np.iterable(bound):
        hi = number(where, bound)
        if hi < 0:
            raise ValueError(f"{where}: the bound must be >= 0, not {float(hi):g}")
        return -hi, hi
    ends = [number(where, x) for x in bound]
    if len(ends) != 2:
        raise ValueError(f"{where}: a bound is one number or a pair [lo, hi], not {len(ends)} numbers")
    lo, hi = ends
    if lo > hi:
        raise ValueError(f"{where}: lo must be <= hi, not [{float(lo):g}, {float(hi):g}]")
    return lo, hi
