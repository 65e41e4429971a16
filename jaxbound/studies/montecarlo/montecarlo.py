"""Monte-Carlo studies of a monitor: how often and how soon it sees faults of which size, over a million
scenarios.

Alarms are counted by the proved test alone. Scenarios are worked off in blocks of one size, on every CPU
device, and a block's draws depend on the key, the fault and the scenarios' numbers only: counts are the same
however the work is cut up, interrupted or spread.
"""

import dataclasses
import os
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property, lru_cache
from itertools import islice
from typing import TYPE_CHECKING

import jax
import numpy as np
from numpy.typing import ArrayLike

from jaxbound.consistency.devices import everywhere, on_devices
from jaxbound.consistency.exchange import ExchangeTest
from jaxbound.consistency.interface import Relations, relations_of
from jaxbound.consistency.strips import StripsTest
from jaxbound.estimation.set_observer import SetObserver
from jaxbound.models.conversion import ModelLike, as_model
from jaxbound.models.faults import Fault
from jaxbound.models.fingerprint import fingerprint
from jaxbound.models.system import LinearSystem
from jaxbound.random.keys import key_of
from jaxbound.recordings.arrays import inputs_of, refuse_infinite
from jaxbound.relations.identity import identity
from jaxbound.relations.parity import parity_relations
from jaxbound.relations.residual import Residual
from jaxbound.relations.sentence import remembers
from jaxbound.sets.floats.probe import refuse_unverified
from jaxbound.sets.floats.threads import inherited
from jaxbound.sets.strips.strips import UNROLLED
from jaxbound.studies.montecarlo import adversary, kernel, records, recursion, scenarios
from jaxbound.studies.montecarlo.keeper import Keeper
from jaxbound.studies.montecarlo.study_result import StudyResult
from jaxbound.studies.montecarlo.tally import TrialTally
from jaxbound.workers.engine import in_order

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["study"]

AT = ("uniform", "vertices", "adversarial")
LONGEST = 10**6  # samples of a scenario
ATTACKED = (
    256  # scenarios that an adversary works on at once: the descent's memory is theirs times their length
)
EVERY, PART = 5.0, 64  # seconds between two states that are kept; with rows, tasks in a part
TOGETHER = 16  # tasks that go to a worker at once


