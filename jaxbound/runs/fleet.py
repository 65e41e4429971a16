"""Many units in one command: a manifest in, a table with a row a unit out, the worst first.

Units of one shape share one compiled kernel, whatever their numbers. An observer follows units of one model
side by side, whose recordings have one length and the same gaps: one step of time for all of them. What is
wrong with a unit (no such file, a bad model) becomes the sentence of its row, and the others are tested.
While one unit is tested, the next ones are read.
"""

import math
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar, cast

import numpy as np

from jaxbound.consistency.interface import Relations
from jaxbound.diagnosis.alarmrule import Stated, stated_rule
from jaxbound.diagnosis.alarms import Alarm
from jaxbound.diagnosis.result import Result
from jaxbound.estimation.blocks import recordings_of
from jaxbound.estimation.set_observer import SetObserver
from jaxbound.models.modelfile import load_model
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.csvlines import is_open, split_lines
from jaxbound.recordings.csvtext import UNCLOSED, cells_of, delimiter_of
from jaxbound.recordings.expressions import missing_column
from jaxbound.recordings.hints import refuse_short
from jaxbound.recordings.read import open_source
from jaxbound.recordings.recording import Recording
from jaxbound.recordings.source import Progress
from jaxbound.runs.ask import Ask
from jaxbound.runs.continuation import Continuation, Joined, followed, joined_carries
from jaxbound.runs.endings import concluded
from jaxbound.runs.summary import CODES, OUTSIDE, Summary
from jaxbound.sets.floats.kernel import sparing
from jaxbound.sets.floats.threads import inherited
from jaxbound.text.objects import readable
from jaxbound.text.progress import reporter
from jaxbound.workers.engine import in_order, stretches_for

if TYPE_CHECKING:
    from distributed import Client

COLUMNS = ("unit", "model", "recording")
ACKNOWLEDGED = "acknowledged"
"""A column that may be there: of alarms that latch."""
AHEAD = 4  # units that are read while another is tested
SIDE = 32  # units that an observer follows side by side, which are in memory at once
ORDER = ("fault", "not tested", OUTSIDE, "too little evidence", "no fault")
IN_WORDS = {
    "fault": "with a proved fault",
    OUTSIDE: OUTSIDE,
    "no fault": "with no fault found",
    "too little evidence": "with too little evidence",
    "not tested": "could not be tested",
}
Row = tuple[str, dict[str, str]]
"""A row of a manifest: where it stands, {column: cell}."""
Page = Callable[..., str]
"""Called with (unit, Result, Recording, alarms, Summary) of a tested unit; returns its `report`."""
Done = TypeVar("Done")


class Unit(NamedTuple):
    """One row of a manifest.

    Fields: name; model, recording: its files; acknowledged: the file in which an operator acknowledges its
    alarms, None: that of all units.
    """

    name: str
    model: Path
    recording: Path
    acknowledged: Path | None = None


@readable
class UnitResult(NamedTuple):
    """The outcome of the test of a unit.

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
        """Return the result of a unit that was not tested, with the reason."""
        return cls(unit, Summary("not tested", why))


def read_manifest(path: str | PathLike[str]) -> list[Unit]:
    r"""Read the units of a fleet from a CSV or TOML file.

    CSV: a header with the columns unit, model and recording, then a row a unit. TOML: a block [[units]] with
    these fields for each. A column acknowledged, which may be left out or empty, names the file of a unit's
    acknowledgements, see `AlarmRule`. Files are looked for beside the manifest.

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
        rows = _csv_rows(text)
        if path.suffix.lower() == ".toml":
            rows = _toml_rows(text)
        return _units(rows, path.parent)
    except UnicodeDecodeError:
        raise ValueError(f"{path}: this is not a text file in UTF-8, so it is no manifest") from None
    except RecursionError as e:
        raise ValueError(f"{path}: this is no manifest: {e}") from None
    except ValueError as e:
        raise ValueError(f"{path}: {e}") from None


def _csv_rows(text: str) -> Iterator[Row]:
    """Yield the rows of a manifest in CSV."""
    lines = [(number, line) for number, line in enumerate(split_lines(text.encode()), 1) if line.strip()]
    rows: list[tuple[int, list[str]]] = []
    delimiter = ","
    if lines:
        delimiter = delimiter_of(lines[0][1].decode())
    for number, line in lines:
        if is_open(line, delimiter.encode()):
            raise ValueError(f"row {number} {UNCLOSED}")
        cells = cells_of(line.decode(), delimiter)
        if any(cell.strip() for cell in cells):
            rows.append((number, cells))
    if not rows:
        raise ValueError(f"the manifest is empty: it needs the columns {', '.join(COLUMNS)} and a row a unit")
    names = [name.strip() for name in rows[0][1]]
    _check_columns("the manifest", names)
    for number, row in rows[1:]:
        if len(row) != len(names):
            raise ValueError(f"row {number} has {len(row)} cells, the header has {len(names)} columns")
        yield f"row {number}", dict(zip(names, map(str.strip, row), strict=True))


