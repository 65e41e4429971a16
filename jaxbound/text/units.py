"""Units that stand in the names of columns: "T_room [degC]", "Pump (bar)"."""

import re

BRACKETS = re.compile(r"\s*(\S.*?)\s*\[\s*([^\[\]]+?)\s*\]\s*")
PARENTHESES = re.compile(r"\s*(\S.*?)\s*\(\s*([^()]+?)\s*\)\s*")
# In parentheses other words stand too, "T (upper)": there a unit is one of these, or made of them by / and *.
KNOWN = frozenset(
    "% ppm degC degF °C °F ℃ K Pa hPa kPa MPa bar mbar psi V mV kV A mA kA W kW MW Wh kWh MWh VA kVA Hz kHz "
    "rpm m mm cm km m2 m² m3 m³ l L ml g kg t N kN Nm J kJ MJ rad deg ms s min h d Ohm Ω".split()
)
SPELLED = {
    "°C": "degC",
    "℃": "degC",
    "C": "degC",
    "°F": "degF",
    "percent": "%",
    "L": "l",
    "m²": "m2",
    "m³": "m3",
}


TIME_UNITS = {
    "ns": "ns nanosecond nanoseconds",
    "us": "us \u00b5s \u03bcs usec microsecond microseconds micros",
    "ms": "ms msec millisecond milliseconds millis",
    "s": "s sec secs second seconds sek sekunde sekunden",
    "min": "min mins minute minutes minuten",
    "h": "h hr hrs hour hours std stunde stunden",
    "d": "d day days tag tage",
}
"""Units of times and their spellings, in lower case."""
UNITS_OF_TIME = "|".join(" ".join(TIME_UNITS.values()).split())
"""All spellings, as a part of a regular expression."""
ENDS_IN_UNIT = re.compile(rf"(?:.*[\s_/.,;:\-\[(])?({UNITS_OF_TIME})\s*[\])]?")
OF_A_DAY = re.compile(r".*of[ _](the[ _])?day")


def time_unit(column: str) -> str:
    """Return the unit in which the name of a column of times ends, "" where it ends in none.

    Example:
        >>> [time_unit(c) for c in ("Time [h]", "t_ms", "Zeit in Minuten", "time of day", "timestamp")]
        ['h', 'ms', 'min', '', '']
    """
    name = column.strip().lower()
    found = ENDS_IN_UNIT.fullmatch(name)
    if found is None or OF_A_DAY.fullmatch(name):
        return ""
    for unit, words in TIME_UNITS.items():
        if found[1] in words.split():
            return unit
    return ""


def without_unit(column: str) -> tuple[str, str]:
    """Return (name, unit) of a column, its unit "" where the name has none; an expression has none.

    Example:
        >>> [without_unit(c) for c in ("T_room [degC]", "Pump (bar)", "T (upper)", "= a - `b [V]`")]
        [('T_room', 'degC'), ('Pump', 'bar'), ('T (upper)', ''), ('= a - `b [V]`', '')]
    """
    if column.lstrip().startswith("="):
        return column, ""
    if found := BRACKETS.fullmatch(column):
        return found[1], found[2]
    if (found := PARENTHESES.fullmatch(column)) and set(re.split(r"[/*·]", found[2])) <= KNOWN:
        return found[1], found[2]
    return column, ""


def same_unit(one: str, other: str) -> bool:
    """Return whether two texts are the same unit, in one of its usual spellings.

    Example:
        >>> same_unit("°C", "degC"), same_unit("bar", "mbar")
        (True, False)
    """
    return SPELLED.get(one.strip(), one.strip()) == SPELLED.get(other.strip(), other.strip())
