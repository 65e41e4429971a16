"""Monte-Carlo studies of a monitor: how often and how soon it sees faults of which size, over a million
scenarios.

Alarms are counted by the proved test alone. Scenarios are worked off in blocks of one size, on every CPU
device, and a block's draws depend on the key, the fault and the scenarios' numbers only: counts are the same
however the work is cut up, interrupted or spread.
"""

from __future__ import annotations

import dataclasses
import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import TYPE_CHECKING, TypeAlias

import jax
import numpy as np
from numpy.typing import ArrayLike

from jaxbound.consistency.devices import everywhere, on_devices
from jaxbound.consistency.interface import AUTO, MONITOR, Relations, margins_for, relations_of
from jaxbound.models.conversion import ModelLike, as_model
from jaxbound.models.faults import Fault
from jaxbound.models.fingerprint import fingerprint
from jaxbound.models.numbers import is_real, is_whole
from jaxbound.models.statedtests import OTHERWISE
from jaxbound.models.system import LinearSystem
from jaxbound.random.keys import key_of
from jaxbound.recordings.arrays import inputs_of, refuse_infinite
from jaxbound.recordings.expressions import expression
from jaxbound.recordings.factors import factors_of
from jaxbound.relations.identity import identity
from jaxbound.relations.parity import parity_relations
from jaxbound.sets.floats.kernel import sparing
from jaxbound.sets.floats.probe import where_proofs_hold
from jaxbound.sets.floats.threads import inherited
from jaxbound.sets.strips.strips import UNROLLED
from jaxbound.studies.montecarlo import adversary, kernel, records, recursion, scenarios
from jaxbound.studies.montecarlo.keeper import Keeper
from jaxbound.studies.montecarlo.recursion import FloatPlant
from jaxbound.studies.montecarlo.scenarios import Act
from jaxbound.studies.montecarlo.study_result import StudyResult
from jaxbound.studies.montecarlo.tally import TrialTally
from jaxbound.text.names import listed
from jaxbound.text.progress import Progress, reporter
from jaxbound.workers.engine import in_order

if TYPE_CHECKING:
    from distributed import Client

Task: TypeAlias = tuple[int, int]
"""(number of a fault, its first scenario)."""
Counts: TypeAlias = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
"""hits, false, delay and onset of each scenario, as `kernel.count_block` has them; of a monitor the first
three have a column for itself and one for each test.
"""
Engine: TypeAlias = Callable[[Act, np.ndarray, np.ndarray], Counts]
"""(act, key, numbers of the scenarios) -> their counts."""

AT = ("uniform", "vertices", "adversarial")
LONGEST = 10**6  # samples of a scenario
ATTACKED = 256  # scenarios that an adversary works on at once: they share the memory of the descent
EVERY, PART = 5.0, 64  # seconds between two states that are kept; with rows, tasks in a part
TOGETHER = 16  # tasks that go to a worker at once
AHEAD = 64  # tasks a thread that are sent out at once


