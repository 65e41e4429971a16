"""Files as loggers, historians and spreadsheets write them, drawn: a healthy plant, how stamps and numbers
are written, and what stands around the samples; with the samples that are to be read of them.
"""

import datetime
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import NamedTuple
from zoneinfo import ZoneInfo

import numpy as np

import jaxbound as jb
from jaxbound.recordings.recordingformat import with_format

COUNT = 40
DAY = datetime.timedelta(days=1)
BERLIN, UTC = ZoneInfo("Europe/Berlin"), datetime.UTC
BEGINS = [
    datetime.datetime(2026, 3, 13),
    datetime.datetime(2026, 3, 4, 23, 45),  # day and month may change places
    datetime.datetime(2026, 11, 12, 11, 50),
    datetime.datetime(2028, 2, 29, 23, 40),
    datetime.datetime(2025, 12, 31, 23, 40),
    datetime.datetime(2026, 3, 29, 1, 40),  # in Berlin, 0:40 of Greenwich: the clock goes forward
    datetime.datetime(1999, 12, 31, 23, 59),
]


class Kind(NamedTuple):
    """The numbers of a plant. Fields: scale, shift: of temp; on: of heater at 1; levels: of heater."""

    scale: int = 1
    shift: int = 0
    on: float = 1.0
    levels: tuple[float, ...] = (20.0, 40.0, 60.0, 80.0)


USUAL = Kind()
LARGE = Kind(scale=1000)
COLD = Kind(shift=-45)
SWITCHED = Kind(on=80.0, levels=(0.0, 1.0))


@cache
def plant(kind=USUAL, dt=60):
    """Return the model of a plant."""
    return jb.LinearSystem(
        [["0.93"]],
        [[f"{0.035 * kind.on * kind.scale:.6g}"]],
        [[1]],
        dt=dt,
        noise=f"{0.11 * kind.scale:g}",
        resolution=f"{0.005 * kind.scale:g}",
        offset={"u": [0], "y": [20 * kind.scale + kind.shift]},
        inputs=["heater"],
        outputs=["temp"],
        horizon=4,
    )


@cache
def windows(kind=USUAL, dt=60):
    """Return the relations of a plant."""
    return jb.parity_relations(plant(kind, dt))


def samples(rng, kind=USUAL):
    """Return (heater, temp) of a healthy plant, (COUNT,) each, with few decimals."""
    u = np.repeat(rng.choice(kind.levels, 5), 8)
    x, y = 35.0, []
    for value in u:
        y.append(round(kind.scale * round(x + rng.uniform(-0.1, 0.1), 2) + kind.shift, 2))
        x = 20 + 0.93 * (x - 20) + 0.035 * kind.on * value
    return u, np.array(y)


class Moment(NamedTuple):
    """The time of a sample. Fields: utc; begin: that of the first one."""

    utc: datetime.datetime
    begin: datetime.datetime

    @property
    def local(self):
        """In Berlin, with its zone."""
        return self.utc.replace(tzinfo=UTC).astimezone(BERLIN)

    @property
    def since(self):
        """Seconds since the first one."""
        return int((self.utc - self.begin).total_seconds())

    @property
    def epoch(self):
        """Seconds since 1970."""
        return int(self.utc.replace(tzinfo=UTC).timestamp())


class Stamp(NamedTuple):
    """How a time is written.

    Fields: form: for strftime of a time that names no zone, or Moment -> text, or several; least: s, a
    multiple of which dt is; names: of the columns; is_number: with the decimal sign of the dialect; fits:
    `fit` reads it without dt.
    """

    form: str | Callable
    least: int = 1
    names: tuple[str, ...] = ("time",)
    is_number: bool = False
    fits: bool = True

    def cells(self, moment):
        """Return the cells of a time."""
        if isinstance(self.form, str):
            return [moment.utc.strftime(self.form)]
        cells = self.form(moment)
        return [cells] if isinstance(cells, str) else cells


def clock24(m):
    before = m.utc - DAY
    is_midnight = (m.utc.hour, m.utc.minute) == (0, 0)
    return (
        f"{before:%Y-%m-%d} 24:00:{m.utc:%S}"
        if is_midnight and not m.utc.second
        else f"{m.utc:%Y-%m-%d %H:%M:%S}"
    )


