"""Many units in one command: a manifest in, a table with a row a unit out, the worst first.

Units of one shape share one compiled kernel, whatever their numbers. An observer follows units of one model
side by side, whose recordings have one length and the same gaps: one step of time for all of them. What is
wrong with a unit (no such file, a bad model) becomes the sentence of its row, and the others are tested.
While one unit is tested, the next ones are read.
"""

import math
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from jaxbound.consistency.engine import in_order, stretches_for
from jaxbound.diagnosis.again import again_hints
from jaxbound.diagnosis.detection import detect
from jaxbound.diagnosis.hints import outgrown
from jaxbound.estimation.set_observer import SetObserver
from jaxbound.models.modelfile import load_model
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.csvlines import is_open, split_lines
from jaxbound.recordings.csvtext import UNCLOSED, cells_of
from jaxbound.recordings.expressions import missing_column
from jaxbound.recordings.hints import refuse_short
from jaxbound.recordings.read import open_source
from jaxbound.recordings.recording import Recording
from jaxbound.relations.sentence import remembers
from jaxbound.runs.continuation import Continuation, alone, beside, followed
from jaxbound.runs.endings import ending_hints
from jaxbound.runs.loop import follow
from jaxbound.runs.relations import relations_by
from jaxbound.runs.summary import CODES, OUTSIDE, Summary, summarised
from jaxbound.text.objects import readable

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["Unit", "UnitResult", "detect_fleet", "fleet_verdict", "read_manifest", "worst_first"]

COLUMNS = ("unit", "model", "recording")
AHEAD = 4  # units that are read while another is tested
SIDE = 32  # units that an observer follows side by side, which are in memory at once
ORDER = ("fault", "not tested", OUTSIDE, "too little evidence", "no fault")


class Unit(NamedTuple):
    """One row of a manifest: the unit's name, its model file and its recording."""

    name: str
    model: Path
    recording: Path


@readable
class UnitResult(NamedTuple):
    """What was found about a unit.

    Fields: unit; summary: its Summary, of one that could not be tested with the verdict "not tested" and why
    in its sentence; report: the file of its own page, beside the page of the fleet, "" where it has none.
    """

    unit: Unit
    summary: Summary
    report: str = ""

    @property
    def verdict(self) -> str:
        """Of the unit: a verdict of a Summary."""
        return self.summary.verdict

    @property
    def margin(self) -> float:
        """Of the worst window, NaN if there is none."""
        return self.summary.margin

    @classmethod
    def untested(cls, unit: Unit, why: str) -> "UnitResult":
        """Return what is said of a unit that was not tested."""
        return cls(unit, Summary("not tested", why))


def read_manifest(path: str | PathLike) -> list[Unit]:
    r"""Read the units of a fleet from a CSV or TOML file.

    CSV: a header with the columns unit, model and recording, then a row a unit. TOML: a block [[units]] with
    these fields for each. Files are looked for beside the manifest.

    Args:
        path: of the manifest; .toml is read as TOML, anything else as CSV.

    Returns:
        A list of Unit. Their files need not exist.

    Raises:
        OSError: no such file. ValueError: unknown or missing columns, an empty cell, a name used twice, no
            unit.

    Example:
        >>> import tempfile, pathlib
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "fleet.csv"
        >>> _ = path.write_text("unit,model,recording\nP-101,pump.toml,p101.csv\n")
        >>> [unit.name for unit in read_manifest(path)]
        ['P-101']
    """
    path = Path(path)
    if path.is_dir():
        raise IsADirectoryError(
            f"{path} is a folder: a manifest is a CSV or TOML file with a unit, a model and a recording in "
            f"each row"
        )
    if not path.exists():
        raise FileNotFoundError(f"there is no manifest {path}")
    try:
        text = path.read_bytes().decode("utf-8-sig")
        rows = _toml_rows(text) if path.suffix.lower() == ".toml" else _csv_rows(text)
        return _units(rows, path.parent)
    except UnicodeDecodeError:
        raise ValueError(f"{path}: this is not a text file in UTF-8, so it is no manifest") from None
    except RecursionError as e:
        raise ValueError(f"{path}: this is no manifest: {e}") from None
    except ValueError as e:
        raise ValueError(f"{path}: {e}") from None


