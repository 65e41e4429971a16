"""The options that several commands share, and the values that they are read as.

A command calls the functions here for its parser. They import nothing heavy, neither jax nor NumPy, because
help and completion are to be there at once.
"""

import argparse
from argparse import ArgumentTypeError
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxbound.cli.terminal import NORMAL, QUIET, VERBOSE, Refused
from jaxbound.estimation.methods import OBSERVERS, observer_method, shell_options
from jaxbound.text.quantities import decimal

if TYPE_CHECKING:
    from jaxbound.diagnosis.alarmrule import AlarmRule

__all__ = [
    "MARGINS",
    "METHODS",
    "OBSERVER",
    "OUTSIDE",
    "WINDOWS",
    "MethodOptions",
    "add_alarm",
    "add_engine",
    "add_every",
    "add_force",
    "add_json",
    "add_loudness",
    "add_margins",
    "add_method",
    "add_observer",
    "add_outside",
    "add_windows",
    "alarm_rule",
    "apart",
    "interval",
    "lags",
    "method_name",
    "named",
    "observer_name",
    "path",
    "refuse_unknown_method",
    "share",
    "sizes",
    "some_of",
    "whole_number",
]

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
        order, latched, observer: of an observer, see `add_observer`.
        margins: one of MARGINS, see `add_margins`. outside: one of OUTSIDE, see `add_outside`.
        every: see `add_every`; None: that of the model.
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


def add_method(parser: argparse.ArgumentParser, more: str = "") -> None:
    """Add --method of a command that tests recordings. more: the end of its help."""
    about = f"{METHODS} (default: windows, all their relations together){more}"
    parser.add_argument("--method", type=method_name, default=WINDOWS[1], metavar="METHOD", help=about)


def add_margins(parser: argparse.ArgumentParser) -> None:
    """Add --margins."""
    parser.add_argument(
        "--margins",
        choices=MARGINS,
        default=MARGINS[0],
        metavar="KIND",
        help="of long windows: exact, every window searched; or bounds, proved, where a window is decided "
        "without a search, ten times as fast, while those of FAULT and of what a report shows closely are "
        "exact; auto: bounds of 131 072 windows and more; through a pipe always exact (default: auto)",
    )


def add_outside(parser: argparse.ArgumentParser) -> None:
    """Add --outside."""
    parser.add_argument(
        "--outside",
        choices=OUTSIDE,
        default=OUTSIDE[0],
        metavar="WORD",
        help="for FAULT where inputs leave the region of training, the ranges of the model: fault, and said "
        "to be outside; or undecided, not claimed there (default: fault)",
    )


def add_windows(parser: argparse.ArgumentParser, about: str = "", least: int = 0) -> None:
    """Add --horizon and --lags. about: the help of --horizon; least: its lowest value."""
    about = about or "a window has S + 1 samples (default: that of the model, or the least useful S)"
    one = parser.add_mutually_exclusive_group()
    one.add_argument("--horizon", type=whole_number(least), metavar="S", help=about)
    one.add_argument(
        "--lags",
        type=lags,
        metavar="0,1,2,4",
        help="look at the outputs only so many samples before the last of a window: long memory, few rows; "
        "every input between is used",
    )


def add_observer(parser: argparse.ArgumentParser) -> None:
    """Add the options of a set observer: those of all, and those that its methods list for the shell."""
    parser.add_argument(
        "--order",
        type=whole_number(1, 1000),
        metavar="N",
        help="observer: directions of its set for each state; more is sharper and slower (default: 20)",
    )
    parser.add_argument(
        "--latched",
        action="store_true",
        help="observer: FAULT stays until a gap; else it begins anew behind a contradiction",
    )
    parser.add_argument(
        "--observer",
        type=observer_name,
        choices=tuple(OBSERVERS),
        metavar="NAME",
        help=f"observer: {'; '.join(f'{name}: {kind.about}' for name, kind in OBSERVERS.items())} "
        f"(default: {next(iter(OBSERVERS))})",
    )
    for kind in OBSERVERS.values():
        for option in kind.shell:
            parser.add_argument(
                option.flag,
                dest=option.dest,
                type=whole_number(option.least, option.most),
                metavar="N",
                help=f"observer {kind.name}: {option.help} (default: {option.default})",
            )


def add_alarm(parser: argparse.ArgumentParser) -> None:
    """Add --alarm and --min-coverage, by which verdicts become a conclusion."""
    parser.add_argument(
        "--alarm",
        type=some_of("k", "3/5"),
        metavar="k/n",
        help="an alarm needs k FAULT among n windows (default: 1/1)",
    )
    parser.add_argument(
        "--least",
        type=sizes,
        metavar="T1=0.5",
        help="FAULT windows that an error of this output below so many of its units explains make no alarm; "
        "one number is for every output (default: any size)",
    )
    parser.add_argument(
        "--suspects",
        action="store_true",
        help="name the signals that alone could be wrong; alarms of different suspects are different alarms; "
        "--merge-alarms and --latch do it too",
    )
    parser.add_argument(
        "--merge-alarms",
        type=apart,
        default=0,
        metavar="10min",
        help="alarms of one suspect at most so far apart are one: samples, or ms, s, min, h, d (default: 0)",
    )
    parser.add_argument(
        "--latch",
        action="store_true",
        help="an alarm stays on until an opposite jump of its suspect speaks for a repair, or until it is "
        "acknowledged",
    )
    parser.add_argument(
        "--acknowledged",
        type=path,
        metavar="FILE",
        help="with --latch: times, one a line, at which an operator acknowledged the alarms that were open; "
        "with - it is read again as samples come",
    )
    parser.add_argument(
        "--min-coverage",
        type=share,
        default=0.5,
        metavar="F",
        help="least share of decided windows (default: 0.5)",
    )


def alarm_rule(args: argparse.Namespace) -> "AlarmRule":
    """Return the rule of alarms from the options of `add_alarm`."""
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


def add_engine(parser: argparse.ArgumentParser) -> None:
    """Add the options that spread the work."""
    one = parser.add_mutually_exclusive_group()
    one.add_argument(
        "--workers",
        type=whole_number(1, 10**4),
        metavar="N",
        help="let N processes of this machine do the work (needs dask)",
    )
    one.add_argument(
        "--scheduler",
        type=named,
        metavar="ADDRESS",
        help="let the workers of a dask scheduler do the work, like tcp://host:8786; they see all files by "
        "the same paths",
    )


def add_every(parser: argparse.ArgumentParser, default: str = "that of the model") -> None:
    """Add --every. default: of it."""
    parser.add_argument(
        "--every",
        type=interval,
        metavar="15min",
        help="samples are the means of what was recorded within each such interval of the clock, in ms, s, "
        f"min, h or d (default: {default})",
    )


def add_json(parser: argparse.ArgumentParser) -> None:
    """Add --json."""
    about = "a machine-readable summary on stdout, nothing else"
    parser.add_argument("--json", action="store_true", help=about)


def add_force(parser: argparse.ArgumentParser) -> None:
    """Add --force of a command that writes files of any name."""
    about = "replace files that are there; never one that is read"
    parser.add_argument("--force", action="store_true", help=about)


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


def whole_number(least: int, most: int = LARGEST) -> Callable[[str], int]:
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


def interval(text: str) -> str:
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
    return interval(text)


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
