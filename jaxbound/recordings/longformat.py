"""Files with a row a tag, (time, tag, value), as ones with a column a tag.

Cells stay the texts that they are, so that all that is known of cells of other files holds for these.
"""

from collections.abc import Iterable
from functools import partial
from io import BytesIO

import numpy as np

from jaxbound.recordings.columns import Arrow, header_line, texts
from jaxbound.recordings.csvtext import Head, Layout, is_number
from jaxbound.recordings.linetext import Opened, reader_of
from jaxbound.recordings.recordingformat import RECORDING, RecordingFormat
from jaxbound.recordings.selection import columns_of_signals
from jaxbound.recordings.signals import SignalModel, Signals
from jaxbound.recordings.timestamps import parse_stamps

ALIKE = 0.75
"""Share of all times that each tag needs, where nothing is said of how long a value stands."""


def pivoted(
    opened: Opened, head: Head, model: SignalModel, how: RecordingFormat
) -> tuple[bytes, tuple[str, ...]]:
    """Return (the lines of a file with a column for each tag that the model names, or for all where it names
    none; hints for its owner).

    Args:
        opened: opens the lines. head: the first of them. how: what is stated of them, with `long`.

    Raises:
        ValueError: a column that is not there; tags with times of their own, where nothing says how long a
            value stands; two values of one tag at one time.
    """
    tag, value = how.long
    columns = {"where": f"`{tag}` != ''"}
    if "time" in model.columns:
        columns["time"] = model.columns["time"]
    reader = reader_of(head, Signals((), (value,), columns), how.wide)
    cells = reader.written(opened)
    if cells is None or how.skip or how.comment:
        sifted = reader.sifted(opened)
        if sifted is not None:
            opened = partial(BytesIO, sifted)
            cells = reader.written(opened)
    if cells is None:
        raise ValueError(f"the file has a row a tag: {reader.trouble_in(opened)}")
    if reader.plan.time is None:
        raise ValueError("a file with a row a tag needs a column of times")
    times = cells[reader.plan.time]
    if reader.is_text:
        times = reader.joined_time(cells)
    tags, codes = _coded(cells[tag])
    wanted = [name for name in tags if name in columns_of_signals(model)] or tags
    numbers = np.full(len(tags) + 1, -1)
    numbers[[tags.index(name) for name in wanted]] = np.arange(len(wanted))
    own = numbers[codes]
    stamps, rows = _coded(times)
    used = np.unique(rows[(own >= 0) & (rows >= 0)])
    order = used[np.argsort(_instants([stamps[k] for k in used], reader.layout, model.dt), kind="stable")]
    place = np.full(len(stamps) + 1, -1)
    place[order] = np.arange(len(order))
    counting = np.flatnonzero((own >= 0) & (place[rows] >= 0))
    table = np.full((len(order), len(wanted)), -1)
    again = _again(place[rows[counting]], own[counting], counting, cells[value], wanted, how)
    left = {
        "hold no time": np.flatnonzero(rows < 0),
        "hold no tag": np.flatnonzero((codes < 0) & (rows >= 0)),
        "have the tag and the time of another row": again,
    }
    for reason, places in left.items():
        if len(places):
            reader.left[reason] = sorted(map(reader.layout.number, places.tolist()))
    if how.equal == "first":  # the last that is put down stays
        counting = counting[::-1]
    table[place[rows[counting]], own[counting]] = counting
    _refuse_unequal(table, wanted, how)
    names = [reader.plan.time, *wanted]
    body = [texts([stamps[k] for k in order]), *(_taken(cells[value], column) for column in table.T)]
    lines = _as_lines(names, body, reader.layout.delimiter)
    return lines, (*reader.layout.hints, *reader.left_hints)


def _coded(cells: Arrow) -> tuple[list[str], np.ndarray]:
    """Return (the different texts of a column, trimmed, the number of each cell's; -1 of a blank one)."""
    import pyarrow.compute as pc

    coded = pc.utf8_trim_whitespace(cells).dictionary_encode()
    codes = pc.fill_null(coded.indices, -1).to_numpy(zero_copy_only=False)
    return coded.dictionary.to_pylist(), np.asarray(codes, np.int64)


def _instants(stamps: list[str], layout: Layout, dt: float | None) -> np.ndarray:
    """Return the numbers by which times are sorted."""
    import pyarrow as pa

    if all(is_number(stamp, layout.decimal) for stamp in stamps):
        return np.array([float(stamp.replace(layout.decimal, ".")) for stamp in stamps])
    return parse_stamps(pa.array(stamps), dt, "time {}".format, layout.how)[0]


def _again(
    rows: np.ndarray,
    tags: np.ndarray,
    places: np.ndarray,
    values: Arrow,
    names: list[str],
    how: RecordingFormat,
) -> np.ndarray:
    """Return the places of rows whose tag and time another row has, too.

    Raises:
        ValueError: their values differ, and nobody states which counts.
    """
    key = rows * len(names) + tags
    order = np.argsort(key, kind="stable")
    again = np.flatnonzero(np.diff(key[order]) == 0)
    if how.equal == "last":
        return places[order[again]]
    for k in again[: len(again) * (not how.equal)]:
        one, other = (values[int(places[order[j]])].as_py() for j in (k, k + 1))
        if one != other:
            name = names[tags[order[k]]]
            raise ValueError(
                f"tag {name!r} has two values of one time, {one} and {other}: say which counts, "
                f'equal = "last" in {RECORDING} (--recording equal=last)'
            )
    return places[order[again + 1]]


def _refuse_unequal(table: np.ndarray, names: list[str], how: RecordingFormat) -> None:
    """Raise ValueError for tags with times of their own, where nobody states how long a value stands."""
    if how.hold:
        return
    shares = (table >= 0).mean(0)
    least = int(np.argmin(shares))
    if shares[least] < ALIKE:
        raise ValueError(
            f"tags have times of their own, {names[least]!r} at {shares[least]:.0%} of them: say how long a "
            f'value stands, hold = "10min" in {RECORDING} (--recording hold=10min), and give dt'
        )


def _taken(cells: Arrow, places: np.ndarray) -> Arrow:
    """Return the cells at some places, blank ones for -1."""
    import pyarrow as pa

    return cells.take(pa.array(places, mask=places < 0))


def _as_lines(names: Iterable[str], columns: Iterable[Arrow], delimiter: str) -> bytes:
    """Return texts as lines of CSV."""
    import pyarrow as pa
    import pyarrow.csv as pc

    sink = BytesIO()
    sink.write(header_line(names, delimiter))
    options = pc.WriteOptions(include_header=False, delimiter=delimiter, quoting_style="needed")
    pc.write_csv(pa.Table.from_arrays(list(columns), list(names)), sink, options)
    return sink.getvalue()
