"""The options --scheduler and --workers: who does the work of a command."""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from jaxbound.consistency.engine import connected
from jaxbound.runs.refusals import Refused

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["engine_of", "refuse_engine"]


@contextmanager
def engine_of(args: argparse.Namespace) -> Iterator["Client | None"]:
    """Give the dask Client that the options ask for, None where they ask for none."""
    if args.scheduler is None and args.workers is None:
        yield None
        return
    try:
        client = connected(args.scheduler, args.workers)
        with client as found:
            yield found
    except (ValueError, ConnectionError) as e:
        raise Refused(str(e)) from e


def refuse_engine(args: argparse.Namespace, why: str) -> None:
    """Raise Refused if --scheduler or --workers is given where nothing can be spread. why: the sentence
    behind the option's name.
    """
    for option, given in (("--scheduler", args.scheduler), ("--workers", args.workers)):
        if given is not None:
            raise Refused(f"{option} {why}")
