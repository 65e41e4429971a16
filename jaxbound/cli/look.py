"""The command `jaxbound look`: what a recording holds, before there is a model."""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from jaxbound.cli.command import swift_imports
from jaxbound.cli.options import FORCE, JSON, Options, reading
from jaxbound.cli.terminal import OK, Conclusion, Row, Table, door, progress_bars
from jaxbound.text.quantities import decimal

if TYPE_CHECKING:
    from jaxbound.recordings.look import Look

NAME = "look"
HELP = "show what a recording holds, before there is a model"
EXAMPLES = (
    (
        "jaxbound look run.csv",
        "how it is written, its times and gaps, each column, the command to go on with",
    ),
    ("jaxbound look run.csv --out run.html", "the same as a page, with a picture of each column"),
    ("zcat run.csv.gz | jaxbound look -", "what comes through a pipe"),
)
CODES = "exit codes: 0, 2 bad input or usage, 70 internal error, 130 interrupted"
OPTIONS = Options(
    {
        "data DATA": "a CSV file, a Parquet file or a folder of these; -: standard input, until it ends",
        "--out FILE": "a page (.html) or a picture of each column (.png) to write",
        **reading("as recorded"),
        "--dt SECONDS": "sampling period of a recording without times",
        **FORCE,
        **JSON,
    },
    {"dt": decimal},
)


@dataclass(frozen=True)
class Looked(Conclusion):
    """A Look in words. Fields: look."""

    look: "Look"

    @property
    def headline(self) -> str:
        """The name of the recording and its extent."""
        return self.look.headline

    def rows(self) -> Iterator[Row]:
        """Yield how the recording was read, what should be asked, and how to go on."""
        yield from self.look.rows()

    def table(self) -> Table:
        """Give a row of cells a column of the recording."""
        return self.look.cells()

    def text(self) -> str:
        """Return the table of a model file that reads such files."""
        return self.look.table

    def plain(self) -> object:
        """Return the look as JSON has it."""
        return self.look.plain()


def run(args: argparse.Namespace) -> int:
    """Look at a recording, write a page or a picture where one is asked for; return the exit code."""
    with swift_imports():
        from jaxbound.files.whole import put
        from jaxbound.plots.canvas import to_png
        from jaxbound.plots.look import plot_look
        from jaxbound.recordings.look import look
        from jaxbound.reports.looked import look_page
        from jaxbound.runs.outputs import refuse_targets

    written = list(filter(None, [args.out]))
    refuse_targets({"--out": args.out}, [args.data], args.force)
    with door(), progress_bars(("read",)) as step:
        found = look(args.data, recording=args.recording, dt=args.dt, progress=partial(step, "read"))
        for path in written:
            page = look_page(found).encode()
            if path.suffix.lower() == ".png":
                page = to_png(plot_look(found))
            put(path, page)
    Looked(found, written=written).show(args.json)
    return OK
