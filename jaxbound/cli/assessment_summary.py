"""Counts of right and wrong alarms on the terminal, as JSON and as files."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from jaxbound.cli.terminal import Conclusion, Row, Table, json_text
from jaxbound.plots.assessment import plot_assessment
from jaxbound.plots.canvas import to_png
from jaxbound.recordings.columns import texts, to_arrow, write_columns
from jaxbound.studies.assessment.assessment import Assessment, Case, Marks
from jaxbound.studies.assessment.scores import Score, rule_text
from jaxbound.text.quantities import duration, percent

HEAD = ("detector", "factor", "alarm", "false alarms", "a day", "missed", "faults seen", "median delay")
Named = Mapping[str, Assessment]
"""{model file: Assessment}, the model of the command first."""


@dataclass(frozen=True)
class AssessmentConclusion(Conclusion):
    """The counts of right and wrong alarms. Fields: named: of each model. out: the folder of the files."""

    named: Named
    out: Path | None

    @property
    def headline(self) -> str:
        """The counts at the bounds as they are."""
        return _counts_sentence(_first(self.named).score)

    def table(self) -> Table:
        """Return the scores of all detectors."""
        return [HEAD, *_table(self.named)]

    def rows(self) -> Iterator[Row]:
        """Yield the outcome of each recording, and what factors are on."""
        first = _first(self.named)
        windows = f"{first.score.healthy} healthy, {first.score.faulty} faulty, tested {_test(first)}"
        yield "windows", windows
        for model, one in self.named.items():
            of_model = ""
            if len(self.named) > 1:
                of_model = f"{model}: "
            for case in one.cases:
                yield f"{of_model}{case.name}", _case_text(case)
            if one.named:
                yield f"{of_model}isolation", _isolation(one)
        yield "factors", f"on all bounds; {first.marks.note}"
        for peer in first.peers:
            yield peer.name, f"{peer.note}; factors are on its threshold"
        if first.peers:
            yield (
                "as few false",
                "at the least threshold with no more healthy windows in alarm than jaxbound's",
            )

    def plain(self) -> dict[str, Any]:
        """Return the counts of all models and detectors."""
        models = {}
        for model, one in self.named.items():
            cases = list(map(_plain_case, one.cases))
            models[model] = {**_plain_marks(one.marks), "recordings": cases, "isolation": one.isolation}
        peers = {peer.name: _plain_marks(peer) for peer in _first(self.named).peers}
        out = self.out and str(self.out)
        return {"models": models, "peers": peers, "hints": self.hints, "out": out}


def _first(named: Named) -> Assessment:
    """Return the Assessment of the command's model."""
    return next(iter(named.values()))


def write_assessment(work: Path, named: Named, plain: dict[str, Any]) -> None:
    """Write the files into a folder. plain: as JSON has it."""
    (work / "evaluation.json").write_text(json_text(plain), encoding="utf-8")
    curves = []
    for model, marks in _all_marks(named):
        for factor, false, caught in marks.curve.tolist():
            curves.append((model or marks.name, factor, false, caught))
    titles, *numbers = zip(*curves, strict=True)
    columns = {"detector": texts(list(titles))}
    for name, values in zip(("factor", "healthy_in_alarm", "faulty_in_alarm"), numbers, strict=True):
        columns[name] = to_arrow(list(values))
    write_columns(work / "curve.csv", columns)
    (work / "roc.png").write_bytes(to_png(plot_assessment(_together(named))))


def _together(named: Named) -> Assessment:
    """Return one Assessment with the curves of all models."""
    first = _first(named)
    if len(named) == 1:
        return first
    own, *beside = [replace(one.marks, name=name) for name, one in named.items()]
    return replace(first, marks=own, peers=(*beside, *first.peers))


def _all_marks(named: Named) -> list[tuple[str, Marks]]:
    """Return (model file, Marks) of all models, and ("", Marks) of other detectors."""
    marks = [(model, one.marks) for model, one in named.items()]
    first = _first(named)
    for peer in first.peers:
        marks.append(("", peer))
    return marks