@where_proofs_hold()
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
    out: str | os.PathLike[str] | None = None,
    rows: bool = False,
    client: Client | None = None,
) -> StudyResult:
    """Simulate n scenarios with faults, count what the proved test finds, and say how sure the shares are.

    A scenario is a recording of `samples` samples from x = 0: inputs, unknowns within the model's bounds, and
    a fault of one size from its onset on. Scenario j of a fault has its size number j modulo the number of
    sizes. What is counted: `StudyResult`.

    Args:
        model: a LinearSystem, the plant as it is. Factors on its noise, `times`, follow the inputs of each
            scenario, and rest on inputs alone.
        faults: texts "signal:kind" (kinds as in `Fault`), Fault objects, or one of these; () for healthy
            scenarios only.
        n: scenarios, spread evenly over the faults.
        key: a jax.random key, or a whole number.
        relations: of the monitor, whatever `detect` takes, a bank, a residual or an `observer` too (then
            windows are samples, those behind the onset faulty), or a `jb.monitor`, whose conditions rest on
            inputs: it is counted as an observer is, by itself and by test; None: `parity_relations(model)`.
            Those of another model with the same signals show what happens when its bounds are not the
            plant's.
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
        method: of the monitor, as for `detect`.
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
    model, report = as_model(model, factors=True), reporter(progress, "study")
    relations = parity_relations(model) if relations is None else relations
    relations_of(relations, "a study", "study(model, .., relations=parity_relations(model))")
    relations = relations.named_like(model)
    if relations.remembers and method == "joint":
        method = relations.methods[0]
    _check_study(model, relations, method)
    _check_numbers(n, samples, hold, at, confidence)
    dtype = jax.dtypes.canonicalize_dtype(np.float64)
    u, limits, highest = _study_inputs(model, inputs, input_range, dtype)
    samples = samples if u is None else len(u)
    ground = scenarios.Ground(model, relations, samples, highest)
    trials = ground.trials(faults, sizes, onset)
    if method not in ("joint", MONITOR):  # what is guaranteed is guaranteed of the joint test
        trials = [dataclasses.replace(t, guaranteed=np.nan) for t in trials]
    if n < len(trials):
        raise ValueError(f"n must be at least the number of faults, {len(trials)}, not {n}")
    counts = [n // len(trials) + (i < n % len(trials)) for i in range(len(trials))]
    key = key_of(key)
    words = [np.asarray(_words(key, i)) for i in range(len(trials))]
    room = ground.largest_room(trials, dtype)
    course = kernel.Course(samples, hold, at == "vertices")
    margins = margins_for(AUTO, n * samples)
    setup = _Setup(model, relations, course, at, method, room, u, limits, dtype, margins)
    run, block = _engine(setup)
    settings: dict[str, object] = {
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
    names = tuple(relations.parts)
    columns = []
    for _ in ("all", *names):
        columns.append([TrialTally(len(t.sizes), samples) for t in trials])
    keeper = None
    if out is not None:
        mark = identity(relations, plant=model, rows=rows, block=block, **settings)
        keeper = Keeper(out, mark, sum(columns, []), rows)
    tasks = [(i, first) for i, count in enumerate(counts) for first in range(0, count, block)]
    acts = [scenarios.act_of(t, model, dtype) for t in trials]

    def collect(number: int, found: Counts) -> None:
        """Add the counts of a task, without the scenarios that only fill its block up."""
        i, first = tasks[number]
        trial, stop = trials[i], min(first + block, counts[i])
        hits, false, delay, begun = (np.asarray(x)[: stop - first] for x in found)
        scenario = np.arange(first, stop)
        which = scenario % len(trial.sizes)
        windows, clean = trial.spans(begun, samples, relations)
        hits, false, delay = (x.reshape(len(x), -1) for x in (hits, false, delay))
        for number, column in enumerate(columns):
            column[i].add(which, hits[:, number], false[:, number], delay[:, number], windows, clean)
        if keeper is not None:
            own = {"size": trial.sizes[which], "scenario": scenario, "onset": begun}
            own |= {"fault_windows": hits[:, 0], "false_alarms": false[:, 0], "delay": delay[:, 0]}
            keeper.add_rows(trial.label, own)

    _work_off(client, _Scenarios(setup, acts, words, block), tasks, collect, keeper, report)
    tallies, *by_test = columns
    return StudyResult(
        model,
        relations.horizon,
        tuple(trials),
        tuple(tallies),
        at,
        samples,
        confidence,
        settings,
        dict(zip(names, map(tuple, by_test), strict=True)),
    )


@dataclasses.dataclass(frozen=True, eq=False)
class _Setup:
    """The numbers of a study that are the same for all its scenarios; it can be pickled."""

    model: LinearSystem
    relations: Relations
    course: kernel.Course
    at: str
    method: str
    room: np.ndarray
    u: np.ndarray | None
    limits: np.ndarray
    dtype: np.dtype
    margins: str

    def scene(self, plant: FloatPlant | LinearSystem, act: Act, key: np.ndarray) -> kernel.Scene:
        """Return the Scene of one fault. key: its random words."""
        return kernel.Scene(plant, act, self.limits, self.u, key, self.course)

    def counted(
        self, act: Act, u: np.ndarray, y: np.ndarray, onset: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return (hits, false, delay) of recordings, by `detect`."""
        return records.count_recordings(self.relations, act, u, y, onset, self.method, self.margins)


@dataclasses.dataclass(frozen=True, eq=False)
class _Scenarios:
    """The scenarios of a study as a `Job`: a task is (number of a fault, first scenario), a block from there
    on.

    Fields: acts, words: of each fault. block: scenarios in a task.
    """

    setup: _Setup
    acts: list[Act]
    words: list[np.ndarray]
    block: int

    @cached_property
    def counted(self) -> Engine:
        """The function that counts a block; made where the work is done."""
        return _engine(self.setup)[0]

    @sparing(False)
    def run(self, task: Task) -> Counts:
        """Return the counts of each scenario of a block: hits, false, delay, onset; judged on the CPU,
        whatever there is beside.
        """
        i, first = task
        numbers = np.arange(first, first + self.block, dtype=np.uint32)
        with jax.default_device(jax.local_devices(backend="cpu")[0]):
            hits, false, delay, onset = self.counted(self.acts[i], self.words[i], numbers)
        return np.asarray(hits), np.asarray(false), np.asarray(delay), np.asarray(onset)


