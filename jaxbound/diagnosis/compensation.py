"""The compensation that the linearized test lacks on healthy data, for models with uncertain parameters."""

from __future__ import annotations

from numpy.typing import ArrayLike

from jaxbound.consistency.parametric_margins import needed_compensation
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.table import Data
from jaxbound.relations.uncertain import UncertainRelations
from jaxbound.sets.floats.probe import where_proofs_hold

__all__ = ["compensation"]


@where_proofs_hold()
def compensation(
    relations: UncertainRelations, u: Data, y: Data = None, share: float = 0.0, starts: ArrayLike = ()
) -> float:
    """Return the smallest compensation under which the linearized test lets a healthy recording pass.

    `detect(relations, u, y, method="linearized", compensation=c)` neglects products of parameters, and marks
    healthy windows as suspect. c is added to what each relation may be off by. Each window needs a certain c;
    this is the least number that is enough for all windows but the given share of them.

    Args:
        relations: UncertainRelations. u (..., T, m), y (..., T, p), starts: healthy recordings, as for
            `detect`.
        share: of the windows, 0 <= share < 1, that may stay suspect.

    Returns:
        A float, 0 where nothing is needed. Nothing is proved for other recordings: use method="joint" for
        that.

    Raises:
        TypeError: relations without uncertain parameters. ValueError: a share outside of [0, 1), infinite
            samples, no window with data.

    Source: Ploix, Adrot 2006, section 4: the a-posteriori compensation of the linearization.

    Example:
        >>> import numpy as np, jaxbound as jb
        >>> gain = jb.Uncertainty("gain", C=[[0.5]])
        >>> r = jb.parity_relations(jb.LinearSystem([[1]], None, [[1]], uncertainties=[gain]))
        >>> y = np.array([[1.0], [0.9], [0.2], [1.0]])  # y[k-1] (1 + gain[k] / 2) = y[k] (1 + gain[k-1] / 2)
        >>> round(compensation(r, None, y), 6)
        0.2
        >>> [int(jb.detect(r, None, y, method="linearized", compensation=c).suspect.sum()) for c in (0, 0.2)]
        [2, 0]
    """
    if not isinstance(relations, UncertainRelations):
        raise TypeError(
            f"compensation is for relations with uncertain parameters, not {type(relations).__name__}: "
            f"others neglect nothing"
        )
    if not 0 <= share < 1:
        raise ValueError(
            f"share is the part of the windows that may stay suspect: 0 <= share < 1, not {share}"
        )
    recording = Recording.of(relations.model, u, y, starts).finite()
    return float(needed_compensation(relations, recording, share))
