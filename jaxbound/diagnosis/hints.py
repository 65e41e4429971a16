"""Hints on bounds, and on a model that does not fit, as sentences for whoever acts on verdicts."""

from collections.abc import Iterator, Mapping
from typing import Protocol

import numpy as np

from jaxbound.certificates.interface import Judgement
from jaxbound.consistency.interface import Relations
from jaxbound.consistency.searched import NOT_REFUTED
from jaxbound.diagnosis.region import Outside
from jaxbound.models.system import FOR_OBSERVER, TO_THE_END, LinearSystem
from jaxbound.sets.floats.status import Status
from jaxbound.text.quantities import percent, times
from jaxbound.text.units import same_unit, without_unit

FOR = "the bounds were found from data for windows of {} samples,"
MAY = "a FAULT may be no more than an error that lasts longer than those"
NEARLY_ALL = 0.9
"""Share of FAULT among windows with data from which on model and bounds are in doubt."""
OTHERWISE = (
    "or a column is in another unit, or another signal, than the model has there: compare `jaxbound info "
    "MODEL.toml`"
)


def bound_hints(model: object, relations: Relations | None = None) -> list[str]:
    """Return sentences on bounds that nobody can mean, and on those that were found for shorter windows than
    these.

    Args:
        model: as it was read: with the horizon or lags that its bounds were found for; nothing is said of
            other kinds.
        relations: or an observer, what it is tested by; None: windows of the model.
    """
    if not isinstance(model, LinearSystem):
        return []
    bare, rounded = [], []
    for name, tolerance, noise, resolution in zip(
        model.outputs, model.tolerance, model.noise, model.resolution, strict=True
    ):
        if not (tolerance or noise or resolution):
            bare.append(name)
        elif not (tolerance or noise):
            rounded.append(name)
    sentences = outgrown(model, relations)
    if bare:
        sentences.append(
            f"the model states no tolerance, noise or resolution for {', '.join(bare)}: any measuring error "
            f"there is a FAULT"
        )
    if rounded:
        have = "has"
        if len(rounded) > 1:
            have = "have"
        sentences.append(
            f"{', '.join(rounded)} {have} only a resolution: state noise or tolerance, what the sensor errs "
            f"by"
        )
    return [*sentences, *column_unit_hints(model)]


def device_hints(device: str) -> tuple[str, ...]:
    """Return the sentence on the device that judged, and whether it may prove; none of a CPU.

    Args:
        device: in the words of `judging_device`.
    """
    card, is_searched, _ = device.partition(f", {NOT_REFUTED}")
    if is_searched:
        return (
            f"{NOT_REFUTED} ({card}): what it called CONSISTENT is UNDECIDED, with margins as it computed "
            f"them; each FAULT was proved on the CPU; JAX_PLATFORMS=cpu does without it",
        )
    if device.startswith("the CPU"):
        return (f"followed on {device}",)
    if device:
        return (f"judged on {device}",)
    return ()


def column_unit_hints(model: LinearSystem) -> Iterator[str]:
    """Yield a sentence on each signal whose unit is another one than that in the name of its column."""
    for signal, unit in model.units.items():
        column = model.column(signal)
        other = without_unit(column)[1]
        if other and not same_unit(unit, other):
            yield (
                f"the model has {signal} in {unit}, and its column {column!r} is in {other}: say in one of "
                f"them what the numbers are"
            )


def outgrown_by(relations: Relations, name: str) -> bool:
    """Return whether a test of a monitor has outgrown its bounds. name: of the test."""
    own = relations.parts[name].model
    assert isinstance(own, LinearSystem), "a monitor has tests of models"
    return bool(outgrown(own, relations.parts[name]))


def outgrown(model: LinearSystem, relations: Relations | None = None, looks_back: str = "") -> list[str]:
    """Return a sentence, or none, on bounds from data that a test reaches beyond: they were found for shorter
    windows.

    Args:
        model, relations: as for `bound_hints`. looks_back: what looks back on all samples; "": an observer
            alone does.
    """
    if relations is not None and relations.parts:
        sentences = []
        for name, test in relations.parts.items():
            own = test.model
            assert isinstance(own, LinearSystem), "a monitor has tests of models"
            sentences += [f"test {name!r}: {sentence}" for sentence in outgrown(own, test)]
        return sentences
    horizon, origins = model.horizon, " ".join(map(str, model.provenance.values()))
    if model.lags:
        horizon = model.lags[-1]
    if not looks_back and relations is not None and relations.remembers:
        looks_back = "an observer"
    if TO_THE_END in origins:
        return []
    if FOR_OBSERVER in origins:
        if looks_back:
            return []
        return [
            "the bounds were found from data for an observer, whose sets are not those of windows: a FAULT "
            "may be no more than healthy operation; fit again without one"
        ]
    if horizon is None or not ("fitted" in origins or "tuned" in origins):
        return []
    if looks_back:
        return [f"{FOR.format(horizon + 1)} and {looks_back} looks back on all samples: {MAY}"]
    if relations is None or relations.horizon <= horizon:
        return []
    again = f"--recipe horizon={relations.horizon}"
    if relations.lags:
        again = f"--recipe lags={','.join(map(str, relations.lags))}"
    reach = f"these windows reach over {relations.horizon + 1}"
    return [f"{FOR.format(horizon + 1)} and {reach}: {MAY}; fit again with {again}"]