def _toml_rows(text: str) -> Iterator[Row]:
    """Yield the [[units]] blocks of a manifest in TOML."""
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
        _check_columns(where, list(block))
        for field, value in block.items():
            if not isinstance(value, str):
                raise ValueError(f"{field} of {where} must be text in quotes, not {value!r}")
        yield where, block


def _check_columns(where: str, names: Sequence[str]) -> None:
    """Refuse a column that is unknown, missing or there twice."""
    for name in names:
        if name not in (*COLUMNS, ACKNOWLEDGED):
            known = ", ".join((*COLUMNS, ACKNOWLEDGED))
            raise ValueError(f"{where} has the unknown column {name!r}; known columns are {known}")
        if names.count(name) > 1:
            raise ValueError(f"{where} has {names.count(name)} columns {name!r}")
    for name in COLUMNS:
        if name not in names:
            raise ValueError(missing_column(name, names, where))


def _units(rows: Iterable[Row], folder: Path) -> list[Unit]:
    """Return the units in the rows of a manifest, whose files are looked for in a folder."""
    units: list[Unit] = []
    named: dict[str, str] = {}
    for where, row in rows:
        for column in COLUMNS:
            if not row[column]:
                raise ValueError(f"{where} has no {column}")
        name = row["unit"]
        if name in named:
            raise ValueError(
                f"{where} names unit {name!r}, as {named[name]} does: every unit needs a name of its own"
            )
        named[name] = where
        seen = None
        if row.get(ACKNOWLEDGED):
            seen = folder / row[ACKNOWLEDGED]
        units.append(Unit(name, folder / row["model"], folder / row["recording"], seen))
    if not units:
        raise ValueError("the manifest names no unit: it has a header but no row")
    return units


@dataclass(frozen=True)
class FleetTest:
    """The test of the units of a fleet.

    Fields: ask: of each of them; its margins are those of the Results that pages are made from, those of
    units are exact. alarm: the rule of alarms, or fields that win over those of each model. min_coverage:
    least share of decided windows; below it, a unit without FAULT has too little evidence.
    state: folder in which continuations of units are kept; None: nowhere. The next recording of a unit, in a
    run with the same folder, is then judged as if it followed in one file: windows look back into the one
    before, an observer carries on, each test of a monitor does, and an interval of means that began in it is
    ended. Where it begins more than a step later, or earlier, or an expression of the model counts from the
    start of a recording, it begins anew, and its hints say so. The same recording again is judged as it was.
    """

    ask: Ask = Ask()
    alarm: Stated = None
    min_coverage: float = 0.5
    state: str | PathLike[str] | None = None

    @property
    def ahead(self) -> int:
        """How many units are read while another is tested."""
        if self.ask.method == SetObserver.method:
            return SIDE
        return AHEAD


def detect_fleet(
    units: Sequence[Unit],
    how: FleetTest = FleetTest(),
    page: Page | None = None,
    progress: Progress | None = None,
    client: "Client | None" = None,
) -> Iterator[UnitResult]:
    """Test every unit; yield its UnitResult in the order of the units, each as soon as it is there.

    Args:
        units: a list of Unit, as `read_manifest` returns it. how: they are tested.
        page: called with (unit, Result, Recording, alarms, Summary) of a tested unit; returns its `report`.
        progress: called with the share of the units done.
        client: of dask.distributed; its workers test the units, see their files by the same paths and call
            `page`, which can be pickled.

    Yields:
        UnitResult. Trouble with a unit makes it "not tested" and leaves the others alone.
    """
    if client is not None:
        yield from _test_by_workers(client, _FleetJob(how, page), units, progress)
    else:
        yield from _test_here(units, how, page, reporter(progress, "fleet"))


def _test_here(
    units: Sequence[Unit], how: FleetTest, page: Page | None, report: Progress = lambda share: None
) -> Iterator[UnitResult]:
    """Test units in this process."""
    done = 0
    for group in _read_groups(units, how):
        for result, about in _tested(group, how):
            if page is not None and about is not None:
                res, recording, alarms = about
                result = result._replace(report=page(result.unit, res, recording, alarms, result.summary))
            yield result
            done += 1
            report(done / len(units))


Detected = tuple[Result, Recording, list[Alarm]]
"""The outcome of a unit that was tested, as its page shows it."""
Judgement = tuple[UnitResult, Detected | None]


