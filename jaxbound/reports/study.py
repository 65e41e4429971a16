"""The page of a study: what a monitor sees, how soon, and how often it is wrong."""

from typing import Any, cast

import numpy as np

from jaxbound.recordings.plaintext import percent
from jaxbound.reports.page import render
from jaxbound.reports.parts import computed, model_values
from jaxbound.studies.montecarlo.study_result import StudyResult

__all__ = ["COLUMNS", "HEAD", "sentence", "study_page", "study_rows"]

HEAD = (
    "fault",
    "size",
    "scenarios",
    "detected",
    "95 %",
    "FAULT windows",
    "95 %",
    "median delay",
    "90 % by",
    "guaranteed",
)
COLUMNS = ("detected: share of scenarios with a FAULT; FAULT windows: share of the windows wholly inside the fault; delays in samples; "
           "size and guaranteed in the unit of the signal, of a drift per sample, of a gain or a tolerance as a share")  # fmt: skip
"""What the columns of HEAD are."""
NOT_SHOWN = ("method", "key", "faults", "engine", "dtype")  # settings that are told elsewhere, or to nobody


def study_page(res: StudyResult, found: Any, png: bytes, seed: int, seconds: float) -> str:
    """Return the HTML text.

    Args:
        res: of the study. found: its table. png: a picture of it. seed: of the study.
        seconds: that it took.
    """
    bounds = {"tolerance": res.model.tolerance, "noise": res.model.noise}
    return render(
        "study.html",
        name=res.model.name,
        verdict="study",
        title="What this monitor sees",
        sentence=sentence(res),
        picture=png,
        head=HEAD,
        columns=COLUMNS,
        rows=study_rows(found),
        settings=list(_settings(res, seed)),
        model=model_values(res.model, bounds),
        computed=computed(cast(str, res.settings["method"]), res.horizon, np.dtype(cast(str, res.settings["dtype"])), {"study": seconds}),
    )


def _settings(res, seed):
    """Yield (name, value) of what a study was asked for."""
    for name, value in res.settings.items():
        if value is not None and name not in NOT_SHOWN:
            yield name, value
    yield "seed", seed
    for trial in res.trials:
        if trial.fault is not None:
            yield f"onset of {trial.label}", f"samples {trial.onset[0]} to {trial.onset[1] - 1}"


def study_rows(found: Any) -> list[tuple[str, ...]]:
    """Return the table of a study as texts, a tuple a row, as HEAD names them."""
    return list(map(_row, found.itertuples()))


def _row(cell):
    rate, spread = "", ""
    if not np.isnan(cell.rate):
        rate, spread = percent(cell.rate), f"{percent(cell.rate_lo)} to {percent(cell.rate_hi)}"
    share = f"{percent(cell.share_lo)} to {percent(cell.share_hi)}"
    sure = f"{cell.guaranteed:.4g}" if np.isfinite(cell.guaranteed) else ""
    soon = _delay(cell.delay_median), _delay(cell.delay_90)
    size, scenarios = f"{cell.size:.4g}", f"{cell.scenarios:,}"
    return cell.fault, size, scenarios, percent(cell.share), share, rate, spread, *soon, sure


def _delay(samples):
    if np.isnan(samples):
        return ""
    return "never" if np.isinf(samples) else f"{samples:.0f}"


def sentence(res: StudyResult) -> str:
    """Return what a study counted as a sentence."""
    false, clean = res.false_alarms
    if false:
        how = "the plant is not what the monitor takes it for"
    else:
        most = 100 * res.false_alarm_interval()[1]
        how = f"fewer than {most:.2g} % of scenarios have one, with 95 % confidence"
    alarms = f"{false} false alarms in {clean:,} windows without a fault ({how})"
    return f"{res.scenarios:,} scenarios of {res.samples} samples: {alarms}"
