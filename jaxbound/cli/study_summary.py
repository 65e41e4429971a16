"""The files of a Monte-Carlo study, and its conclusion on the terminal or as JSON."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np

from jaxbound.cli.terminal import Conclusion, Row, Table
from jaxbound.recordings.columns import Arrow, texts, to_arrow, write_columns
from jaxbound.reports.study import COLUMNS, sentence, study_head, study_page, study_rows
from jaxbound.studies.montecarlo.study_result import StudyResult, delay_table, study_table
from jaxbound.text.characters import cell

FILES = ("summary.csv", "summary.parquet", "delays.parquet", "report.html")


def write_study(work: Path, result: StudyResult, seed: int, seconds: float) -> None:
    """Write the tables and the page of a study into a folder. seconds: its duration."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    counts = study_table(result)
    write_columns(work / "summary.csv", _columns(counts, cell))
    summary, delays = _columns(counts), _columns(delay_table(result))
    delays["delay"] = delays["delay"].cast(pa.int64())
    for file, columns in (("summary.parquet", summary), ("delays.parquet", delays)):
        pq.write_table(pa.Table.from_arrays(list(columns.values()), list(columns)), work / file)
    (work / "report.html").write_text(study_page(result, seed, seconds), encoding="utf-8")


def _columns(table: dict[str, np.ndarray], written: Callable[[Any], str] = str) -> dict[str, Arrow]:
    """Return the columns of a table as pyarrow arrays."""
    return {name: _column(values, written) for name, values in table.items()}


def _column(values: np.ndarray, written: Callable[[Any], str]) -> Arrow:
    """Return numbers, or texts as they are written, as a pyarrow array."""
    if values.dtype != object:
        return to_arrow(values)
    names = list(dict.fromkeys(values))
    return texts([written(name) for name in names]).take(to_arrow(np.array([names.index(v) for v in values])))


@dataclass(frozen=True)
class StudyConclusion(Conclusion):
    """The conclusion of a study. Fields: result; page: its report; seconds: its duration."""

    result: StudyResult
    page: Path
    seconds: float

    @property
    def headline(self) -> str:
        """The name of the model."""
        return self.result.model.name

    def table(self) -> Table:
        """Return a row for each fault and size."""
        return [study_head(self.result), *study_rows(self.result)]

    def rows(self) -> Sequence[Row]:
        """Return the false alarms, and the speed."""
        result = self.result
        speed = result.scenarios * result.samples / max(self.seconds, 1e-9) / 1e6
        where = f"on {jax.local_device_count()} device"
        return [
            ("study", sentence(result)),
            ("columns", COLUMNS),
            ("seconds", f"{self.seconds:.1f}, {speed:.3g} million samples a second {where}"),
            ("report", str(self.page)),
        ]

    def plain(self) -> dict[str, Any]:
        """Return the counts."""
        result = self.result
        false_alarms, clean_windows = result.false_alarms
        columns = {name: x.tolist() for name, x in study_table(result).items()}
        cells = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
        return {
            "scenarios": result.scenarios,
            "samples": result.samples,
            "at": result.at,
            "horizon": result.horizon,
            "false_alarms": false_alarms,
            "clean_windows": clean_windows,
            "cells": cells,
            "report": str(self.page),
        }
