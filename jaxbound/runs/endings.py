"""What may be said of alarms that are over: whether a fault was repaired or lasts, a CONSISTENT window often
cannot tell.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jaxbound.diagnosis.alarms import BEGAN_ANEW, GAP, NO_LONGER, ONSET_LEFT, Alarm
from jaxbound.diagnosis.detectability import always_seen
from jaxbound.diagnosis.memory import slowest
from jaxbound.relations.sentence import latched, looked_at, remembers
from jaxbound.runs.digest import Digest
from jaxbound.runs.summary import evidence

__all__ = ["ending_hints", "endings_said", "sizes_seen", "sizes_text"]


def sizes_seen(res: Any, alarms: Sequence[Alarm]) -> dict[str, float] | None:
    """Return the sizes of `always_seen`; None where there is no alarm, as nobody needs them then, or where
    they are not known.

    Args:
        res: a Result of one recording, or a Digest, of which the samples around the first alarm say how large
            readings get.
        alarms: its alarms.
    """
    if not alarms:
        return None
    return always_seen(
        res.relations, res.method, res.near(alarms[0].worst).y if isinstance(res, Digest) else res.y
    )


def ending_hints(res: Any, alarms: Sequence[Alarm], sizes: Mapping[str, float] | None = None) -> list[str]:
    """Return a sentence on alarms after which CONSISTENT windows do not mean that the fault is repaired.

    Args:
        res, alarms: as for `sizes_seen`, which returns sizes; None: not asked for.
    """
    counts = evidence(res, alarms).ended or {}
    return [
        f"{said}; {sizes_text(res, sizes)}{_longer(res, sizes)}"
        for said in endings_said(counts, sum(counts.values()))
    ]


def _longer(res, sizes):
    """Return what to add where the plant remembers longer than its windows, which lasting errors hide
    behind.
    """
    relations = res.relations
    if (
        sizes is None
        or getattr(relations, "lags", None) is not None
        or slowest(relations.model) <= relations.horizon + 1
    ):
        return ""
    longer = "; smaller ones may show in a longer --horizon, or with the lags of jb.suggest_lags(model)"
    return f"{longer}; bounds from data must be fitted for these again"


def endings_said(counts: Mapping[str, int], total: int) -> list[str]:
    """Return a sentence, or none, on those of so many alarms that are over. counts: {why: how many}."""
    some = lambda n: (
        "the alarm" if total == 1 else f"all {total} alarms" if n == total else f"{n} of {total} alarms"
    )
    said = []
    if n := counts.get(ONSET_LEFT):
        said.append(f"{some(n)} may have ended because the onset left the window: repaired or lasting")
    if n := counts.get(BEGAN_ANEW):
        said.append(
            f"{some(n)} ended because the observer began anew: the fault may last, taken for the state or "
            f"hidden"
        )
    if n := counts.get(GAP):
        said.append(f"{some(n)} ended at a gap, as FAULT stays until one: repaired or lasting")
    if n := counts.get(NO_LONGER):
        said.append(f"{some(n)} ended after windows without the onset: repaired, or hidden within the bounds")
    return ["; ".join(said)] if said else []


def sizes_text(res: Any, sizes: Mapping[str, float] | None) -> str:
    """Say from which size on windows are sure to show an error that lasts."""
    if remembers(res.relations):
        stays = "" if latched(res.relations) else "; --latched keeps FAULT on behind what was contradicted"
        return f"an observer is sure of no size that lasts{stays}"
    these = looked_at(res.relations)
    if sizes is None:
        return f"{these} alone cannot tell"
    unit = res.relations.model.unit
    seen = ", ".join(
        f"{name} {size:.3g} {unit(name)}".strip() for name, size in sizes.items() if np.isfinite(size)
    )
    never = ", ".join(name for name, size in sizes.items() if not np.isfinite(size))
    if not seen:
        return f"{these} are sure of no constant error that lasts, whatever its size"
    return f"{these} are sure to show a constant error that lasts from {seen} on" + (
        f", of {never} at no size" if never else ""
    )