def _counts_sentence(score: Score) -> str:
    """Return the counts at the bounds as they are, in a sentence."""
    parts = []
    if score.healthy:
        parts.append(
            f"{score.false} of {score.healthy} healthy windows in alarm ({percent(score.false_share)})"
        )
    if score.faulty:
        parts.append(f"{score.caught} of {score.faulty} faulty ones ({percent(score.caught_share)})")
    if not parts:
        return "No window counts: none is healthy throughout, none ends at a faulty sample."
    return f"{'; '.join(parts)}."


def _test(one: Assessment) -> str:
    """Return how windows were tested."""
    relations = one.relations
    if relations is None:
        return f"by {one.marks.name}"
    if getattr(relations, "parts", {}):
        return f"by a bank: {', '.join(relations.parts)}"
    if relations.remembers:
        return "sample by sample, each against those before it"
    return f"in windows of {relations.horizon + 1} samples"


def _table(named: Named) -> Iterator[tuple[str, ...]]:
    """Yield the rows of the table: all factors by the first rule, other rules at factor 1."""
    first = _first(named)
    for model, marks in _all_marks(named):
        for score in marks.scores:
            is_main = score.rule == first.score.rule
            is_model = bool(model)
            if score.factor == 1 or (is_main and is_model):
                title = marks.name
                if is_model and len(named) > 1:
                    title = model
                yield title, *_cells(score)
        if marks.equal is not None:
            yield f"{marks.name}, as few false", *_cells(marks.equal)


def _cells(score: Score) -> tuple[str, ...]:
    seen = "-"
    if score.episodes:
        seen = f"{len(score.delays)} of {score.episodes}"
    return (
        f"{score.factor:.4g}",
        rule_text(score),
        _percent_or_dash(score.false_share),
        _shown(score.alarms_a_day),
        _percent_or_dash(score.missed_share),
        seen,
        _delay_text(score.delay, score.dt),
    )


def _percent_or_dash(share: float) -> str:
    if math.isnan(share):
        return "-"
    return percent(share)


def _shown(number: float) -> str:
    if math.isnan(number):
        return "-"
    return f"{number:.3g}"


def _delay_text(samples: float, dt: float | None) -> str:
    if math.isnan(samples):
        return "-"
    if math.isinf(samples):
        return "never"
    if dt is None or samples == 0:
        return f"{samples:g} samples"
    return duration(samples * dt)


def _case_text(case: Case) -> str:
    """Return the outcome of one faulty recording in words."""
    score = case.score
    if not score.faulty:
        return "no window ends at a faulty sample"
    text = f"{percent(score.caught_share)} of {score.faulty} faulty windows in alarm"
    if not score.delays:
        return f"{text}; no fault of {score.episodes} is seen"
    seen = f"{len(score.delays)} of {score.episodes} faults seen"
    return f"{text}; {seen}, median delay {_delay_text(score.delay, score.dt)}"


def _isolation(one: Assessment) -> str:
    """Return how often the labelled signal is named."""
    count = len(one.named)
    first = sum(naming.first for naming in one.named)
    among = sum(naming.among for naming in one.named)
    return (
        f"{first} of {count} faults have their signal as the most plausible candidate of the first alarm, "
        f"{among} among its candidates"
    )


def _plain_marks(marks: Marks) -> dict[str, Any]:
    plain: dict[str, Any] = {"scores": list(map(_plain_score, marks.scores)), "note": marks.note}
    if marks.equal is not None:
        plain["as_few_false"] = _plain_score(marks.equal)
    return plain


def _plain_score(score: Score) -> dict[str, Any]:
    return {
        "factor": score.factor,
        "alarm": rule_text(score),
        "healthy_windows": score.healthy,
        "healthy_in_alarm": score.false,
        "false_alarms": score.alarms,
        "false_alarms_a_day": score.alarms_a_day,
        "faulty_windows": score.faulty,
        "faulty_in_alarm": score.caught,
        "missed_share": score.missed_share,
        "faults": score.episodes,
        "delays": score.delays,
        "median_delay": score.delay,
    }


def _plain_case(case: Case) -> dict[str, Any]:
    return {"recording": case.name, **_plain_score(case.score), "named": case.named}
