"""The page of a study: what a monitor sees, how soon, and how often it is wrong."""

import numpy as np

from jaxbound.recordings.plaintext import escape, percent
from jaxbound.reports.page import about, figure, frame, model_tables, section, table

__all__ = ["HEAD", "sentence", "study_page", "study_rows"]

HEAD = ("fault", "size", "scenarios", "detected", "95 %", "FAULT windows", "95 %", "median delay", "90 % by", "guaranteed")
PROMISE = (
    "Counted is what the proved test calls FAULT. The shares are estimates for scenarios like these: inputs and unknowns as above, the "
    "plant as the model says. The intervals hold what such a share really is with the stated confidence. The guaranteed size holds for "
    "any unknowns within the bounds; no simulation can show more than that."
)


def study_rows(frame_of):
    """Return the table of a study as texts, a tuple a row, as HEAD names them."""
    number = lambda x, form="{:.4g}": "" if np.isnan(x) else "never" if np.isinf(x) else form.format(x)
    out = []
    for row in frame_of.itertuples():
        sure = number(row.guaranteed) if np.isfinite(row.guaranteed) else ""
        rate = "" if np.isnan(row.rate) else percent(row.rate)
        share, spread = (f"{percent(lo)} to {percent(hi)}" for lo, hi in ((row.share_lo, row.share_hi), (row.rate_lo, row.rate_hi)))
        soon = (number(x, "{:.0f}") for x in (row.delay_median, row.delay_90))
        cells = (row.fault, f"{row.size:.4g}", f"{row.scenarios:,}", percent(row.share), share, rate, spread if rate else "", *soon, sure)
        out.append(cells)
    return out


def sentence(res):
    """Return what a study counted as a sentence."""
    false, clean = res.false_alarms
    most = res.false_alarm_interval()[1]
    how = f"fewer than {100 * most:.2g} % of scenarios have one, with 95 % confidence"
    how = "the plant is not what the monitor takes it for" if false else how
    return f"{res.scenarios:,} scenarios of {res.samples} samples: {false} false alarms in {clean:,} windows without a fault ({how})"


def study_page(res, found, png, seed, seconds):
    """Return the HTML text. res: StudyResult. found: its table. png: its picture. seed: of the study. seconds: it took."""
    caption = (
        "Left: share of scenarios detected, and of FAULT windows among those wholly inside the fault, with their intervals; dashed: the "
        "size of a constant fault that nothing within the bounds can hide. Right: share of scenarios detected so soon after the onset."
    )
    kept = {name: value for name, value in res.settings.items() if name not in ("key", "faults", "engine", "dtype")}
    told = [(name, str(value)) for name, value in kept.items() if value is not None]
    told += [("seed", str(seed))]
    told += [(f"onset of {t.label}", f"samples {t.onset[0]} to {t.onset[1] - 1}") for t in res.trials if t.fault is not None]
    bounds = {name: getattr(res.model, name) for name in ("tolerance", "noise")}
    sections = [
        f'<header><p class="kind">jaxbound study</p><h1>{escape(res.model.name)}</h1></header>',
        f'<section class="verdict"><h2>What this monitor sees</h2><p>{escape(sentence(res))}</p></section>',
        section("Detected against size", figure(png, "share detected against the size of each fault", caption)),
        section("In numbers", "<p>Delays in samples, from the onset to the end of the first FAULT window, among all scenarios.</p>",
                [HEAD, *study_rows(found)]),
        section("Scenarios", table(("", ""), told, "about")),
        section("Model and bounds", model_tables(res.model, bounds)),
        section("How this was computed", about("joint", res.horizon, np.dtype(res.settings["dtype"]), {"study": seconds})),
        f'<section class="guarantee"><h2>What is guaranteed</h2><p>{PROMISE}</p></section>',
    ]  # fmt: skip
    return frame(res.model.name, "study", sections)
