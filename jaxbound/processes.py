"""Several processes that share the work on one recording, and how each learns what became of the others.

They have nothing in common but a folder. In it each keeps a file of its own: its state, a number that grows while it lives, and what it
has heard from the others. A run that died leaves such files behind, so each process draws a word anew and believes only a file that repeats
it: a process of the same run has heard it. Who does not move for a minute is given up, and so is everything else, in one sentence.
"""

import json
import os
import secrets
import shutil
import sys
import threading
import time
from dataclasses import dataclass, field

import jax

__all__ = ["Lost", "Team", "abandon", "join_others"]

ENVIRONMENT = ("JAX_COORDINATOR_ADDRESS", "JAX_NUM_PROCESSES", "JAX_PROCESS_ID")
BEAT = 0.25  # seconds from one sign of life to the next
SILENCE = 60.0  # seconds without one until a process is given up
START = 300.0  # seconds until its first one
FOLDER = ".jaxbound-processes"


class Lost(RuntimeError):
    """Another process of the same run has failed; silent: without a word."""

    def __init__(self, sentence, silent):
        super().__init__(sentence)
        self.silent = silent


@dataclass
class _Other:
    """What is known of another process: its file as it was last read, when that changed, and whether it has repeated our word."""

    text: str = ""
    changed: float = field(default_factory=time.monotonic)
    known: dict = field(default_factory=dict)
    ours: bool = False
    gone: bool = False


class Team:
    """The processes of one run, as one of them sees them; a context: what is raised inside is told to the others.

    Args:
        out: folder that all of them share. number, count: of this process and of all; None: those of `jax.distributed`.
    """

    def __init__(self, out, number=None, count=None):
        self.number = jax.process_index() if number is None else number
        self.count = jax.process_count() if count is None else count
        self.folder, self.lock, self.over = out / FOLDER, threading.RLock(), threading.Event()
        self.others = {i: _Other() for i in range(self.count) if i != self.number}
        self.later = []
        self.own = {"word": secrets.token_hex(8), "heard": {}, "state": "starts", "said": None, "beats": 0}

    def __enter__(self):
        if self.others:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._look()
            self.thread = threading.Thread(target=self._live, daemon=True)
            self.thread.start()
        return self

    def __exit__(self, kind, e, trace):
        if not self.others:
            if e is None:
                shutil.rmtree(self.folder, ignore_errors=True)  # of a run that was killed
            return
        try:
            if e is not None and not isinstance(e, Lost | KeyboardInterrupt):
                self._look()
                self.check()  # what broke here may be what another one left behind
        except Lost as lost:
            e = lost
            raise
        finally:
            if e is not None:
                self.fail(e)
            self._leave(stay=e is not None or self.number == 0)

    def say(self, state, said=None):
        """Tell the others what this process does now."""
        with self.lock:
            self.own |= {"state": state, "said": said}
        if self.others:
            self._look()

    def fail(self, e):
        """Tell the others why this process ends, and they with it."""
        why = "it was interrupted" if isinstance(e, KeyboardInterrupt) else str(e) or type(e).__name__
        self.say("failed", [why, e.silent] if isinstance(e, Lost) else [f"process {self.number} stopped: {why}", False])

    def afterwards(self, do):
        """Call do() once no other process is at work any more."""
        if self.others:
            self.later.append(do)
        else:
            do()

    def said(self, i):
        """Return (state, words) of another process, None before it is heard of."""
        known = self.others[i].known if self.others[i].ours else {}
        return known.get("state"), known.get("said")

    def check(self):
        """Raise Lost if another process has failed or is not heard of any more."""
        for i in self.others:
            state, words = self.said(i)
            if state == "failed":
                raise Lost(*words)
            if self.others[i].gone and i == 0 and state != "published":
                raise Lost("process 0 has ended before the others", False)
            if limit := self._silent(i):
                raise Lost(f"process {i} has not been heard of for {limit:g} s, it may have been killed: start all processes again, "
                           "what is done is kept", True)  # fmt: skip

    def wait(self, done):
        """Return as soon as done() is true; raise Lost as `check`."""
        while not done():
            self.check()
            time.sleep(BEAT / 5)

    def _silent(self, i):
        """Return for how many seconds at least another process has been silent, 0 if that is not long."""
        limit = SILENCE if self.others[i].ours else START
        return limit if not self.others[i].gone and time.monotonic() - self.others[i].changed > limit else 0

    def _live(self):
        while not self.over.wait(BEAT):
            self._look()

    def _look(self):
        """Read what the others say and write what this process has heard."""
        with self.lock:
            for i, other in self.others.items():
                try:
                    text = (self.folder / str(i)).read_text()
                    known = json.loads(text)
                except FileNotFoundError:
                    other.gone = other.ours
                    continue
                except (OSError, ValueError):  # out of reach, or being written
                    continue
                if text != other.text:
                    other.text, other.known, other.changed = text, known, time.monotonic()
                    other.ours = known["heard"].get(str(self.number)) == self.own["word"]
                    self.own["heard"][str(i)] = known["word"]
            self.own["beats"] += 1
            try:
                (self.folder / str(self.number)).write_text(json.dumps(self.own))  # in place: a shared folder shows that soonest
            except OSError:  # out of reach for a moment, or gone with process 0
                pass

    def _leave(self, stay):
        """Take away the own file; stay: not before the others have read it."""
        left = lambda i: self.others[i].gone or (self.number > 0 and self.said(i)[0] == "failed")
        try:
            end = time.monotonic() + SILENCE
            while stay and time.monotonic() < end and not all(left(i) or self._silent(i) for i in self.others):
                time.sleep(BEAT / 5)
        finally:
            for do in self.later:
                do()
            self.over.set()
            self.thread.join()
            (self.folder / str(self.number)).unlink(missing_ok=True)
            if self.number == 0 and all(map(left, self.others)):
                shutil.rmtree(self.folder, ignore_errors=True)


def join_others():
    """Become one of several processes if the environment says so, before JAX is used.

    JAX_COORDINATOR_ADDRESS (host:port of process 0), JAX_NUM_PROCESSES and JAX_PROCESS_ID are read.

    Raises:
        ValueError: one of them is missing or no number; the others do not come.
    """
    given = {name: os.environ[name] for name in ENVIRONMENT if os.environ.get(name)}
    if not given or jax.distributed.is_initialized():
        return
    if missing := [name for name in ENVIRONMENT if name not in given]:
        raise ValueError(f"{' and '.join(given)} of the environment asks for several processes: set {' and '.join(missing)} too")
    address, *numbers = given.values()
    if not all(x.isdecimal() for x in numbers) or not int(numbers[1]) < int(numbers[0]):
        raise ValueError(f"JAX_PROCESS_ID={numbers[1]} must be a whole number below JAX_NUM_PROCESSES={numbers[0]}")
    try:
        jax.distributed.initialize(address, *map(int, numbers), cluster_detection_method="deactivate", heartbeat_timeout_seconds=300)
    except RuntimeError as e:
        raise ValueError(f"the processes do not find each other at JAX_COORDINATOR_ADDRESS={address}: {str(e).splitlines()[0]}") from e


def abandon(code):
    """End this process at its exit with a code, without the others: `jax.distributed` would wait for one that does not answer."""
    import atexit

    def leave():
        if jax.process_index() == 0:
            time.sleep(1)  # jax.distributed ends the others together with this one: let them say why
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)

    atexit.register(leave)
