"""Tests that a model states for its monitor: the `[[test]]` tables of a model file, as values.

A test says how far it looks back (windows, lags, an observer), by how much the bounds of the model are wider
for it, under which condition it holds, and which numbers of the model are others for it.
"""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from fractions import Fraction
from typing import Any, TypeAlias

import numpy as np

from jaxbound.exact.linalg import Number, rational
from jaxbound.models.arguments import listed_argument, whole_horizon, whole_lags
from jaxbound.models.filevalues import (
    NUMBER,
    TEXT,
    TRUTH,
    Table,
    checked_table,
    in_list,
    known_fields,
    number_text,
)
from jaxbound.models.numbers import is_whole, number
from jaxbound.recordings.expressions import expression

OTHERWISE = "otherwise"
"""The condition that holds where none of the other tests' conditions does."""
OPTIONS = ("latched", "order", "weight", "window")
"""Options of a test by an observer."""
FIELDS = ("name", "horizon", "lags", "observer", *OPTIONS, "factor", "when", "model")
LOOKS = ("horizon", "lags", "observer")
"""How far a test looks back: one of these at most."""
WORDS = ("name", "unit", "column", "times", "time", "where", "every")
"""Fields of a model that hold text, which may look like a number."""
DECIMAL = re.compile(r"[-+]?(0|[1-9]\d*)(\.\d+)?([eE][-+]?\d+)?")


@dataclass(frozen=True)
class StatedTest:
    """One test of a monitor, as a model states it. `stated_tests` builds it of a table.

    Fields: name; horizon, lags: of windows; observer: the method of an observer; all None: the windows of the
    model. options: of the observer, pairs (option, value). factor: on the tolerance, noise, averages and
    disturbances of the model. when: a condition on columns, `OTHERWISE`, or None: it always holds. changes:
    fields of the model file that are others for this test, as TOML has them.
    """

    name: str
    horizon: int | None = None
    lags: tuple[int, ...] | None = None
    observer: str | None = None
    options: tuple[tuple[str, Any], ...] = ()
    factor: Fraction = Fraction(1)
    when: str | None = None
    changes: Mapping[str, Any] = field(default_factory=dict, hash=False)

    @property
    def states_bounds(self) -> bool:
        """Whether bounds are stated for this test, and not for the windows of the model alone."""
        return self.factor != 1 or bool(self.changes)

    def words(self, samples: int | None = None) -> str:
        """Return how far the test looks back and how wide its bounds are, in words.

        Args:
            samples: of a window, where the model says it.

        Example:
            >>> (test,) = stated_tests([{"name": "slow", "lags": [0, 1, 4], "factor": 1.2}])
            >>> test.words()
            'lags 0, 1, 4, bounds times 1.2'
        """
        if self.observer is not None:
            text = f"observer {self.observer}"
            for key, value in self.options:
                text += f", {key} {_option_text(value)}".removesuffix(" true")
        elif self.lags is not None:
            text = f"lags {', '.join(map(str, self.lags))}"
        elif samples is not None:
            text = f"windows of {samples} samples"
        else:
            text = "windows of the model"
        if self.factor != 1:
            text += f", bounds times {NUMBER.spell(self.factor)}"
        if self.changes:
            text += ", numbers of its own"
        return text


StatedTests: TypeAlias = Sequence[StatedTest | Mapping[str, Any]]
"""Tests, or tables with the fields of one."""


def stated_tests(given: StatedTests | None) -> tuple[StatedTest, ...]:
    """Return the tests of a model, checked.

    Args:
        given: tests, or tables like {"name": "slow", "lags": [0, 1, 2, 4], "factor": 1.2}.

    Raises:
        ValueError: an unknown field (with the nearest one), a name that is missing or used twice, two ways to
            look back, options of another way, a condition that cannot be read, a factor that is not above 0.
    """
    tests: list[StatedTest] = []
    stated = listed_argument("tests", given or (), "[{'name': 'slow', 'lags': [0, 1, 4]}]")
    for i, table in enumerate(stated):
        test = table
        if not isinstance(test, StatedTest):
            place = f"number {i + 1} of test"
            fields = dict(checked_table(place, table))
            if "name" not in fields:
                raise ValueError(f"{place} needs a name")
            name = TEXT.read("name", place, fields["name"])
            test = stated_test(f"test {name!r}", fields)
        if test.name in [other.name for other in tests]:
            raise ValueError(f"two tests are called {test.name!r}: each needs a name of its own")
        tests.append(test)
    conditions = {test.when for test in tests if test.when is not None}
    if conditions == {OTHERWISE}:
        raise ValueError(
            f'when = "{OTHERWISE}" means where no other condition holds: no other test has a condition'
        )
    return tuple(tests)


