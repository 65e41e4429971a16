"""A parameter of the plant that is another: a size of it that explains a window, found by search.

What it multiplies is a state that nobody knows, so the rows of a window are E(f) z + K(f) U: linear in z for
each size f and each sample from which on it holds, not in both. A search in floats looks for an f whose
smallest factor on all bounds is at most 1: over sizes up to `most` of the fault and over onsets, then around
the pair of the smallest factor, or of the smallest size that explains. A proof in exact rationals, on the
rows of that f, confirms what it finds. Nothing found is no proof, so no parameter is ever excluded.
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from fractions import Fraction
from itertools import product
from typing import TypeAlias

import numpy as np

from jaxbound.certificates.exact_window import ExactWindow, known_inputs, rounded_witness
from jaxbound.certificates.fault_size import FaultSize
from jaxbound.exact.chebyshev import nearest
from jaxbound.models.named_faults import NamedFault
from jaxbound.models.window import ParameterForm

STEPS = 8
"""Sizes of each sign that are tried at first, as many steps to `most`."""
ONSETS = 5
"""Onsets that are tried at first."""
HALVINGS = 6
"""How often steps are halved around the best."""
SURE = 1 - 1e-7
"""A factor in floats up to which a size is worth a proof."""
Trial: TypeAlias = tuple[int, int]
"""(size in the finest steps, number of the onset)."""


def changed_window(window: ExactWindow, fault: NamedFault, size: Fraction, since: int) -> ExactWindow:
    """Return the window whose parameter is another by a size from a sample on."""
    E, K = ParameterForm(window.model, window.horizon, fault.coefficients, Fraction)(size, since)
    own = tuple(map(tuple, E.tolist())), tuple(map(tuple, K.tolist()))
    return replace(window, own=own).with_limits(window.limits)


def found_size(window: ExactWindow, fault: NamedFault, onsets: Iterable[int] = (0,)) -> FaultSize:
    """Return the FaultSize of a parameter: the smallest size that was found, its proof the unknowns z.

    Args:
        window: of a certain model. fault: a parameter of the model.
        onsets: samples of the window from one of which on it is another.

    Returns:
        size None: none of `.tried` sizes explains the window, which is no proof.
    """
    search = _Search(window, fault, tuple(onsets))
    for number, onset in search.explaining():
        size = search.size(number)
        changed = changed_window(window, fault, size, search.onsets[onset])
        best = changed.solve()
        if best.t <= 1:
            z = rounded_witness(changed, best.z)
            return FaultSize(fault, size, search.onsets[onset], z=z, tried=len(search.factors))
    return FaultSize(fault, None, tried=len(search.factors))


class _Search:
    """Sizes and onsets that are tried, and the factor of each in floats."""

    def __init__(self, window: ExactWindow, fault: NamedFault, onsets: tuple[int, ...]) -> None:
        self.window, self.fault, self.onsets = window, fault, onsets
        self.factors: dict[Trial, float] = {}
        self.finest = STEPS * 2**HALVINGS
        rows = [i for i, ends in enumerate(window.limits) if ends is not None]
        ends = np.array([list(map(float, window.known_limits(i))) for i in rows]).reshape(-1, 2)
        self.rows, self.middles, self.radii = rows, ends.mean(1), np.diff(ends, axis=1)[:, 0] / 2
        self.form = ParameterForm(window.model, window.horizon, fault.coefficients, float)
        self.inputs = np.array(list(map(float, known_inputs(window.model, window.u))))

    def size(self, number: int) -> Fraction:
        """Return a size from its number of finest steps."""
        assert self.fault.most is not None, "a parameter has a largest size"
        return Fraction(number, self.finest) * self.fault.most

    def explaining(self) -> Iterator[Trial]:
        """Yield the trials that explain in floats, the smallest size first.

        From the best of a coarse grid on, steps in both directions are halved where none is better.
        """
        step = 2**HALVINGS
        spread = np.linspace(0, len(self.onsets) - 1, min(ONSETS, len(self.onsets))).round().astype(int)
        grid = product(spread.tolist(), range(-self.finest, self.finest + 1, step))
        # a coarse grid first: the factor may have several valleys over onsets and sizes
        best = min(((number, onset) for onset, number in grid), key=self._rank)
        apart = max(1, len(self.onsets) // len(spread))
        while step and self.factors:
            number, onset = best
            sizes, moments = (number - step, number + step), (onset - apart, onset + apart)
            best = min(best, *((x, onset) for x in sizes), *((number, x) for x in moments), key=self._rank)
            if best == (number, onset):
                step, apart = step // 2, max(1, apart // 2)
        explaining = [trial for trial, factor in self.factors.items() if factor <= SURE]
        yield from sorted(explaining, key=lambda t: (abs(t[0]), t[1]))

    def _rank(self, trial: Trial) -> tuple[float, int]:
        """Return (factor, size), the least of the best, the size where trials explain; infinite beyond the
        bounds of the fault or the window.
        """
        number, onset = trial
        fault = self.fault
        beyond = abs(number) > self.finest or not 0 <= onset < len(self.onsets) or not number
        wrong = fault.sign is not None and (number < 0) != (fault.sign == "-")
        small = fault.least is not None and abs(self.size(number)) < fault.least
        if beyond or wrong or small:
            return np.inf, 0
        if trial not in self.factors:
            self.factors[trial] = self._factor(float(self.size(number)), self.onsets[onset])
        return max(SURE, self.factors[trial]), abs(number)

    def _factor(self, size: float, since: int) -> float:
        """Return the factor on all bounds at which the window is explained, about."""
        E, K = self.form(size, since)
        # a missing input is an unknown here too, as in the exact window
        z = np.concatenate([E, K[:, list(self.window.missing_inputs)]], 1)[self.rows] / self.radii[:, None]
        off = (self.middles - (K @ self.inputs)[self.rows]) / self.radii
        found = nearest(z, off)
        if found is None:
            return np.inf  # so far from the model that numbers end
        return found.t
