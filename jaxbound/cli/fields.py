"""Values of several fields on the command line, like --test observer=joint,order=20.

Options of before are such fields now. They are taken for one more version, without a word in the help.
"""

import argparse
import shlex
from collections.abc import Sequence
from typing import Any

from jaxbound.text.quantities import decimal

FIRST = {"TEST": "name", "RULE": "rule", "RECIPE": "file", "N|ADDRESS": "who", "A=1,B=2": "", "FIELDS": ""}
"""{metavar of an option that holds fields: the one that may stand first without its name}."""
OLD = {
    "test": "method horizon lags order observer margins outside span:window latched:latched=true",
    "alarm": "least acknowledged merge-alarms:merge suspects:suspects=true latch:latch=true",
    "workers": "scheduler:who",
    # fields of `jb.Recipe`, whose home imports NumPy, for which a help does not wait; a test compares them
    "recipe": "order delay direct:direct=true horizon lags average test observer disturbances see follow "
    "signals method safety held-out:held_out",
    "recording": "time every long",
    "scenario": "samples onset at input-range:input_range hold",
}
"""{option: options of before, each with the field that it is now if that has another name}; a field with its
value was a switch.
"""
STAYS = "--method", "--time", "--every", "--long"
"""Options of before that are no worse than their fields."""
TEXTS = {*FIRST.values(), "see", "when", "acknowledged"}
"""Fields whose values are texts, whatever they look like."""
TRUTH = {"true": True, "True": True, "false": False}
DIGITS = 20
"""A number of so many digits is not even converted to a whole one."""


class Fields(argparse.Action):
    """Gathers the fields of an option.

    Args:
        option_strings, dest, nargs, metavar, help: of `argparse.Action`. first: the field that may stand
            without its name. old: of an option of before its field, with a value where it was a switch.
    """

    def __init__(
        self,
        option_strings: Sequence[str],
        dest: str,
        first: str,
        old: str = "",
        nargs: int | None = None,
        metavar: str | None = None,
        help: str | None = None,
    ) -> None:
        super().__init__(option_strings, dest, nargs, metavar=metavar, help=help)
        self.first, self.old = first, old

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: object,
        option: str | None = None,
    ) -> None:
        """Add the fields that a text holds."""
        text = str(values)
        if self.old:
            text = self._spelled(text)
            namespace.old = [*getattr(namespace, "old", ()), (self.option_strings[0], self.dest, text)]
        known = getattr(namespace, self.dest) or {}
        try:
            setattr(namespace, self.dest, known | fields_of(text, self.first))  # the last one counts
        except ValueError as e:
            raise argparse.ArgumentError(self, str(e)) from None

    def _spelled(self, value: str) -> str:
        """Return the text of the field that an option of before sets."""
        if self.nargs == 0:
            return self.old
        if self.old == "least" and "=" in value:
            return "least." + value.replace(",", ",least.")
        if self.old == self.first:
            return value
        return f"{self.old}={value}"


def add_fields(parser: argparse.ArgumentParser, flag: str, metavar: str, about: str) -> None:
    """Add an option that holds fields, and those of before which say one of them."""
    name, first = flag.strip("-"), FIRST[metavar]
    parser.add_argument(flag, action=Fields, first=first, metavar=metavar, help=about)
    for word in OLD[name].split():
        flag, _, field = word.partition(":")
        field = field or flag
        nargs = 0 if "=" in field else None
        parser.add_argument(
            f"--{flag}", action=Fields, dest=name, first=first, old=field, nargs=nargs, help=argparse.SUPPRESS
        )


def fields_of(text: str, first: str) -> dict[str, Any]:
    """Return {field: value} of a text; a.b=1 is the entry b of a table a.

    Args:
        first: the field that may stand first without its name; "": none, and all values are texts.

    Raises:
        ValueError: no fields, or one twice.

    Example:
        >>> fields_of("2/4,latch=true,least.T1=0.5,merge=10min", "rule")
        {'rule': '2/4', 'latch': True, 'least': {'T1': 0.5}, 'merge': '10min'}
        >>> fields_of("lags=0,1,4,observer=joint", "name")
        {'lags': (0, 1, 4), 'observer': 'joint'}
    """
    entries: list[tuple[str, str]] = []
    for part in text.split(","):
        name, equals, value = part.partition("=")
        if equals:
            entries.append((name.strip(), value))
        elif entries:  # a comma within a value
            entries[-1] = entries[-1][0], f"{entries[-1][1]},{part}"
        elif first and part.strip():
            entries.append((first, part.strip()))
        else:
            raise ValueError(f"needs fields, like a=1,b=2: not {text[:60]!r}")
    fields: dict[str, Any] = {}
    for name, value in entries:
        table, key = fields, name
        if "." in name:
            outer, _, key = name.partition(".")
            table = fields.setdefault(outer, {})
        if not isinstance(table, dict) or key in table:
            raise ValueError(f"says {name} twice")
        table[key] = value.strip() if name in TEXTS or not first else _value(value)
        # lags=4 alone is a list of one, not a number
        if name == "lags" and not isinstance(table[key], tuple):
            table[key] = (table[key],)
    return fields


def _value(text: str) -> object:
    """Return numbers with commas between them, a number, a truth, or a word."""
    if "," in text:
        return tuple(map(_value, text.split(",")))
    text = text.strip()
    if text.isascii() and text.lstrip("-").isdecimal() and len(text) < DIGITS:
        return int(text)
    try:
        return decimal(text)
    except ValueError:
        return TRUTH.get(text, text)


def moved(namespace: argparse.Namespace) -> str:
    """Return the sentence on options of before in a command line, "" where there are none."""
    now: dict[str, dict[str, str]] = {}
    flags: dict[str, str] = {}
    for flag, option, text in getattr(namespace, "old", ()):
        if flag not in STAYS:
            flags[flag] = option
            now.setdefault(option, {})[flag] = text
    if not flags:
        return ""
    words = ""
    for option, texts in now.items():
        words += f" --{option} {shlex.quote(','.join(texts.values()))}"
    return f"{', '.join(flags)}: the next version takes only{words}"