@jax.jit
def _words(key: jax.Array, i: int) -> jax.Array:
    """Return (2,) random words for the fault with number i."""
    return jax.random.bits(jax.random.fold_in(key, i), (2,), np.uint32)


def _check_study(model: LinearSystem, relations: Relations, method: str) -> None:
    """Raise ValueError for relations that `study` does not take."""
    if relations.parts and method != MONITOR:
        raise ValueError(f"method is for one test, and a monitor has tests of its own: leave out {method!r}")
    _refuse_conditions(relations)
    if (relations.model.inputs, relations.model.outputs) != (model.inputs, model.outputs):
        raise ValueError("the relations speak of other signals than the model of the study")


def _check_numbers(n: int, samples: int, hold: int, at: str, confidence: float) -> None:
    """Raise ValueError for numbers out of range."""
    for name, value in (("n", n), ("samples", samples), ("hold", hold)):
        if not is_whole(value) or value < 1:
            raise ValueError(f"{name} must be a whole number >= 1, not {value!r}")
    if samples > LONGEST:
        raise ValueError(
            f"samples must be at most {LONGEST}, not {samples}: a fault that is not seen by then never is"
        )
    if n >= 2**32:
        raise ValueError(f"n must be below 2^32, not {n}: run several studies with different keys")
    if at not in AT:
        raise ValueError(f"at must be one of {', '.join(AT)}, not {at!r}")
    if not (is_real(confidence) and 0 < confidence < 1):
        raise ValueError(f"confidence must be between 0 and 1, not {confidence!r}")


def _refuse_conditions(bank: Relations) -> None:
    """Raise ValueError for a condition on anything else than inputs, which scenarios do not have."""
    for watch in bank.watches:
        if watch.when in (None, OTHERWISE):
            continue
        columns = expression(watch.when).columns
        if not set(columns) <= set(bank.model.inputs):
            raise ValueError(
                f"a study draws inputs alone, and test {watch.name!r} watches when {watch.when!r}: give a "
                f"monitor whose conditions rest on {listed(bank.model.inputs) or 'no input'}"
            )


def _study_inputs(
    model: LinearSystem, inputs: object, input_range: ArrayLike | None, dtype: np.dtype
) -> tuple[np.ndarray | None, np.ndarray, np.ndarray]:
    """Return (u (T, m) or None, limits (m, 2), largest |u - offset| (m,))."""
    offset = np.array([float(x) for x in model.offset["u"]])
    if inputs is None:
        limits = _limits(model, input_range, dtype)
        return None, limits, np.abs(limits - offset[:, None]).max(1)
    u = np.asarray(inputs_of(model, inputs, "inputs"), dtype)
    if u.ndim != 2 or u.shape[1] != model.m:
        raise ValueError(f"inputs must have shape (samples, {model.m}), time first: their shape is {u.shape}")
    if not np.isfinite(u).all():
        refuse_infinite("inputs", u, model.inputs)
        raise ValueError("inputs of a study must not be missing (NaN)")
    return u, np.zeros((model.m, 2), dtype), np.abs(u - offset).max(0, initial=0)


def _limits(model: LinearSystem, input_range: ArrayLike | None, dtype: np.dtype) -> np.ndarray:
    """Return (m, 2), between which inputs are drawn: as asked for, as the model says, or near its offset."""
    if input_range is None:
        known = []
        for name, level in zip(model.inputs, model.offset["u"], strict=True):
            near = float(level) - 1, float(level) + 1
            lo, hi = map(float, model.ranges.get(name, near))
            if lo == hi:  # an input that never moved
                lo, hi = near
            known.append((lo, hi))
        limits = np.array(known, float).reshape(-1, 2)
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
    return limits


def _engine(setup: _Setup) -> tuple[Engine, int]:
    """Return the function that counts a block of scenarios, and their number."""
    model, relations = setup.model, setup.relations
    by = relations.test(setup.method, setup.dtype)  # refuses here what it would refuse in every block
    certain = not by.remembers and by.by_strips
    tests = relations.parts or {"": relations}
    factored = factors_of(model) or any(factors_of(test.model) for test in tests.values())
    plain = not factored and recursion.fits(model, setup.room) and bool(np.isfinite(setup.room).all())
    plant = recursion.plant_of(model, setup.room, setup.dtype) if plain else None
    if setup.at == "adversarial":
        if plant is None or not certain:
            raise NotImplementedError(
                "an adversary needs a test by strips, down whose margin it goes: a certain model without "
                "averages or factors on noise, noise on every output, parity relations, method 'joint' or "
                "'box'; use at='vertices' instead"
            )
        return _attacking(setup, plant), min(ATTACKED, records.recording_block(setup.course))
    circuits = len(relations.linear.circuits) if relations.linear is not None else 0
    if plant is not None and certain and setup.method == "joint" and 0 < circuits <= UNROLLED:
        # where circuits are many, what the fused kernel saves is nothing beside their test
        devices = tuple(jax.local_devices(backend="cpu"))
        return _counting_kernel(setup, plant, devices), kernel.BLOCK * len(devices)
    return _writing(setup, plant), records.recording_block(setup.course)