class _UnitData(NamedTuple):
    """One unit, read.

    Fields: model, relations; joined: its recording, behind the one before where it goes on; kept: its
    Continuation, or None.
    """

    model: LinearSystem
    relations: Relations
    joined: Joined
    kept: Continuation | None = None

    @property
    def recording(self) -> Recording:
        """The samples of the unit."""
        return self.joined.recording


Group = list[tuple[Unit, Future[_UnitData]]]
"""Units that are tested together, and the reading of each."""


def _read_groups(units: Sequence[Unit], how: FleetTest) -> Iterator[Group]:
    """Yield the units that are tested together, while the next ones are read.

    An observer follows units of one model side by side; others are tested one by one.
    """
    read = inherited(_Reader(units, how).read)
    with ThreadPoolExecutor(1) as thread:
        waiting: deque[tuple[Unit, Future[_UnitData]]] = deque()
        left = deque(units)
        try:
            while left or waiting:
                while left and len(waiting) < how.ahead:
                    unit = left.popleft()
                    waiting.append((unit, thread.submit(read, unit)))
                group = [waiting.popleft()]
                while how.ahead == SIDE and waiting and waiting[0][0].model == group[0][0].model:
                    group.append(waiting.popleft())
                yield group
        finally:
            for _, job in waiting:
                job.cancel()


class _Reader:
    """A reader of units, which makes once what units of one model have in common."""

    def __init__(self, units: Sequence[Unit], how: FleetTest) -> None:
        self.how = how
        self.shared = Counter(unit.model for unit in units)
        self.models: dict[Path, tuple[LinearSystem, Relations]] = {}

    def read(self, unit: Unit) -> _UnitData:
        """Return one unit, read."""
        how, relations, ask = self.how, None, self.how.ask
        if unit.model in self.models:
            model, relations = self.models[unit.model]
        else:
            model = ask.chosen(load_model(unit.model))
        source = open_source(unit.recording, ask.recorded(model))
        if how.state is None:
            recording = source.read()
        if relations is None:
            relations = ask.relations(model)
        if self.shared[unit.model] > 1:
            self.models[unit.model] = model, relations
        if how.state is None:
            return _UnitData(model, relations, Joined(recording))
        # the content before it is read, so that a later change is seen
        kept = Continuation(how.state, unit.name, relations, ask.of(model).method, source.content)
        return _UnitData(model, relations, kept.joined(kept.read(source)), kept)


@dataclass(frozen=True, eq=False)
class _FleetJob:
    """The test of units as a `Job`: a task is a list of units."""

    how: FleetTest
    page: Page | None

    def run(self, units: Sequence[Unit]) -> list[UnitResult]:
        """Return the UnitResult of each."""
        return list(_test_here(units, self.how, self.page))


def _test_by_workers(
    client: "Client", job: _FleetJob, units: Sequence[Unit], progress: Progress | None
) -> Iterator[UnitResult]:
    """Let workers test the units; yield the results in order."""
    tasks = [[units[i] for i in numbers] for numbers in stretches_for(client, [range(len(units))])]
    done = 0
    for results in in_order(client, job, tasks):
        yield from results
        done += len(results)
        if progress is not None:
            progress(done / len(units))


def _tested(group: Group, how: FleetTest) -> Iterator[Judgement]:
    """Yield the results of units of one model."""
    read = [(unit, _tried(unit, job.result)) for unit, job in group]
    together: _Together = {}
    if len(group) > 1:
        together = _units_side_by_side([data for _, data in read if isinstance(data, _UnitData)], how.ask)
    for unit, data in read:
        if isinstance(data, UnitResult):
            yield data, None
            continue
        judgement = _tried(unit, partial(_judge_unit, unit, data, how, together.get(id(data.recording))))
        if isinstance(judgement, UnitResult):
            yield judgement, None
        else:
            yield judgement


def _tried(unit: Unit, work: Callable[[], Done]) -> Done | UnitResult:
    """Return the value of work(), or the UnitResult that says why it could not be done."""
    try:
        return work()
    except (OSError, ValueError, NotImplementedError, TypeError) as e:
        if isinstance(e, OSError) and e.filename and e.strerror:
            return UnitResult.untested(unit, f"{e.filename}: {e.strerror.lower()}")
        return UnitResult.untested(unit, str(e))
    except Exception as e:  # one unit's trouble must not cost the others their answer
        return UnitResult.untested(unit, f"internal error, please report it: {type(e).__name__}: {e}")


