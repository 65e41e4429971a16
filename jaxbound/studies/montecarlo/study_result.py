"""The result of a Monte-Carlo study."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from jaxbound.consistency.interface import MONITOR, OBSERVER
from jaxbound.models.system import LinearSystem
from jaxbound.studies.montecarlo.proportions import proportion_interval
from jaxbound.studies.montecarlo.scenarios import Trial
from jaxbound.studies.montecarlo.tally import TrialTally
from jaxbound.text.objects import readable

if TYPE_CHECKING:
    import pandas as pd


@readable
@dataclass(frozen=True, eq=False)
class StudyResult:
    """Counts of a study, by fault and size. Build it with `study`.

    Fields:
        model: the plant that was simulated. horizon: of the windows. trials: one entry a fault, with .label,
            .sizes and .guaranteed, the size of a constant fault from which on none stays hidden (nan where
            nothing is known). tallies: the counts of each.
        at: "uniform", "vertices" or "adversarial". samples: of a scenario. confidence: of the intervals.
        settings: what else the scenarios depend on, as plain values, for reports.
        by_test: of a monitor, {name: the counts of one of its tests for each trial}.
    """

    model: LinearSystem
    horizon: int
    trials: tuple[Trial, ...]
    tallies: tuple[TrialTally, ...]
    at: str
    samples: int
    confidence: float
    settings: dict[str, object]
    by_test: Mapping[str, tuple[TrialTally, ...]] = field(default_factory=dict)

    @property
    def remembers(self) -> bool:
        """Whether an observer or a monitor was studied: windows are samples then, and horizon those that
        it takes to begin.
        """
        return self.settings["method"] in (OBSERVER, MONITOR)

    @property
    def scenarios(self) -> int:
        """Number of scenarios counted."""
        return int(sum(t.scenarios.sum() for t in self.tallies))

    @property
    def false_alarms(self) -> tuple[int, int]:
        """(FAULT windows, all windows) without a faulty sample: the first is 0 if the plant is what the
        relations take it for.
        """
        return int(sum(t.false.sum() for t in self.tallies)), int(sum(t.clean.sum() for t in self.tallies))

    def false_alarm_interval(self) -> tuple[float, float]:
        """Return (lo, hi) of the true share of scenarios with a false alarm, Clopper-Pearson."""
        alarmed = sum(t.alarmed.sum() for t in self.tallies)
        lo, hi = proportion_interval(alarmed, self.scenarios, self.confidence)
        return float(lo), float(hi)

    def to_pandas(self) -> "pd.DataFrame":
        """Return a DataFrame with a row for each fault and size.

        Columns: fault, size; scenarios, detected; share with share_lo, share_hi: of scenarios detected
        (Clopper-Pearson); windows, rate with rate_lo, rate_hi: FAULT windows among those wholly inside the
        fault (over scenarios, normal); delay_median, delay_90: samples from the onset to the end of the first
        FAULT window, among all scenarios (inf: not detected by then); never: not detected; false_alarms,
        clean_windows; guaranteed; of a monitor "share of NAME", of scenarios that this test detects.
        """
        import pandas as pd

        return pd.DataFrame(study_table(self))

    def delays(self) -> "pd.DataFrame":
        """Return a DataFrame with a row for each (fault, size, delay) that occurred: scenarios, delay null
        where never detected.
        """
        import pandas as pd

        columns = delay_table(self)
        delay = pd.array(columns["delay"], dtype="Int64")
        return pd.DataFrame(columns | {"delay": delay})

    def __repr__(self) -> str:
        false, clean = self.false_alarms
        labels = ", ".join(t.label for t in self.trials)
        return (
            f"StudyResult({self.scenarios} scenarios of {labels}, unknowns {self.at}; {false} false "
            f"alarms in {clean} windows)"
        )


def study_table(res: StudyResult) -> dict[str, np.ndarray]:
    """Return the columns of `StudyResult.to_pandas` as {name: array}, without pandas, which takes longer to
    import than a small study.
    """
    parts = []
    for i, (trial, tally) in enumerate(zip(res.trials, res.tallies, strict=True)):
        columns = _columns(trial, tally, res.confidence)
        for name, tallies in res.by_test.items():
            columns[f"share of {name}"], _, _ = tallies[i].share(res.confidence)
        parts.append(columns)
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def delay_table(res: StudyResult) -> dict[str, np.ndarray]:
    """Return the columns of `StudyResult.delays` as {name: array}, NaN for the delay of what was never
    detected.
    """
    rows: list[tuple[str, float, float, int]] = []
    for trial, tally in zip(res.trials, res.tallies, strict=True):
        for i, size in enumerate(trial.sizes):
            for delay in np.flatnonzero(tally.delays[i]):
                rows.append((trial.label, float(size), float(delay), int(tally.delays[i, delay])))
            never = int(tally.scenarios[i] - tally.detected[i])
            if never:
                rows.append((trial.label, float(size), np.nan, never))
    kinds = {"fault": object, "size": float, "delay": float, "scenarios": np.int64}
    return {name: np.array([row[j] for row in rows], kind) for j, (name, kind) in enumerate(kinds.items())}


def _columns(trial: Trial, tally: TrialTally, confidence: float) -> dict[str, np.ndarray]:
    """Return {name: (S,)} of one Trial."""
    (share, lo, hi), (rate, rate_lo, rate_hi) = tally.share(confidence), tally.rate(confidence)
    columns = {
        "fault": trial.label,
        "size": trial.sizes,
        "scenarios": tally.scenarios,
        "detected": tally.detected,
        "share": share,
        "share_lo": lo,
        "share_hi": hi,
        "windows": tally.windows,
        "rate": rate,
        "rate_lo": rate_lo,
        "rate_hi": rate_hi,
        "delay_median": delay_quantile(tally, 0.5),
        "delay_90": delay_quantile(tally, 0.9),
        "never": tally.scenarios - tally.detected,
        "false_alarms": tally.false,
        "clean_windows": tally.clean,
        "guaranteed": trial.guaranteed,
    }
    like = {"fault": object, "size": float, "guaranteed": float}
    count = len(tally.scenarios)
    return {name: np.array(np.broadcast_to(x, count), like.get(name)) for name, x in columns.items()}


def delay_quantile(tally: TrialTally, share: float) -> np.ndarray:
    """Return (S,) the least delay by which that share of all scenarios is detected, inf where it never is,
    nan without scenarios.
    """
    reached = np.cumsum(tally.delays, 1) >= share * tally.scenarios[:, None]
    out = np.where(reached.any(1), reached.argmax(1).astype(float), np.inf)
    return np.where(tally.scenarios > 0, out, np.nan)
