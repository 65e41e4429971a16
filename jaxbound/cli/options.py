"""The options that several commands share, and the values that they are read as.

A command declares its own beside these. They import nothing heavy, neither jax nor NumPy, because
help and completion are to be there at once.
"""

import argparse
from argparse import ArgumentTypeError
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from jaxbound.cli.fields import DIGITS, FIRST, add_fields
from jaxbound.cli.terminal import NORMAL, QUIET, VERBOSE
from jaxbound.estimation.methods import OBSERVERS
from jaxbound.text.quantities import decimal

LARGEST = 10**15


@dataclass(frozen=True)
class Options:
    """The options of a command, declared once.

    Fields:
        help: {usage: its help}, in the order of the help. A usage is "--out DIR", "--json", or of an argument
            without dashes its name and how it is shown: "data DATA"; "..." behind it takes several, brackets
            around it none or one. A metavar of PATHS is a path, one of `fields.FIRST` holds fields.
        more: the same of options that only --help all shows.
        readers: {name: reader of its text} of the others that are no texts. defaults: {name: value}, else
            None, or False of a switch. required: names. choices: {name: the values that there are}.
    """

    help: Mapping[str, str]
    readers: dict[str, Callable[[str], object]] = field(default_factory=dict)
    defaults: dict[str, object] = field(default_factory=dict)
    required: Sequence[str] = ()
    choices: dict[str, Sequence[str]] = field(default_factory=dict)
    more: Mapping[str, str] = field(default_factory=dict)

    @property
    def rare(self) -> list[str]:
        """The names of the options that only --help all shows."""
        return [_parts(usage)[1] for usage in self.more]

    def add_to(self, parser: argparse.ArgumentParser) -> None:
        """Add the options to a parser."""
        for usage, about in {**self.help, **self.more}.items():
            flag, name, metavar = _parts(usage)
            if metavar in FIRST:
                add_fields(parser, flag, metavar, about)
                continue
            parser.add_argument(flag, help=about, **self._keywords(name, metavar))

    def _keywords(self, name: str, metavar: str) -> dict[str, Any]:
        """Return the keywords of `add_argument` beside the help."""
        if not metavar:
            return {"action": "store_true", "default": self.defaults.get(name, False)}
        shown = metavar.removesuffix(" ...").strip("[]")
        keywords: dict[str, Any] = {"metavar": shown}
        if shown.endswith(PATHS):
            keywords["type"] = path
        if metavar.endswith("..."):
            keywords["nargs"] = "+"
        elif metavar.startswith("["):
            keywords["nargs"] = "?"
        if name in self.required:
            keywords["required"] = True
        values: dict[str, Mapping[str, object]] = {
            "type": READERS | self.readers,
            "default": DEFAULTS | self.defaults,
            "choices": self.choices,
        }
        for word, named in values.items():
            if name in named:
                keywords[word] = named[name]
        return keywords


PATHS = "DATA", "DIR", "FILE", "HEALTHY", "MANIFEST", "PNG", "TRAINING", ".toml", ".json"
"""Ends of metavars that name a file or a folder."""


def _parts(usage: str) -> tuple[str, str, str]:
    """Return (flag, name, metavar) of a usage."""
    flag, _, metavar = usage.partition(" ")
    return flag, flag.strip("-").replace("-", "_"), metavar


def reading(default: str = "that of the model", more: str = "") -> dict[str, str]:
    """Return --recording. default: of its field every. more: fields that a command takes besides."""
    return {
        "--recording FIELDS": "how files are read: every=15min (samples are the means of what was recorded "
        "within each such interval of the clock, in ms, s, min, h or d; default: "
        f"{default}); and how they are written, beside [recording] of the model file, like "
        "header=3,decimal=comma: header (row), skip (rows), comment, delimiter, decimal, thousands, "
        "encoding; time (column), time_format, time_unit, zone; missing, on, off (words); hold, deadband, "
        "equal, long (columns of tags and of values) "
        f"(default: found by looking){more}"
    }


def sampling(args: argparse.Namespace) -> tuple[dict[str, str], float | None]:
    """Return (fields of --recording without dt, dt in s or None), of a command without a model.

    Raises:
        ValueError: dt is no number.
    """
    fields = dict(args.recording or {})
    stated = fields.pop("dt", None)
    if stated is None:
        return fields, args.dt
    try:
        return fields, decimal(stated)
    except ValueError:
        raise ValueError(f"--recording: dt is a number of seconds, not {stated!r}") from None


