"""The terminal: refusals in one sentence, a bar for each stage, conclusions in colour."""

import ctypes
import io
import os
import signal
import sys
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass

from jaxbound.cli.signals import ENDS
from jaxbound.runs.refusals import Refused, Stopped
from jaxbound.text.characters import clipped, printable
from jaxbound.text.quantities import plain

__all__ = [
    "BAD_INPUT",
    "Conclusion",
    "INTERNAL",
    "INTERRUPTED",
    "LOUDNESS",
    "NORMAL",
    "OK",
    "QUIET",
    "Refused",
    "VERBOSE",
    "json_text",
    "door",
    "hushed",
    "nobody_reads",
    "progress_bars",
    "say",
    "show",
    "some_device",
    "stoppable",
    "system_trouble",
    "usable_device",
    "write",
]

OK, BAD_INPUT, INTERNAL, INTERRUPTED = 0, 2, 70, 130  # of every command; of verdicts: `runs.summary`
QUIET, NORMAL, VERBOSE = 0, 1, 2
LOUDNESS: ContextVar[int] = ContextVar("loudness", default=NORMAL)
"""How much a command says: -q the first line of its conclusion, -v more than it would."""
Row = tuple[str, str]
"""(name, value)."""
Table = Iterable[Sequence[str]]
EVERY = 60.0
"""Seconds between two lines of progress where there is no terminal."""


@contextmanager
def door(*kinds: type[Exception]) -> Iterator[None]:
    """Turn exceptions of the library and of the file system into a sentence for the user."""
    kinds = kinds or (OSError, ValueError, NotImplementedError, TypeError)
    try:
        yield
    except kinds as e:
        raise Refused(system_trouble(e)) from e


def system_trouble(e: BaseException) -> str:
    """Return the sentence of an exception; one of the file system names its file."""
    if not isinstance(e, OSError) or not e.strerror:
        return str(e)
    if not e.filename:
        return e.strerror.lower()
    return f"{e.filename}: {e.strerror.lower()}"


@contextmanager
def stoppable() -> Iterator[list[int]]:
    """Let SIGTERM and SIGHUP end a command as Ctrl-C does; yields a list that gets the number of the signal.

    What is ignored stays ignored (`nohup`). A second signal does not disturb the cleaning up of the first;
    Ctrl-C does.
    """
    caught = []
    names: set[signal.Signals] = set()
    # Python hands signals to the main thread alone, and lets no other set their handlers
    if threading.current_thread() is threading.main_thread():
        names = {n for n in ENDS if signal.getsignal(n) == signal.SIG_DFL}

    def stop(number: int, frame: object) -> None:
        # the first signal counts: what follows must not break the cleaning up
        caught.append(number)
        for n in names:
            signal.signal(n, signal.SIG_IGN)
        raise Stopped

    for n in names:
        signal.signal(n, stop)
    try:
        yield caught
    finally:
        for n in names:
            signal.signal(n, signal.SIG_DFL)


@contextmanager
def hushed() -> Iterator[None]:
    """Keep off the output what compiled libraries print there by themselves, as HiGHS does at times."""
    with suppress(OSError, AttributeError, ValueError):  # no output, or one that is none of the system
        sys.stdout.flush()
    try:
        output = os.dup(1)
    except OSError:
        yield
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        yield
    finally:
        with suppress(OSError, TypeError, AttributeError):  # what C still holds back would be printed later
            ctypes.CDLL(None).fflush(None)
        os.dup2(output, 1)
        os.close(output)
        os.close(nowhere)


@contextmanager
def progress_bars(stages: Sequence[str]) -> Iterator[Callable[[str, float], object]]:
    """Show a bar for each stage on a terminal's stderr, elsewhere a line now and then; yields a function of
    (stage, share).
    """
    if sys.stderr is None or LOUDNESS.get() == QUIET:
        yield lambda stage, share: None
        return
    # a bar redraws its line, which fills a log with control characters
    if not sys.stderr.isatty():
        yield _Lines().step
        return
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        TaskProgressColumn,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description:>8}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bars:
        # all from the start: a user sees what is still to come
        tasks = {stage: bars.add_task(stage, total=1.0) for stage in stages}
        yield lambda stage, share: bars.update(tasks[stage], completed=share)


class _Lines:
    """Progress in a log: a line every minute while work goes on; with -v also one where a stage begins."""

    def __init__(self) -> None:
        self.start = self.last = time.monotonic()
        self.stage = ""

    def step(self, stage: str, share: float) -> None:
        """Print the state of the work, if it is time to."""
        now = time.monotonic()
        if stage != self.stage and LOUDNESS.get() == VERBOSE:
            say(f"{stage}, {now - self.start:.1f} s after the start")
        elif now - self.last >= EVERY:
            say(f"{stage} {share:.0%}, {now - self.start:.0f} s after the start")
            self.last = now
        self.stage = stage