MONTHS = {
    "German": "Januar Februar März April Mai Juni Juli August September Oktober November Dezember",
    "French": "janv. févr. mars avril mai juin juil. août sept. oct. nov. déc.",
    "Spanish": "ene feb mar abr may jun jul ago sep oct nov dic",
    "Italian": "gen feb mar apr mag giu lug ago set ott nov dic",
    "Dutch": "jan feb mrt apr mei jun jul aug sep okt nov dec",
    "Swedish": "januari februari mars april maj juni juli augusti september oktober november december",
    "Portuguese": "jan fev mar abr mai jun jul ago set out nov dez",
}


def month_in(language, form):
    """Return the writer of times with the names of months in a language."""
    names = MONTHS[language].split()

    def written(m):
        t = m.utc
        return t.strftime(form.replace("%b", names[t.month - 1]))

    return written


STAMPS = {
    "iso": Stamp("%Y-%m-%d %H:%M:%S"),
    "iso T": Stamp(lambda m: m.local.isoformat()),
    "iso Z": Stamp("%Y-%m-%dT%H:%M:%S.000Z"),
    "iso minutes": Stamp("%Y-%m-%d %H:%M", 60),
    "slashes": Stamp("%Y/%m/%d %H:%M:%S"),
    "German": Stamp("%d.%m.%Y %H:%M:%S"),
    "German, Uhr": Stamp("%d.%m.%Y %H:%M Uhr", 60),
    "two digits": Stamp("%d.%m.%y %H:%M", 60),
    "two digits, slashes": Stamp("%d/%m/%y %H:%M:%S"),
    "American": Stamp("%m/%d/%Y %I:%M:%S%p"),
    "American, blank": Stamp("%m/%d/%Y %I:%M:%S %p"),
    "American, one digit": Stamp(
        lambda m: f"{m.utc.month}/{m.utc.day}/{m.utc:%Y} {m.utc.hour}:{m.utc:%M}", 60
    ),
    "English": Stamp("%d/%m/%Y %H.%M.%S"),
    "English, half days": Stamp("%d/%m/%Y %I:%M:%S %p"),
    "historian": Stamp("%d-%b-%y %H:%M:%S"),
    "historian, year": Stamp("%d-%b-%Y %H:%M:%S"),
    "mail": Stamp("%a %d %b %Y %H:%M:%S GMT"),
    "mail, comma": Stamp("%a, %d %b %Y %H:%M:%S +0000"),
    "ctime": Stamp("%a %b %d %H:%M:%S %Y"),
    "date": Stamp("%a %b %d %H:%M:%S UTC %Y"),
    "Apache": Stamp(lambda m: f"{m.local:[%d/%b/%Y:%H:%M:%S %z]}"),
    "zone by name": Stamp(lambda m: f"{m.local:%Y-%m-%d %H:%M:%S %Z}"),
    "zone by place": Stamp(lambda m: f"{m.local:%Y-%m-%d %H:%M:%S} Europe/Berlin"),
    "day of the year": Stamp("%Y-%j %H:%M:%S"),
    "ISO week": Stamp("%G-W%V-%u %H:%M", 60),
    "file name": Stamp("%Y.%m.%d_%H-%M-%S"),
    "midnight at 24": Stamp(clock24),
    "compact": Stamp("%Y%m%d%H%M%S"),
    "compact T": Stamp("%Y%m%dT%H%M%S"),
    "compact day": Stamp("%Y%m%d %H:%M:%S"),
    "fraction now and then": Stamp(lambda m: f"{m.utc:%Y-%m-%d %H:%M:%S}{'.000' * (m.since % 180 == 0)}"),
    "fraction, comma": Stamp("%Y-%m-%d %H:%M:%S,000"),
    "seven digits": Stamp(lambda m: f"{m.local:%Y-%m-%dT%H:%M:%S}.0000000{m.local:%z}"[:-2] + ":00"),
    "epoch": Stamp(lambda m: str(m.epoch), is_number=True),
    "epoch, fraction": Stamp(lambda m: f"{m.epoch}.000", is_number=True),
    "epoch ms": Stamp(lambda m: f"{m.epoch}000", is_number=True),
    "epoch ns": Stamp(lambda m: f"{m.epoch}000000000", is_number=True),
    "seconds": Stamp(lambda m: str(m.since), is_number=True),
    "pandas": Stamp(
        lambda m: f"{m.since // 86400} days {datetime.datetime(1, 1, 1) + (m.utc - m.begin):%H:%M:%S}"
    ),
    "elapsed": Stamp(lambda m: f"{30 + m.since // 3600}:{m.since // 60 % 60:02d}:{m.since % 60:02d}"),
    "ISO span": Stamp(lambda m: f"PT{m.since}S"),
    ".NET span": Stamp(lambda m: f"1.{m.since // 3600:02d}:{m.since // 60 % 60:02d}:{m.since % 60:02d}"),
    "clock": Stamp("%H:%M:%S"),
    "hours and minutes": Stamp("%H:%M", 60, fits=False),
    "clock, half days": Stamp("%I:%M:%S %p"),
    "day and clock": Stamp(lambda m: [f"{m.utc:%d.%m.%Y}", f"{m.utc:%H:%M:%S}"], names=("Date", "Time")),
    "clock and day": Stamp(lambda m: [f"{m.utc:%H:%M:%S}", f"{m.utc:%Y-%m-%d}"], names=("Time", "Date")),
    "hours": Stamp(lambda m: f"{m.since / 3600:.8f}", names=("Time [h]",), is_number=True),
    "minutes": Stamp(lambda m: f"{m.since // 60}", 60, names=("t (min)",), is_number=True),
    "spreadsheet": Stamp(
        lambda m: f"{(m.utc - datetime.datetime(1899, 12, 30)) / DAY:.10f}",
        names=("time [d]",),
        is_number=True,
    ),
    "blanks around": Stamp("  %Y-%m-%d %H:%M:%S "),
} | {f"{language} month": Stamp(month_in(language, "%d. %b %Y %H:%M:%S")) for language in MONTHS}