def _csv_rows(text):
    """Yield (where, {column: cell}) of each row."""
    lines = [(number, line) for number, line in enumerate(split_lines(text.encode()), 1) if line.strip()]
    header = lines[0][1].decode() if lines else ""
    delimiter = next((d for d in (";", "\t", ",") if d in header), ",")
    rows: list[tuple[int, list[str]]] = []
    for number, line in lines:
        if is_open(line, delimiter.encode()):
            raise ValueError(f"row {number} {UNCLOSED}")
        cells = cells_of(line.decode(), delimiter)
        if any(cell.strip() for cell in cells):
            rows.append((number, cells))
    if not rows:
        raise ValueError(f"the manifest is empty: it needs the columns {', '.join(COLUMNS)} and a row a unit")
    names = [name.strip() for name in rows[0][1]]
    _known("the manifest", names)
    for number, row in rows[1:]:
        if len(row) != len(names):
            raise ValueError(f"row {number} has {len(row)} cells, the header has {len(names)} columns")
        yield f"row {number}", dict(zip(names, map(str.strip, row), strict=True))


def _toml_rows(text):
    """Yield (where, {field: value}) of each [[units]] block."""
    import tomllib

    try:
        table = tomllib.loads(text)
    except tomllib.TOMLDecodeError as e:
        raise ValueError(f"this is not valid TOML: {e}") from None
    if unknown := [name for name in table if name != "units"]:
        raise ValueError(f"the manifest has the unknown field {unknown[0]!r}: it is made of [[units]] blocks")
    blocks = table.get("units", [])
    if not isinstance(blocks, list) or not all(isinstance(block, dict) for block in blocks):
        raise ValueError("units must be a list of blocks: write [[units]] above each of them")
    for i, block in enumerate(blocks):
        where = f"number {i + 1} of units"
        _known(where, list(block))
        for field, value in block.items():
            if not isinstance(value, str):
                raise ValueError(f"{field} of {where} must be text in quotes, not {value!r}")
        yield where, block


def _known(where, names):
    """Refuse a column that is unknown, missing or there twice."""
    for name in names:
        if name not in COLUMNS:
            raise ValueError(
                f"{where} has the unknown column {name!r}; known columns are {', '.join(COLUMNS)}"
            )
        if names.count(name) > 1:
            raise ValueError(f"{where} has {names.count(name)} columns {name!r}")
    for name in COLUMNS:
        if name not in names:
            raise ValueError(missing_column(name, names, where))


def _units(rows, folder):
    units: list[Unit] = []
    found: dict[str, str] = {}
    for where, row in rows:
        for column in COLUMNS:
            if not row[column]:
                raise ValueError(f"{where} has no {column}")
        if row["unit"] in found:
            raise ValueError(
                f"{where} names unit {row['unit']!r}, as {found[row['unit']]} does: every unit needs a name "
                f"of its own"
            )
        found[row["unit"]] = where
        units.append(Unit(row["unit"], folder / row["model"], folder / row["recording"]))
    if not units:
        raise ValueError("the manifest names no unit: it has a header but no row")
    return units


def detect_fleet(
    units: Sequence[Unit],
    method: str = "joint",
    horizon: int | None = None,
    alarm: tuple[int, int] = (1, 1),
    min_coverage: float = 0.5,
    progress: Callable | None = None,
    lags: Sequence[int] | None = None,
    page: Callable[..., str] | None = None,
    options: Mapping[str, Any] | None = None,
    client: "Client | None" = None,
    state: str | PathLike | None = None,
) -> Iterator[UnitResult]:
    """Test every unit; yield its UnitResult in the order of the units, each as soon as it is there.

    Args:
        units: a list of Unit, as `read_manifest` returns it. method: as for `detect`, or "observer". horizon,
            lags: as for `parity_relations`, or `observer`, which takes no lags. options: more for `observer`.
        alarm: (k, n), an alarm needs k FAULT among n windows.
        min_coverage: least share of decided windows; below it, a unit without FAULT has too little evidence.
        progress: called with the share of the units done.
        page: called with (unit, Result, Recording, alarms, Summary) of a tested unit; returns its `report`.
        client: of dask.distributed; its workers test the units, see their files by the same paths and call
            `page`, which can be pickled.
        state: folder in which it is kept how each unit goes on; None: nowhere. The next recording of a unit,
            in a run with the same folder, is then judged as if it followed in one file: windows look back
            into the one before, an observer carries on. Where it begins more than a step later, or earlier,
            it begins anew, and its hints say so. The same recording again is judged as it was.

    Yields:
        UnitResult. What is wrong with a unit makes it "not tested" and leaves the others alone.
    """
    if client is not None:
        same = {
            "method": method,
            "horizon": horizon,
            "alarm": alarm,
            "min_coverage": min_coverage,
            "lags": lags,
            "options": options,
            "state": state,
            "page": page,
        }
        yield from _spread_out(client, _Fleet(same), units, progress)
        return
    report = progress or (lambda share: None)
    how = _How(method, horizon, lags, options, state, alarm, min_coverage)
    results, done = _Collected(page), 0
    try:
        for _ in follow(_groups(units, how), partial(_tested, how=how), [results]):
            for found in results.take():
                yield found
                done += 1
                report(done / len(units))
    except KeyboardInterrupt:  # some of those that are followed side by side may be done
        yield from results.take()
        raise


