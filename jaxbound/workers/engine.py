"""Tasks on the workers of an engine that exists: dask.distributed sends them out, and again where a worker
died.

A job is a value that can be pickled, with a method `run(task)` that is a pure function: what it returns, or
the file that it writes whole, depends on the job and the task alone. So it does not matter who runs a task,
how often and in which order. Which tasks are left is known to whoever asks, from the files that are there or
from a checkpoint: the engine remembers nothing.

A worker is a process that was started afresh, with one thread: jax is not to be forked. Where workers have
the resource GPU, a task takes one: start a process for each card, with `--nthreads 1 --resources GPU=1`.
"""

import logging
import os
import pickle
import platform
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import jax

from jaxbound.sets.floats.probe import Unverified
from jaxbound.sets.floats.threads import has_x64

if TYPE_CHECKING:
    from distributed import Client, LocalCluster, Worker

# settings of workers that we start ourselves
WORKERS = {
    "distributed.worker.multiprocessing-method": "spawn",
    # workers that may die of one task: what kills them may have nothing to do with it
    "distributed.scheduler.allowed-failures": 100,
    # until a worker is given up: to start it may take long where the machine is busy
    "distributed.deploy.lost-worker-timeout": "600s",
    "distributed.nanny.pre-spawn-environ": {
        # the memory of a chunk is kept for the next: to return it and ask again costs as much as to judge
        **{
            "MALLOC_ARENA_MAX": 1,
            "MALLOC_MMAP_THRESHOLD_": 1 << 30,
            "MALLOC_TRIM_THRESHOLD_": 1 << 30,
            "NUMPY_MADVISE_HUGEPAGE": 0,
        },
        "OMP_NUM_THREADS": 1,  # columns are decoded by threads, too
    },
    # measurements of themselves, up to fifty times a second, that nobody reads
    "distributed.worker.profile.enabled": False,
    "distributed.admin.system-monitor.interval": "60s",
    "distributed.admin.tick": {"interval": "10s", "limit": "600s", "cycle": "60s"},
}
RETRIES = 3  # of a task that fails by more than what it says of its data
AHEAD = 4  # tasks a thread that are sent out at once: results must not pile up
WAIT = 60  # seconds until a scheduler answers
# a worker, where a task may be of any length: a few, for each reads again what comes before it
TASKS = 4
HERE = ("processor", "devices")  # workers have these in common, but need not share them with this process
ALIKE = "for the same bytes everywhere, workers need the same kind of processor and the same versions"
GOES_ON = "what is done is kept, the same call goes on from there"


class Job(Protocol):
    """One piece of work, of which tasks are parts; it can be pickled."""

    def run(self, task: Any) -> Any:
        """Do one task."""


class _Kind(NamedTuple):
    """A worker as it describes itself: {name: text} of all that its bits depend on, threads, whether it has a
    GPU.
    """

    names: dict[str, str]
    threads: int
    has_gpu: bool


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
            place = open_things.enter_context(_own_cluster(LocalCluster, workers))
        try:
            client = Client(place, timeout=WAIT, set_as_default=False)
        except (OSError, ValueError) as e:
            raise ConnectionError(f"no dask scheduler answers at {scheduler}: {e}") from None
        yield open_things.enter_context(client)


def _own_cluster(cluster: Callable[..., "LocalCluster"], workers: int | None) -> "LocalCluster":
    """Start processes of this machine, one thread each, with nothing to say."""
    try:
        return cluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            env=_environment(),
            silence_logs=logging.CRITICAL,
            dashboard_address="127.0.0.1:0",
            memory_limit=None,
        )
    except RuntimeError as e:
        raise ConnectionError(f"{workers} workers could not be started here: {e}") from None


def spread(client: "Client", job: Job, tasks: Sequence[Any]) -> Iterator[tuple[int, Any]]:
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

    kind = _alike(client)
    address = _address(client)
    needs = {"resources": {"GPU": 1}} if kind.has_gpu else {}
    # sent once, and a task itself: what is scattered is lost with the worker that holds it
    packed = client.submit(_kept, pickle.dumps((job, kind.names, has_x64())), pure=False)
    ready, left = as_completed(loop=client.loop), deque(enumerate(tasks))
    numbers: dict[Any, int] = {}
    try:
        while left or numbers:
            while left and len(numbers) < AHEAD * kind.threads:
                number, task = left.popleft()
                future = client.submit(_attempt, packed, task, pure=False, retries=RETRIES, **needs)
                numbers[future] = number
                ready.add(future)
            future = next(ready)
            refused, result = future.result()
            if refused is not None:
                raise refused
            yield numbers.pop(future), result
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


def in_order(client: "Client", job: Job, tasks: Sequence[Any], together: int = 1) -> Iterator[Any]:
    """Yield the results of the tasks of a job in their order.

    Args:
        client, job, tasks: as for `spread`. together: how many tasks are sent as one, where to send one costs
            as much as to do it.
    """
    groups = [tasks[i : i + together] for i in range(0, len(tasks), together)]
    early: dict[int, list[Any]] = {}
    done = 0
    for number, results in spread(client, _Together(job), groups):
        early[number] = results
        while done in early:
            yield from early.pop(done)
            done += 1