def with_point(x):
    return repr(x)


def with_comma(x):
    return repr(x).replace(".", ",")


def german_thousands(x):
    return f"{x:,.1f}".translate({ord("."): ",", ord(","): "."})


class Dialect(NamedTuple):
    """How cells are written.

    Fields: delimiter; number: its text; quoted: whether all cells are; kind: of the plant; words: of a heater
    that is on or off; how: what is stated of the format; encoding, end: of the file and its lines; extra: a
    column that no model names, (its place, its cells); from_pipe: a pipe takes it; on_change: the heater is
    written when it changes; long: a row a tag.
    """

    delimiter: str = ","
    number: Callable = with_point
    quoted: bool = False
    kind: Kind = USUAL
    words: tuple[str, str] | None = None
    how: Mapping = {}
    encoding: str = "utf-8"
    end: str = "\n"
    extra: tuple[int, str, Callable] | None = None
    from_pipe: bool = True
    on_change: bool = False
    long: bool = False

    @property
    def decimal(self):
        """The decimal sign."""
        return "," if self.how.get("thousands") == "." or "1,5" in self.number(1.5) else "."


DIALECTS = {
    "plain": Dialect(),
    "German": Dialect(";", with_comma),
    "tabs": Dialect("\t", with_comma),
    "all in quotes": Dialect(quoted=True),
    "quoted commas": Dialect(",", with_comma, True),
    "units in cells": Dialect(";", lambda x: f"{with_comma(x)} °C"),
    "units in cells, quoted": Dialect(",", lambda x: f"{x!r} kW", True),
    "percent": Dialect(";", lambda x: f"{with_comma(x)} %"),
    "padded": Dialect(";", lambda x: f"\u00a0{with_comma(x)}\u00a0"),
    "spaces": Dialect(",", lambda x: f" {x!r:>9}"),
    "signs": Dialect(",", lambda x: f"{x:+.2f}", kind=COLD),
    "powers": Dialect(",", lambda x: f"{x:.4E}"),
    "long minus": Dialect(",", lambda x: f"{x:.2f}".replace("-", "\u2212"), kind=COLD),
    "long minus and comma": Dialect(";", lambda x: with_comma(x).replace("-", "\u2212"), kind=COLD),
    "thousands": Dialect(";", german_thousands, kind=LARGE),
    "American thousands": Dialect(",", lambda x: f"{x:,.1f}", True, LARGE),
    "Swiss thousands": Dialect(";", lambda x: f"{x:,.1f}".replace(",", "'"), kind=LARGE),
    "French thousands": Dialect(
        ";", lambda x: f"{x:,.1f}".replace(",", "\u202f").replace(".", ","), kind=LARGE
    ),
    "whole thousands, stated": Dialect(
        ";", lambda x: f"{x:,.0f}".replace(",", "."), kind=LARGE, how={"thousands": "."}
    ),
    "on and off": Dialect(",", kind=SWITCHED, words=("OFF", "ON")),
    "true and false": Dialect(";", with_comma, kind=SWITCHED, words=("False", "True")),
    "stated words": Dialect(kind=SWITCHED, words=("shut", "open"), how={"on": "open", "off": "shut"}),
    "bars, stated": Dialect("|", with_comma, how={"delimiter": "|"}),
    "missing words, stated": Dialect(how={"missing": "Bad,I/O Timeout,-999"}),
    "UTF-8 of Windows": Dialect(";", with_comma, encoding="utf-8-sig", end="\r\n"),
    "Windows-1252": Dialect(";", lambda x: f"{with_comma(x)} °C", encoding="cp1252", end="\r\n"),
    "UTF-16": Dialect("\t", with_comma, encoding="utf-16", end="\r\n", from_pipe=False),
    "old Macintosh": Dialect(end="\r"),
    "a note": Dialect(extra=(3, "note", lambda k: '"pump, one"' if k % 3 else "")),
    "a count": Dialect(extra=(0, "RECORD", str)),
    "an index": Dialect(extra=(0, "", str)),
    "other commas": Dialect(";", with_comma, extra=(2, "flow", lambda k: f"{k}.125")),
    "long": Dialect(how={"long": "tag,value"}, from_pipe=False, long=True),
    "long, German": Dialect(";", with_comma, how={"long": "tag,value"}, from_pipe=False, long=True),
    "on change": Dialect(how={"hold": "8h"}, from_pipe=False, on_change=True),
    "long, on change": Dialect(
        how={"hold": "8h", "long": "tag,value"}, from_pipe=False, on_change=True, long=True
    ),
}


