"""What `jaxbound detect --method validation` found: its verdict in a sentence, its columns in a file, its page."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jaxbound.bands import plot_output
from jaxbound.columns import to_arrow, words, write_columns
from jaxbound.diagnosis.alarms import group_alarms
from jaxbound.diagnosis.validation import Validation
from jaxbound.models.system import LinearSystem
from jaxbound.page import about, duration, figure, frame, model_tables, opening, percent, section, table, tiles
from jaxbound.plots import PANELS, to_png
from jaxbound.sets.status import Status

__all__ = ["Validated", "write_columns_of", "write_page"]

ROWS = 200  # stretches in the table
MEANING = {
    Status.FAULT: "proved: the samples of this window contradict the model, given what was accepted before",
    Status.CONSISTENT: "proved: the model explains the samples with every error inside its bounds",
    Status.UNDECIDED: "nothing contradicts the model; a fault too small to be proved may be there",
    Status.MISSING: "no usable data: the first samples of a recording, or missing values",
}
PROMISE = (
    "As long as the model and its bounds are true and the first window is free of faults, a healthy plant never raises a FAULT, and the "
    "bands hold the true values, floating-point rounding included, if every faulty sample was found. A fault too small to be proved is "
    "accepted as healthy and may push a band past the truth: nobody can promise more. A corrected value is the middle of its interval: "
    "the interval is the guarantee, the middle is convenience."
)


@dataclass(frozen=True, eq=False)
class Validated:
    """A Validation of one recording with what a report needs beside it.

    Fields: model: LinearSystem. horizon: windows have horizon + 1 samples. y: (T, p) as recorded. found: Validation, NumPy inside.
    """

    model: LinearSystem
    horizon: int
    y: np.ndarray
    found: Validation
    method = "validation"
    aside = 0

    relations = property(lambda self: self, doc="Where reports look for the model and the horizon.")
    status = property(lambda self: np.asarray(self.found.status), doc="(T,) int8.")
    margin = property(lambda self: np.full(len(self.y), np.nan), doc="(T,): validation measures none.")

    @property
    def counts(self):
        """{status name: number of windows}."""
        return {s.name: int(np.sum(self.status == s)) for s in Status}

    @property
    def tested(self):
        """The share of full windows that have data."""
        windows = len(self.y) - self.horizon
        return 1 - (self.counts["MISSING"] - self.horizon) / windows if windows > 0 else 0.0

    @property
    def blamed(self):
        """{output: number of its faulty samples}, those without any left out."""
        return {name: int(n) for name, n in zip(self.model.outputs, np.asarray(self.found.faulty).sum(0), strict=True) if n}

    def alarms(self, k=1, n=1):
        """Group FAULT windows. See `Result.alarms`."""
        return group_alarms(self, k, n, 0, 1, 0)

    def explain(self, at):
        """Refuse: there is no certificate of a verdict that rests on all samples before it."""
        raise NotImplementedError("validation has no certificate of a single window: its verdict rests on all samples before it")

    def summary(self, alarms, label, min_coverage):
        """Return (verdict, sentence). See `report.summary`."""
        windows, faults, tested = len(self.y) - self.horizon, self.counts["FAULT"], self.tested
        if faults:
            whom = ", ".join(f"{name} in {count} sample{'s' * (count > 1)}" for name, count in self.blamed.items())
            whom = f"; faulty: {whom}" if whom else "; no single sensor explains it"
            grouped = f", in {len(alarms)} alarm{'s' * (len(alarms) != 1)}" if alarms else ", too scattered for an alarm"
            if faults > 1 and faults == round(tested * windows):
                return "fault", f"Every one of the {faults} windows with data is FAULT: the model or its bounds do not fit this recording."
            return "fault", (f"Fault proved: {faults} of {windows} windows ({percent(faults / windows)}) contradict the model and the "
                             f"samples accepted before{grouped}; the first is at {label(int(np.argmax(self.status == Status.FAULT)))}"
                             f"{whom}.")  # fmt: skip
        if tested < min_coverage:
            return "too little evidence", (f"Too little evidence: only {percent(tested)} of {windows} windows have data, at least "
                                           f"{percent(min_coverage)} are asked for.")  # fmt: skip
        return "no fault", f"No fault found: every sample of {round(tested * windows)} windows fits what the samples before it allow."

    def stretches(self):
        """Return [(index of the output, first, last sample)] of the faulty stretches, in order of time."""
        faulty, out = np.asarray(self.found.faulty), []
        for i in range(faulty.shape[1]):
            edges = np.flatnonzero(np.diff(np.concatenate([[0], faulty[:, i].astype(int), [0]])))
            out += [(i, int(a), int(b) - 1) for a, b in edges.reshape(-1, 2)]
        return sorted(out, key=lambda s: s[1:])


def write_columns_of(path, res, recording):
    """Write one row a sample: time, status, and for each output whether it is faulty, its band and its corrected value; the states' bands.

    A bound that is not known, as in the first samples, is blank.
    """
    blank = lambda x: to_arrow(np.where(np.isfinite(x), x, np.nan))
    band = lambda name, x, i: {f"{name}.lo": blank(np.asarray(x.lo)[:, i]), f"{name}.hi": blank(np.asarray(x.hi)[:, i])}
    columns = {
        "time": to_arrow(recording.time) if recording.written is None else recording.written,
        "status": words([s.name for s in Status], res.status),
    }
    found = res.found
    for i, name in enumerate(res.model.outputs):
        lo, hi = (np.asarray(end)[:, i] for end in (found.corrected.lo, found.corrected.hi))
        known = np.isfinite(lo) & np.isfinite(hi)
        columns[f"faulty.{name}"] = to_arrow(np.asarray(found.faulty)[:, i])
        columns |= band(f"output.{name}", found.output, i)
        columns[f"corrected.{name}"] = blank(np.where(known, np.where(known, lo, 0) / 2 + np.where(known, hi, 0) / 2, np.nan))
        columns |= band(f"corrected.{name}", found.corrected, i)
    for i, name in enumerate(res.model.states):
        columns |= band(f"state.{name}", found.state, i)
    write_columns(path, columns)


def write_page(directory, res, recording, alarms, *, hints=(), seconds=None, min_coverage=0.5, progress=None):
    """Write report.html and a picture for each output. Args: as for `report.write_report`.

    Returns:
        The names of the files written.
    """
    directory, model, report = Path(directory), res.model, progress or (lambda share: None)
    shown = model.outputs[:PANELS]
    pictures = {}
    for i in range(len(shown)):
        pictures[f"output{i + 1}.png"] = to_png(plot_output(res, i, recording.axis))
        report((i + 1) / (len(shown) + 1))
    for name, data in pictures.items():
        (directory / name).write_bytes(data)
    verdict, sentence = res.summary(alarms, recording.label, min_coverage)
    counted = tiles(res.counts, res.horizon, MEANING, f"{percent(res.tested)} of all full windows have data.")
    caption = (
        "Blue: where the true value of {0} is, by the model, the samples accepted before and this one. Orange: samples that are proved to "
        "be faulty, and where; the dark line is what is to be used in their place, the middle of the band."
    )
    sections = opening(model, verdict, sentence, recording, len(res.y), [counted], hints)
    sections.append(section("Faulty sensors", _faulty(res, recording)))
    sections += [
        section(f"Output {name}", figure(png, f"band of {name}", caption.format(name)))
        for name, png in zip(shown, pictures.values(), strict=True)
    ]
    if len(shown) < model.p:
        sections.append(section("Other outputs", f"<p>{model.p - len(shown)} more outputs are in verdicts.csv.</p>"))
    sections += [
        section("Model and bounds", model_tables(model, {"tolerance": model.tolerance, "noise": model.noise})),
        section("How this was computed", about(res.method, res.horizon, np.asarray(res.found.state.lo).dtype, seconds or {})),
        f'<section class="guarantee"><h2>What is guaranteed</h2><p>{PROMISE}</p></section>',
    ]
    (directory / "report.html").write_text(frame(model.name, verdict, sections), encoding="utf-8")
    report(1.0)
    return ["report.html", *pictures]


def _faulty(res, recording):
    """Return the table of faulty stretches with what each sensor showed and should have shown in the middle of it."""
    found = res.stretches()
    if not found:
        return "<p>None.</p>" if not res.counts["FAULT"] else "<p>No single sensor explains the windows that are FAULT.</p>"
    rows = []
    for i, first, last in found[:ROWS]:
        k, unit = (first + last) // 2, res.model.unit(res.model.outputs[i])
        lo, hi = (float(np.asarray(end)[k, i]) for end in (res.found.corrected.lo, res.found.corrected.hi))
        lasts = duration(float(recording.time[last] - recording.time[first]) + res.model.dt)
        rows.append((res.model.outputs[i], recording.label(first), recording.label(last), lasts, last - first + 1,
                     f"{res.y[k, i]:.5g} {unit}".strip(), f"{lo:.5g} to {hi:.5g} {unit}".strip()))  # fmt: skip
    note = f"<p>The first {ROWS} of {len(found)} stretches.</p>" if len(found) > ROWS else ""
    text = "<p>Shown and true: in the middle of the stretch. All samples are in <code>verdicts.csv</code>.</p>"
    return note + table(("sensor", "from", "to", "lasts", "samples", "shown", "true value within"), rows, "stretches") + text
