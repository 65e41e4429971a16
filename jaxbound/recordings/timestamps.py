"""Time stamps of a recording: text of any usual format, or numbers, to seconds; and back to text for a
reader.
"""

import math
import re
from collections.abc import Callable, Sequence
from datetime import datetime
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from jaxbound.recordings.columns import from_arrow
from jaxbound.recordings.recordingformat import UNSTATED, RecordingFormat
from jaxbound.recordings.seams import TOLERATED_STEP
from jaxbound.recordings.tidystamps import DAY, Tidied, elapsed, localized, tidied, zoned
from jaxbound.text.quantities import decimal

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

DATES = (
    "%Y-%m-%d",
    "%Y/%m/%d",
    "%Y.%m.%d",
    "%m/%d/%Y",
    "%d/%m/%Y",
    "%d.%m.%Y",
    "%d-%m-%Y",
    "%m-%d-%Y",
    "%d-%b-%Y",
    "%d %b %Y",
    "%d %b %y",
    "%b %d %Y",
    "%m/%d/%y",
    "%d/%m/%y",
    "%d.%m.%y",
    "%y/%m/%d",
    "%y.%m.%d",
    "%Y%m%d",
)
CLOCKS = ("%H:%M:%S", "%H:%M", "%I:%M:%S %p", "%I:%M %p", "%H%M%S")
FORMATS = [f"{date}{gap}{clock}" for date in DATES for gap in (" ", "T") for clock in CLOCKS]
OF_A_DAY = "%[dDjuwcxs]|%-d"  # a format with one of these has a date
MINUTES = "%M:%S"  # as Excel writes a time that it shows as 08:30.0
FORMATS += [*DATES[:-1], *CLOCKS[:4], MINUTES]
ORDERS = (
    "%m/%d/%Y",
    "%d/%m/%Y",
    "%m-%d-%Y",
    "%d-%m-%Y",
    "%m/%d/%y",
    "%d/%m/%y",
    "%y/%m/%d",
    "%d.%m.%y",
    "%y.%m.%d",
)
"""Dates in which day, month and year could change places."""
BY_SIGNS: dict[str, list[str]] = {}
"""{the signs of a text, which are no letters or digits: the formats of such texts}."""
for _form in FORMATS:
    BY_SIGNS.setdefault(re.sub(r"%.|[\sT]", "", _form), []).append(_form)
STATING = " (--recording, or [recording] of the model file)"
LONGEST = 64  # letters of a time stamp
DIGITS = re.compile(r"\d{8}")  # of a day that is written without separators
COMPACT = {14: "%Y%m%d%H%M%S", 12: "%Y%m%d%H%M"}  # by their digits
YEARS = 1678, 2261  # that a count of ns since 1970 holds
NO_CLOCK = "have a date without a clock"
FAR = f"only the years {YEARS[0]} to {YEARS[1]} can be told"
CENTURIES = 1970, 2200  # years that a number of so many digits may begin with
EPOCHS = {1.0: "s", 1e3: "ms", 1e6: "us", 1e9: "ns"}
STAMPS = np.dtype("datetime64[ns]")
EPOCH, SECOND = np.datetime64(0, "s"), np.timedelta64(1, "s")
"""The instant that times count from, and what a difference of stamps is divided by."""