@dataclass
class File:
    """A file in parts: lines above the names, the names, lines below, rows, lines behind.

    Fields: rows: (number of its sample, cells), or (None, text) of what is none; lost: samples that are not
    there; missing: samples without temp; said: what sentences say; unended: the last line has no end.
    """

    dialect: Dialect
    stamp: Stamp
    names: list
    rows: list
    above: list = field(default_factory=list)
    below: list = field(default_factory=list)
    behind: list = field(default_factory=list)
    lost: list = field(default_factory=list)
    missing: list = field(default_factory=list)
    said: list = field(default_factory=list)
    more: str = ""
    unended: bool = False

    def line(self, cells):
        """Return the text of cells."""
        if isinstance(cells, str):
            return cells
        if self.dialect.quoted:
            cells = [f'"{cell}"' for cell in cells]
        elif self.dialect.delimiter == ",":
            cells = [f'"{cell}"' if "," in cell and not cell.startswith('"') else cell for cell in cells]
        return self.dialect.delimiter.join(cells)

    def filled(self, *cells):
        """Return a line of as many cells as the names."""
        return self.line([*cells, *[""] * (len(self.names) - len(cells))])

    def data(self):
        """Return the bytes."""
        rows = [self.line(cells) + self.more * (k is not None) for k, cells in self.rows]
        lines = [*self.above, self.line(self.names), *self.below, *rows, *self.behind]
        text = self.dialect.end.join([*lines, ""])
        if self.unended:
            text = text[: -len(self.dialect.end) - 1]
        return text.encode(self.dialect.encoding)


def drawn(u, y, moments, stamp, dialect):
    """Return the File of samples at these Moments."""
    names = ["heater", "temp"]
    rows = []
    for k, (a, b, moment) in enumerate(zip(u.tolist(), y.tolist(), moments, strict=True)):
        number, time = dialect.number, stamp.cells(moment)
        if stamp.is_number and dialect.decimal == ",":
            time = [time[0].replace(".", ",")]
        heater = dialect.words[int(a)] if dialect.words else number(a)
        if dialect.on_change and k and a == u[k - 1]:
            heater = ""
        cells = [heater, number(b)]
        if dialect.long:
            rows += [(k, ["heater", *time, heater])] * bool(heater) + [(k, ["temp", *time, cells[1]])]
        else:
            cells = [*time, *cells]
            if dialect.extra:
                cells.insert(dialect.extra[0], dialect.extra[2](k))
            rows.append((k, cells))
    names = ["tag", *stamp.names, "value"] if dialect.long else [*stamp.names, *names]
    if dialect.extra:
        names.insert(dialect.extra[0], dialect.extra[1])
    return File(dialect, stamp, names, rows)


