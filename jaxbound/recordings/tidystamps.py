"""Time stamps as servers, historians and spreadsheets write them, in the words of `timestamps.FORMATS`.

A weekday goes, a month gets its English name, a clock its colons; fractions, offsets of zones and 24:00
become something to add. Guesses of a format by other parsers (pandas, dateutil) take no more of them, and
some of a day for a month; here no digit changes its place, so that their order is asked for as ever.
"""

import re
from typing import NamedTuple

import numpy as np

from jaxbound.recordings.columns import Arrow, from_arrow

MONTHS = {
    "Jan": "january januar janvier enero gennaio gen janeiro januari jän jänner janv ene",
    "Feb": "february februar février febrero febbraio fevereiro februari fév févr fev",
    "Mar": "march märz mars marzo março maart marts mär mrz mrt",
    "Apr": "april avril abril aprile avr abr",
    "May": "mai mayo maggio maio mei maj mag",
    "Jun": "june juni juin junio giugno junho giu",
    "Jul": "july juli juillet julio luglio julho lug juil",
    "Aug": "august août agosto augustus augusti aoû ago aout",
    "Sep": "september septembre septiembre settembre setembro sept set",
    "Oct": "october oktober octobre octubre ottobre outubro okt ott out",
    "Nov": "november novembre noviembre novembro",
    "Dec": "december dezember décembre diciembre dicembre dezembro dez déc dic des",
}
"""English short names of months, and their names in languages of loggers: none of them is two months."""
MONTH_WORDS = {name: "|".join([*words.split(), name]) for name, words in MONTHS.items()}
WEEKDAYS = (
    "mon(day|tag)? mo tue(s|sday)? di(enstag)? wed(nesday)? mi(ttwoch)? thu(r|rs|rsday)? do(nnerstag)? "
    "fri(day)? fr(eitag)? sat(urday)? sa(mstag)? sun(day)? so(nntag)?"
)
ZONES = {
    "Z UTC GMT WET": 0,
    "CET MEZ WEST": 60,
    "CEST MESZ EET": 120,
    "EEST MSK": 180,
    "EDT": -240,
    "EST CDT": -300,
    "CST MDT": -360,
    "MST PDT": -420,
    "PST": -480,
}
"""Names of zones, those of America as mail has them (RFC 2822), and their minutes before Greenwich."""
CLOCK = r"\d{1,2}:\d\d(?::\d\d)?"
ZONE = r"[A-Z]{1,5}|(?:UTC|GMT)?[+-]\d{1,2}(?::?\d\d)?|[A-Z][A-Za-z]+/[A-Za-z_/+-]+"
REWRITTEN = (
    ("[\u00a0\u202f\u2009\\s]+", " "),
    (r"^ | $", ""),
    (r"^\[([^\]]*)\]$", r"\1"),
    (rf"(?i)^({'|'.join(WEEKDAYS.split())})[.,]* ", ""),
    *((rf"(?i)(^|[^a-zà-ÿ])({words})\b\.?", rf"\1{name}") for name, words in MONTH_WORDS.items()),
    (r", ", " "),
    (r"(?i) ?uhr$", ""),
    # the day before the month, whatever stands between them
    (r"^(\d{1,2})[-/. ]*([A-Z][a-z][a-z])[-/. ]*(\d{4}|\d\d)\b:?", r"\1 \2 \3 "),
    (r"^(\d{4})[-/. ]([A-Z][a-z][a-z])[-/. ](\d{1,2})\b:?", r"\3 \2 \1 "),
    (r" +", " "),
    (rf"^([A-Z][a-z][a-z] \d{{1,2}}) ({CLOCK}(?:[.,]\d+)?) (?:([A-Z]+) )?(\d{{4}})$", r"\1 \4 \2 \3"),
    (r"(\d)[_ T](\d{1,2})[.-](\d\d)[.-](\d\d)( ?[AaPp]\.?[Mm]\.?)?$", r"\1 \2:\3:\4\5"),
    (r"_(\d{1,2}:)", r" \1"),
    (r"(\d) ?[Aa]\.? ?[Mm]\.?$", r"\1 AM"),
    (r"(\d) ?[Pp]\.? ?[Mm]\.?$", r"\1 PM"),
    (r"(:\d\d:\d\d):(\d{3})$", r"\1.\2"),
    (r"([+-]\d\d:?\d\d)\[[A-Za-z_/+-]+\]$", r"\1"),
    (r" $", ""),
)
"""(pattern, text in its place), one after the other."""
PARTS = (
    rf"^(?P<whole>.*?{CLOCK})(?:[.,](?P<fraction>\d+))?(?P<half> [AP]M)?"
    rf"(?: ?[\[(]?(?P<zone>{ZONE})[\])]?)?$"
)
MIDNIGHT = r"(^|[ T])24:00(:00)?$"
OF_YEAR = r"^(?P<year>\d{4})-(?:(?P<day>\d{3})|W(?P<week>\d\d)-?(?P<weekday>[1-7]))(?P<clock>[ T].*)?$"
SPAN = r"^(?:(?P<days>-?\d+)(?: days?,? \+?|\.))?(?P<h>\d+):(?P<m>[0-5]\d):(?P<s>[0-5]\d)(?:[.,](?P<f>\d+))?$"
ISO_SPAN = r"^P(?:(?P<days>\d+)D)?T(?:(?P<h>\d+)H)?(?:(?P<m>\d+)M)?(?:(?P<s>\d+)(?:[.,](?P<f>\d+))?S)?$"
DAY = np.timedelta64(86400 * 10**9, "ns")