def parse_stamps(
    cells: "pa.Array",
    dt: float | None,
    where: Callable[[int], str],
    how: RecordingFormat = UNSTATED,
    second: float | None = None,
) -> tuple[np.ndarray, np.ndarray | None, str]:
    """Return (time, stamps, hint) of text cells.

    Args:
        cells: pyarrow array of strings without nulls. dt: of the model; decides between day/month and
            month/day; None: the median step.
        where: called with an index, returns "row 7" of the file. how: states their format, or their zone.
        second: of a stream, the time of the second cell, which is its last one before; see `localized`.

    Returns:
        time: seconds since the first sample; stamps: datetime64[ns], in UTC where a zone is known, None for a
            clock without a date; hint: a sentence or "".

    Raises:
        ValueError: no known format, or a cell that does not follow that of the first.
    """
    if how.time_format in ("", *DATES):
        iso = iso_stamps(cells, where)
        if iso is not None and iso.dtype != STAMPS:
            return _since_first(iso), None, f"{FAR}: times count from the first row"
        if iso is not None:
            if how.zone and not _has_zone(cells):
                iso = _in_zone(iso, how.zone, second)
            return _since_first(iso), iso, ""
        spans = elapsed(cells)
        if spans is not None:
            return _since_first(spans), None, f"times like {cells[0].as_py()!r} are read as elapsed"
    read = _readings(cells, where, how, second)
    seams = [uneven_steps(_since_first(stamps), dt) for _, stamps in read]
    # 3/4/2017 is a day in March or in April: time runs evenly in one of the two orders only
    smoothest = [one for one, count in zip(read, seams, strict=True) if count == min(seams)]
    form, stamps = smoothest[0]
    like = f"time stamps like {cells[0].as_py()!r}"
    if dt is None and form == "%H:%M" and smoothest[-1][0] == MINUTES and len(cells) > 1:
        ways = "hours and minutes, or minutes and seconds"
        raise ValueError(
            f"{like} may be {ways}: say which, by time_format = {form!r} or {MINUTES!r}{STATING}"
        )
    if form == MINUTES:
        hint = f"{like} are read as minutes and seconds: a gap of whole hours cannot be seen"
        return _since_first(stamps) + _rounds(stamps, 3600.0), None, hint
    if not re.search(OF_A_DAY, form):
        hint = f"{like} have no day: a gap of whole days cannot be seen"
        if smoothest[-1][0] == MINUTES and not how.time_format:
            hint = f"{hint}; they are read as hours and minutes: write 0:08:30 for minutes and seconds"
        return _since_first(stamps) + _rounds(stamps, 86400.0), None, hint
    return _in_order(smoothest, dt, like)


def _in_order(
    read: Sequence[tuple[str, np.ndarray]], dt: float | None, like: str
) -> tuple[np.ndarray, np.ndarray, str]:
    """Return (time, stamps, hint) by the format, of some that differ in the order of day, month and year,
    that makes the most equal steps.

    Raises:
        ValueError: several do, and their steps differ.
    """
    # days are equally long, months and years are not
    spreads = [_spread(_since_first(stamps), dt) for _, stamps in read]
    evenest = [one for one, spread in zip(read, spreads, strict=True) if spread <= 2 * min(spreads) + 1e-6]
    form, stamps = evenest[0]
    time, others = _since_first(stamps), [other for other, x in read if (x != stamps).any()]
    if not others:
        return time, stamps, ""
    order, rest = order_in_words(form), " or ".join(map(order_in_words, others))
    which = f"say which by time_format, like {_date_of(others[0])!r}{STATING}"
    steps = {round(_usual(_since_first(x)), 6) for _, x in evenest}
    if dt is None and len(time) > 1 and len(steps) > 1:
        raise ValueError(f"{like} may be {order} or {rest}: {which}")
    return time, stamps, f"{like} are read as {order}; they could also be {rest}: {which}"


def _readings(
    cells: "pa.Array", where: Callable[[int], str], how: RecordingFormat, second: float | None
) -> list[tuple[str, np.ndarray]]:
    """Return (format, stamps) of each format that all cells have; refuse cells without any."""
    zones, date = None, how.time_format
    if date not in ("", *DATES):
        read = [(how.time_format, _as_stated(cells, how.time_format, where))]
    else:
        try:
            read = _in_formats(cells, _split_fraction(cells), where, date)
        except ValueError as refused:
            tidy = tidied(cells)
            zones = tidy.zones
            try:
                read = _in_formats(cells, tidy, where, date)
            except ValueError:
                raise refused from None
    try:
        if zones is not None:
            read = [(form, zoned(stamps, zones, second)) for form, stamps in read]
    except ValueError as e:
        raise ValueError(f"of time stamps like {cells[0].as_py()!r} {e}") from None
    if how.zone and (zones is None or zones[0].as_py() == "") and not re.search("%[zZs]", read[0][0]):
        read = [(form, _in_zone(stamps, how.zone, second)) for form, stamps in read]
    return read


