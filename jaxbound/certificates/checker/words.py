"""Documents: certificates as JSON gives them, and parts of them, whose numbers are Fractions.

Somebody else wrote them: whoever reads a part checks it. Rows are samples in order of time; an entry is None
where a sample is missing. A *claim* is what a certificate is about, no part of its proof:

| numbers | of |
|---|---|
| A B C D G F D_v offset_u offset_y | the plant |
| tolerance noise resolution disturbance averages uncertainties constant | its bounds, as `proof` says |
| recorder floor | what is rounded away: see `claim` |
| u y all_y factors first_state | samples, and what is known beside them; all_y: of averages too |
| lags runs variables | the samples, averages and parameters that count |
"""

from fractions import Fraction
from typing import Any, TypeAlias

Document: TypeAlias = dict[str, Any]
Vector: TypeAlias = list[Fraction]
Matrix: TypeAlias = list[Vector]
Samples: TypeAlias = list[list[Fraction | None]]
Ends: TypeAlias = tuple[Fraction, Fraction]
"""(lo, hi) of a number."""


def insist(true: bool, reason: str) -> None:
    """Raise ValueError with a reason unless something is true."""
    if not true:
        raise ValueError(reason)
