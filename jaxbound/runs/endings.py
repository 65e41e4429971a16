"""Sentences on alarms that are over: a CONSISTENT window often cannot tell whether a fault was repaired or
lasts.
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from jaxbound.consistency.interface import Relations
from jaxbound.diagnosis.alarms import BEGAN_ANEW, GAP, NO_LONGER, ONSET_LEFT, Alarm
from jaxbound.diagnosis.detectability import always_seen, is_affordable
from jaxbound.diagnosis.hints import outgrown
from jaxbound.diagnosis.memory import slowest
from jaxbound.diagnosis.result import Result
from jaxbound.models.system import LinearSystem
from jaxbound.relations.sentence import looked_at
from jaxbound.runs.digest import Digest
from jaxbound.runs.summary import Summary, evidence, summarised
from jaxbound.text.names import listed
from jaxbound.text.quantities import three_digits

WORDS = {
    ONSET_LEFT: "may have ended because the onset left the window: repaired or lasting",
    BEGAN_ANEW: "ended because the observer began anew: the fault may last, taken for the state or hidden",
    GAP: "ended at a gap, as FAULT stays until one: repaired or lasting",
    NO_LONGER: "ended after windows without the onset: repaired, or hidden within the bounds",
}
"""{why alarms are over: the words for it}, in the order of a sentence."""


def sizes_seen(res: Result | Digest, alarms: Sequence[Alarm]) -> dict[str, float] | None:
    """Return the sizes of `always_seen`; None where there is no alarm, as nobody needs them then, or where
    they are not known.

    Args:
        res: a Result of one recording, or a Digest, of which the samples around the first alarm say how large
            readings get.
        alarms: its alarms.
    """
    if not alarms:
        return None
    readings = res.near(alarms[0].worst).y if isinstance(res, Digest) else res.y
    if res.relations.parts:
        return _least_sizes(res.relations, readings)
    return always_seen(res.relations, res.method, readings)


def _least_sizes(monitor: Relations, readings: np.ndarray) -> dict[str, float] | None:
    """Return the sizes of the test that sees most, of those that always watch; None where none is known."""
    least: dict[str, float] = {}
    for watch in monitor.watches:
        sizes = None
        if watch.when is None:
            sizes = always_seen(watch.relations, readings=readings)
        for signal, size in (sizes or {}).items():
            least[signal] = min(size, least.get(signal, np.inf))
    return least or None


def concluded(
    res: Result | Digest,
    alarms: Sequence[Alarm],
    stated: LinearSystem,
    label: Callable[[int], str],
    min_coverage: float,
    sizes: Mapping[str, float] | None = None,
) -> Summary:
    """Return the Summary of a test, with all that is to be said of it.

    Args:
        res, alarms: as for `sizes_seen`, which returns sizes. stated: the model as its file states it, with
            the windows that its bounds were found for. label, min_coverage: see `summarised`.
    """
    reaches = outgrown(stated, res.relations)
    hints = dict.fromkeys((*res.hints, *reaches, *ending_hints(res, alarms)))
    return summarised(res, alarms, label, min_coverage, hints, sizes, bool(reaches))


def ending_hints(res: Result | Digest, alarms: Sequence[Alarm]) -> list[str]:
    """Return a sentence on alarms after which CONSISTENT windows do not mean that the fault is repaired.

    Args:
        res, alarms: as for `sizes_seen`.
    """
    counts = evidence(res, alarms).ended or {}
    return endings_said(counts, sum(counts.values()))


def _longer(res: Result | Digest, sizes: Mapping[str, float] | None) -> str:
    """Return the advice where a plant remembers longer than its windows, which lasting errors hide behind."""
    relations = res.relations
    model = relations.model
    if sizes is None or relations.parts or relations.lags is not None or not isinstance(model, LinearSystem):
        return ""
    if slowest(model) <= relations.horizon + 1:
        return ""
    longer = "; smaller ones may show in a longer horizon, or with the lags of jb.suggest_lags(model)"
    return f"{longer}; bounds from data must be fitted for these again"


def endings_said(counts: Mapping[str, int], total: int) -> list[str]:
    """Return a sentence, or none, on those of so many alarms that are over. counts: {why: how many}."""
    clauses = [f"{_of_alarms(counts[why], total)} {words}" for why, words in WORDS.items() if counts.get(why)]
    if not clauses:
        return []
    return ["; ".join(clauses)]


def _of_alarms(count: int, total: int) -> str:
    if total == 1:
        return "the alarm"
    if count == total:
        return f"all {total} alarms"
    return f"{count} of {total} alarms"


def sizes_text(res: Result | Digest, sizes: Mapping[str, float] | None) -> str:
    """Say from which size on windows are sure to show an error that lasts."""
    if res.relations.parts and sizes is None:
        return "from which size on the tests are sure to show an error that lasts is not known"
    if res.relations.latched and not res.relations.parts:
        return "an observer may miss an error that lasts, whatever its size"
    if res.relations.remembers and not res.relations.parts:
        advice = "latched=true keeps FAULT on behind what was contradicted"
        return f"an observer may miss an error that lasts, whatever its size; {advice}"
    these = looked_at(res.relations)
    if res.relations.parts:
        these = "the tests"
    if sizes is None:
        return f"{these} alone cannot tell"
    unit = res.relations.model.unit
    shown = ", ".join(
        f"{name} {three_digits(least)} {unit(name)}".strip()
        for name, least in sizes.items()
        if np.isfinite(least)
    )
    never = ", ".join(name for name, size in sizes.items() if not np.isfinite(size))
    untold = [name for name, test in res.relations.parts.items() if not is_affordable(test)]
    if not shown:
        return f"{these} may miss a constant error that lasts, whatever its size"
    if never:
        never = f"; one of {never} they may miss, whatever its size"
    said = f"{these} are sure to show a constant error that lasts from {shown} on{never}"
    if untold:
        said += f"; {listed(untold)} may show smaller ones: jaxbound info tells from which size on"
    return said + _longer(res, sizes)
