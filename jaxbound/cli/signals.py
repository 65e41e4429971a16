"""Signals that ask a command to end, and the wait for samples that they may interrupt.

POSIX wakes a process that waits for bytes by a file that a signal writes into. Where the system cannot wait
for a file (Windows, whose `select` knows sockets alone), and for a generator, a thread waits in its place.
"""

import os
import select
import signal
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from queue import Empty, SimpleQueue
from typing import Any

ENDS = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))
"""The signals, beside Ctrl-C, that ask for the end."""
CAN_WAIT = hasattr(select, "poll")
"""Whether the system can wait for any open file."""
AT_ONCE = 1 << 18  # bytes read at once
PIPE = 1 << 20  # bytes that the pipe should hold
AHEAD = 2  # items that a thread holds for us: what it holds is lost with the process
LOOK = 0.2  # seconds between two looks for a signal, where nothing wakes us


class Ends:
    """Whether a signal has asked for the end.

    Fields: asked: an event; woken: the number of a file that can be read then, None where there is none.
    """

    def __init__(self, woken: int | None) -> None:
        self.asked, self.woken = threading.Event(), woken


@contextmanager
def ends() -> Iterator[Ends]:
    """Let SIGINT, SIGTERM and SIGHUP ask for the end, so that nothing is interrupted half-way.

    What is ignored stays ignored (`nohup`).
    """
    numbers = [signal.SIGINT]
    for number in ENDS:
        if signal.getsignal(number) != signal.SIG_IGN:
            numbers.append(number)
    with _waking() as woken:
        found = Ends(woken)
        before = {n: signal.signal(n, lambda *_: found.asked.set()) for n in numbers}
        try:
            yield found
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)


@contextmanager
def _waking() -> Iterator[int | None]:
    """Give the number of a file that can be read once a signal came, None where the system has none."""
    if not CAN_WAIT:
        yield None
        return
    woken, waker = os.pipe()
    # a full pipe must not stop the handler of a signal
    os.set_blocking(waker, False)
    previous = signal.set_wakeup_fd(waker)
    try:
        yield woken
    finally:
        signal.set_wakeup_fd(previous)
        os.close(woken)
        os.close(waker)


def arrivals(raw: int | Iterable[Any], end: Ends) -> Iterator[Any]:
    """Yield bytes or items as soon as some come; None, at the end, if a signal ended it.

    Args:
        raw: the number of an open file, of which bytes come; or an iterator.
    """
    if not isinstance(raw, int):
        return _by_thread(raw, end)
    _enlarge(raw)
    if end.woken is None:
        # the system cannot wait for a file: a thread reads it, and the wait is for that
        return _by_thread(_read(raw), end)
    return _by_select(raw, end, end.woken)


def _enlarge(fd: int) -> None:
    """Let a pipe hold more, so that the sender waits less."""
    try:
        import fcntl

        fcntl.fcntl(fd, fcntl.F_SETPIPE_SZ, PIPE)
    except (ImportError, AttributeError, OSError):  # no pipe, or none that can grow: the usual 64 kB will do
        pass


def _by_select(fd: int, end: Ends, woken: int) -> Iterator[bytes | None]:
    """Yield bytes of a file."""
    while True:
        ready, _, _ = select.select([fd, woken], [], [])
        if end.asked.is_set():
            yield None
            return
        if fd in ready:
            data = os.read(fd, AT_ONCE)
            if not data:
                return
            yield data


def _read(fd: int) -> Iterator[bytes]:
    """Yield bytes of a file until its end."""
    while data := os.read(fd, AT_ONCE):
        yield data


def _by_thread(items: Iterable[Any], end: Ends) -> Iterator[Any]:
    """Yield items that a thread waits for; whatever it raises is raised here."""
    room = threading.Semaphore(AHEAD)
    queue: SimpleQueue[tuple[str, Any]] = SimpleQueue()

    def wait() -> None:
        try:
            for item in items:
                room.acquire()
                queue.put(("item", item))
            queue.put(("end", None))
        except BaseException as e:
            queue.put(("error", e))

    threading.Thread(target=wait, daemon=True).start()
    while not end.asked.is_set():
        try:
            kind, value = queue.get(timeout=LOOK)
        except Empty:
            continue
        if kind == "end":
            return
        if kind == "error":
            raise value
        room.release()
        yield value
    yield None