def stated_test(where: str, table: Table) -> StatedTest:
    """Return the test that a table with a name states. where: for sentences on what is wrong with it."""
    known_fields(where, table, FIELDS)
    looks = [key for key in LOOKS if table.get(key) is not None]
    if len(looks) > 1:
        raise ValueError(f"{where} has {looks[0]} and {looks[1]}: a test looks back in one way")
    observer, lags = table.get("observer"), table.get("lags")
    if lags is not None:
        lags = whole_lags(lags, f"lags of {where}")
    if observer is not None:
        observer = TEXT.read("observer", where, observer)
    return StatedTest(
        table["name"],
        whole_horizon(table.get("horizon"), f"horizon of {where}"),
        lags,
        observer,
        _options(where, table),
        _factor(where, table.get("factor", 1)),
        _condition(where, table.get("when")),
        checked_table(f"model of {where}", _as_in_a_file(table.get("model", {}))),
    )


def _as_in_a_file(value: object) -> object:
    """Return fields of a model as TOML has them: decimals as texts."""
    if isinstance(value, Mapping):
        return {key: _as_in_a_file(x) for key, x in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return list(map(_as_in_a_file, value))
    if isinstance(value, float | Fraction | Decimal | np.floating):
        return number_text(rational(value))
    if isinstance(value, np.integer):
        return int(value)
    return value


def _options(where: str, table: Table) -> tuple[tuple[str, Any], ...]:
    """Return the options of an observer; refuse them beside windows."""
    chosen: list[tuple[str, Any]] = []
    for key in OPTIONS:
        if key not in table:
            continue
        if table.get("observer") is None:
            raise ValueError(f'{key} of {where} is for an observer: it has none, like observer = "joint"')
        value = table[key]
        if key == "latched":
            value = TRUTH.read(key, where, value)
        elif key == "weight":
            many = np.atleast_1d(np.asarray(value, object))
            value = tuple(number(f"weight of {where}", x) for x in many)
        elif not is_whole(value):
            raise ValueError(f"{key} of {where} must be a whole number, not {value!r}")
        chosen.append((key, value))
    return tuple(chosen)


def _factor(where: str, given: Number) -> Fraction:
    factor = number(f"factor of {where}", NUMBER.read("factor", where, _as_in_a_file(given)))
    if factor <= 0:
        raise ValueError(f"factor of {where} must be above 0, not {given!r}")
    return factor


def _condition(where: str, given: object) -> str | None:
    """Return a condition without blanks around it; refuse one that cannot be read."""
    if given is None:
        return None
    text = str(TEXT.read("when", where, given)).strip()
    if text == OTHERWISE:
        return text
    try:
        return expression(text).text
    except ValueError as e:
        raise ValueError(f"when of {where}: {e}") from None


def test_lines(test: StatedTest) -> Iterator[str]:
    """Yield the lines of the `[[test]]` table of a test."""
    yield "[[test]]"
    yield f"name = {TEXT.spell(test.name)}"
    if test.horizon is not None:
        yield f"horizon = {test.horizon}"
    if test.lags is not None:
        yield f"lags = {in_list(map(str, test.lags))}"
    if test.observer is not None:
        yield f"observer = {TEXT.spell(test.observer)}"
    for key, value in test.options:
        yield f"{key} = {_option_text(value)}"
    if test.factor != 1:
        yield f"factor = {NUMBER.spell(test.factor)}"
    if test.when is not None:
        yield f"when = {TEXT.spell(test.when)}"
    if test.changes:
        yield from _table_lines("test.model", test.changes)


def _option_text(value: object) -> str:
    """Return an option as TOML has it."""
    if isinstance(value, tuple):
        return in_list(map(NUMBER.spell, value))
    return json.dumps(value)


def _table_lines(place: str, table: Mapping[str, Any]) -> Iterator[str]:
    """Yield the lines of a table of a model, its own fields before the tables inside it."""
    inside = {}
    yield f"[{place}]"
    for key, value in table.items():
        if isinstance(value, dict) or (isinstance(value, list) and value and isinstance(value[0], dict)):
            inside[key] = value
        else:
            yield f"{key} = {_value_text(key, value)}"
    for key, value in inside.items():
        if isinstance(value, dict):
            yield from _table_lines(f"{place}.{key}", value)
            continue
        for entry in value:
            fields = [f"{name} = {_value_text(name, x)}" for name, x in entry.items()]
            yield f"[[{place}.{key}]]"
            yield from fields


def _value_text(key: str, value: object) -> str:
    """Return a value as TOML has it; decimals, which were read as text, as numbers."""
    if isinstance(value, list | tuple):
        return in_list(_value_text(key, x) for x in value)
    if isinstance(value, dict):
        return "{" + ", ".join(f"{name} = {_value_text(name, x)}" for name, x in value.items()) + "}"
    if isinstance(value, str) and (key in WORDS or not DECIMAL.fullmatch(value)):
        return TEXT.spell(value)
    if isinstance(value, str):
        return value
    return json.dumps(value)