def _as_stated(cells: "pa.Array", form: str, where: Callable[[int], str]) -> np.ndarray:
    """Return the stamps of texts in a format that is stated."""
    import pandas as pd

    texts = cells.to_pylist()
    try:
        stamps = pd.to_datetime(texts, format=form, utc="%z" in form, errors="coerce")
    except ValueError as e:
        raise ValueError(f"time_format {form!r}: {e}") from None
    if stamps.hasnans:
        bad = int(np.argmax(stamps.isna()))
        raise ValueError(f"{where(bad)} of the time column is {texts[bad]!r}: not like time_format {form!r}")
    return in_ns(stamps.to_numpy(), where)


def _in_zone(stamps: np.ndarray, zone: str, second: float | None) -> np.ndarray:
    """Return times of the clock of a zone in UTC."""
    try:
        return localized(stamps, zone, second)
    except ValueError as e:
        raise ValueError(f"the time column: {e}") from None


def _has_zone(cells: "pa.Array") -> bool:
    """Return whether time stamps in ISO 8601 name their zone."""
    return re.search(r":\d\d(\.\d+)?([Zz]|[+-]\d\d(:?\d\d)?)$", cells[0].as_py().strip()) is not None


def _in_formats(
    cells: "pa.Array", tidy: Tidied, where: Callable[[int], str], date: str
) -> list[tuple[str, np.ndarray]]:
    """Return (format, stamps) of each known format that all cells have; refuse cells without any.

    Args:
        cells: as they stand in the recording. tidy: what is read of them. date: that formats begin with.
    """
    first = tidy.texts[0].as_py()
    read = []
    # strptime compiles a pattern for each of its calls: it is asked of few of 170 formats
    for form in BY_SIGNS.get(_signs(first), ()):
        # a fraction is one of a second: none of 08:30.5 is an hour
        if form.startswith(date) and _has_format(first, form) and (not tidy.fine or "%S" in form):
            stamps = _stamps_in(tidy.texts, tidy.more, form, where)
            read.append((form, _with_midnights(stamps, cells, tidy.texts, form, where)))
    if not read:
        raise ValueError(
            f"{where(0)} of the time column is {cells[0].as_py()!r}: neither seconds nor a known time stamp "
            "(2017-09-12 08:00:00, 9/12/2017 8:00, 12.09.2017 8:00, ...)"
        )
    complete = [(form, stamps) for form, stamps in read if not np.isnat(stamps).any()]
    if not complete:
        bad = max(int(np.argmax(np.isnat(stamps))) for _, stamps in read)
        odd, usual = cells[bad].as_py(), cells[0].as_py()
        raise ValueError(
            f"{where(bad)} of the time column is {odd!r}: not a time stamp like the first, {usual!r}"
        )
    return complete


def _with_midnights(
    stamps: np.ndarray, cells: "pa.Array", tidy: "pa.Array", form: str, where: Callable[[int], str]
) -> np.ndarray:
    """Return stamps (N,) with the beginning of the day where a cell, or what is read of it, is a date."""
    import pyarrow as pa
    import pyarrow.compute as pc

    unread = np.flatnonzero(np.isnat(stamps))
    if len(unread):
        texts = pc.utf8_trim_whitespace(cells.take(pa.array(unread)))
        read = tidy.take(pa.array(unread))
        texts = pc.if_else(pc.equal(read, ""), texts, read)
        days = pc.if_else(pc.match_substring(texts, ":"), "", texts)  # others are not read twice
        stamps[unread] = _stamps_in(days, None, _date_of(form), where)
    return stamps


def without_clock(cells: "pa.Array", time: np.ndarray, usual: float) -> np.ndarray:
    """Return (N,) bool: which rows have a date alone where most have a clock, and do not follow the row
    before: spreadsheets write midnight so, but what stands below the samples may have a date, too.

    Args:
        cells: (N,) texts. time: (N,) s. usual: step in s.
    """
    import pyarrow as pa
    import pyarrow.compute as pc

    alone = np.zeros(len(cells), bool)
    lengths = np.asarray(pc.binary_length(cells))
    longest = int(np.argmax(lengths))
    short = np.flatnonzero(lengths <= lengths[longest] - len(" 0:00"))
    if not len(short) or ":" not in cells[longest].as_py():
        return alone
    has_none = np.asarray(pc.invert(pc.match_substring(cells.take(pa.array(short)), ":")))
    dates = short[has_none & (short > 0)]
    if 2 * len(dates) > len(cells):
        return alone
    alone[dates] = True
    before = 0
    for k in dates.tolist():
        if not alone[k - 1]:
            before = k - 1
        alone[k] = not 0 < time[k] - time[before] <= (1 + TOLERATED_STEP) * usual
    return alone


