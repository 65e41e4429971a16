"""The recipe of a fit on the command line: --recipe order=1,horizon=30, or a model file that has one."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from jaxbound.text.quantities import decimal

FIELDS = (
    "order delay direct horizon lags average test observer disturbances see follow signals method safety "
    "held_out"
).split()
"""Of `jb.Recipe`, whose home imports NumPy, for which a help does not wait; a test compares them."""
TRUTH = {"true": True, "True": True, "false": False}
DIGITS = 20
"""A number of so many digits is not even converted to a whole one."""


RECIPE = {
    "--recipe A=1,B=2": "how to fit, and for which test, like order=1,horizon=30 (a window of 31 samples) or "
    "a model file, to fit as it was fitted; order, delay: numbers or auto (default: 2, 1); direct=true: "
    "inputs act at once; horizon, lags=0,1,2,4, average=8: windows; test=bank: all that see what others "
    "miss, auto: the best (default: bank, where nothing else says what is tested); observer, "
    "disturbances=auto, see=T1:bias:2: bounds of an observer, of disturbances, for these faults; "
    "follow=auto: bounds follow the operating point; signals=auto: choose inputs; method: least squares, "
    "windows, filters, auto; safety (default: 1.25); held_out (default: 0.3)",
    "--direct": argparse.SUPPRESS,
}
HIDDEN = [name for name in FIELDS if name != "direct"]
"""Fields that are options of their own, too, which help does not show."""


def recipe_fields(args: argparse.Namespace) -> tuple[Path | None, dict[str, Any]]:
    """Return (the model file whose recipe is asked for, if any, the fields that differ from it).

    Raises:
        ValueError: no fields, one that is given twice, or faults that are none.
    """
    options = [(name, str(getattr(args, name))) for name in _options(args)]
    if args.recipe.endswith(".toml"):
        return Path(args.recipe), _field_values(options)
    entries: list[tuple[str, str]] = []
    for part in filter(None, args.recipe.split(",")):
        name, equals, text = part.partition("=")
        if equals:
            entries.append((name.strip(), text))
        elif entries:  # a comma within a value
            entries[-1] = entries[-1][0], f"{entries[-1][1]},{part}"
        else:
            raise ValueError(f"--recipe needs fields, like order=1,horizon=30, or a model file: not {part!r}")
    return None, _field_values([*entries, *options])


def _field_values(entries: Sequence[tuple[str, str]]) -> dict[str, Any]:
    """Return {field: value} of texts.

    Raises:
        ValueError: a field twice.
    """
    values: dict[str, Any] = {}
    for name, text in entries:
        if name in values:
            raise ValueError(f"{name} is given twice: --recipe takes each field once")
        values[name] = _value(name, text)
    return values


def _value(name: str, text: str) -> object:
    """Return the value of a field: faults, a truth, a number, numbers with commas, or a word."""
    from jaxbound.cli.tradeoff_table import wanted_faults

    if name == "see":
        return wanted_faults(text)
    if "," in text:
        return tuple(_value(name, part) for part in text.split(","))
    try:
        number = decimal(text)
    except ValueError:
        return TRUTH.get(text.strip(), text.strip())
    if text.strip().lstrip("-").isdecimal() and len(text) < DIGITS:
        return int(text)
    return number


def _options(args: argparse.Namespace) -> list[str]:
    """Return the fields of a recipe that are given by options of their own."""
    return [name for name in FIELDS if getattr(args, name) is not None]


def recipe_hints(args: argparse.Namespace) -> list[str]:
    """Return a sentence on options that are fields of a recipe."""
    flags = ", ".join(map("--{}".format, _options(args))).replace("_", "-")
    if not flags:
        return []
    return [f"{flags}: the next version has them in a recipe alone, --recipe horizon=30,order=1"]
