"""Parameters that keep one value over a whole recording, estimated by all of its windows at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import singledispatch
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from jaxbound.consistency.bisection import span
from jaxbound.consistency.interface import Observer, Relations, relations_of
from jaxbound.consistency.parameter_boxes import ParameterBoxes, PolynomialBoxes
from jaxbound.consistency.parameter_residual import ResidualBoxes
from jaxbound.estimation.parameter_search import Search
from jaxbound.estimation.parameter_set import EMPTY, NAMED, ParameterSet
from jaxbound.models.numbers import is_whole
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.table import Data
from jaxbound.relations.residual import Residual
from jaxbound.relations.uncertain import UncertainRelations
from jaxbound.sets.floats.probe import where_proofs_hold
from jaxbound.text.progress import reporter

BUDGET = 20_000
"""Boxes that are judged."""
PRECISION = 1 / 32
"""The edge of a box that is not cut any more, as a share of the hull."""
EXAMPLE = "parameters(parity_relations(model), u, y)"


@where_proofs_hold()
def parameters(
    relations: Relations,
    u: Data,
    y: Data = None,
    constant: Mapping[str, int] | None = None,
    precision: float = PRECISION,
    budget: int = BUDGET,
    progress: Callable[[float], object] | None = None,
    starts: ArrayLike = (),
) -> ParameterSet:
    """Return boxes that hold all values of constant parameters that can explain a whole recording.

    Each window of horizon + 1 samples refutes boxes of parameters, and all windows have the same parameters:
    a box is left out as soon as one window is proved to contradict its bounds all over it.

    Args:
        relations: from `parity_relations` of a model whose `uncertainties` keep one value (varying=False), as
            those of `linearize(.., parameters=.., varying=False)`; or a `residual`. Uncertainties of the same
            model that vary are not estimated: they may be anything within their bounds at each sample.
        u, y: (T, m) and (T, p) of one recording, as for `detect`.
        constant: of a residual, {name: number of the unknown} of the entries of z that keep one value over
            the recording; the others may be anything in the box in each window.
        precision: boxes with no edge beyond this share of the hull are not cut, nor along a parameter that
            changes what is left unknown of every window by less than a quarter of it.
        budget: boxes that are judged at most.
        progress: called with the share of the budget spent, and 1 at the end.
        starts: as for `detect`: no window across says anything, and the parameters are the same on both
            sides.

    Returns:
        A ParameterSet: .lo and .hi, boxes in the units of the parameters, .hull, .status, .model. Interrupted
        (Ctrl-C), it returns what is left so far.

    Encloses: every value within the bounds with which some behaviour explains each window, rounding included;
        so the true one, if the model and its bounds are true. No box left is a proof of a fault.

    Windows are taken one by one: values with which each window alone can be explained stay in the set, though
    no one behaviour may explain all windows; longer windows leave fewer. Boxes inside the set are not told
    from those across its border. Windows that lack a sample are left aside.
    Of more than 16 384 windows each level of boxes asks some, and all are asked of what is left: a coarser
    set, in a few seconds for a million.

    Raises:
        TypeError: no relations.
        ValueError: relations without constant parameters, a recording without a whole window, several
            recordings, an infinite sample, a precision or a budget that is none; see `detect` too.

    Source: Milanese, Vicino 1991, Optimal estimation theory for dynamic systems with set membership
    uncertainty; Jaulin, Walter 1993.

    Example:
        >>> import jaxbound as jb
        >>> pole = jb.Uncertainty("a", A=[[1]], between=("0.5", "0.9"), varying=False)
        >>> m = jb.LinearSystem([[0]], None, [[1]], noise="0.01", uncertainties=[pole])
        >>> found = parameters(jb.parity_relations(m), None, [[1.0], [0.8], [0.64], [0.51]])
        >>> found.status, [round(x, 2) for x in found.hull["a"]]
        ('found', [0.78, 0.82])
    """
    relations_of(relations, "parameters", EXAMPLE, monitors=False)
    _check_precision(precision, budget)
    report = reporter(progress, "parameters")
    named, recording = relations.recording(u, y, starts)
    if np.ndim(recording.y) != 2:
        raise ValueError(
            f"parameters takes one recording (T, p): y has the shape {np.shape(recording.y)}; lay several "
            f"end to end and give where each begins, starts=(..)"
        )
    recording = replace(recording, u=np.asarray(recording.u), y=np.asarray(recording.y)).finite()
    test, ends = _box_windows(named, recording, constant)
    search = Search(test, float(precision))
    search.run(int(budget), report)
    lo, hi = test.units(search.lo, search.hi)
    status = search.status
    if not len(lo):
        status = EMPTY
    least, most = test.units(test.lo[:, None], test.hi[:, None])
    bounds = dict(zip(test.names, zip(least[0].tolist(), most[0].tolist(), strict=True), strict=True))
    refuted = {}
    for k in np.argsort(-search.refuted, kind="stable")[:NAMED].tolist():
        if search.refuted[k]:
            refuted[int(ends[k])] = int(search.refuted[k])
    return ParameterSet(test.names, lo, hi, bounds, status, test.count, search.evaluated, refuted, relations)


def _check_precision(precision: float, budget: int) -> None:
    """Raise ValueError for a precision or a budget that is none."""
    if not is_whole(budget) or budget < 1:
        raise ValueError(f"budget must be a whole number of boxes >= 1, not {budget!r}")
    if not isinstance(precision, (float, int, np.number)) or not 0 < precision <= 1:
        raise ValueError(f"precision must be a share of the hull in (0, 1], not {precision!r}")


@singledispatch
def _box_windows(
    relations: Relations, recording: Recording, constant: Mapping[str, int] | None
) -> tuple[ParameterBoxes, np.ndarray]:
    """Return (the windows of a recording as a test of boxes, the samples at which they end)."""
    raise ValueError(
        f"parameters needs relations with parameters, and {type(relations).__name__} has none: give the "
        f"model uncertainties=[jb.Uncertainty(.., varying=False)], then {EXAMPLE}"
    )


@_box_windows.register(Observer)
def _of_observer(
    relations: Observer[Any], recording: Recording, constant: Mapping[str, int] | None
) -> tuple[ParameterBoxes, np.ndarray]:
    raise ValueError(
        f"parameters are estimated by windows, and an observer has none: {EXAMPLE}, with a longer horizon "
        f"where windows should remember more"
    )


@_box_windows.register
def _of_model(
    relations: UncertainRelations, recording: Recording, constant: Mapping[str, int] | None
) -> tuple[ParameterBoxes, np.ndarray]:
    if constant is not None:
        raise ValueError("constant= is for residuals: a model says itself which of its parameters vary")
    fixed = [p.name for p in relations.model.uncertainties if not p.varying]
    if not fixed:
        names = ", ".join(p.name for p in relations.model.uncertainties)
        raise ValueError(
            f"no parameter keeps one value: {names} may have another at each sample (varying=True, the "
            f"default); give varying=False to what stays the same over the recording"
        )
    if not {name for name, _ in relations.variables} & set(fixed):
        raise ValueError(
            f"no window of {relations.horizon + 1} samples depends on {', '.join(fixed)}: choose a longer "
            f"horizon"
        )
    starts = _whole(recording, relations.horizon, relations.reading(recording.y.dtype).lags)
    return PolynomialBoxes(relations, recording.u, recording.y, starts), starts + relations.horizon


@_box_windows.register
def _of_residual(
    relations: Residual, recording: Recording, constant: Mapping[str, int] | None
) -> tuple[ParameterBoxes, np.ndarray]:
    n = relations.box.shape[0]
    if not constant:
        raise ValueError(
            f"say which of the {n} unknowns of the residual keep one value over the recording: "
            f'constant={{"gain": 0}}; the others may be anything in the box in each window'
        )
    places = list(constant.values())
    fits = all(is_whole(i) and 0 <= i < n for i in places)
    if not fits or len(set(places)) < len(places):
        raise ValueError(f"constant needs numbers of different unknowns, 0 to {n - 1}: not {dict(constant)}")
    starts = _whole(recording, relations.horizon, relations.horizon + 1)
    return ResidualBoxes(relations, constant, recording.u, recording.y, starts), starts + relations.horizon


def _whole(recording: Recording, horizon: int, lags: int) -> np.ndarray:
    """Return the starts of windows that lack no sample and lie across no seam.

    Raises:
        ValueError: there is none.
    """
    ends = np.flatnonzero(~recording.across(horizon))
    starts = np.asarray(ends[ends >= horizon] - horizon)
    lacking = span(np.isnan(recording.y), starts, horizon + 1) | span(np.isnan(recording.u), starts, lags)
    starts = np.asarray(starts[~lacking])
    if not len(starts):
        raise ValueError(
            f"no window of {horizon + 1} samples is whole: the recording has {recording.samples} samples, "
            f"{len(recording.starts)} gaps, and {int(np.isnan(recording.y).any(1).sum())} samples without "
            f"some output"
        )
    return starts