def no_damage(file, rng):
    pass


def units(file, rng):
    file.below += [file.filled("[s]", "%", "degC"), file.filled("", "Smp", "Avg")]
    file.said.append("hold no samples")


def dimensionless(file, rng):
    file.below.append(
        file.line(["1" if n == "heater" else "degC" if n == "temp" else "s" for n in file.names])
    )
    file.said.append("holds no samples")


def preamble(file, rng):
    file.above += ["# Logger 7", f"Serial{file.dialect.delimiter}12", ""]
    file.said.append("holds the names of the columns: 2 rows above it")


def toa5(file, rng):
    file.above.append(
        file.line(["TOA5", "Site", "CR1000", "1234", "CR1000.Std.31", "CPU:a.CR1", "4242", "Table1"])
    )
    file.below += [file.filled("TS", "pct", "Deg C"), file.filled("", "Smp", "Avg")]
    file.said += ["holds the names of the columns: 1 row above it", "hold no samples"]


def separator(file, rng):
    file.above.append(f"sep={file.dialect.delimiter}")


def long_preamble(file, rng):
    file.above += [f"Station{file.dialect.delimiter} {k}" for k in range(12)]
    file.said.append("12 rows above it")


NO_SAMPLE = -1
"""The number of a row of the logger that is none of a sample of its own."""


def place(file, rng, behind=1):
    """Return where a row stands that nothing happened to yet."""
    free = [
        i
        for i, (k, _) in enumerate(file.rows)
        if k not in (None, NO_SAMPLE) and 2 <= i < len(file.rows) - behind
    ]
    return int(rng.choice(free))


def header_again(file, rng):
    file.rows.insert(place(file, rng), (None, file.line(file.names)))
    file.said.append("what stands above")


def all_above_again(file, rng):
    at = place(file, rng)
    file.rows[at:at] = [(None, line) for line in (*file.above, file.line(file.names), *file.below) if line]
    file.said.append("what stands above")


def blank_cells(file, rng):
    for _ in range(2):
        file.rows.insert(place(file, rng), (None, file.filled().replace('"', "")))
    file.said.append(" hold no cell")


def blank_lines(file, rng):
    for _ in range(3):
        file.rows.insert(place(file, rng), (None, ""))


def no_time(file, rng):
    at = place(file, rng)
    k, cells = file.rows[at]
    cells = [*cells]
    for name in file.stamp.names:
        cells[file.names.index(name)] = ""
    file.rows[at] = NO_SAMPLE, cells
    file.lost.append(k)
    file.said.append("no time")


def power_cut(file, rng):
    at = place(file, rng)
    k, cells = file.rows[at]
    text = file.line(cells)
    file.rows[at] = NO_SAMPLE, text[:5] + "\0" * 64 + text[9:]
    file.lost.append(k)
    file.said.append("zero bytes")


def zero_line(file, rng):
    file.rows.insert(place(file, rng), (None, "\0" * 512))
    file.said.append("zero bytes")


def logger_off(file, rng):
    at = place(file, rng, 12)
    for k, _ in file.rows[at : at + 9]:
        if k not in (None, NO_SAMPLE):
            file.lost.append(k)
    file.rows[at : at + 9] = [row for row in file.rows[at : at + 9] if row[0] in (None, NO_SAMPLE)]


def row_twice(file, rng):
    at = place(file, rng)
    file.rows.insert(at, (NO_SAMPLE, file.rows[at][1]))
    file.said.append("of another row" if file.dialect.long else "repeat")


def all_twice(file, rng):
    file.rows = [one for row in file.rows for one in (row, (NO_SAMPLE, row[1]))]
    file.said.append("of another row" if file.dialect.long else "repeat")


