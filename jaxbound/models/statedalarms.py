"""The rule of alarms that a model states: the `[alarms]` table of a model file, as a value."""

import json
import re
from collections.abc import Mapping
from typing import Any

from jaxbound.exact.linalg import Number
from jaxbound.models.filevalues import TEXT, TRUTH, ValueKind, known_fields
from jaxbound.models.numbers import number

PLAIN = "plain"
"""In place of k/n: each stretch of FAULT windows is an alarm, whatever a model states."""
RULE = re.compile(r"(\d{1,15})/(\d{1,15})", re.ASCII)


def _read_rule(field: str, where: str, value: object) -> str:
    """Return k/n, or the word for the plain rule, as text, checked."""
    if value == PLAIN:
        return PLAIN
    match = RULE.fullmatch(value) if isinstance(value, str) else None
    if match is None or not 1 <= int(match[1]) <= int(match[2]):
        raise ValueError(f"{where} needs a {field} k/n with 1 <= k <= n, like 3/5, or {PLAIN}, not {value!r}")
    return match[0]


def _read_sizes(field: str, where: str, value: Number | Mapping[str, Number]) -> float | dict[str, float]:
    """Return one size, or {output: size}."""
    if isinstance(value, Mapping):
        return {name: float(number(f"{field}.{name} of {where}", size)) for name, size in value.items()}
    return float(number(f"{field} of {where}", value))


def _spelled_sizes(sizes: float | Mapping[str, float]) -> str:
    if isinstance(sizes, Mapping):
        return f"{{{', '.join(f'{TEXT.spell(name)} = {size!r}' for name, size in sizes.items())}}}"
    return repr(sizes)


COUNT = ValueKind(lambda field, where, value: value, json.dumps)  # `AlarmRule` says what is wrong with it
ALARMS: Mapping[str, ValueKind] = {
    "rule": ValueKind(_read_rule, TEXT.spell),
    "hold": COUNT,
    "clear": COUNT,
    "merge": COUNT,
    "latch": TRUTH,
    "least": ValueKind(_read_sizes, _spelled_sizes),
    "suspects": TRUTH,
    "acknowledged": TEXT,
}
"""{field of `[alarms]`: kind of its value}: those of an `AlarmRule`, k and n of which are its rule."""


def stated_alarms(given: Mapping[str, Any] | None, where: str = "[alarms]") -> dict[str, Any]:
    """Return the fields of a rule of alarms, checked.

    Args:
        given: like {"rule": "3/5", "latch": True}. where: they stand, for sentences.

    Raises:
        ValueError: an unknown field (with the nearest one), a value of another kind.

    Example:
        >>> stated_alarms({"rule": "3/5", "least": {"T1": "0.5"}})
        {'rule': '3/5', 'least': {'T1': 0.5}}
    """
    table = known_fields(where, dict(given or {}), tuple(ALARMS))
    return {name: ALARMS[name].read(name, where, value) for name, value in table.items()}
