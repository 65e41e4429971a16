"""The options --scheduler and --workers: who does the work of a command."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from jaxbound.runs.refusals import Refused
from jaxbound.workers.engine import connected

if TYPE_CHECKING:
    from distributed import Client


@contextmanager
def engine(scheduler: str | None, workers: int | None) -> Iterator["Client | None"]:
    """Give the dask Client that the options ask for, None where they ask for none."""
    if scheduler is None and workers is None:
        yield None
        return
    try:
        client = connected(scheduler, workers)
        with client as found:
            yield found
    except (ValueError, ConnectionError) as e:
        raise Refused(str(e)) from e