class Tidied(NamedTuple):
    """Time stamps in usual forms.

    Fields: texts (N,): null where nothing is known; more (N,) timedelta64[ns]: to add to what they say, None:
    nothing; zones (N,): names, "" where there is none, None: there are none; fine: whether some have a
    fraction of a second.
    """

    texts: Arrow
    more: np.ndarray | None = None
    zones: "Arrow | None" = None
    fine: bool = False


def tidied(cells: Arrow) -> Tidied:
    """Return time stamps (N,) in usual forms."""
    import pyarrow.compute as pc

    texts = cells
    for pattern, replacement in REWRITTEN:
        texts = pc.replace_substring_regex(texts, pattern, replacement)
    parts = pc.extract_regex(texts, PARTS)
    whole = pc.binary_join_element_wise(_field(parts, "whole"), _field(parts, "half"), "")
    texts = pc.if_else(pc.is_valid(parts), whole, texts)
    fractions = _field(parts, "fraction")
    late = _mask(pc.match_substring_regex(texts, MIDNIGHT))
    texts, days = _of_year(pc.replace_substring_regex(texts, MIDNIGHT, r"\100:00\2"))
    more = _nanoseconds(fractions) + (days + late) * DAY
    return Tidied(texts, more, _field(parts, "zone"), bool((_lengths(fractions) > 0).any()))


def elapsed(cells: Arrow) -> np.ndarray | None:
    """Return spans of time, like 0 days 00:01:00, 1.00:01:00, PT1M or 25:13:00, as timedelta64[ns]; None
    where some are none, or all may be times of a day.
    """
    import pyarrow.compute as pc

    cells = pc.utf8_trim_whitespace(cells)
    for pattern in (SPAN, ISO_SPAN):
        parts = pc.extract_regex(cells, pattern)
        if parts.null_count:
            continue
        counts = {name: _whole_numbers(_field(parts, name)) for name in ("days", "h", "m", "s")}
        seconds = 3600 * counts["h"] + 60 * counts["m"] + counts["s"]
        has_days = bool((_lengths(_field(parts, "days")) > 0).any())
        if pattern == SPAN and not has_days and (seconds <= 86400).all():
            return None  # a clock
        spans = (86400 * counts["days"] + seconds) * np.timedelta64(1, "s")
        return np.asarray(spans.astype("timedelta64[ns]") + _nanoseconds(_field(parts, "f")))
    return None


def zoned(stamps: np.ndarray, zones: Arrow, second: float | None = None) -> np.ndarray:
    """Return local times (N,) of named zones as those of Greenwich. second: as `localized` takes it, where
    both have one zone.

    Raises:
        ValueError: a zone that is not known, some stamps with and some without one, a time that the clock of
            its zone leaves out.
    """
    import pyarrow.compute as pc

    names = pc.unique(zones).to_pylist()
    if names == [""]:
        return stamps
    if "" in names:
        raise ValueError("some have a zone and others have none")
    found = stamps.copy()
    for name in names:
        here = _mask(pc.equal(zones, name))
        minutes = _offset(name)
        if minutes is not None:
            found[here] = stamps[here] - np.timedelta64(minutes, "m")
        else:
            found[here] = localized(stamps[here], name, second if here[:2].all() else None)
    return found


