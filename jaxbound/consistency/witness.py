"""A behaviour that is known to be behind windows, as that of a simulation: what it is proved to explain is
CONSISTENT, with no search.
"""

from collections.abc import Sequence
from typing import Any, cast

import numpy as np

from jaxbound.consistency.drive import raw_outputs
from jaxbound.consistency.exchange import ExchangeTest
from jaxbound.consistency.interface import Arrays, Observer, Run, WindowTest
from jaxbound.consistency.projection import EasyStretches, of_witness
from jaxbound.consistency.reading import Block
from jaxbound.recordings.recording import NOWHERE

__all__ = ["explained_by"]


def explained_by(
    test: WindowTest | Observer[Any], u: np.ndarray, y: np.ndarray, truth: np.ndarray
) -> np.ndarray | None:
    """Return bool (..., T): the window that ends there is proved to be explained by the truth. None where
    nothing is gained by knowing it.

    Args:
        test: of the recordings u (..., T, m), y (..., T, p). truth: (..., T, p + g), the true outputs, in
            deviations, and the disturbances; whatever it is, what is returned is proved.
    """
    if type(test) is not ExchangeTest or not test.easy_first:
        return None
    if test.easy is None or test.easy.stretches is None:
        return None
    stretches = cast(EasyStretches, test.easy.stretches)
    if stretches.reading.window.sums:
        return None
    known = _Witnessed(stretches.relations, stretches.dtype, stretches.projection, stretches.reading)
    (margin,) = raw_outputs(known, u, np.concatenate([y, truth], -1), NOWHERE)
    return np.asarray(margin > 0)


class _Witnessed(EasyStretches):
    """Proves windows of samples CONSISTENT by the truth that stands beside them."""

    def judge(self, run: Run, blocks: Sequence[Block]) -> Sequence[Arrays]:
        """Return (margin,) of all windows of stretches."""
        return list(zip(run(of_witness, blocks), strict=True))