def order_of(cells: "pa.Array", stamps: np.ndarray) -> str:
    """Return the format of the dates of texts in which day, month and year could change places, "" of others.

    Args:
        cells: (N,) texts. stamps: (N,) as they were read.
    """
    ends = cells.take([0, len(cells) - 1])
    if not re.match(r"\D*\d\d?[-/.]\d", ends[0].as_py()):
        return ""
    dates: set[str] = set()
    for tidy in (_split_fraction(ends), tidied(ends)):
        first, last = tidy.texts.to_pylist()
        for form in BY_SIGNS.get(_signs(first or ""), ()):
            if _is_read_as(first, form, stamps[0]) and _is_read_as(last, form, stamps[-1]):
                dates.add(_date_of(form))
        if dates:
            break
    if len(dates) != 1 or not dates & {*ORDERS}:
        return ""
    return dates.pop()


def _is_read_as(text: str, form: str, stamp: np.datetime64) -> bool:
    """Return whether a text has a format, and is this day by it, in whatever zone."""
    return _has_format(text, form) and bool(abs(np.datetime64(datetime.strptime(text, form)) - stamp) < DAY)


def instant_of(time: object) -> float:
    """Return one time in s to a microsecond, as `Recording.instants` has it: since 1970 of dates; numbers are
    seconds, an epoch, or count the samples where nothing tells their time.

    Args:
        time: a number, text of it or of a date in any usual format, a datetime, a datetime64.

    Raises:
        ValueError: no time, a time of day without its date, a date that may be read in two ways.

    Example:
        >>> instant_of("60 s"), instant_of("2017-09-12 08:00:00.5"), instant_of(1505203200500)
        (60.0, 1505203200.5, 1505203200.5)
    """
    import pyarrow as pa

    text = str(time).strip()
    try:
        value = decimal(text.removesuffix("s"))
    except ValueError:
        pass
    else:
        if not math.isfinite(value):
            raise ValueError(f"{text!r} is no time")
        seconds = float(since_epoch(np.array([value]))[0])
        return round(seconds / (scale_of(seconds) or 1.0), 6)
    if not text:
        raise ValueError("'' is no time")
    _, stamps, hint = parse_stamps(pa.array([text]), None, lambda k: "a time")
    if stamps is None:
        raise ValueError(f"{text!r} has no date: write it as well, like 2017-09-12 08:00:00")
    if hint:
        raise ValueError(
            f"{text!r} may be read in several ways: write the year first, like 2017-09-12 08:00:00"
        )
    return round(float((stamps[0] - EPOCH) / SECOND), 6)


@lru_cache(1024)  # the rows that tell where a header stands are looked at once for each row it may be
def stamp_kind(cell: str | None, form: str = "") -> str:
    """Return the kind of a cell: "stamp" for a time stamp of any format, "day" or "clock" for half of one,
    "" for none.

    Eight digits may be a day beside a clock, but also a number: "digits". That it is no other number is
    known. form: of time stamps, where it is stated.

    Example:
        >>> cells = "2017-09-12 08:00", "20170912T080000", "12.09.2017", "20170912", "8:00 PM", "shift 2"
        >>> [stamp_kind(cell) for cell in cells]
        ['stamp', 'stamp', 'day', 'digits', 'clock', '']
    """
    import pyarrow as pa

    if not cell or not any(c.isdigit() for c in cell) or len(cell) > LONGEST:
        return ""
    if form not in DATES and _has_format(cell.strip(), form):
        return "stamp"
    if DIGITS.fullmatch(cell.strip()):
        if _has_format(cell.strip(), DATES[-1]):
            return "digits"
        return ""
    try:
        parse_stamps(pa.array([cell]), None, str)
    except ValueError:
        return ""
    cells = pa.array([cell])
    wholes = {x.texts[0].as_py() for x in (_split_fraction(cells), tidied(cells))}
    if any(_has_format(whole, form) for whole in wholes for form in DATES):
        return "day"
    if any(_has_format(whole, form) for whole in wholes for form in (*CLOCKS, MINUTES)):
        return "clock"
    return "stamp"


