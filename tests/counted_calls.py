"""How much Python a piece of code runs, counted in calls: the same number on every machine, however busy."""

import sys
from contextlib import contextmanager


class TooManyCalls(AssertionError):
    """More calls than were allowed: whatever runs is stopped there, not after minutes."""


@contextmanager
def at_most(calls):
    """Run a block and stop it where it calls more functions, of Python and of C, than allowed."""
    count = 0

    def counted(frame, event, argument):
        nonlocal count
        count += event in ("call", "c_call")
        if count > calls:
            sys.setprofile(None)
            raise TooManyCalls(f"more than {calls} calls")

    before = sys.getprofile()
    sys.setprofile(counted)
    try:
        yield lambda: count
    finally:
        sys.setprofile(before)
