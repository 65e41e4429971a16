"""Healthy recordings, simulated in exact fractions with every bound kept, and written in as many ways as
people and programs do.

Nothing of jaxbound is used to make them. A Variant is drawn from a seed alone: what the recording is, how it
is written and who reads it.
"""

import csv
import datetime
import io
import random
from dataclasses import dataclass, field
from fractions import Fraction as F
from pathlib import Path

A = ((F(9, 10), F(1, 10)), (F(0), F(4, 5)))
B = (F(1, 5), F(1, 2))
C = ((F(1), F(0)), (F(1), F(1)))
NOISE = (F(1, 20), F(1, 10))
TOLERANCE = (F(1, 50), F(0))
DIGITS = 4  # of what is recorded
TOML = """name = "plant"
dt = 1
{columns}
[[states]]
name = "a"
[[states]]
name = "b"
[[inputs]]
name = "u1"
[[outputs]]
name = "y1"
{y1}
tolerance = 0.02
noise = 0.05
resolution = 0.0
[[outputs]]
name = "y2"
tolerance = 0
noise = 0.1
resolution = 0.0
[matrices]
A = [[0.9, 0.1], [0, 0.8]]
B = [[0.2], [0.5]]
C = [[1, 0], [1, 1]]
"""
READERS = ("file", "pipe", "parquet", "pandas", "polars", "arrow", "xarray", "fleet", "state")
FIRST = datetime.datetime(2024, 2, 28, 23, 59, 30)  # over midnight and into a leap day
UNITS = {"hours": ("Time [h]", 3600), "minutes": ("time_min", 60), "milliseconds": ("time (ms)", 0.001)}
EXCEL = 25569  # the day from which epochs count, in days of a spreadsheet
STAMPS = (
    "%Y-%m-%d %H:%M:%S",
    "%Y-%m-%dT%H:%M:%S",
    "%Y-%m-%dT%H:%M:%SZ",
    "%d.%m.%Y %H:%M:%S",
    "%m/%d/%Y %H:%M:%S",
    "%Y%m%d%H%M%S",
    "%d-%b-%Y %H:%M:%S",
    "%Y/%m/%d %H:%M:%S.%f",
)
MISSING = ("", "", " ", "NaN", "nan", "NA", "N/A", "null", "None")
REMARKS = ("fine", "", "shift 2", 'a 5" pipe', "it's on", "a\u2028b", "x\x0by", "\u201cok\u201d", "`", "'")


def simulated(draw, samples, fault=False):
    """Return (u, y): lists of decimals as Fractions; each error lies within its bounds, often at their
    ends.
    """
    x, level, us, ys = [F(draw.randint(-20, 20), 10) for _ in A], F(0), [], []
    for k in range(samples):
        if draw.random() < 0.3:
            level = F(draw.randint(-30, 30), 10)
        true = [sum(c * v for c, v in zip(row, x, strict=True)) for row in C]
        y = []
        for i, value in enumerate(true):
            reach = TOLERANCE[i] * abs(value) + NOISE[i]
            share = draw.choice((F(-1), F(1), F(draw.randint(-1000, 1000), 1000)))
            y.append(inward(value + share * reach, value))
        if fault and k >= samples // 2:
            y[0] += 3
        us.append(level)
        ys.append(y)
        x = [sum(a * v for a, v in zip(row, x, strict=True)) + b * level for row, b in zip(A, B, strict=True)]
    return us, ys


def inward(value, true):
    """Return a decimal between a value and the true one, close to the value; where there is none, that next
    to the true one.
    """
    scaled = value * 10**DIGITS
    whole = scaled.__floor__() if value >= true else scaled.__ceil__()
    near = F(whole, 10**DIGITS)
    return near if min(value, true) <= near <= max(value, true) else F(round(true * 10**DIGITS), 10**DIGITS)


def decimal(x):
    """Return a Fraction whose decimals end as text."""
    whole = round(x * 10**DIGITS)
    assert F(whole, 10**DIGITS) == x
    return f"{'-' if whole < 0 else ''}{abs(whole) // 10**DIGITS}.{abs(whole) % 10**DIGITS:0{DIGITS}d}"