def no_number(file, rng):
    stated = file.dialect.how.get("missing", "#N/A").split(",")
    for word in rng.choice(["", "NaN", "null", " ", "n/a", *stated], 3):
        at = place(file, rng)
        k, cells = file.rows[at]
        cells = [*cells]
        cells[file.names.index("temp")] = str(word)
        file.rows[at] = k, cells
        file.missing.append(k)


def footer(file, rng):
    file.behind.append("Total rows: 40")
    file.said.append("holds no sample, behind the last")


def footer_of_cells(file, rng):
    for word in ("Average", "Max"):
        file.behind.append(file.line([word if name in file.stamp.names else "1" for name in file.names]))
    file.said.append("2 rows hold no sample, behind")


def footer_without_time(file, rng):
    file.behind.append(file.line(["" if n in file.stamp.names else "1" for n in file.names]))
    file.said.append("no time")


def delimiter_more(file, rng):
    file.more = file.dialect.delimiter
    file.said.append("has a delimiter more")


def cut(file, rng):
    last = next(i for i in reversed(range(len(file.rows))) if file.rows[i][0] not in (None, NO_SAMPLE))
    k, cells = file.rows[last]
    del file.rows[last + 1 :]
    file.lost.append(k)
    file.unended = True
    file.said.append("line end")


ABOVE = (units, dimensionless, preamble, toa5, separator, long_preamble)
INSIDE = (
    header_again,
    all_above_again,
    blank_cells,
    blank_lines,
    no_time,
    power_cut,
    zero_line,
    logger_off,
    row_twice,
    no_number,
)
BEHIND = (footer, footer_of_cells, footer_without_time, delimiter_more, cut, all_twice)
DAMAGE = (no_damage, *ABOVE, *INSIDE, *BEHIND)
OF_LONG = (no_damage, blank_lines, preamble, footer, row_twice, all_twice, separator, zero_line)


class Drawn(NamedTuple):
    """A drawn file.

    Fields: data: its bytes; model: of the plant, with what is stated of the format; relations; dialect,
    stamp; kept: numbers of its samples; moments, u, y: of all; said: what sentences say; about: how it was
    drawn; texts: {column: cells} of the samples.
    """

    data: bytes
    model: jb.LinearSystem
    relations: object
    dialect: Dialect
    stamp: Stamp
    kept: np.ndarray
    moments: list
    u: np.ndarray
    y: np.ndarray
    said: list
    about: str
    texts: Mapping


def draw(rng, stamp, dialect, damages, dt=60, begin=BEGINS[0]):
    """Return the Drawn file of these names of STAMPS and DIALECTS, and of these functions of DAMAGE."""
    about = f"{stamp}, {dialect}, {[d.__name__ for d in damages]}, dt {dt}, {begin}"
    form, how = STAMPS[stamp], DIALECTS[dialect]
    u, y = samples(rng, how.kind)
    moments = [Moment(begin + datetime.timedelta(seconds=dt * k), begin) for k in range(COUNT)]
    file = drawn(u, y, moments, form, how)
    for damage in damages:
        damage(file, rng)
    y[file.missing] = np.nan
    kept = np.setdiff1d(np.arange(COUNT), file.lost)
    rows = [cells for k, cells in file.rows if k in kept]
    texts = {name: [cells[i] for cells in rows] for i, name in enumerate(file.names)}
    model = plant(how.kind, dt)
    model = model.replace(columns=with_format({}, how.how))
    return Drawn(
        file.data(),
        model,
        windows(how.kind, dt),
        how,
        form,
        kept,
        moments,
        u,
        y,
        file.said,
        about,
        texts,
    )


def drawn_names(rng, dialect, dt):
    """Return random arguments of `draw`."""
    how = DIALECTS[dialect]
    # times in quotes with commas for decimals are refused
    is_refused = how.delimiter == "," == how.decimal
    fitting = [n for n, s in STAMPS.items() if dt % s.least == 0 and not (is_refused and s.is_number)]
    damages = [rng.choice(group) for group in (ABOVE, INSIDE, INSIDE, BEHIND) if rng.random() < 0.35]
    if how.long or how.on_change:
        damages = [rng.choice(OF_LONG)]
    damages.sort(key=lambda damage: (damage is row_twice) - (damage is logger_off))  # twins come last
    if all_twice in damages:
        damages = [all_twice]
    return str(rng.choice(fitting)), dialect, damages, dt, BEGINS[rng.integers(len(BEGINS))]
