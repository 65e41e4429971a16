"""Units that stand in the names of columns: "T_room [degC]", "Pump (bar)"."""

import re

__all__ = ["same_unit", "without_unit"]

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
