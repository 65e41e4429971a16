"""The option --workers: who does the work of a command."""

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING

from jaxbound.runs.refusals import Refused
from jaxbound.workers.engine import connected

if TYPE_CHECKING:
    from distributed import Client


@contextmanager
def engine(asked: Mapping[str, str] | None) -> Iterator["Client | None"]:
    """Give the dask Client that --workers asks for, None where it is not given."""
    if asked is None:
        yield None
        return
    who = asked.get("who", "")
    number = re.fullmatch("[1-9][0-9]{0,3}", who)
    if number is None and ":" not in who:
        raise Refused(
            f"--workers needs their number, 1 to 9999, or an address, like tcp://host:8786: not {who!r}"
        )
    try:
        client = connected(who) if number is None else connected(workers=int(who))
        with client as found:
            yield found
    except (ValueError, ConnectionError) as e:
        raise Refused(str(e)) from e