CLAIMS = "; margins=exact or bounds (faster); outside=undecided: no FAULT outside the ranges of the model"
"""Fields of a test, of commands that claim faults."""


def test(more: str = "") -> dict[str, str]:
    """Return --test. more: fields that the command takes besides."""
    observers = "; ".join(f"{name}: {kind.about}" for name, kind in OBSERVERS.items())
    return {
        "--test TEST": "the name of a [[test]] of the model file, or fields of one: horizon=30 (windows of "
        "31 samples), lags=0,1,2,4, observer=joint,order=20,latched=true, factor=1.5; or method=box (faster, "
        f"sees less){more}; observers are {observers} (default: all tests that the model states, else its "
        "windows)"
    }


RULE = {
    "--alarm RULE": "3/5: an alarm needs 3 FAULT among 5 windows; plain: each stretch of FAULT is one, as of "
    "faults that end; or fields of [alarms] of the model file: rule=3/5, latch=true (on until a repair, or "
    "an acknowledgement), merge=10min (alarms so far apart are one, merge=10 counts samples), suspects=true, "
    "least=0.5 or least.T1=0.5 (smaller errors make none), acknowledged=FILE (default: those of the model, "
    "else plain)"
}
COVERAGE = {"--min-coverage F": "least share of decided windows (default: 0.5)"}
"""By which verdicts become a conclusion."""
ENGINE = {
    "--workers N|ADDRESS": "let N processes of this machine do the work (needs dask), or the workers of a "
    "dask scheduler, like tcp://host:8786; they see all files by the same paths"
}
JSON = {"--json": "a machine-readable summary on stdout, nothing else"}
FORCE = {"--force": "replace files that are there; never one that is read"}


def add_loudness(parser: argparse.ArgumentParser) -> None:
    """Add -q and -v, which every command has."""
    one = parser.add_mutually_exclusive_group()
    one.add_argument(
        "-q",
        "--quiet",
        action="store_const",
        const=QUIET,
        dest="loudness",
        help="print the first line of the conclusion alone, and no progress",
    )
    one.add_argument(
        "-v",
        "--verbose",
        action="store_const",
        const=VERBOSE,
        dest="loudness",
        help="say more: when each stage begins, all of a certificate, the traceback of an internal error",
    )
    parser.set_defaults(loudness=NORMAL)


def named(text: str) -> str:
    """Return a name as it is, unless it is empty."""
    if not text.strip():
        raise ArgumentTypeError("needs a name, not an empty text")
    return text


def path(text: str) -> Path:
    """Return a path."""
    return Path(named(text))


def _is_whole(text: str) -> bool:
    return text.isascii() and text.isdecimal()


def whole_number(least: int = 0, most: int = LARGEST) -> Callable[[str], int]:
    """Return a reader of whole numbers between two."""

    def read(text: str) -> int:
        # int() of a million digits takes minutes
        is_long = len(text) >= DIGITS
        if not _is_whole(text) or (not is_long and int(text) < least):
            raise ArgumentTypeError(f"needs a whole number >= {least}, not {text[:40]!r}")
        if is_long or int(text) > most:
            raise ArgumentTypeError(f"needs a whole number of at most {most}, not {text[:40]}")
        return int(text)

    return read


def some_of(k: str, example: str) -> Callable[[str], tuple[int, int]]:
    """Return a reader of k/n with 1 <= k <= n. k: the letter that stands for it; example: a valid text."""

    def read(text: str) -> tuple[int, int]:
        first, slash, n = text.partition("/")
        if not slash or not _is_whole(first) or not _is_whole(n) or not 1 <= int(first) <= int(n):
            raise ArgumentTypeError(f"needs {k}/n with 1 <= {k} <= n, like {example}, not {text!r}")
        return int(first), int(n)

    return read


def rule(text: str) -> str:
    """Return k/n, or the word for the plain rule, as it is written."""
    if text != "plain":
        some_of("k", "3/5")(text)
    return text


def share(text: str) -> float:
    """Return a number between 0 and 1."""
    try:
        number = decimal(text)
    except ValueError:
        number = -1.0
    if not 0 <= number <= 1:
        raise ArgumentTypeError(f"needs a share between 0 and 1, not {text!r}")
    return number


READERS: dict[str, Callable[[str], object]] = {"min_coverage": share}
"""Of the options that several commands share."""
DEFAULTS: dict[str, object] = {"min_coverage": 0.5}
