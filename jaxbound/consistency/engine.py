"""Tasks on the workers of an engine that exists: dask.distributed sends them out, and again where a worker
died.

A job is a value that can be pickled, with a method `run(task)` that is a pure function: what it returns, or
the file that it writes whole, depends on the job and the task alone. So it does not matter who runs a task,
how often and in which order. Which tasks are left is known to whoever asks, from the files that are there or
from a checkpoint: the engine remembers nothing.

A worker is a process that was started afresh, with one thread: jax is not to be forked. Where workers have
the resource GPU, a task takes
one: start a process for each card, with `--nthreads 1 --resources GPU=1`.
"""

import logging
import os
import pickle
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import version
from typing import TYPE_CHECKING, Any, Protocol

import jax

from jaxbound.sets.floats import settings
from jaxbound.sets.floats.probe import Unverified
from jaxbound.sets.floats.threads import has_x64

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["Job", "connected", "in_order", "processor", "spread", "stretches_for"]

WORKERS = {  # how those are set that we start ourselves
    "distributed.worker.multiprocessing-method": "spawn",
    # may die of one task: what kills them may have nothing to do with it
    "distributed.scheduler.allowed-failures": 100,
    # until one is given up: to start it may take long where the machine is busy
    "distributed.deploy.lost-worker-timeout": "600s",
    "distributed.nanny.pre-spawn-environ": {
        # the memory of a chunk is kept for the next one: to give it back and to ask again costs as much as to
        # judge
        **{
            "MALLOC_ARENA_MAX": 1,
            "MALLOC_MMAP_THRESHOLD_": 1 << 30,
            "MALLOC_TRIM_THRESHOLD_": 1 << 30,
            "NUMPY_MADVISE_HUGEPAGE": 0,
        },
        "OMP_NUM_THREADS": 1,  # what decodes columns asks for it, too
    },
    # what they would measure of themselves up to fifty times a second, and nobody reads
    "distributed.worker.profile.enabled": False,
    "distributed.admin.system-monitor.interval": "60s",
    "distributed.admin.tick": {"interval": "10s", "limit": "600s", "cycle": "60s"},
}
RETRIES = 3  # of a task that fails by more than what it says of its data
AHEAD = 4  # tasks a thread that are sent out at once: results must not pile up
WAIT = 60  # seconds until a scheduler answers
# a worker, where a task may be of any length: a few, for each reads again what comes before it; parts of a
# task are kept
TASKS = 4
HERE = ("processor", "devices")  # of a kind, what workers have in common but need not share with this process
ALIKE = "for the same bytes everywhere, workers need the same kind of processor and the same versions"
GOES_ON = "what is done is kept, the same call goes on from there"


class Job(Protocol):
    """What the tasks of one piece of work have in common; it can be pickled."""

    def run(self, task: Any) -> Any:
        """Do one task."""


@contextmanager
def connected(scheduler: str | None = None, workers: int | None = None) -> Iterator["Client"]:
    """Give a dask.distributed Client, and let go of it at the end.

    Args:
        scheduler: address of one that runs, like tcp://host:8786. workers: or processes of this machine to
            start, one thread each.

    Raises:
        ValueError: distributed is not installed. ConnectionError: nobody answers.
    """
    try:
        import dask
        from distributed import Client, LocalCluster
    except ImportError:
        raise ValueError(
            "workers need dask.distributed, which is not installed: pip install 'jaxbound[dask]'"
        ) from None
    with ExitStack() as open_things:
        place: Any = scheduler
        if scheduler is None:
            open_things.enter_context(dask.config.set(WORKERS))
            quiet = {
                "silence_logs": logging.CRITICAL,
                "dashboard_address": "127.0.0.1:0",
                "memory_limit": None,
            }
            try:
                place = LocalCluster(
                    n_workers=workers, threads_per_worker=1, processes=True, env=_environment(), **quiet
                )
            except RuntimeError as e:
                raise ConnectionError(f"{workers} workers could not be started here: {e}") from None
            open_things.enter_context(place)
        try:
            client = Client(place, timeout=WAIT, set_as_default=False)
        except (OSError, ValueError) as e:
            raise ConnectionError(f"no dask scheduler answers at {scheduler}: {e}") from None
        yield open_things.enter_context(client)


def spread(client: "Client", job: Job, tasks: Sequence) -> Iterator[tuple[int, Any]]:
    """Let workers do the tasks of a job; yield (number of a task, what it returned) as they are done, in any
    order.

    Args:
        client: of dask.distributed. job: see `Job`. tasks: any sequence of what can be pickled.

    Raises:
        ConnectionError: workers of several kinds, or none; a scheduler that is gone; a task that no worker
            survives: what is done stays.
        Exception: what a task says of its data, as it is.
    """
    from distributed import KilledWorker, as_completed
    from distributed.comm import CommClosedError

    kind, threads, gpus = _alike(client)
    address = getattr(
        client.scheduler, "address", ""
    )  # a client that lost its scheduler does not know it any more
    wide, needs = has_x64(), {"resources": {"GPU": 1}} if gpus else {}
    # sent once, and a task itself: what is scattered is lost with the worker that holds it
    given = client.submit(_kept, pickle.dumps((job, kind, wide)), pure=False)
    ready, left = as_completed(loop=client.loop), deque(enumerate(tasks))
    numbers: dict[Any, int] = {}
    try:
        while left or numbers:
            while left and len(numbers) < AHEAD * threads:
                number, task = left.popleft()
                future = client.submit(_attempt, given, task, pure=False, retries=RETRIES, **needs)
                numbers[future] = number
                ready.add(future)
            future = next(ready)
            refused, found = future.result()
            if refused is not None:
                raise refused
            yield numbers.pop(future), found
    except KilledWorker:
        raise ConnectionError(
            f"workers died with one of {len(tasks)} tasks again and again, too little memory perhaps: "
            f"{GOES_ON}"
        ) from None
    except (CancelledError, CommClosedError):
        raise ConnectionError(f"the scheduler {address} is gone: {GOES_ON}") from None
    finally:
        with suppress(Exception):  # whoever is gone need not be told
            client.cancel(list(numbers))


