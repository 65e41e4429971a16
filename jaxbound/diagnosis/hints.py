"""What to check of bounds and of a model that does not fit, as sentences for whoever acts on verdicts."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxbound.models.system import LinearSystem
from jaxbound.relations.sentence import latched
from jaxbound.sets.floats.status import Status
from jaxbound.text.quantities import percent, times
from jaxbound.text.units import same_unit, without_unit

__all__ = ["bound_hints", "fit_hints", "outgrown", "unfit", "unit_hints"]

FOR = "the bounds were found from data for windows of {} samples,"
MAY = "a FAULT may be no more than an error that lasts longer than those"
NEARLY_ALL = 0.9
"""Share of FAULT among windows with data from which on model and bounds are in doubt."""


def bound_hints(model: Any, relations: Any = None) -> list[str]:
    """Return sentences on bounds that nobody can mean, and on those that were found for shorter windows than
    these.

    Args:
        model: as it was read: with the horizon or lags that its bounds were found for; nothing is said of
            other kinds.
        relations: or an observer, what it is tested by; None: windows of the model.
    """
    if not isinstance(model, LinearSystem):
        return []
    bare = [
        s
        for s, *b in zip(model.outputs, model.tolerance, model.noise, model.resolution, strict=True)
        if not any(b)
    ]
    none = (
        f"the model states no tolerance, noise or resolution for {', '.join(bare)}: any measuring error "
        f"there is a FAULT"
    )
    rows = zip(model.outputs, model.tolerance, model.noise, model.resolution, strict=True)
    rounded = [s for s, tolerance, noise, resolution in rows if resolution and not (tolerance or noise)]
    have = "have" if len(rounded) > 1 else "has"
    only = f"{', '.join(rounded)} {have} only a resolution: state noise or tolerance, what the sensor errs by"
    other_units = unit_hints(model)
    return outgrown(model, relations) + [none] * bool(bare) + [only] * bool(rounded) + other_units


def unit_hints(model: LinearSystem) -> list[str]:
    """Return a sentence on each signal whose unit is another one than that in the name of its column."""
    sentences = []
    for signal, unit in model.units.items():
        column = model.column(signal)
        other = without_unit(column)[1]
        if other and not same_unit(unit, other):
            sentences.append(
                f"the model has {signal} in {unit}, and its column {column!r} is in {other}: say in one of "
                f"them what the numbers are"
            )
    return sentences


def outgrown(model: LinearSystem, relations: Any = None, looks_back: str = "") -> list[str]:
    """Return a sentence, or none, on bounds from data that a test reaches beyond: they were found for shorter
    windows.

    Args:
        model, relations: as for `bound_hints`. looks_back: what looks back on all samples; "": an observer
            alone does.
    """
    known, found = (
        model.lags[-1] if model.lags else model.horizon,
        " ".join(map(str, model.provenance.values())),
    )
    if relations is None or known is None or not ("fitted" in found or "tuned" in found):
        return []
    looks_back = looks_back or ("an observer" if relations.remembers else "")
    if looks_back:
        return [f"{FOR.format(known + 1)} and {looks_back} looks back on all samples: {MAY}"]
    if relations.horizon <= known:
        return []
    lags = getattr(relations, "lags", None)
    again = f"--lags {','.join(map(str, lags))}" if lags else f"--horizon {relations.horizon}"
    reach = f"these windows reach over {relations.horizon + 1}"
    return [f"{FOR.format(known + 1)} and {reach}: {MAY}; fit again with {again}"]


def fit_hints(result: Any) -> list[str]:
    """Return a sentence, or none, on each recording of a Result that the model or its bounds seem not to
    fit.
    """
    relations, out = result.relations, []
    if latched(relations):  # one fault, and all that follows is FAULT
        return []
    for at in np.ndindex(result.status.shape[:-1]):
        status, margin = np.asarray(result.status[at]), np.asarray(result.margin[at])
        fault = status == Status.FAULT
        seen = margin[fault & ~np.isnan(margin)] if not relations.remembers else margin[:0]
        worst = float(seen.min()) if len(seen) else np.nan
        counts = {s.name: int(np.count_nonzero(status == s)) for s in Status}
        which = f"recording {', '.join(map(str, at))}: " if at else ""
        out += [
            which + said for said in unfit(counts, worst, "samples" if relations.remembers else "windows")
        ]
    return out


def unfit(counts: Mapping[str, int], margin: float, what: str = "windows") -> list[str]:
    """Return a sentence, or none, where all windows with data are FAULT, or nearly all.

    Args:
        counts: {status name: number of windows}. margin: of the worst, NaN: not known. what: "windows" or
            "samples".
    """
    faults = counts["FAULT"]
    tested = faults + counts["CONSISTENT"] + counts["UNDECIDED"]
    if faults < 2 or faults < NEARLY_ALL * tested:
        return []
    by = ""
    if np.isfinite(margin):
        wider = times(1 - margin).removesuffix(" times")
        by = f": all bounds times about {wider} would make every window consistent"
    if faults == tested:
        return [
            f"every one of the {faults} {what} with data is FAULT: the model or its bounds do not fit this "
            f"recording{by}"
        ]
    many = f"{faults} of {tested} {what} with data ({percent(faults / tested)}) are FAULT"
    return [f"{many}: a fault lasts all through, or the model or its bounds do not fit this recording{by}"]