def study(
    model: ModelLike,
    faults: str | Fault | Sequence[str | Fault],
    n: int,
    key: jax.Array | int,
    relations: Relations | None = None,
    *,
    samples: int = 200,
    sizes: Sequence[float] | dict[str, Sequence[float]] | None = None,
    onset: int | tuple[int, int] | None = None,
    at: str = "uniform",
    inputs: object = None,
    input_range: ArrayLike | None = None,
    hold: int = 20,
    method: str = "joint",
    confidence: float = 0.95,
    progress: Callable[[float], object] | None = None,
    out: str | os.PathLike | None = None,
    rows: bool = False,
    client: "Client | None" = None,
) -> StudyResult:
    """Simulate n scenarios with faults, count what the proved test finds, and say how sure the shares are.

    A scenario is a recording of `samples` samples from x = 0: inputs, unknowns within the model's bounds, and
    a fault of one size from its onset on. Scenario j of a fault has its size number j modulo the number of
    sizes. What is counted: `StudyResult`.

    Args:
        model: a LinearSystem, the plant as it is.
        faults: texts "signal:kind" (kinds as in `Fault`), Fault objects, or one of these; () for healthy
            scenarios only.
        n: scenarios, spread evenly over the faults.
        key: a jax.random key, or a whole number.
        relations: of the monitor, whatever `detect` takes, a bank, a residual or an `observer` too (then
            windows are samples, those behind the onset faulty); None: `parity_relations(model)`. Those of
            another model with the same signals show what happens when its bounds are not the plant's.
        samples: of a scenario. sizes: of the faults, in the unit of the signal (relative for gain and
            tolerance): a sequence for all, or {"signal:kind": sequence}; None: a Fault's own, else twelve
            around the guaranteed size.
        onset: a sample, or (lo, hi): drawn uniformly from lo <= k < hi; None: a Fault's own start and stop,
            else the second quarter.
        at: "uniform" draws unknowns uniformly, "vertices" each at one of its bounds, "adversarial" chooses
            them to hide the fault.
        inputs: (samples, m) for all, or a table; None: piecewise constant levels, uniform in input_range.
        hold: samples that each of these levels lasts.
        input_range: (lo, hi), or one such pair an input, in the unit of the inputs; None: the
            model's `ranges` (`fit` writes them), else from 1 below the offset to 1 above.
        method: of the monitor, as for `detect`; all but "linearized", which proves nothing.
        confidence: of the intervals.
        progress: called with the share of the work done.
        out: a folder where the state is kept every few seconds: the same call goes on where a killed one
            stopped, and ends with the same counts.
        rows: True keeps a row for each scenario there too, in Parquet files: fault, size, scenario, onset,
            fault_windows, false_alarms, delay.
        client: of dask.distributed, whose workers simulate and test; the counts are the same.

    Returns:
        A StudyResult.

    Raises:
        ValueError: an unknown fault, signal, `at`, or a number out of range; `out` holds another study.
        NotImplementedError: an adversary with uncertain parameters, unknown inputs or sensors without noise.

    Encloses: where relations are those of the model, no window without a faulty sample is ever FAULT: the
    simulated data are explained by
        unknowns within their bounds, rounding included (`recursion`, `simulate`).

    Example:
        >>> import jaxbound as jb
        >>> m = jb.LinearSystem([[0.8]], [[1]], [[1]], noise=0.1)
        >>> found = study(m, "y1:bias", 2000, 0, sizes=[0.1, 2.5], samples=40)
        >>> found.false_alarms[0], found.tallies[0].detected[1]
        (0, np.int64(1000))
    """
    model = as_model(model)
    relations = parity_relations(model) if relations is None else _named(relations, model)
    method = SetObserver.method if isinstance(relations, SetObserver) and method == "joint" else method
    _check(model, relations, n, samples, hold, at, method, confidence)
    refuse_unverified()
    dtype = jax.dtypes.canonicalize_dtype(np.float64)
    u, limits, highest = _inputs(model, inputs, input_range, samples, dtype)
    samples = samples if u is None else len(u)
    trials = scenarios.trials(model, faults, sizes, onset, samples, relations, highest)
    if method != "joint":  # what is guaranteed is guaranteed of the joint test
        trials = [dataclasses.replace(t, guaranteed=np.nan) for t in trials]
    counts = [n // len(trials) + (i < n % len(trials)) for i in range(len(trials))]
    if n < len(trials):
        raise ValueError(f"n must be at least the number of faults, {len(trials)}, not {n}")
    key = key_of(key)
    words = [np.asarray(_words(key, i)) for i in range(len(trials))]
    reach = samples if remembers(relations) else relations.horizon
    room = np.max(
        [
            recursion.rounding_room(
                model, reach, scenarios.largest_input(model, t, highest, samples), samples, dtype
            )
            for t in trials
        ],
        0,
    )
    course = kernel.Course(samples, hold, at == "vertices")
    made = model, relations, course, at, method, room, u, limits, dtype
    run, block = _engine(*made)
    settings = {
        "method": method,
        "at": at,
        "samples": samples,
        "hold": hold,
        "n": n,
        "horizon": relations.horizon,
        "dtype": np.dtype(dtype).name,
        "input range": limits.tolist(),
        "inputs": None if u is None else fingerprint(u),
        "key": [w.tolist() for w in words],
        "engine": run.__name__,
        "faults": [[t.label, t.sizes.tolist(), t.onset, t.length] for t in trials],
    }
    tallies = [TrialTally(len(t.sizes), samples) for t in trials]
    keeper = (
        None
        if out is None
        else Keeper(out, identity(relations, plant=model, rows=rows, block=block, **settings), tallies, rows)
    )
    tasks = [(i, first) for i, count in enumerate(counts) for first in range(0, count, block)]
    job = _Scenarios(made, [scenarios.act_of(t, model, dtype) for t in trials], words, block)

    def collect(number, found):
        i, first = tasks[number]
        take = min(block, counts[i] - first)
        hits, false, delay, begun = (np.asarray(x)[:take] for x in found)
        which = np.arange(first, first + take) % len(trials[i].sizes)
        windows, clean = trials[i].spans(begun, samples, relations)
        tallies[i].add(which, hits, false, delay, windows, clean)
        if keeper is not None:
            keeper.add_rows(
                trials[i].label,
                trials[i].sizes[which],
                np.arange(first, first + take),
                begun,
                hits,
                false,
                delay,
            )

    _work_off(client, job, tasks, collect, keeper, progress)
    return StudyResult(
        model, relations.horizon, tuple(trials), tuple(tallies), at, samples, confidence, settings
    )


@dataclasses.dataclass(frozen=True, eq=False)
class _Scenarios:
    """The scenarios of a study as a `Job`: a task is (number of a fault, first scenario), a block from there
    on.

    Fields: made: what `_engine` takes. acts, words: of each fault. block: scenarios in a task.
    """

    made: tuple
    acts: list
    words: list
    block: int

    @cached_property
    def counted(self):
        """The function that counts a block; made where the work is done."""
        return _engine(*self.made)[0]

    def run(self, task):
        """Return the counts of each scenario of a block: hits, false, delay, onset; judged on the CPU,
        whatever there is beside.
        """
        i, first = task
        with jax.default_device(jax.local_devices(backend="cpu")[0]):
            found = self.counted(
                self.acts[i], self.words[i], np.arange(first, first + self.block, dtype=np.uint32)
            )
        return tuple(map(np.asarray, found))


@jax.jit
def _words(key, i):
    """Return (2,) random words for the fault with number i."""
    return jax.random.bits(jax.random.fold_in(key, i), (2,), np.uint32)


def _named(relations: Relations, model: LinearSystem) -> Relations:
    """Give a residual whose signals have no names those of the plant, in its order; see `Channels`."""
    if not isinstance(relations, Residual):
        return relations
    channels = relations.model
    inputs = model.inputs if channels.stated_inputs is None else channels.inputs
    outputs = model.outputs if channels.stated_outputs is None else channels.outputs
    named = dataclasses.replace(channels, stated_inputs=inputs, stated_outputs=outputs)
    return dataclasses.replace(relations, model=named)


def _check(model, relations, n, samples, hold, at, method, confidence):
    relations_of(relations, "a study", "study(model, .., relations=parity_relations(model))")
    if method == "linearized":
        raise ValueError(
            "method 'linearized' neglects terms and proves no FAULT, which is what a study counts: use "
            "'joint' or 'paving'"
        )
    if (relations.model.inputs, relations.model.outputs) != (model.inputs, model.outputs):
        raise ValueError("the relations speak of other signals than the model of the study")
    for name, value in (("n", n), ("samples", samples), ("hold", hold)):
        if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 1:
            raise ValueError(f"{name} must be a whole number >= 1, not {value!r}")
    if samples > LONGEST:
        raise ValueError(
            f"samples must be at most {LONGEST}, not {samples}: a fault that is not seen by then never is"
        )
    if n >= 2**32:
        raise ValueError(f"n must be below 2^32, not {n}: run several studies with different keys")
    if at not in AT:
        raise ValueError(f"at must be one of {', '.join(AT)}, not {at!r}")
    if not 0 < confidence < 1:
        raise ValueError(f"confidence must be between 0 and 1, not {confidence!r}")


def _inputs(model, inputs, input_range, samples, dtype):
    """Return (u (T, m) or None, limits (m, 2), largest |u - offset| (m,))."""
    offset = np.array([float(x) for x in model.offset["u"]])
    if inputs is not None:
        u = np.asarray(inputs_of(model, inputs, "inputs"), dtype)
        if u.ndim != 2 or u.shape[1] != model.m:
            raise ValueError(
                f"inputs must have shape (samples, {model.m}), time first: their shape is {u.shape}"
            )
        if not np.isfinite(u).all():
            refuse_infinite("inputs", u, model.inputs)
            raise ValueError("inputs of a study must not be missing (NaN)")
        return u, np.zeros((model.m, 2), dtype), np.abs(u - offset).max(0, initial=0)
    if input_range is None:
        known = [model.ranges.get(name, (x - 1, x + 1)) for name, x in zip(model.inputs, offset, strict=True)]
        limits = np.array([[float(lo), float(hi)] for lo, hi in known]).reshape(-1, 2)
    else:
        limits = np.asarray(input_range, float)
    if limits.shape not in ((2,), (model.m, 2)):
        raise ValueError(
            f"input_range needs a pair (lo, hi), or one for each of {model.m} inputs: its shape is "
            f"{limits.shape}"
        )
    limits = np.broadcast_to(limits, (model.m, 2)).astype(dtype)
    if not (np.isfinite(limits).all() and (limits[:, 0] <= limits[:, 1]).all()):
        raise ValueError(f"input_range needs finite lo <= hi, not {limits.tolist()}")
    return None, limits, np.abs(limits - offset[:, None]).max(1)


def _engine(model, relations, course, at, method, room, u, limits, dtype):
    """Return (function of (act, key, numbers) that counts a block of scenarios, their number)."""
    by = relations.test(method, dtype)  # refuses here what it would refuse in every block
    certain = isinstance(by, StripsTest | ExchangeTest)
    plain = recursion.fits(model, room) and np.isfinite(room).all()
    if plain:
        plant = recursion.plant_of(model, room, dtype)
    if at == "adversarial":
        if not (plain and certain):
            raise NotImplementedError(
                "an adversary needs a test by strips, down whose margin it goes: a certain model without "
                "averages, noise on every output, "
                "parity relations, method 'joint' or 'box'; use at='vertices' instead"
            )
        test = relations.reading(dtype)

        def attacked(act, key, numbers):
            us, ys, onset = map(
                np.asarray, adversary.attack_block(course, test, plant, act, limits, u, key, numbers)
            )
            return *records.count_recordings(relations, act, us, ys, onset, method), onset

        return attacked, min(ATTACKED, records.recording_block(course))
    few = method == "joint" and certain and 0 < len(relations.circuits) <= UNROLLED
    if plain and few:  # where circuits are many, what the fused kernel saves is nothing beside their test
        devices, test = tuple(jax.local_devices(backend="cpu")), relations.reading(dtype)

        def counted(act, key, numbers):
            blocks = [(part,) for part in np.split(numbers, len(devices))]
            found = on_devices(
                _counter(course), everywhere((test, plant, act, limits, u, key), devices), blocks, devices
            )
            return tuple(map(np.concatenate, zip(*found, strict=True)))

        return counted, kernel.BLOCK * len(devices)

    def written(act, key, numbers):
        if plain:
            us, ys, onset = map(np.asarray, kernel.replay_block(course, plant, act, limits, u, key, numbers))
        else:
            us, ys, onset = records.simulate_block(course, model, act, limits, u, key, numbers)
        return *records.count_recordings(relations, act, us, ys, onset, method), onset

    return written, records.recording_block(course)


@lru_cache(maxsize=32)
def _counter(course):
    """Return `count_block` as a kernel of (everything that is the same for all scenarios, their numbers)."""
    return lambda constants, numbers: kernel.count_block(course, *constants, numbers)


def _work_off(client, job, tasks, collect, keeper, progress):
    """Do the tasks that are left; collect them in order, and keep the state now and then."""
    done, saved = 0 if keeper is None else keeper.done, time.monotonic()
    try:
        for found in (
            _here(job, tasks[done:]) if client is None else in_order(client, job, tasks[done:], TOGETHER)
        ):
            collect(done, found)
            done += 1
            due = done % PART == 0 if keeper is not None and keeper.rows else time.monotonic() - saved > EVERY
            if keeper is not None and (due or done == len(tasks)):
                keeper.save(done)
                saved = time.monotonic()
            if progress is not None:
                progress(done / len(tasks))
    except (
        KeyboardInterrupt
    ):  # what was collected since the last state may be half counted: it is drawn again
        if keeper is None:
            raise
        kept = f"{keeper.done} of {len(tasks)} blocks of scenarios are kept in {keeper.folder}"
        raise KeyboardInterrupt(f"interrupted: {kept}, the same command goes on from there") from None


def _here(job, tasks):
    """Yield the results of tasks, in order; one runs on each core at a time."""
    _, *others = jax.local_devices(backend="cpu")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    threads = max(1, cores // (1 + len(others)))
    run = inherited(job.run)
    left, waiting = iter(tasks), deque()  # type: ignore[var-annotated]

    with ThreadPoolExecutor(threads) as pool:
        try:
            waiting.extend(pool.submit(run, task) for task in islice(left, threads + 2))
            while waiting:
                found = waiting.popleft().result()
                waiting.extend(pool.submit(run, task) for task in islice(left, 1))
                yield found
        finally:
            for one in waiting:
                one.cancel()