def write(text: str) -> None:
    """Write to stdout; a reader that has gone away, or a closed stdout, is no trouble: the exit code stays
    what it is.

    Raises:
        Refused: a full device.
    """
    if sys.stdout is None:  # closed from the start
        return
    try:
        encoding = sys.stdout.encoding or "utf-8"
        # letters that it cannot show are written as numbers
        sys.stdout.write(text.encode(encoding, "backslashreplace").decode(encoding))
        sys.stdout.flush()
    except BrokenPipeError:  # the reader, `head` perhaps, has seen enough
        nobody_reads()
    except OSError as e:
        nobody_reads()
        raise Refused(f"cannot write to standard output: {system_trouble(e)}") from e


def json_text(value: object) -> str:
    """Return the JSON of a value, see `plain`, with the end of its line."""
    import json

    return json.dumps(plain(value), indent=2, allow_nan=False, ensure_ascii=False) + "\n"


def nobody_reads() -> None:
    """Drop the text that waits for stdout: else the interpreter complains of it at its end."""
    with suppress(OSError):  # a stand-in for stdout has no number
        # at exit Python flushes stdout, and would end with a broken pipe and another exit code
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def show(
    headline: str, style: str, rows: Iterable[Row], table: Table = (), text: str = "", last: bool = False
) -> None:
    """Print a headline, a table (rows of cells, the header first), pairs of (name, value) and a text; names
    are not markup.

    With -q the headline alone. Args: last: the table stands behind the pairs.
    """
    if LOUDNESS.get() == QUIET:
        rows, table, text = (), (), ""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    # what rich itself writes to stdout, a full or closed one would break
    page, shown = io.StringIO(), Console()
    terminal = shown.is_terminal
    # no terminal, no width: 160 columns, so that no cell of a table is broken into lines
    console = Console(file=page, force_terminal=terminal, width=shown.width if terminal else 160)
    grid = Table.grid(padding=(0, 2))
    for name, value in rows:
        grid.add_row(Text(printable(name), "dim"), Text(printable(value), overflow="fold"))
    console.print(Text(printable(headline), style), soft_wrap=not terminal)
    if last and grid.row_count:
        console.print(grid)
    lines = list(table)
    if lines:
        # numbers on the right, names on the left
        rates = Table(box=None, padding=(0, 2), pad_edge=False)
        for i, name in enumerate(lines[0]):
            rates.add_column(Text(printable(name)), justify="right" if i else "left")
        for row in lines[1:]:
            rates.add_row(*(Text(printable(cell)) for cell in row))
        console.print(rates)
    if not last and grid.row_count:
        console.print(grid)
    if text:
        console.print(Text(printable(text, "\n")), soft_wrap=True)
    if terminal:
        write(page.getvalue())
    else:
        write("\n".join(line.rstrip() for line in page.getvalue().split("\n")))


@dataclass(frozen=True, kw_only=True)
class Conclusion(ABC):
    """The result of a command in words: rows for people, or the same for programs.

    Fields: hints: sentences to check. written: new files. style: of the headline, as rich has it.
    """

    hints: Sequence[str] = ()
    written: Sequence[object] = ()
    style: str = "bold"

    @property
    @abstractmethod
    def headline(self) -> str:
        """The first line, all that -q leaves."""

    @abstractmethod
    def rows(self) -> Iterable[Row]:
        """Give rows of (name, value), without the hints and the new files."""

    def table(self) -> Table:
        """Give rows of cells, the header first."""
        return ()

    def text(self) -> str:
        """Return a text to stand behind all."""
        return ""

    @abstractmethod
    def plain(self) -> object:
        """Return the conclusion as JSON has it, see `text.quantities.plain`."""

    def show(self, as_json: bool = False) -> None:
        """Print the conclusion."""
        if as_json:
            write(json_text(self.plain()))
            return
        if LOUDNESS.get() == QUIET:
            show(self.headline, self.style, ())
            return
        rows = list(self.rows())
        if self.written:
            rows.append(("written", " and ".join(map(str, self.written))))
        rows += [("hint", hint) for hint in self.hints]
        show(self.headline, self.style, rows, self.table(), self.text())


def say(sentence: str) -> None:
    """Print a sentence to stderr, a very long one in part."""
    if sys.stderr is None:
        return
    from rich.console import Console

    with suppress(OSError):  # there is no place left to say it
        Console(stderr=True).print(
            f"jaxbound: {printable(clipped(sentence))}", soft_wrap=True, markup=False, highlight=False
        )


def usable_device() -> None:
    """Raise ValueError if JAX finds no device, Unverified if it runs where nothing is proved."""
    from jaxbound.sets.floats.probe import refuse_unusable

    some_device()
    refuse_unusable()


def some_device() -> None:
    """Raise ValueError if JAX finds no device."""
    import jax

    try:
        jax.default_backend()
    except (RuntimeError, AssertionError):  # the latter where the plugin of the only platform named is absent
        raise ValueError(
            f"JAX_PLATFORMS={os.environ.get('JAX_PLATFORMS')} names no device of this machine: unset it, or "
            f"use cpu"
        ) from None