def with_day(days: "pa.Array", clocks: "pa.Array") -> "pa.Array":
    """Return the time stamps of two pyarrow arrays of texts, days and times of day; null where one of them
    is.
    """
    import pyarrow.compute as pc

    return pc.binary_join_element_wise(pc.utf8_trim_whitespace(days), pc.utf8_trim_whitespace(clocks), " ")


def since_epoch(values: np.ndarray) -> np.ndarray:
    """Return numbers whose digits are time stamps, 20240101080000 or 202401010800, as seconds since 1970;
    other numbers as they are.

    Example:
        >>> since_epoch(np.array([20240101080000.0, 20240101080100.0])), since_epoch(np.array([202401.0]))
        (array([1.70409600e+09, 1.70409606e+09]), array([202401.]))
    """
    import pyarrow as pa

    if not len(values) or not np.isfinite(values).all():
        return values
    first = str(int(values[0]))
    form = COMPACT.get(len(first))
    if form is None or not CENTURIES[0] <= int(first[:4]) < CENTURIES[1]:
        return values
    if (values != np.floor(values)).any():
        return values
    stamps = _stamps_in(pa.array(values.astype(np.int64)).cast(pa.string()), None, form, str)
    if np.isnat(stamps).any():
        return values
    return (stamps - EPOCH) / SECOND


def from_epoch(values: np.ndarray, scale: float) -> np.ndarray:
    """Return numbers since 1970, `scale` of them a second, as datetime64[ns]."""
    return np.round(values * (1e9 / scale)).astype("int64").astype("datetime64[ns]")


def scale_of(value: float) -> float | None:
    """Return how many units a second has of which a number may be an epoch of these years, or None.

    In seconds that is from 2001 to 2128. In smaller units it is from 1973 on: such numbers are no seconds.
    """
    for scale in EPOCHS:
        least = 1e9 if scale == 1 else 1e8 * scale
        if least <= value < 5e9 * scale:
            return scale
    return None


def time_label(seconds: float, stamp: np.datetime64 | None, step: float) -> str:
    """Return the time of a sample as text: of its time stamp if it has one, else of its seconds to a
    hundredth of a step.

    Example:
        >>> start = np.datetime64("2017-09-12T08:00:00.500")
        >>> time_label(0.30000000000000004, None, 0.01), time_label(0.0, start, 1.0)
        ('0.3 s', '2017-09-12 08:00:00.500')
    """
    if stamp is not None:
        return str(stamp.astype("datetime64[ms]")).replace("T", " ").removesuffix(".000")
    text = f"{seconds:.{max(0, 2 - math.floor(math.log10(step)))}f}"
    if "." in text:
        text = text.rstrip("0").rstrip(".")
    return f"{text} s"


def row_label(index: "pd.Index | np.ndarray | None", k: int) -> str:
    """Return the label of row k as text; index: labels of all rows, None where they have none."""
    if index is None:
        return f"sample {k}"
    return label_text(index[k])


def label_text(label: object) -> str:
    """Return the label of a row as text."""
    if isinstance(label, np.datetime64):
        return time_label(0.0, label, 1.0)
    return str(label)


def time_like(label: object) -> bool:
    """Return whether a label is text that looks like a time."""
    return isinstance(label, str) and re.search(r"\d[-/.:]\d+[-/.: T]", label + " ") is not None


def _split_fraction(cells: "pa.Array") -> Tidied:
    """Split "12:00:01.25" into "12:00:01" and 0.25 s, if the first cell has a fraction of a second."""
    import pyarrow as pa
    import pyarrow.compute as pc

    cells = pc.utf8_trim_whitespace(cells)
    if not pc.match_substring_regex(cells[:1], r":\d\d[.,]\d+$")[0].as_py():
        return Tidied(cells)
    parts = pc.extract_regex(cells, r"^(?P<whole>.*?:\d\d)[.,]?(?P<fraction>\d*)$")
    digits = pc.struct_field(parts, "fraction")
    seconds = pc.binary_join_element_wise("0.", pc.coalesce(digits, "0"), "0", "").cast(pa.float64())
    fraction = (from_arrow(seconds) * 1e9).round().astype("timedelta64[ns]")
    return Tidied(pc.coalesce(pc.struct_field(parts, "whole"), ""), fraction, fine=True)