def in_order(client: "Client", job: Job, tasks: Sequence, together: int = 1) -> Iterator[Any]:
    """Yield what the tasks of a job return in their order.

    Args:
        client, job, tasks: as for `spread`. together: how many tasks are sent as one, where to send one costs
            as much as to do it.
    """
    done, held = 0, {}
    for number, found in spread(
        client, _Together(job), [tasks[i : i + together] for i in range(0, len(tasks), together)]
    ):
        held[number] = found
        while done in held:
            yield from held.pop(done)
            done += 1


@dataclass(frozen=True)
class _Together:
    """Several tasks of a job as one."""

    job: Job

    def run(self, tasks):
        """Return what they return."""
        return [self.job.run(task) for task in tasks]


def stretches_for(client: "Client | None", stretches: Sequence[range]) -> list[range]:
    """Return ranges cut into tasks, so many that all workers are done at about the same time; uncut where
    there is no client.
    """
    if client is None:
        return list(stretches)
    count = sum(map(len, stretches))
    size = max(1, count // (TASKS * max(sum(client.nthreads().values()), 1)))
    return [x[i : i + size] for x in stretches for i in range(0, len(x), size)]


def processor() -> str:
    """Return the kind of processor that rounds the last bits of this process: its maker's name, and what the
    compiler may use of it.
    """
    flags = os.environ.get("XLA_FLAGS", "")
    name, _ = settings.processor()
    return f"{name} with {flags}" if flags else name


@lru_cache
def _kind():
    """Return what the bits that this process computes depend on."""
    from jaxbound import __version__

    devices = ",".join(sorted({f"{d.platform} {d.device_kind}" for d in jax.local_devices()}))
    packages = {name: version(name) for name in ("jax", "jaxlib", "numpy")}
    return {"jaxbound": __version__, **packages, "processor": processor(), "devices": devices}


def _about(dask_worker):
    """Return (kind, threads, whether it has a GPU to give) of a worker."""
    return _kind(), dask_worker.state.nthreads, bool(dask_worker.state.total_resources.get("GPU"))


def _alike(client):
    """Return (the kind of all workers, their threads, whether they have GPUs to give); refuse workers that
    write other bytes.
    """
    from jaxbound import __version__

    answers: dict[str, Any] = {}
    while not answers:
        try:
            client.wait_for_workers(1, timeout=WAIT)
        except TimeoutError:
            raise ConnectionError(f"the scheduler {client.scheduler.address} has no workers") from None
        found = client.run(_about, on_error="return")
        answers = {
            address: x for address, x in found.items() if not isinstance(x, OSError)
        }  # those died meanwhile
    for address, found in answers.items():
        if isinstance(found, ModuleNotFoundError):
            raise ConnectionError(
                f"the worker {address} cannot import {found.name}: it needs jaxbound {__version__}, as this "
                f"process has it"
            )
        if isinstance(found, BaseException):
            raise ConnectionError(f"the worker {address} is of no use: {type(found).__name__}: {found}")
    mine = {name: text for name, text in _kind().items() if name not in HERE}
    (kind, _, _), *_ = answers.values()
    for address, (found, _, _) in answers.items():
        if said := _difference(found, kind | mine):
            raise ConnectionError(f"the worker {address} has {said}: {ALIKE}")
    threads, gpus = zip(*(answer[1:] for answer in answers.values()), strict=True)
    return kind, sum(threads), any(gpus)


def _difference(kind, wanted):
    """Return what a kind has that is not what is wanted, as text; empty where nothing is."""
    return " and ".join(
        f"{name} {text}, not {wanted[name]}" for name, text in kind.items() if text != wanted[name]
    )


def _kept(data):
    return data


@lru_cache(maxsize=4)
def _unpacked(data):
    """Return what was packed; once in a worker, for a job may keep what it computes."""
    return pickle.loads(data)


def _attempt(given, task):
    """Return (what the task refuses or None, what it returns): what is wrong with data is as wrong at the
    next attempt.
    """
    job, kind, wide = _unpacked(given)
    if said := _difference(_kind(), kind):  # one that came later
        return ConnectionError(f"a worker that joined has {said}: {ALIKE}; {GOES_ON}"), None
    try:
        with jax.enable_x64(wide):  # of this thread alone: the worker may be of use to others
            return None, job.run(task)
    except (ValueError, TypeError, NotImplementedError, Unverified) as e:
        return e, None


def _environment():
    """Return what a process of our own needs to know of this one: where kernels are kept, and on what it
    computes.
    """
    found = {
        "JAX_PLATFORMS": jax.config.jax_platforms,  # type: ignore[attr-defined]
        "JAX_COMPILATION_CACHE_DIR": jax.config.jax_compilation_cache_dir,  # type: ignore[attr-defined]
    }
    keeps = {
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
    }
    return {name: text for name, text in found.items() if text} | keeps