def localized(stamps: np.ndarray, zone: str, second: float | None = None) -> np.ndarray:
    """Return times (N,) of the clock of a zone as those of Greenwich. Of an hour that the clock has twice the
    first is meant, until it goes back.

    Args:
        second: seconds from the first to the second, where those between, now gone, told them.

    Raises:
        ValueError: no such zone; a time that its clock leaves out.
    """
    from zoneinfo import ZoneInfoNotFoundError

    import pandas as pd

    index = pd.DatetimeIndex(stamps)
    try:
        summer = index.tz_localize(zone, ambiguous=np.ones(len(index), bool), nonexistent="NaT")
        winter = index.tz_localize(zone, ambiguous=np.zeros(len(index), bool), nonexistent="NaT")
    except (ZoneInfoNotFoundError, KeyError, ValueError):
        raise ValueError(f"there is no zone {zone!r}") from None
    if (summer.isna() & ~index.isna()).any():
        missing = index[summer.isna() & ~index.isna()][0]
        raise ValueError(f"the clock of {zone} has no {missing}, where it goes forward")
    early, late = (x.tz_convert(None).to_numpy("datetime64[ns]") for x in (summer, winter))
    found: np.ndarray = early.copy()
    for k in np.flatnonzero(early != late):
        is_late = k > 0 and early[k] <= found[k - 1]
        if k == 1 and second is not None:  # that which is nearer to it
            is_late = 2e9 * second > int(early[1] - early[0]) + int(late[1] - early[0])
        if is_late:
            found[k] = late[k]
    return found


def _offset(name: str) -> int | None:
    """Return the minutes of a zone before Greenwich, None of one that is known by its place."""
    for names, minutes in ZONES.items():
        if name in names.split():
            return minutes
    numeric = re.fullmatch(r"(?:UTC|GMT)?([+-])(\d{1,2})(?::?(\d\d))?", name)
    if numeric is None:
        return None
    return int(f"{numeric[1]}1") * (60 * int(numeric[2]) + int(numeric[3] or 0))


def _of_year(texts: Arrow) -> tuple[Arrow, np.ndarray]:
    """Return (texts that begin with a day, days to add) of those that count the days or weeks of a year."""
    import pyarrow.compute as pc

    parts = pc.extract_regex(texts, OF_YEAR)
    if parts.null_count == len(parts):
        return texts, np.zeros(len(texts), np.int64)
    fields = {name: _field(parts, name) for name in ("year", "clock", "week", "day", "weekday")}
    by_week = _lengths(fields["week"]) > 0
    years = np.maximum(_whole_numbers(fields["year"]), 1)
    january = (years - 1970).astype("datetime64[Y]").astype("datetime64[D]").astype(np.int64)
    fourth = (january + 3 + 3) % 7  # weekday of 4 January, which lies in the first week; 0: a Monday
    weeks = 7 * (_whole_numbers(fields["week"]) - 1) + _whole_numbers(fields["weekday"]) - 1 + 3 - fourth
    days = np.where(by_week, weeks, _whole_numbers(fields["day"]) - 1)
    begun = pc.binary_join_element_wise(fields["year"], "-01-01", fields["clock"], "")
    return pc.if_else(pc.is_valid(parts), begun, texts), np.where(_mask(pc.is_valid(parts)), days, 0)


def _field(parts: Arrow, name: str) -> Arrow:
    """Return a group of matches, "" where there is no match."""
    import pyarrow.compute as pc

    return pc.fill_null(pc.struct_field(parts, name), "")


def _mask(found: Arrow) -> np.ndarray:
    import pyarrow.compute as pc

    return np.asarray(pc.fill_null(found, False).to_numpy(zero_copy_only=False), bool)


def _lengths(texts: Arrow) -> np.ndarray:
    import pyarrow.compute as pc

    return np.asarray(pc.utf8_length(texts).to_numpy(zero_copy_only=False))


def _whole_numbers(texts: Arrow) -> np.ndarray:
    """Return whole numbers, 0 where there is none."""
    import pyarrow as pa
    import pyarrow.compute as pc

    digits = pc.if_else(pc.equal(texts, ""), "0", texts)
    return np.asarray(digits.cast(pa.int64()).to_numpy(zero_copy_only=False))


def _nanoseconds(fractions: Arrow) -> np.ndarray:
    """Return digits behind the point of a second as timedelta64[ns]."""
    import pyarrow as pa
    import pyarrow.compute as pc

    seconds = pc.binary_join_element_wise("0.", fractions, "0", "").cast(pa.float64())
    return np.asarray((from_arrow(seconds) * 1e9).round().astype("timedelta64[ns]"))
