"""The options that several commands share, and the values that they are read as.

A command declares its own beside these. They import nothing heavy, neither jax nor NumPy, because
help and completion are to be there at once.
"""

import argparse
from argparse import ArgumentTypeError
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxbound.cli.terminal import NORMAL, QUIET, VERBOSE, Refused
from jaxbound.estimation.methods import OBSERVERS, observer_method, shell_options
from jaxbound.text.quantities import decimal

if TYPE_CHECKING:
    from jaxbound.diagnosis.alarmrule import AlarmRule
    from jaxbound.runs.ask import Ask

OBSERVER = "observer"
# A text of its own, because the home of these methods imports jax, for which a help does not wait. A test
# compares it with `consistency.interface.METHODS`.
METHODS = "windows, box"
WINDOWS = "windows", "joint"
"""The exact test of windows: as the command line calls it, and as the library does."""
MARGINS = "auto", "bounds", "exact"  # likewise
OUTSIDE = "fault", "undecided"  # likewise, of `consistency.claims`
LARGEST = 10**15
DIGITS = 20  # a number of so many digits is not even converted


def method_name(text: str) -> str:
    """Return the name that the library has for a method of the command line.

    Example:
        >>> method_name("windows"), method_name("box")
        ('joint', 'box')
    """
    called, name = WINDOWS
    if text == called:
        return name
    return text


def observer_name(text: str) -> str:
    """Return the name of a method of observers; another one is refused with the names that there are."""
    try:
        observer_method(text)
    except ValueError as e:
        raise ArgumentTypeError(str(e)) from None
    return text


def refuse_unknown_method(method: str, known: str) -> None:
    """Raise Refused for a method that is neither among `known`, with commas, nor registered as a family."""
    if method in (*known.split(", "), *WINDOWS):
        return
    from jaxbound.consistency.interface import FAMILIES, GONE  # only now: a help is to be there at once

    if method in GONE:
        raise Refused(f"--method {method!r} is gone: {GONE[method].replace('joint', WINDOWS[0])}")
    if method not in FAMILIES:
        raise Refused(f"--method must be one of {', '.join((known, *FAMILIES))}, not {method!r}")


@dataclass(frozen=True)
class MethodOptions:
    """The test that a command is to make: its method, the windows, and the set of an observer.

    Fields:
        method: one of METHODS, "observer", or, for a command that has it, "validation".
        horizon, lags: the windows; None: those of the model.
        order, latched, observer: of an observer, see `SET_OBSERVER`.
        margins: one of MARGINS, see `MARGINS_KIND`. outside: one of OUTSIDE, see `OUTSIDE_WORD`.
        every: see `every`; None: that of the model.
        settings: {field: value} of the observer's own options, see `estimation.methods.ShellOption`.
    """

    method: str = "joint"
    horizon: int | None = None
    lags: tuple[int, ...] | None = None
    order: int | None = None
    latched: bool = False
    observer: str | None = None
    margins: str = MARGINS[0]
    every: str | None = None
    outside: str = OUTSIDE[0]
    settings: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def of(cls, args: argparse.Namespace) -> "MethodOptions":
        """Return the options of a command line; a command without one of them has its default.

        An option of argparse and the field that it sets have one name.
        """
        given = {f.name: getattr(args, f.name) for f in fields(cls) if hasattr(args, f.name)}
        settings = {}
        for option in shell_options():
            value = getattr(args, option.dest, None)
            if value is not None:
                settings[option.field] = value
        return cls(settings=settings, **given)

    @property
    def observes(self) -> bool:
        """Whether an observer is asked for."""
        return self.method == OBSERVER

    @property
    def ask(self) -> "Ask":
        """The test that is asked for, as `runs` takes it."""
        from jaxbound.runs.ask import Ask  # only now: a help is to be there at once

        return Ask(self.method, self.horizon, self.lags, self.observer_options, self.margins, self.outside)

    @property
    def observer_options(self) -> dict[str, Any]:
        """The keywords of `jb.observer` that differ from their defaults; other methods have none."""
        if not self.observes:
            return {}
        keywords: dict[str, Any] = {
            "order": self.order,
            "horizon": self.horizon,
            "restart": False if self.latched else None,
            "method": self.observer,
            **self.settings,
        }
        return {name: value for name, value in keywords.items() if value is not None}

    @property
    def flags(self) -> dict[str, float]:
        """{flag: value} of the observer's own options, as they stand in a command line."""
        flags = {}
        for option in shell_options():
            if option.field in self.settings:
                flags[option.flag] = self.settings[option.field]
        return flags

    def check(self) -> None:
        """Raise ValueError for an option that the method does not take."""
        if not self.observes:
            self._refuse_observing()
            return
        if self.lags is not None:
            raise ValueError("--lags is for windows: an observer looks at every sample")
        chosen = OBSERVERS[self.observer or next(iter(OBSERVERS))]
        for kind in OBSERVERS.values():
            for option in kind.shell:
                if option.field in self.settings and kind is not chosen:
                    raise ValueError(f"{option.flag} is for --observer {kind.name}")
        try:
            chosen(**self.settings)
        except ValueError as e:
            raise ValueError(f"{', '.join(self.flags)}: {e}") from None

    def _refuse_observing(self) -> None:
        """Raise ValueError for an option of an observer."""
        for name in ("order", "latched", "observer"):
            if getattr(self, name):
                raise ValueError(f"--{name} is for --method {OBSERVER}")
        for flag in self.flags:
            raise ValueError(f"{flag} is for --method {OBSERVER}")