class _How(NamedTuple):
    """How the units of a fleet are tested, see `detect_fleet`."""

    method: str
    horizon: int | None
    lags: Sequence[int] | None
    options: Mapping[str, Any] | None
    state: str | PathLike[str] | None
    alarm: tuple[int, int]
    min_coverage: float

    @property
    def ahead(self) -> int:
        """How many units are read while another is tested."""
        return SIDE if self.method == SetObserver.method else AHEAD


class _Collected:
    """A sink that makes the pages of units, and keeps what was found until somebody takes it."""

    def __init__(self, page: Callable[..., str] | None) -> None:
        self.page = page
        self.results: list[UnitResult] = []

    def add(self, result: UnitResult, about: tuple[Any, ...] | None) -> None:
        """Make the page of a unit that was tested."""
        if self.page is not None and about is not None:
            result = result._replace(report=self.page(result.unit, *about, result.summary))
        self.results.append(result)

    def take(self) -> list[UnitResult]:
        """Return the results since the last call."""
        results, self.results = self.results, []
        return results

    def memory(self) -> None:
        """Return None: what goes on of a unit is in its Continuation."""

    def flush(self) -> None:
        """Do nothing: results wait for whoever takes them."""


Group = list[tuple[Unit, "Future[_Given]"]]


def _groups(units: Sequence[Unit], how: _How) -> Iterator[Group]:
    """Yield the units that are tested together, each with what is read of it beside.

    An observer follows units of one model side by side; others are tested one by one.
    """
    reader = _Reader(units, how)
    with ThreadPoolExecutor(1) as beside:
        waiting: deque[tuple[Unit, Future[_Given]]] = deque()
        left = deque(units)
        try:
            while left or waiting:
                while left and len(waiting) < how.ahead:
                    unit = left.popleft()
                    waiting.append((unit, beside.submit(reader.read, unit)))
                group = [waiting.popleft()]
                while how.ahead == SIDE and waiting and waiting[0][0].model == group[0][0].model:
                    group.append(waiting.popleft())
                yield group
        finally:
            for _, job in waiting:
                job.cancel()


class _Reader:
    """Reads units; what units of one model have in common is made once."""

    def __init__(self, units: Sequence[Unit], how: _How) -> None:
        self.how = how
        self.shared = Counter(unit.model for unit in units)
        self.models: dict[Path, tuple[Any, Any]] = {}

    def read(self, unit: Unit) -> "_Given":
        """Return one unit, read."""
        how = self.how
        model, relations = self.models.get(unit.model) or (load_model(unit.model), None)
        source = open_source(unit.recording, model)
        content = None if how.state is None else source.content
        recording = source.read()
        if how.state is None:
            longest = self._longest(model)
            refuse_short(unit.recording, recording.samples, longest if how.ahead == AHEAD else None)
        if relations is None:
            relations = relations_by(how.method, model, how.horizon, lags=how.lags, options=how.options)
        if self.shared[unit.model] > 1:
            self.models[unit.model] = model, relations
        if how.state is None:
            return _Given(model, relations, recording)
        kept = Continuation(how.state, unit.name, relations, how.method, content)
        recording, carry, known = kept.joined(recording)
        return _Given(model, relations, recording, kept, carry, known)

    def _longest(self, model: LinearSystem) -> int | None:
        """Return the horizon of the windows of a model, before its relations are made."""
        if self.how.lags:
            return max(self.how.lags)
        return model.horizon if self.how.horizon is None else self.how.horizon


class _Given(NamedTuple):
    """One unit, read. Fields: model, relations, recording; kept: its Continuation, or None; carry, known: as
    of `Continuation.joined`.
    """

    model: Any
    relations: Any
    recording: Recording
    kept: Continuation | None = None
    carry: Any = None
    known: int = 0


@dataclass(frozen=True, eq=False)
class _Fleet:
    """The test of units as a `Job`: a task is a list of units. Fields: options: as `detect_fleet` takes
    them.
    """

    options: dict

    def run(self, units):
        """Return the UnitResult of each."""
        return list(detect_fleet(units, **self.options))


def _spread_out(client, fleet, units, progress):
    done, tasks = 0, [[units[i] for i in numbers] for numbers in stretches_for(client, [range(len(units))])]
    for results in in_order(client, fleet, tasks):
        yield from results
        done += len(results)
        if progress is not None:
            progress(done / len(units))


def _tested(group, how):
    """Yield (UnitResult, (Result, Recording, alarms) or None) of units of one model."""
    read = [(unit, _tried(unit, job.result)) for unit, job in group]
    given = [x for _, x in read if not isinstance(x, UnitResult)]
    alike = _side_by_side(given) if len(given) > 1 else {}
    for unit, x in read:
        if not isinstance(x, UnitResult):
            together = alike.get(id(x.recording))
            x = _tried(unit, partial(_judged, unit, x, how.method, how.alarm, how.min_coverage, together))
        yield (x, None) if isinstance(x, UnitResult) else x


