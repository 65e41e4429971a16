"""The result of data validation: states, outputs and verdicts, time first."""

from dataclasses import dataclass

import jax
import numpy as np

from jaxbound.consistency.interface import Array
from jaxbound.sets.intervals.interval import Interval
from jaxbound.text.objects import readable


@readable
@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Validation:
    """The states, outputs and verdicts of `validate`, time first: entry k comes from the window that ends at
    k.

    Fields: state Interval (..., T, n). output Interval (..., T, p): what a perfect sensor would show.
    residual Interval (..., T, p): the sample minus what the samples before it allow. faulty (..., T, p) bool:
    sensors whose residual excludes 0, that contradict the samples before them in a sharper test, or without
    which alone a contradiction of all sensors ends. corrected Interval (..., T, p): `output`, where a sample
    was accepted also within what it says; corrected.mid is the point value. status (..., T) int8, see
    `Status`: FAULT is a proof that not all samples of the window fit the model, those before being as
    accepted (if nobody is to blame, its newest samples are left out); UNDECIDED: nothing was proved; MISSING:
    no sample, and the first s. CONSISTENT is never said: it would need a behaviour from the first sample on
    that explains all, and an enclosure holds points that none reaches. `detect` proves it, window by window.
    """

    state: Interval
    output: Interval
    residual: Interval
    faulty: Array
    corrected: Interval
    status: Array

    @property
    def margin(self) -> np.ndarray:
        """(..., T), NaN: validation measures none."""
        return np.full(np.shape(self.status), np.nan)