@dataclass(frozen=True)
class Options:
    """The options of a command, declared once.

    Fields:
        help: {usage: its help}, in the order of the help. A usage is "--out DIR", "--json", or of an argument
            without dashes its name and how it is shown: "data DATA"; "..." behind it takes several, brackets
            around it none or one. A metavar of PATHS is a path.
        readers: {name: reader of its text} of the others that are no texts. defaults: {name: value}, else
            None, or False of a switch. required: names. choices: {name: the values that there are}.
        hidden: names of options of text that help does not show.
    """

    help: Mapping[str, str]
    readers: dict[str, Callable[[str], object]] = field(default_factory=dict)
    defaults: dict[str, object] = field(default_factory=dict)
    required: Sequence[str] = ()
    choices: dict[str, Sequence[str]] = field(default_factory=dict)
    hidden: Sequence[str] = ()

    def add_to(self, parser: argparse.ArgumentParser) -> None:
        """Add the options to a parser."""
        apart: dict[tuple[str, ...], Any] = {}
        for usage, about in self.help.items():
            flag, _, metavar = usage.partition(" ")
            name = flag.strip("-").replace("-", "_")
            place: Any = parser
            for names in APART:
                if name in names:
                    place = apart[names] = apart.get(names) or parser.add_mutually_exclusive_group()
            place.add_argument(flag, help=about, **self._keywords(name, metavar))
        for name in self.hidden:
            parser.add_argument(f"--{name.replace('_', '-')}", help=argparse.SUPPRESS)

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
            "choices": CHOICES | self.choices,
        }
        for word, named in values.items():
            if name in named:
                keywords[word] = named[name]
        return keywords


PATHS = "DATA", "DIR", "FILE", "HEALTHY", "MANIFEST", "PNG", "TRAINING", ".toml", ".json"
"""Ends of metavars that name a file or a folder."""
APART = ("workers", "scheduler"), ("horizon", "lags")
"""Options of which one may be given."""


def method(more: str = "") -> dict[str, str]:
    """Return --method of a command that tests recordings. more: the end of its help."""
    return {"--method METHOD": f"{METHODS} (default: windows, all their relations together){more}"}


def every(default: str = "that of the model") -> dict[str, str]:
    """Return --every. default: of it."""
    return {
        "--every 15min": "samples are the means of what was recorded within each such interval of the clock, "
        f"in ms, s, min, h or d (default: {default})"
    }


def _observer() -> dict[str, str]:
    """Return the options of a set observer: those of all, and those that its methods list for the shell."""
    about = "; ".join(f"{name}: {kind.about}" for name, kind in OBSERVERS.items())
    options = {
        "--order N": "observer: directions of its set for each state; more is sharper and slower (default: "
        "20)",
        "--latched": "observer: FAULT stays until a gap; else it begins anew behind a contradiction",
        "--observer NAME": f"observer: {about} (default: {next(iter(OBSERVERS))})",
    }
    for kind in OBSERVERS.values():
        for option in kind.shell:
            options[f"{option.flag} N"] = f"observer {kind.name}: {option.help} (default: {option.default})"
    return options