class Reported(Judgement, Protocol):
    """Verdicts whose FAULT windows have exact margins where somebody asks for them."""

    @property
    def reported(self) -> np.ndarray:
        """(..., T): the margins, exact ones at FAULT windows."""

    def beyond_of(self, at: tuple[int, ...]) -> Outside | None:
        """Return the windows of a recording outside the region of training; None: there is no region."""


def fit_hints(result: Reported) -> list[str]:
    """Return a sentence, or none, on each recording of a Result that the model or its bounds seem not to
    fit.
    """
    relations, sentences = result.relations, []
    for at in np.ndindex(result.status.shape[:-1]):
        status, margin = np.asarray(result.status[at]), np.asarray(result.margin[at])
        beyond = result.beyond_of(at)
        counts = {s.name: int(np.count_nonzero(status == s)) for s in Status}
        measured = (status == Status.FAULT) & ~np.isnan(margin)
        worst = np.nan
        if measured.any() and unfit_by(relations, counts, worst, None):
            worst = float(result.reported[at][measured].min())
        for sentence in unfit_by(relations, counts, worst, beyond):
            if at:
                sentence = f"recording {', '.join(map(str, at))}: {sentence}"
            sentences.append(sentence)
    return sentences


def unfit_by(
    relations: Relations, counts: Mapping[str, int], margin: float, beyond: Outside | None
) -> list[str]:
    """Return the sentences of `unfit` on a run of relations, or of an observer."""
    if relations.latched:  # one fault, and all that follows is FAULT
        return []
    if relations.remembers:
        return unfit(counts, np.nan, "samples", beyond)
    return unfit(counts, margin, "windows", beyond)


def unfit(
    counts: Mapping[str, int], margin: float, what: str = "windows", beyond: Outside | None = None
) -> list[str]:
    """Return a sentence, or none, where all windows with data are FAULT, or nearly all.

    Outside the region of training it is that; inside it a fault is the likelier reason.

    Args:
        counts: {status name: number of windows}. margin: of the worst, NaN: not known. what: "windows" or
            "samples". beyond: those outside the region of training, None: there is no region.
    """
    faults = counts["FAULT"]
    tested = faults + counts["CONSISTENT"] + counts["UNDECIDED"]
    if faults < 2 or faults < NEARLY_ALL * tested:
        return []
    if beyond is not None and beyond.holds(faults):
        return [never_seen(beyond, faults, what)]
    by = ""
    if np.isfinite(margin):
        wider = times(1 - margin).removesuffix(" times")
        by = f": all bounds times about {wider} would make every window consistent"
    many = f"every one of the {faults} {what} with data is FAULT"
    if faults < tested:
        many = f"{faults} of {tested} {what} with data ({percent(faults / tested)}) are FAULT"
    if beyond is not None and beyond.spares(faults):
        within = "within the region of training"
        if beyond.faults:
            within = f"nearly all {within}"
        return [f"{many}, {within}: a fault lasts all through, or the bounds are too tight{by}; {OTHERWISE}"]
    why = "a fault lasts all through, or the model or its bounds do not fit this recording"
    return [f"{many}: {why}{by}; {OTHERWISE}"]


def never_seen(beyond: Outside, faults: int, what: str = "windows") -> str:
    """Return the sentence on FAULT windows that lie outside the region of training, nearly all of so many."""
    many, proofs = f"all {faults} FAULT {what} read", "their proofs rest"
    if beyond.faults < faults:
        many = f"{beyond.faults} of {faults} FAULT {what} read"
    if faults == 1:
        many, proofs = f"the only FAULT {what.removesuffix('s')} reads", "its proof rests"
    new = f"inputs that this model has never seen, most by {beyond.words}"
    return f"{many} {new}: {proofs} on extrapolation"