@dataclass(frozen=True)
class _Together:
    """Several tasks of a job as one."""

    job: Job

    def run(self, tasks: Sequence[Any]) -> list[Any]:
        """Return the results of these tasks."""
        return [self.job.run(task) for task in tasks]


def stretches_for(client: "Client | None", stretches: Sequence[range]) -> list[range]:
    """Cut ranges into tasks, so many that all workers are done at about the same time; uncut without a
    client.
    """
    if client is None:
        return list(stretches)
    count = sum(map(len, stretches))
    threads = sum(client.nthreads().values())
    size = max(1, count // (TASKS * max(threads, 1)))
    return [x[i : i + size] for x in stretches for i in range(0, len(x), size)]


def processor() -> str:
    """Return the processor that rounds the last bits of this process: its name, and flags of the compiler."""
    flags = os.environ.get("XLA_FLAGS", "")
    told, name = Path("/proc/cpuinfo"), platform.machine()
    if told.exists():
        name += told.read_text().partition("model name")[2].partition(":")[2].partition("\n")[0]
    return f"{name} with {flags}" if flags else name


@lru_cache
def _kind() -> dict[str, str]:
    """Return {name: text} of all that the bits of this process depend on."""
    from jaxbound import __version__

    kinds = {f"{device.platform} {device.device_kind}" for device in jax.local_devices()}
    packages = {name: version(name) for name in ("jax", "jaxlib", "numpy")}
    devices = ",".join(sorted(kinds))
    return {"jaxbound": __version__, **packages, "processor": processor(), "devices": devices}


def _about(dask_worker: "Worker") -> tuple[dict[str, str], int, bool]:
    """Return (kind, threads, whether it has a GPU to give) of a worker."""
    return _kind(), dask_worker.state.nthreads, bool(dask_worker.state.total_resources.get("GPU"))


def _alike(client: "Client") -> _Kind:
    """Return the kind of all workers, their threads together; refuse workers that write other bytes."""
    answers = _answers(client)
    mine = {name: text for name, text in _kind().items() if name not in HERE}
    names = next(iter(answers.values())).names
    threads, has_gpu = 0, False
    for address, other in answers.items():
        different = _differing_names(other.names, names | mine)
        if different:
            raise ConnectionError(f"the worker {address} has {different}: {ALIKE}")
        threads += other.threads
        has_gpu |= other.has_gpu
    return _Kind(names, threads, has_gpu)


def _answers(client: "Client") -> dict[str, _Kind]:
    """Return {address: its kind} of the workers, at least one; refuse those that are of no use."""
    from jaxbound import __version__

    answers: dict[str, _Kind] = {}
    while not answers:
        try:
            client.wait_for_workers(1, timeout=WAIT)
        except TimeoutError:
            raise ConnectionError(f"the scheduler {_address(client)} has no workers") from None
        for address, answer in client.run(_about, on_error="return").items():
            if isinstance(answer, OSError):  # it died meanwhile
                continue
            if isinstance(answer, ModuleNotFoundError):
                raise ConnectionError(
                    f"the worker {address} cannot import {answer.name}: it needs jaxbound {__version__}, as "
                    f"this process has it"
                )
            if isinstance(answer, BaseException):
                raise ConnectionError(f"the worker {address} is of no use: {type(answer).__name__}: {answer}")
            answers[address] = _Kind(*answer)
    return answers


def _address(client: "Client") -> str:
    """Return the address of the scheduler, nothing where a client has lost it."""
    return getattr(client.scheduler, "address", "")


def _differing_names(kind: dict[str, str], wanted: dict[str, str]) -> str:
    """Return the names in which a kind differs from the one that is wanted, as text; empty for none."""
    differing = (name for name, text in kind.items() if text != wanted[name])
    return " and ".join(f"{name} {kind[name]}, not {wanted[name]}" for name in differing)


def _kept(data: bytes) -> bytes:
    """Return the data: a task that workers keep."""
    return data


@lru_cache(maxsize=4)
def _unpacked(data: bytes) -> tuple[Job, dict[str, str], bool]:
    """Unpack a job, once in a worker: a job may keep what it computes."""
    job, kind, wide = pickle.loads(data)
    return job, kind, wide


def _attempt(packed: bytes, task: object) -> tuple[Exception | None, Any]:
    """Return (the refusal of a task or None, its result): data that are wrong are as wrong at the next
    attempt.
    """
    job, kind, wide = _unpacked(packed)
    different = _differing_names(_kind(), kind)
    if different:  # one that came later
        return ConnectionError(f"a worker that joined has {different}: {ALIKE}; {GOES_ON}"), None
    try:
        with jax.enable_x64(wide):  # of this thread alone: the worker may be of use to others
            return None, job.run(task)
    except (ValueError, TypeError, NotImplementedError, Unverified) as e:
        return e, None


def _environment() -> dict[str, str]:
    """Return the environment of processes that we start: where kernels are kept, and the platform."""
    environment = {
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
    }
    # attributes of the configuration are made at run time
    platforms = jax.config.jax_platforms  # type: ignore[attr-defined]
    kernels = jax.config.jax_compilation_cache_dir  # type: ignore[attr-defined]
    if platforms:
        environment["JAX_PLATFORMS"] = platforms
    if kernels:
        environment["JAX_COMPILATION_CACHE_DIR"] = kernels
    return environment