# The names of the functions below that count are kept in the state of a study, in its folder.


def _attacking(setup: _Setup, plant: FloatPlant) -> Engine:
    """Return the function that lets an adversary hide the fault, then gives its recordings to `detect`."""
    test = setup.relations.reading(setup.dtype)

    def attacked(act: Act, key: np.ndarray, numbers: np.ndarray) -> Counts:
        found = adversary.attack_block(test, setup.scene(plant, act, key), numbers)
        u, y, onset = (np.asarray(x) for x in found)
        return *setup.counted(act, u, y, onset), onset

    return attacked


def _counting_kernel(setup: _Setup, plant: FloatPlant, devices: tuple[jax.Device, ...]) -> Engine:
    """Return the function that simulates and tests in one kernel, on all devices."""
    test = setup.relations.reading(setup.dtype)

    def counted(act: Act, key: np.ndarray, numbers: np.ndarray) -> Counts:
        blocks = [(part,) for part in np.split(numbers, len(devices))]
        constants = everywhere((test, setup.scene(plant, act, key)), devices)
        found = on_devices(kernel.count_block, constants, blocks, devices)
        hits, false, delay, onset = (np.concatenate(parts) for parts in zip(*found, strict=True))
        return hits, false, delay, onset

    return counted


def _writing(setup: _Setup, plant: FloatPlant | None) -> Engine:
    """Return the function that writes scenarios out and gives them to `detect`."""

    def written(act: Act, key: np.ndarray, numbers: np.ndarray) -> Counts:
        if plant is None:
            u, y, onset = records.simulate_block(setup.scene(setup.model, act, key), numbers)
        else:
            found = kernel.replay_block(setup.scene(plant, act, key), numbers)
            u, y, onset = (np.asarray(x) for x in found)
        return *setup.counted(act, u, y, onset), onset

    return written


def _work_off(
    client: Client | None,
    job: _Scenarios,
    tasks: Sequence[Task],
    collect: Callable[[int, Counts], None],
    keeper: Keeper | None,
    report: Progress,
) -> None:
    """Do the tasks that are left; collect them in order, and keep the state now and then."""
    done, saved = 0 if keeper is None else keeper.done, time.monotonic()
    left = tasks[done:]
    results = _on_cores(job, left) if client is None else in_order(client, job, left, TOGETHER)
    try:
        for found in results:
            collect(done, found)
            done += 1
            if keeper is not None and _is_due(keeper, done, saved, len(tasks)):
                keeper.save(done)
                saved = time.monotonic()
            report(done / len(tasks))
    except KeyboardInterrupt:
        # what was collected since the last state may be half counted: it is drawn again
        if keeper is None:
            raise
        kept = f"{keeper.done} of {len(tasks)} blocks of scenarios are kept in {keeper.folder}"
        raise KeyboardInterrupt(f"interrupted: {kept}, the same command goes on from there") from None


def _is_due(keeper: Keeper, done: int, saved: float, tasks: int) -> bool:
    """Return whether the state is to be kept now: saved at a time, with so many tasks done."""
    if done == tasks:
        return True
    if keeper.rows:  # parts hold as many tasks each, however fast they are
        return done % PART == 0
    return time.monotonic() - saved > EVERY


def _on_cores(job: _Scenarios, tasks: Sequence[Task]) -> Iterator[Counts]:
    """Yield the results of tasks, in order; one runs on each core at a time."""
    _, *others = jax.local_devices(backend="cpu")
    cores = os.cpu_count() or 1
    if hasattr(os, "sched_getaffinity"):
        cores = len(os.sched_getaffinity(0))
    threads = max(1, cores // (1 + len(others)))
    run, ahead = inherited(job.run), AHEAD * threads
    with ThreadPoolExecutor(threads) as pool:
        for first in range(0, len(tasks), ahead):  # results must not pile up
            yield from pool.map(run, tasks[first : first + ahead])
