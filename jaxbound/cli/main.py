"""The command line of jaxbound: its commands, and how they end.

Exit codes: 0 no fault, 1 fault found, 2 bad input or usage, 3 too little evidence or outside bounds that were
fitted to shorter windows, 70 internal error, 130 interrupted (129 by SIGHUP, 143 by SIGTERM, as shells
count). What the user did wrong is one sentence on stderr; a report is written completely or not at all.
"""

import argparse
import os
import re
import sys
import tempfile
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress

from jaxbound import __version__
from jaxbound.cli import (
    demo,
    detect,
    evaluate,
    example,
    explain,
    fit,
    fleet,
    info,
    look,
    parameters,
    study,
    tune,
    verify,
)
from jaxbound.cli.command import EXIT_CODES, Command, Parser, add_command, swift_imports
from jaxbound.cli.terminal import (
    BAD_INPUT,
    INTERNAL,
    INTERRUPTED,
    LOUDNESS,
    OK,
    QUIET,
    Refused,
    say,
    stoppable,
    system_trouble,
)
from jaxbound.text.characters import clipped

COMMANDS: tuple[Command, ...] = (
    demo,
    example,
    look,
    detect,
    explain,
    verify,
    fleet,
    fit,
    tune,
    parameters,
    study,
    evaluate,
    info,
)
"""In the order of the help. Each file says its name, its options and its work, see `Command`."""

COMPLETION = "_ARGCOMPLETE"  # in the environment of a process that is to complete a command line
NEGATIVE = re.compile(r"-[\d.]")

NO_COMMAND = (
    "which command? `jaxbound example heater` writes recordings to begin with, and `jaxbound detect --help` "
    "has examples"
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        argv: the arguments after the program's name; None: those of the process.

    Returns:
        The exit code.
    """
    words = sys.argv[1:] if argv is None else list(argv)
    with stoppable() as signals:
        code = _ended(words)
        if code == INTERRUPTED and signals:
            # as shells report a process that a signal ended
            return 128 + signals[0]
        return code


def _ended(words: list[str]) -> int:
    """Run a command line; turn what ends it into a sentence and an exit code."""
    try:
        return _exit_code_of(_parse(words))
    except SystemExit as e:  # --help, --version
        return e.code if isinstance(e.code, int) else OK
    except Refused as e:
        say(str(e))
        return BAD_INPUT
    except KeyboardInterrupt as e:
        say(str(e) or "interrupted: nothing was written")
        return INTERRUPTED
    except MemoryError as e:
        size = clipped(str(e)) or "no more was given"
        say(f"this needs more memory than there is ({size}): ask for less at once, or use a larger machine")
        return BAD_INPUT
    except OSError as e:  # a disk that fills up, say, while a report is written
        say(system_trouble(e))
        return BAD_INPUT
    except Exception as e:
        with tempfile.NamedTemporaryFile("w", prefix="jaxbound-traceback-", suffix=".txt", delete=False) as f:
            traceback.print_exc(file=f)
        # the line may be what could not be parsed: it is asked for -v by hand
        if any(word == "-v" or (word > "--" and "--verbose".startswith(word)) for word in words):
            traceback.print_exc()
        say(f"internal error, {type(e).__name__}: please report it with the traceback in {f.name}")
        return INTERNAL


def _exit_code_of(args: argparse.Namespace) -> int:
    """Run the command of a command line; return its exit code."""
    with swift_imports():
        from jaxbound.sets.floats.probe import Unverified

        _configure()
    loudness = LOUDNESS.set(args.loudness)
    try:
        with _keep_log(args.loudness):
            code: int = args.run(args)
        return code
    except Unverified as e:
        raise Refused(str(e)) from e
    finally:
        LOUDNESS.reset(loudness)


def commands() -> dict[str, Parser]:
    """Return the parser of each command by its name."""
    return _parsers()[1]


def _parse(words: list[str]) -> argparse.Namespace:
    parser, _ = _parsers()
    if COMPLETION in os.environ:
        _complete(parser)
    if not words:
        parser.print_help()
        raise Refused(NO_COMMAND)
    return parser.parse_args(_joined(words))


def _complete(parser: Parser) -> None:
    """Print the completions of the word at the cursor and end the process, when the shell asks for them."""
    with suppress(ImportError):
        import argcomplete

        argcomplete.autocomplete(parser)


def _joined(words: list[str]) -> list[str]:
    """Return the words with values like -1:1 joined to their options: argparse takes them for options."""
    joined: list[str] = []
    for word in words:
        if NEGATIVE.match(word) and joined and joined[-1].startswith("--"):
            joined[-1] += f"={word}"
        else:
            joined.append(word)
    return joined


def _parsers() -> tuple[Parser, dict[str, Parser]]:
    """Return (the parser of the command line, {command: its parser})."""
    parser = Parser(
        "jaxbound", description="Guaranteed fault detection: every FAULT is a proof.", epilog=EXIT_CODES
    )
    parser.add_argument("--version", action="version", version=f"jaxbound {__version__}")
    choices = parser.add_subparsers(
        title="commands (jaxbound COMMAND --help has its options and examples)",
        metavar="COMMAND",
        required=True,
        parser_class=Parser,
    )
    for command in COMMANDS:
        add_command(choices, command)
    return parser, dict(choices.choices)


@contextmanager
def _keep_log(loudness: int) -> Iterator[None]:
    """Keep the log of work that takes long from who asked for the conclusion alone."""
    if loudness != QUIET:
        yield
        return
    import logging

    log = logging.getLogger("jaxbound")
    # a program that calls main has a level of its own
    before = log.level
    log.setLevel(logging.ERROR)
    try:
        yield
    finally:
        log.setLevel(before)


def _configure() -> None:
    """Switch on float64, the CPU unless the user chose otherwise, and a cache of compiled kernels that
    lasts.
    """
    import jax

    from jaxbound.runs.cache import use_cache

    # jax states no types of these functions
    jax.config.update("jax_enable_x64", True)  # type: ignore[no-untyped-call]
    # a card searches and proves nothing unless it was examined: who wants it says so
    if not os.environ.get("JAX_PLATFORMS"):
        jax.config.update("jax_platforms", "cpu")  # type: ignore[no-untyped-call]
    with suppress(ValueError):  # a folder that cannot be written: what is slow is not wrong
        use_cache()


if __name__ == "__main__":
    sys.exit(main())