def _tried(unit, work):
    """Return what work() returns, or the UnitResult that says why it could not be done."""
    try:
        return work()
    except (OSError, ValueError, NotImplementedError, TypeError) as e:
        if isinstance(e, OSError) and e.filename and e.strerror:
            return UnitResult.untested(unit, f"{e.filename}: {e.strerror.lower()}")
        return UnitResult.untested(unit, str(e))
    except Exception as e:  # one unit's trouble must not cost the others their answer
        return UnitResult.untested(unit, f"internal error, please report it: {type(e).__name__}: {e}")


def _judged(unit, given, method, alarm, min_coverage, res):
    """Return (UnitResult, (Result, Recording, alarms)); given: a _Given; res: (Result, carry) where it is
    there.
    """
    model, relations, recording, kept, carry, known = given
    refuse_short(unit.recording, recording.samples, relations.horizon)
    if res is None and kept is not None and remembers(relations):
        res = followed(relations, recording, carry, known)
    res, between = (detect(relations, recording, method=method), None) if res is None else res
    if kept is not None:
        kept.save(recording, between)
    alarms = res.alarms(*alarm)
    res, reaches = replace(res, recorded=recording.hints), outgrown(model, relations)
    hints = dict.fromkeys((*res.hints, *again_hints(res), *reaches, *ending_hints(res, alarms)))
    found = summarised(res, alarms, recording.label, min_coverage, hints, outgrown=bool(reaches))
    return UnitResult(unit, found), (res, recording, alarms)


def _side_by_side(given):
    """Return {id of a recording: (Result, carry)} of those that an observer can follow side by side; given:
    of _Given.
    """
    groups: dict[Any, list] = {}
    for one in given:
        recording, before = one.recording, 0 if one.carry is None else int(one.carry.samples)
        kind = (
            recording.samples,
            tuple(recording.starts.tolist()),
            str(recording.y.dtype),
            str(recording.u.dtype),
            one.known,
            before,
        )
        groups.setdefault(kind, []).append(one)
    found = {}
    for group in groups.values():
        _, relations, one, kept, carry, known = group[0]
        if len(group) == 1 or one.samples <= relations.horizon:
            continue
        stack = lambda name, group=group: np.stack([np.asarray(getattr(x.recording, name)) for x in group])
        with suppress(ValueError):  # of one of them: each is told alone what is wrong
            many, between = Recording(stack("u"), stack("y"), one.starts, one.inputs, one.outputs), None
            if kept is None:
                together = detect(relations, many, method=relations.method)
            else:
                together, between = followed(
                    relations, many, carry and beside(relations, [x.carry for x in group]), known
                )
            for i, x in enumerate(group):
                parts = {name: getattr(together, name)[i] for name in ("status", "margin", "u", "y")}
                of_it = relations if x.carry is None else relations.continued(x.carry)
                one_of_them = replace(
                    together,
                    **parts,
                    relations=of_it,
                    index=x.recording.index,
                    aside=x.recording.aside(relations.horizon),
                )
                found[id(x.recording)] = one_of_them, between and alone(relations, between, i)
    return found


def worst_first(results: Iterable[UnitResult]) -> list[UnitResult]:
    """Return the results sorted: faults (the deepest first), units not tested, too little evidence, no fault
    (the tightest first).
    """
    return sorted(
        results, key=lambda r: (ORDER.index(r.verdict), math.inf if math.isnan(r.margin) else r.margin)
    )


def fleet_verdict(results: Sequence[UnitResult]) -> tuple[str, int, str]:
    """Return (verdict, exit code, sentence) of a whole fleet.

    A fault counts before a unit that could not be tested, and that before too little evidence.
    """
    count = Counter(r.verdict for r in results)
    verdict = next(v for v in ORDER if count[v])
    code = CODES[verdict]
    several = lambda n: f"{n} unit{'s' * (n != 1)}"
    parts = [f"{several(len(results))} listed"]
    told = {
        "fault": "with a proved fault",
        OUTSIDE: OUTSIDE,
        "no fault": "with no fault found",
        "too little evidence": "with too little evidence",
        "not tested": "could not be tested",
    }
    parts += [f"{count[v]} {words}" for v, words in told.items() if count[v]]
    deepest = min((r for r in results if r.verdict == "fault"), key=lambda r: r.margin, default=None)
    worst_unit = f"; the worst is {deepest.unit.name}" if deepest else ""
    return verdict, code, f"{parts[0]}: {', '.join(parts[1:])}{worst_unit}."
