"""The page of a study: what a monitor sees, how soon, and how often it is wrong."""

from collections.abc import Iterator
from dataclasses import asdict
from types import SimpleNamespace
from typing import cast

import numpy as np

from jaxbound.plots.study import FAULTS, plot_study, study_charts
from jaxbound.relations.sentence import looked_at
from jaxbound.reports.chart import picture_of
from jaxbound.reports.page import render
from jaxbound.reports.parts import computed, model_values
from jaxbound.studies.montecarlo.study_result import StudyResult, study_table
from jaxbound.text.quantities import percent, plain

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
COLUMNS = (
    "detected: share of scenarios with a FAULT; FAULT windows: share of the windows wholly inside the fault; "
    "delays in samples; "
    "size and guaranteed in the unit of the signal, of a drift per sample, of a gain or a tolerance as a "
    "share; by ..: of a monitor, the share of scenarios in which this test has a FAULT"
)
"""What the columns of HEAD are."""
NOT_SHOWN = ("method", "key", "faults", "engine", "dtype")  # settings that are told elsewhere, or to nobody


def study_page(res: StudyResult, seed: int, seconds: float) -> str:
    """Return the HTML text. res: of the study. seed: of it. seconds: that it took."""
    bounds = {"tolerance": res.model.tolerance, "noise": res.model.noise}
    method, dtype = cast(str, res.settings["method"]), np.dtype(cast(str, res.settings["dtype"]))
    return render(
        "study.html",
        name=res.model.name,
        verdict="study",
        sentence=sentence(res),
        charts=plain(list(map(asdict, study_charts(res)))),
        picture=picture_of(plot_study(res)),
        others=max(len(res.trials) - FAULTS, 0),
        head=study_head(res),
        columns=COLUMNS,
        rows=list(study_rows(res)),
        settings=list(_settings(res, seed)),
        model=model_values(res.model, bounds),
        computed=computed(method, looked_at(res), dtype, {"study": seconds}),
    )


def _settings(res: StudyResult, seed: int) -> Iterator[tuple[str, object]]:
    """Yield (name, value) of what a study was asked for."""
    for name, value in res.settings.items():
        if value is not None and name not in NOT_SHOWN:
            yield name, value
    yield "seed", seed
    for trial in res.trials:
        if trial.fault is not None:
            yield f"onset of {trial.label}", f"samples {trial.onset[0]} to {trial.onset[1] - 1}"


def study_head(res: StudyResult) -> tuple[str, ...]:
    """Return the names of the columns of `study_rows`: HEAD, and of a monitor the share of each test."""
    return (*HEAD, *(f"by {name}" for name in res.by_test))


def study_rows(res: StudyResult) -> Iterator[tuple[str, ...]]:
    """Yield the table of a study as texts, a tuple a row, as `study_head` names them."""
    table = study_table(res)
    for cells in zip(*table.values(), strict=True):
        row = dict(zip(table, cells, strict=True))
        shares = [percent(row.pop(f"share of {name}")) for name in res.by_test]
        yield *_row(SimpleNamespace(**row)), *shares


def _row(cell: SimpleNamespace) -> tuple[str, ...]:
    rate, spread = "", ""
    if not np.isnan(cell.rate):
        rate, spread = percent(cell.rate), f"{percent(cell.rate_lo)} to {percent(cell.rate_hi)}"
    share = f"{percent(cell.share_lo)} to {percent(cell.share_hi)}"
    sure = f"{cell.guaranteed:.4g}" if np.isfinite(cell.guaranteed) else ""
    soon = _delay(cell.delay_median), _delay(cell.delay_90)
    size, scenarios = f"{cell.size:.4g}", f"{cell.scenarios}"
    return cell.fault, size, scenarios, percent(cell.share), share, rate, spread, *soon, sure


def _delay(samples: float) -> str:
    if np.isnan(samples):
        return ""
    if np.isinf(samples):
        return "never"
    return f"{samples:.0f}"


def sentence(res: StudyResult) -> str:
    """Return the counts of a study as a sentence."""
    false, clean = res.false_alarms
    if false:
        how = "the plant is not what the monitor takes it for"
    else:
        most = 100 * res.false_alarm_interval()[1]
        how = f"fewer than {most:.2g} % of scenarios have one, with 95 % confidence"
    alarms = f"{false} false alarms in {clean} windows without a fault ({how})"
    return f"{res.scenarios} scenarios of {res.samples} samples: {alarms}"