def iso_stamps(cells: "pa.Array", where: Callable[[int], str]) -> np.ndarray | None:
    """Return datetime64[ns] of texts in ISO 8601, with or without a zone; None where some are not; of two
    rows or more whose years all are too far for it, datetime64[us].

    Args, raises: as `in_ns`.
    """
    import pyarrow as pa

    for unit in ("ns", "us"):  # a far year fits into the second only, by which it is named
        for zone in (None, "UTC"):
            try:
                stamps = from_arrow(cells.cast(pa.timestamp(unit, zone)))
            except pa.ArrowInvalid:
                continue
            if len(stamps) > 1 and _far(stamps).all():
                return stamps
            return in_ns(stamps, where)
    return None


def in_ns(stamps: np.ndarray, where: Callable[[int], str]) -> np.ndarray:
    """Return datetime64 of any unit in ns.

    Args:
        where: called with an index, returns "row 7" of the file.

    Raises:
        ValueError: a year that does not fit: NumPy would take another for it.
    """
    far = _far(stamps)
    if far.any():
        k = int(np.argmax(far))
        raise ValueError(f"{where(k)} has the time {stamps[k]}: {FAR}")
    return stamps.astype("datetime64[ns]")


def _far(stamps: np.ndarray) -> np.ndarray:
    """Return (N,) bool: whether ns since 1970 cannot tell the year of datetime64 of any unit."""
    years = stamps.astype("datetime64[Y]").astype(np.int64) + 1970
    return np.asarray(~np.isnat(stamps) & ((years < YEARS[0]) | (years > YEARS[1])))


def _signs(text: str) -> str:
    """Return the signs of a text, which are no letters or digits."""
    return re.sub(r"[\w\s]", "", text)


def _has_format(text: str, form: str) -> bool:
    try:
        datetime.strptime(text, form)
    except ValueError:
        return False
    return True


def _stamps_in(
    whole: "pa.Array", fraction: np.ndarray | None, form: str, where: Callable[[int], str]
) -> np.ndarray:
    import pyarrow.compute as pc

    seconds = pc.strptime(whole, format=form, unit="s", error_is_null=True)
    stamps = in_ns(from_arrow(seconds), where)
    if fraction is not None:
        stamps += fraction
    return stamps


def uneven_steps(time: np.ndarray, dt: float | None) -> int:
    """Return how many steps of times in s are not dt, by default the usual one."""
    steps = np.diff(time)
    if not len(steps):
        return 0
    usual = _usual(time) if dt is None else dt
    return int((np.abs(steps - usual) > TOLERATED_STEP * abs(usual)).sum())


def _usual(time: np.ndarray) -> float:
    """Return the usual step of times in s, NaN where there is none."""
    if len(time) < 2:
        return math.nan
    return float(np.median(np.diff(time)))


def _spread(time: np.ndarray, dt: float | None) -> float:
    """Return by what share steps of times in s differ on the average from dt, by default the usual one; gaps
    do not count.
    """
    usual = _usual(time) if dt is None else dt
    shares = np.abs(np.diff(time) / (usual or math.nan) - 1)
    shares = shares[shares <= TOLERATED_STEP]
    if not len(shares):
        return 0.0
    return float(shares.mean())


def _since_first(stamps: np.ndarray) -> np.ndarray:
    """Return seconds since the first time stamp."""
    return np.asarray((stamps - stamps[0]) / SECOND)


def _rounds(stamps: np.ndarray, length: float) -> np.ndarray:
    """Return the seconds of the rounds before each stamp of a clock that begins again after so many: at
    midnight, or with the hour.
    """
    back = np.diff(_since_first(stamps)) < -length / 2
    return length * np.concatenate([[0], np.cumsum(back)])


def _date_of(form: str) -> str:
    """Return the date of a format."""
    return re.split("[ T]%[HIM]", form)[0]


def order_in_words(form: str) -> str:
    """Return the order of day, month and year in a format."""
    date = _date_of(form)
    for code, word in {"%Y": "year", "%y": "year", "%m": "month", "%d": "day", "%b": "month"}.items():
        date = date.replace(code, word)
    return date