@dataclass
class Variant:
    """One recording. Fields: reader; u, y, seconds: of its rows, None where missing; time: how it is written;
    draw: for the rest.
    """

    seed: int
    fault: bool = False
    reader: str = ""
    u: list = field(default_factory=list)
    y: list = field(default_factory=list)
    seconds: list = field(default_factory=list)
    time: str = ""

    def __post_init__(self):
        self.draw = draw = random.Random(self.seed)
        self.reader = READERS[self.seed % len(READERS)]
        samples = draw.choice((40, 60, 61))
        us, ys = simulated(draw, samples, self.fault)
        self.time = draw.choice(
            (
                "seconds",
                "seconds",
                "hours",
                "minutes",
                "milliseconds",
                "days",
                "digits",
                "minutes and seconds",
                "offset",
                "epoch",
                "epoch ms",
                "stamps",
                "stamps",
                "two columns",
                "clock",
                "none",
            )
        )
        if self.reader == "state" and self.time in ("none", "clock", "digits", "minutes and seconds"):
            self.time = "stamps"
        keep = range(samples)
        if self.time != "none" and draw.random() < 0.4:  # gaps, which only a time shows
            at = draw.randrange(5, samples - 10)
            keep = [k for k in keep if not at <= k < at + draw.choice((1, 1, 5))]
        self.seconds = list(keep)
        lost = draw.choice((0.0, 0.0, 0.03, 0.2))
        spoilt = lambda x: None if draw.random() < lost else x
        self.u = [spoilt(us[k]) for k in keep]
        self.y = [[spoilt(v) for v in ys[k]] for k in keep]
        self.order = "kept"
        if self.time != "none" and draw.random() < 0.08:
            self.order = draw.choice(("newest first", "shuffled"))
        self.rows = len(self.seconds)
        # y1 as 1.234 thousandths of thousandths, where some number shows what the points are for
        raw = [round(v[0] * 10**DIGITS) for v in self.y[:-1] if v[0] is not None]
        shown = any(0 < abs(x) < 1000 for x in raw) and any(abs(x) >= 1000 and x % 10 == 0 for x in raw)
        self.by_thousands = self.reader in ("file", "fleet") and shown and draw.random() < 0.5

    def halves(self):
        """Return two Variants, the first rows and those that follow."""
        parts = []
        at = self.rows // 2
        for span in (slice(0, at), slice(at, None)):
            part = Variant(self.seed, self.fault)
            part.u, part.y, part.seconds, part.time, part.order = (
                self.u[span],
                self.y[span],
                self.seconds[span],
                self.time,
                "kept",
            )
            part.rows = len(part.seconds)
            parts.append(part)
        return parts

    def arranged(self, things):
        if self.order == "newest first":
            return things[::-1]
        if self.order == "shuffled":
            return random.Random(1).sample(things, len(things))
        return things

    def text(self):
        """Return (bytes of a CSV file, whether a line of it is spoilt on purpose)."""
        draw = self.draw
        delimiter = draw.choice((",", ",", ";", "\t")) if not self.by_thousands else draw.choice((";", "\t"))
        comma = delimiter != "," and draw.random() < 0.5
        missing = draw.choice(MISSING)
        style = draw.choice(("plain", "plain", "padded", "plus", "exponent"))

        def number(x):
            if x is None:
                return missing
            text = decimal(x) if style != "exponent" else f"{round(x * 10**DIGITS)}e-{DIGITS}"
            text = {"padded": f" {text}", "plus": text if x < 0 else f"+{text}"}.get(style, text)
            return text.replace(".", ",") if comma else text

        columns = {
            "u1": list(map(number, self.u)),
            "y1": [number(v[0]) for v in self.y],
            "y2": [number(v[1]) for v in self.y],
        }
        if self.by_thousands:
            points = lambda x: missing if x is None else f"{round(x * 10**DIGITS):,}".replace(",", ".")
            columns["raw"] = [points(v[0]) for v in self.y]
            del columns["y1"]
        columns |= self._times(draw)
        for i in range(draw.choice((0, 0, 1, 2))):
            columns[f"remark {i}"] = [draw.choice(REMARKS) for _ in range(self.rows)]
        names = list(columns)
        stamped = {"Date", "Time"} <= set(names)
        if not stamped:
            draw.shuffle(names)
        if draw.random() < 0.1:  # a delimiter at the end
            names.append("")
            columns[""] = [""] * self.rows
        lines = self.arranged([[columns[name][k] for name in names] for k in range(self.rows)])
        return self._written(draw, names, lines, delimiter)

    def _times(self, draw):
        moments = [FIRST + datetime.timedelta(seconds=s) for s in self.seconds]
        epoch = int(FIRST.replace(tzinfo=datetime.UTC).timestamp())
        if self.time == "none":
            return {}
        if self.time == "seconds":
            return {draw.choice(("t", "time", "Time (s)")): [str(s) for s in self.seconds]}
        if self.time in UNITS:
            name, scale = UNITS[self.time]
            return {name: [repr(s / scale) for s in self.seconds]}
        if self.time == "days":
            name = draw.choice(("time", "Zeit", "Date", "Time [d]"))
            return {name: [f"{EXCEL + (epoch + s) / 86400:.10f}" for s in self.seconds]}
        if self.time == "digits":
            moments = [m + datetime.timedelta(hours=8) for m in moments]
            return {draw.choice(("time", "Time (HHMMSS)")): [str(int(m.strftime("%H%M%S"))) for m in moments]}
        if self.time == "minutes and seconds":
            return {"time": [m.strftime("%M:%S.0") for m in moments]}
        if self.time == "offset":
            return {"time": [f"{s + 7}.0" for s in self.seconds]}
        if self.time == "epoch":
            return {"timestamp": [str(epoch + s) for s in self.seconds]}
        if self.time == "epoch ms":
            return {"timestamp": [str(1000 * (epoch + s)) for s in self.seconds]}
        if self.time == "two columns":
            return {
                "Date": [m.strftime("%Y-%m-%d") for m in moments],
                "Time": [m.strftime("%H:%M:%S") for m in moments],
            }
        if self.time == "clock":
            return {"time": [m.strftime("%H:%M:%S") for m in moments]}
        form = draw.choice(STAMPS)
        return {draw.choice(("time", "Datetime", "Zeitstempel")): [m.strftime(form) for m in moments]}

    def _written(self, draw, names, lines, delimiter):
        quoting = draw.choice((csv.QUOTE_MINIMAL, csv.QUOTE_MINIMAL, csv.QUOTE_ALL))
        out = io.StringIO()
        table = csv.writer(out, delimiter=delimiter, quoting=quoting, lineterminator="\n")
        table.writerow(names)
        table.writerows(lines)
        rows = out.getvalue().removesuffix("\n").split("\n")
        spoilt = draw.random() < 0.06
        if spoilt:
            at = draw.randrange(1, len(rows))
            rows[at] = draw.choice(
                (
                    f'"{rows[at]}',
                    rows[at].replace(delimiter, f'{delimiter}"', 1),
                    rows[at] + delimiter + "1",
                    "what",
                )
            )
        if draw.random() < 0.15:
            at = draw.randrange(2, len(rows))
            rows.insert(at, draw.choice(("", " ")))
        if draw.random() < 0.1:
            rows = ["", *rows]
        elif delimiter != "\t" and draw.random() < 0.1:
            rows = [f"sep={delimiter}", *rows]
        ends = draw.choice((("\n",), ("\n",), ("\r\n",), ("\r",), ("\r\r\n",), ("\n", "\r\n"), ("\n", "\r")))
        text = "".join(row + draw.choice(ends) for row in rows)
        if draw.random() < 0.2:
            text = text.rstrip("\r\n")
            if draw.random() < 0.5:  # it was copied while somebody wrote it
                begun = max(text.rfind("\n"), text.rfind("\r")) + 1
                text = text[: draw.randrange(begun + 1, len(text) + 1)]
        elif draw.random() < 0.2:
            text += ends[0] * 2
        return draw.choice((b"", b"", b"\xef\xbb\xbf")) + text.encode()

    def frame(self):
        """Return ({column: list}, index or None): numbers as floats, NaN where missing; the index is of
        times.
        """
        value = lambda x: float("nan") if x is None else float(x)
        columns = {
            "u1": list(map(value, self.u)),
            "y1": [value(v[0]) for v in self.y],
            "y2": [value(v[1]) for v in self.y],
        }
        moments = [FIRST + datetime.timedelta(seconds=s) for s in self.seconds]
        if self.time == "none":
            return columns, None
        if self.time in ("seconds", "offset"):
            return columns | {"time": [float(s) for s in self.seconds]}, None
        if self.time in UNITS:
            name, scale = UNITS[self.time]
            return columns | {name: [s / scale for s in self.seconds]}, None
        if self.time == "days":
            epoch = FIRST.replace(tzinfo=datetime.UTC).timestamp()
            return columns | {"time": [EXCEL + (epoch + s) / 86400 for s in self.seconds]}, None
        if self.time in ("stamps", "two columns"):
            return columns, moments
        return columns | {"time": moments}, None

    def parquet(self, folder):
        """Write Parquet: a file, or a folder of files; return its path."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        draw, (columns, index) = self.draw, self.frame()
        kind = pa.float32() if draw.random() < 0.2 else pa.float64()
        nulls = draw.random() < 0.5
        signals = ("u1", "y1", "y2")
        made = {name: pa.array(columns[name], kind, from_pandas=nulls) for name in signals}
        (name,) = [name for name in columns if name not in signals] or [None]
        times = index if index is not None else columns.get(name)
        if name in (None, "time"):
            name = draw.choice(
                ("time", "t") if self.time in ("seconds", "offset", "days") else ("time", "when")
            )
        if times is not None:
            made[name] = pa.array(times)
        order = pa.array(self.arranged(list(range(self.rows))))
        table = pa.table(made).take(order)
        if draw.random() < 0.5:
            path = Path(folder) / "run.parquet"
            pq.write_table(
                table,
                path,
                row_group_size=draw.choice((7, 1000)),
                compression=draw.choice(("snappy", "zstd", "none")),
            )
            return path
        path = Path(folder) / "run"
        path.mkdir()
        at = draw.randrange(1, self.rows)
        for name, part in (("part-9", table.slice(0, at)), ("part-10", table.slice(at))):
            pq.write_table(part, path / f"{name}.parquet")
        return path
