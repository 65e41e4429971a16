"""A command of the shell: what its file holds, and the parser that it fills.

A file of this folder that is a command has the names of `Command`. It imports the code that computes inside
`run`, under `swift_imports`: help and completion read all commands, and wait for none of that.
"""

import argparse
import difflib
import gc
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import NoReturn, Protocol

from jaxbound.cli.fields import moved
from jaxbound.cli.options import Options, add_loudness
from jaxbound.cli.terminal import Refused, say, write

EXIT_CODES = (
    "exit codes: 0 no fault, 1 fault found, 2 bad input or usage, 3 too little evidence or outside bounds "
    "that were fitted to shorter windows, 70 internal error, 130 interrupted, and as shells count 129 by "
    "SIGHUP, 143 by SIGTERM"
)
"""Exit codes of a command that tests recordings."""

MOVED = {"examine": "info --device"}
"""{command of before: what it is called now}."""


class Command(Protocol):
    """A command: a module with these names.

    Fields:
        NAME: as one types it. HELP: one sentence for the list of commands.
        OPTIONS: its arguments and options.
        EXAMPLES: (command line, its effect). CODES: its exit codes, the end of its help.
    """

    NAME: str
    HELP: str
    CODES: str
    OPTIONS: Options

    @property
    def EXAMPLES(self) -> Sequence[tuple[str, str]]:
        """Command lines and their effects."""

    def run(self, args: argparse.Namespace) -> int:
        """Do the work; return the exit code."""


class Formatter(argparse.HelpFormatter):
    """Keeps paragraphs apart, and lines that are examples as they are."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        paragraphs = []
        for paragraph in text.split("\n\n"):
            is_example = "\n  " in paragraph
            paragraphs.append(paragraph if is_example else super()._fill_text(paragraph, width, indent))
        return "\n\n".join(paragraphs)


class Help(argparse.Action):
    """Prints the help of a command and ends; options that are rare only where it is asked for all.

    Args:
        option_strings, dest, help: of `argparse.Action`. rare: names of options.
    """

    def __init__(self, option_strings: Sequence[str], dest: str, rare: Sequence[str], help: str) -> None:
        super().__init__(option_strings, dest, nargs="?", metavar="all", default=argparse.SUPPRESS, help=help)
        self.rare = rare

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: object,
        option: str | None = None,
    ) -> NoReturn:
        """Print the help."""
        for action in parser._actions:
            # hidden when help is printed: they are parsed like any other
            if values != self.metavar and action.dest in self.rare:
                action.help = argparse.SUPPRESS
        parser.print_help()
        parser.exit()


class Parser(argparse.ArgumentParser):
    """Reports wrong usage in one sentence."""

    def error(self, message: str) -> NoReturn:
        """Raise Refused instead of printing the usage."""
        # argparse says "argument --n: expected ..", which reads on as a sentence without its colon
        if message.startswith("argument "):
            message = message.removeprefix("argument ").replace(": ", " ", 1)
        raise Refused(f"{message}; see {self.prog} --help")

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None
    ) -> tuple[argparse.Namespace, list[str]]:
        """Parse; an option that there is not comes before one that is missing.

        Raises:
            Refused: an unknown option or command, with the nearest one; a word too many.
        """
        words = sys.argv[1:] if args is None else list(args)
        if self.commands:
            # argparse would first miss the arguments that a command of that name has not
            self._refuse_unknown_command(words)
        else:
            self._refuse_unknown_option(words)
        parsed, left = super().parse_known_args(words, namespace)
        if not self.commands:
            left = self._behind(parsed, left)
            if left:
                raise Refused(f"{self.prog} has no use for {' '.join(left)}; see {self.prog} --help")
            parsed.words = words
            if sentence := moved(parsed):
                say(sentence)
        return parsed, left

    @property
    def commands(self) -> list[str]:
        """The commands of a parser that has some."""
        for action in self._actions:
            if isinstance(action, argparse._SubParsersAction):
                return list(action.choices)
        return []

    def _behind(self, parsed: argparse.Namespace, left: list[str]) -> list[str]:
        """Give words that stand behind an option to the argument that takes several; return those left.

        argparse gives it only the words before that option: its own way around, intermixed parsing, knows no
        commands.
        """
        if any(word.startswith("-") for word in left):
            return left
        for action in self._actions:
            if action.nargs == argparse.ONE_OR_MORE and not action.option_strings:
                files = getattr(parsed, action.dest)
                files += [self._get_value(action, word) for word in left]  # type: ignore[attr-defined]
                return []
        return left

    def _refuse_unknown_command(self, words: list[str]) -> None:
        name = next(iter(words), "")
        if not name or name.startswith("-") or name in self.commands:
            return
        if name in MOVED:
            raise Refused(f"{self.prog} {name} is {self.prog} {MOVED[name]} now")
        raise Refused(f"there is no command {name!r}{nearest(name, self.commands)}; see {self.prog} --help")

    def _refuse_unknown_option(self, words: list[str]) -> None:
        options: list[str] = []
        shown: list[str] = []
        for action in self._actions:
            options += action.option_strings
            if action.help != argparse.SUPPRESS:
                shown += action.option_strings
        for word in words:
            if word == "--":  # what follows are no options
                return
            name = word.partition("=")[0]
            is_option = name.startswith("--") and " " not in name
            if is_option and not any(option.startswith(name) for option in options):
                # options that are kept for old command lines are not advertised
                near = nearest(name, shown)
                raise Refused(f"there is no option {name} of {self.prog}{near}; see {self.prog} --help")

    def _print_message(self, message: str, file: object = None) -> None:
        """Print help and version as everything is printed."""
        if message:
            write(message)


def nearest(word: str, known: Sequence[str]) -> str:
    """Return a question for the nearest of the known words, "" where none is near.

    Example:
        >>> nearest("detct", ["detect", "demo"])
        ' (did you mean detect?)'
    """
    near = difflib.get_close_matches(word, known, n=1)
    return f" (did you mean {near[0]}?)" if near else ""


def add_command(choices: "argparse._SubParsersAction[Parser]", command: Command) -> None:
    """Add the parser of a command to those of the command line."""
    parser = choices.add_parser(
        command.NAME,
        help=command.HELP,
        formatter_class=Formatter,
        epilog=end_of_help(command),
        add_help=False,
    )
    rare = command.OPTIONS.rare
    about = "show this"
    if rare:
        about = f"show this, with all {len(rare)} options more"
    parser.add_argument("-h", "--help", action=Help, rare=rare, help=about)
    command.OPTIONS.add_to(parser)
    add_loudness(parser)
    parser.set_defaults(run=command.run)


def end_of_help(command: Command) -> str:
    """Return the examples and exit codes of a command."""
    lines = ["examples:"]
    for line, effect in command.EXAMPLES:
        lines += [f"  {line}", f"      {effect}"]
    return "\n".join(lines) + "\n\n" + command.CODES


@contextmanager
def swift_imports() -> Iterator[None]:
    """Import without the garbage collector, a fifth sooner.

    What is imported stays: the collector need not look through it again and again, neither now nor later.
    """
    # a program that calls main may have switched it off itself
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
        gc.freeze()
    finally:
        if was_enabled:
            gc.enable()