@sparing(False)  # the same bytes in whatever order units are judged
def _judge_unit(
    unit: Unit, data: _UnitData, how: FleetTest, known: "_Followed | None"
) -> tuple[UnitResult, Detected]:
    """Return the result of a unit. known: of one that was followed beside others."""
    model, relations, recording = data.model, data.relations, data.recording
    if data.kept is not None and recording.samples <= relations.horizon:
        data.kept.keep(data.joined)
    refuse_short(unit.recording, recording.samples, relations.horizon)
    if known is not None:
        res, carry = known
    elif data.kept is not None and relations.observer is not None:
        res, carry = followed(relations.observer, data.joined, how.ask)
    else:
        # each by its own number of windows: the tightest one of a unit is searched for among nearly all
        res, carry = replace(how.ask.detect(relations, recording), known=data.joined.known), None
    if data.kept is not None:
        data.kept.save(recording, carry)
    rule = stated_rule(how.alarm, model, unit.model)
    if unit.acknowledged is not None:
        rule = replace(rule, acknowledged=unit.acknowledged)
    alarms = res.alarms(rule=rule)
    res = replace(res, recorded=recording.hints)
    summary = concluded(res, alarms, model, recording.label, how.min_coverage)
    return UnitResult(unit, summary), (res, recording, alarms)


_Followed = tuple[Result, Any]
"""(Result of a unit, what its observer carried before the last samples that are kept; None: nothing is)."""
_Together = dict[int, _Followed]
"""{id of a recording: its outcome}."""


@sparing(False)
def _units_side_by_side(read: Sequence[_UnitData], ask: Ask) -> _Together:
    """Return the outcomes of units that an observer can follow side by side."""
    alike: dict[tuple[object, ...], list[_UnitData]] = {}
    for data in read:
        alike.setdefault(_shape_of(data), []).append(data)
    outcomes: _Together = {}
    for group in alike.values():
        if len(group) > 1 and group[0].recording.samples > group[0].relations.horizon:
            with suppress(ValueError):  # of one of them: each is told alone what is wrong
                outcomes |= _followed_together(group, ask)
    return outcomes


def _shape_of(data: _UnitData) -> tuple[object, ...]:
    """Return the shape that units have in common where one observer follows them in one step of time."""
    recording, carry = data.recording, data.joined.carry
    before = 0
    if carry is not None:
        before = int(carry.samples)
    types = str(recording.y.dtype), str(recording.u.dtype)
    # gaps too: at a gap the state of all begins anew
    return recording.samples, tuple(recording.starts.tolist()), *types, data.joined.known, before


def _followed_together(group: Sequence[_UnitData], ask: Ask) -> _Together:
    """Follow units of one model, and of one shape, by one observer."""
    first, observer = group[0], cast(SetObserver[Any], group[0].relations)  # others are tested one by one
    u = np.stack([np.asarray(data.recording.u) for data in group])
    y = np.stack([np.asarray(data.recording.y) for data in group])
    one = first.recording
    many = Recording(u, y, one.starts, one.inputs, one.outputs)
    carry = None
    if first.joined.carry is not None:
        carry = joined_carries([data.joined.carry for data in group])
    together, between = followed(observer, Joined(many, carry, first.joined.known), ask)
    outcomes: _Together = {}
    for i, data in enumerate(group):
        own = recordings_of(between, len(group), np.array([i]))
        outcomes[id(data.recording)] = _one_of(together, i, data), own
    return outcomes


def _one_of(together: Result, i: int, data: _UnitData) -> Result:
    """Return the Result of recording i of those side by side."""
    observer = together.relations
    if data.joined.carry is not None:
        observer = observer.continued(data.joined.carry)
    return replace(
        together,
        status=together.status[i],
        margin=together.margin[i],
        u=together.u[i],
        y=together.y[i],
        relations=observer,
        index=data.recording.index,
        aside=data.recording.aside(observer.horizon),
    )


def worst_first(results: Iterable[UnitResult]) -> list[UnitResult]:
    """Return the results sorted: faults (the deepest first), units not tested, too little evidence, no fault
    (the tightest first).
    """
    return sorted(results, key=_rank)


def _rank(result: UnitResult) -> tuple[int, float]:
    margin = result.margin
    if math.isnan(margin):
        margin = math.inf
    return ORDER.index(result.verdict), margin


def fleet_verdict(results: Sequence[UnitResult]) -> tuple[str, int, str]:
    """Return (verdict, exit code, sentence) of a whole fleet.

    A fault counts before a unit that could not be tested, and that before too little evidence.
    """
    count = Counter(r.verdict for r in results)
    verdict = next(v for v in ORDER if count[v])
    several = len(results) != 1
    numbers = [f"{count[v]} {words}" for v, words in IN_WORDS.items() if count[v]]
    faulty = [r for r in results if r.verdict == "fault"]
    worst = ""
    if faulty:
        worst = f"; the worst is {min(faulty, key=lambda r: r.margin).unit.name}"
    return verdict, CODES[verdict], f"{len(results)} unit{'s' * several} listed: {', '.join(numbers)}{worst}."