MARGINS_KIND = {
    "--margins KIND": "of long windows: exact, every window searched; or bounds, proved, where a window is "
    "decided without a search, ten times as fast, while those of FAULT and of what a report shows closely "
    "are exact; auto: bounds of 131 072 windows and more; through a pipe always exact (default: auto)"
}
OUTSIDE_WORD = {
    "--outside WORD": "for FAULT where inputs leave the region of training, the ranges of the model: fault, "
    "and said to be outside; or undecided, not claimed there (default: fault)"
}
WINDOW = {
    "--horizon S": "a window has S + 1 samples (default: that of the model, or the least useful S)",
    "--lags 0,1,2,4": "look at the outputs only so many samples before the last of a window: long memory, "
    "few rows; every input between is used",
}
SET_OBSERVER = _observer()
ALARM = {
    "--alarm k/n": "an alarm needs k FAULT among n windows (default: 1/1)",
    "--least T1=0.5": "FAULT windows that an error of this output below so many of its units explains make "
    "no alarm; one number is for every output (default: any size)",
    "--suspects": "name the signals that alone could be wrong; alarms of different suspects are different "
    "alarms; --merge-alarms and --latch do it too",
    "--merge-alarms 10min": "alarms of one suspect at most so far apart are one: samples, or ms, s, min, h, "
    "d (default: 0)",
    "--latch": "an alarm stays on until an opposite jump of its suspect speaks for a repair, or until it is "
    "acknowledged",
    "--acknowledged FILE": "with --latch: times, one a line, at which an operator acknowledged the alarms "
    "that were open; with - it is read again as samples come",
    "--min-coverage F": "least share of decided windows (default: 0.5)",
}
"""By which verdicts become a conclusion."""
ENGINE = {
    "--workers N": "let N processes of this machine do the work (needs dask)",
    "--scheduler ADDRESS": "let the workers of a dask scheduler do the work, like tcp://host:8786; they see "
    "all files by the same paths",
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


def alarm_rule(args: argparse.Namespace) -> "AlarmRule":
    """Return the rule of alarms from the options ALARM."""
    from jaxbound.diagnosis.alarmrule import AlarmRule

    k, n = args.alarm or (1, 1)
    if args.acknowledged is not None and not args.latch:
        raise Refused("--acknowledged ends alarms that latch: give --latch, too")
    return AlarmRule(
        k,
        n,
        merge=args.merge_alarms,
        latch=args.latch,
        least=args.least,
        suspects=args.suspects,
        acknowledged=args.acknowledged or (),
    )


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


def share(text: str) -> float:
    """Return a number between 0 and 1."""
    try:
        number = decimal(text)
    except ValueError:
        number = -1.0
    if not 0 <= number <= 1:
        raise ArgumentTypeError(f"needs a share between 0 and 1, not {text!r}")
    return number


def clock_interval(text: str) -> str:
    """Return an interval of the clock as it is written."""
    from jaxbound.recordings.clockintervals import seconds_of

    try:
        seconds_of(text)
    except ValueError as e:
        raise ArgumentTypeError(str(e).removeprefix("every ")) from None
    return text


def apart(text: str) -> int | str:
    """Return the distance of alarms in samples, or an interval of the clock as it is written."""
    if _is_whole(text):
        return whole_number(0)(text)
    return clock_interval(text)


def sizes(text: str) -> "float | dict[str, float]":
    """Return the least sizes of alarms: one number, or {output: size} of T1=0.5,T2=1."""
    least: dict[str, float] = {}
    for part in text.split(","):
        name, equals, number = part.rpartition("=")
        try:
            size = decimal(number)
        except ValueError:
            size = 0.0
        wrong = not 0 < size < float("inf") or name.strip() in least or bool(equals) != bool(name.strip())
        if wrong or (not name and "," in text):
            raise ArgumentTypeError(
                f"needs a size > 0, like 0.5, or one for each output, like T1=0.5,T2=1: not {text[:60]!r}"
            )
        least[name.strip()] = size
    return least.get("", least)


def lags(text: str) -> tuple[int, ...]:
    """Return the lags of a window, like 0,1,2,4."""
    from jaxbound.models.arguments import whole_lags

    try:
        return whole_lags([whole_number(0)(part.strip()) for part in text.split(",")])
    except (ValueError, ArgumentTypeError):
        raise ArgumentTypeError(
            f"needs different whole numbers with commas, 0 among them, like 0,1,2,4,8: not {text[:60]!r}"
        ) from None


READERS: dict[str, Callable[[str], object]] = {
    "alarm": some_of("k", "3/5"),
    "every": clock_interval,
    "horizon": whole_number(),
    "lags": lags,
    "least": sizes,
    "merge_alarms": apart,
    "method": method_name,
    "min_coverage": share,
    "observer": observer_name,
    "order": whole_number(1, 1000),
    "scheduler": named,
    "workers": whole_number(1, 10**4),
    **{option.dest: whole_number(option.least, option.most) for option in shell_options()},
}
"""Of the options that several commands share."""
DEFAULTS: dict[str, object] = {
    "margins": MARGINS[0],
    "merge_alarms": 0,
    "method": WINDOWS[1],
    "min_coverage": 0.5,
    "outside": OUTSIDE[0],
}
CHOICES: dict[str, Sequence[str]] = {"margins": MARGINS, "outside": OUTSIDE, "observer": tuple(OBSERVERS)}
