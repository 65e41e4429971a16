"""One place for what every test needs: float64, strict promotion, the shared golden values and recordings."""

import contextlib
import ctypes
import gc
import importlib
import json
import os
import sys
import zlib
from pathlib import Path

import hypothesis
import jax
import numpy as np
import pytest

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")

SHARED = Path(os.environ.get("JAXBOUND_SHARED", Path(__file__).resolve().parents[2] / "shared"))


def pytest_configure(config):
    """Keep compiled kernels beside pytest's own cache: two workers compile each once.

    Hypothesis draws from the test's name too, but for JAXBOUND_SEED=fresh.
    """
    # a twelfth of all time went into looking for garbage among what jax keeps
    gc.set_threshold(20_000, 20, 20)
    # and a fourteenth into pages of arrays, given back and asked for again
    if sys.platform == "linux":
        for option, size in ((M_MMAP_THRESHOLD, 2**25), (M_TRIM_THRESHOLD, 2**26)):
            ctypes.CDLL(None).mallopt(option, size)
    hypothesis.settings.register_profile(
        "named",
        derandomize=os.environ.get("JAXBOUND_SEED") != "fresh",
        deadline=None,
        print_blob=True,  # a failure says how to repeat it, with fresh draws too
    )
    hypothesis.settings.load_profile("named")
    if not hasattr(config, "cache"):  # pytest was told to keep none
        return
    jax.config.update("jax_compilation_cache_dir", str(config.cache.mkdir("kernels")))
    # small ones too: eager code is made of them
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)


M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
"""Options of the allocator of glibc."""

BY_NIGHT = Path(__file__).with_name("by_night.txt")
"""Names of tests that take seconds, beside a smaller case of the same; `.ci/night.py` writes it."""


NEVER_BY_DAY = pytest.StashKey[list[str]]()
"""Tests that have no case by day, and name no other test that has."""


@pytest.hookimpl(tryfirst=True)  # before -m asks for marks
def pytest_collection_modifyitems(config, items):
    """Leave to the night what `by_night.txt` names. Skip, where the system is not POSIX, the tests marked
    `posix("what they need")`.
    """
    by_night = set(BY_NIGHT.read_text().splitlines())
    asked, answered = set(), set()
    for item in items:
        if item.nodeid in by_night:
            item.add_marker("long")
        function, marks = item.nodeid.partition("[")[0], list(item.iter_markers("long"))
        asked.add(function)
        if not marks or any("by_day" in mark.kwargs for mark in marks):
            answered.add(function)
    config.stash[NEVER_BY_DAY] = sorted(asked - answered)
    if os.name == "posix":
        return
    for item in items:
        for marker in item.iter_markers("posix"):
            item.add_marker(pytest.mark.skip(reason=f"needs {marker.args[0]}, which this system lacks"))


@pytest.fixture
def never_by_day(request):
    """Return which of the tests that were collected have no case by day and name no other test that has."""
    return request.config.stash[NEVER_BY_DAY]


def _spent():
    return sum(os.times()[:4])


BEGUN = pytest.StashKey[float]()


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item):
    """Remember how much of the processor was taken before a test, by the processes that it waited for too."""
    item.stash[BEGUN] = _spent()


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_makereport(item, call):
    """Note what a test took."""
    if call.when == "teardown":
        item.user_properties.append(("seconds", round(_spent() - item.stash[BEGUN], 2)))


SECONDS: dict[str, float] = {}


def pytest_runtest_logreport(report):
    """Collect what tests took, of all workers."""
    if report.when == "teardown":
        SECONDS[report.nodeid] = dict(report.user_properties).get("seconds", 0)


def pytest_terminal_summary(terminalreporter, config):
    """Show how much of the processor the tests of each room took, and keep it beside pytest's own cache."""
    if hasattr(config, "cache"):
        config.cache.set("seconds", SECONDS)
    rooms = {}
    for name, taken in SECONDS.items():
        rooms.setdefault("/".join(name.split("::")[0].split("/")[:-1]), []).append(taken)
    terminalreporter.write_line("CPU seconds, tests, and what the longest one took:")
    for room, taken in sorted(rooms.items(), key=lambda item: -sum(item[1])):
        terminalreporter.write_line(f"{sum(taken):8.1f} {len(taken):5d} {max(taken):6.1f}  {room}")


@pytest.fixture(scope="module", autouse=True)
def in_numpy(request):
    """Have NumPy evaluate all kernels, but in files that are marked `compiled`. Processes that
    tests start keep to what users have.
    """
    from jaxbound.sets.floats import kernel

    kernel.compile("always")  # what is not evaluated, whatever the module before said
    with kernel.outside_xla(request.node.get_closest_marker("compiled") is None):
        yield
    kernel.compile()  # examples of docstrings say what users see


@pytest.fixture(scope="session", autouse=True)
def simulated_in_numpy():
    """Have NumPy follow what is simulated, unless it is long: the same bits, and nothing to compile."""
    from jaxbound.sets.floats.kernel import kernel, outside_xla

    simulate = importlib.import_module("jaxbound.models.simulate")
    by_xla = simulate._trajectory
    in_numpy = kernel(by_xla.__wrapped__)

    def trajectory(numbers, x0, along):
        if len(along[0]) > 1024:
            return by_xla(numbers, x0, along)
        with outside_xla():
            return in_numpy(numbers, x0, along)

    trajectory.by_xla = by_xla
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simulate, "_trajectory", trajectory)
        yield


@pytest.fixture
def simulated_by_xla(monkeypatch):
    """Have XLA follow what is simulated, as users do."""
    simulate = importlib.import_module("jaxbound.models.simulate")
    monkeypatch.setattr(simulate, "_trajectory", simulate._trajectory.by_xla)


@pytest.fixture(autouse=True)
def compiled(request):
    """Have XLA compile the kernels of a single test that is marked so."""
    from jaxbound.sets.floats import kernel

    alone = any(mark.name == "compiled" for mark in request.node.own_markers)
    with kernel.outside_xla(False) if alone else contextlib.nullcontext():
        yield


@pytest.fixture
def by_numpy():
    """Have NumPy evaluate the kernels of a single test in a file that is marked `compiled`."""
    from jaxbound.sets.floats import kernel

    with kernel.outside_xla():
        yield


@pytest.fixture
def as_users_do():
    """Compile as for users who said nothing, whatever other tests ask for."""
    from jaxbound.sets.floats import kernel

    kernel.compile()
    yield
    kernel.compile("always")


@pytest.fixture
def many(monkeypatch):
    """Judge few windows as many are: easy ones first."""
    monkeypatch.setattr("jaxbound.consistency.interface.MANY", 1)


@pytest.fixture
def as_compiled(monkeypatch):
    """Take the way of programs that XLA made, block by block, easy windows first; NumPy evaluates them."""
    for place in (
        "consistency.drive",
        "consistency.exchange",
        "consistency.parametric",
        "estimation.set_observer",
    ):
        monkeypatch.setattr(f"jaxbound.{place}.is_outside_xla", lambda: False)


@pytest.fixture
def searched_in_numpy(monkeypatch):
    """Have NumPy search for the hints of joint observers, too: a second where compiling takes three."""
    from jaxbound.estimation import window_search
    from jaxbound.sets.floats.kernel import kernel

    monkeypatch.setattr(window_search, "_path", kernel(window_search._path.__wrapped__))


ROOM, GROWTH = 2**30, 2**28
"""Bytes from which on a process gives back what compiling left, and how many at least: else it lets go of its
compiled kernels, too, which the next tests read from the disk where they need them again. Linux allows 65 530
mappings, and XLA dies where it gets none.
"""
LARGEST = pytest.StashKey[int]()


@pytest.fixture(scope="module", autouse=True)
def room_for_kernels(request):
    """Give memory back where a process became large."""
    yield
    status, stash = Path("/proc/self/statm"), request.config.stash
    if not status.exists():
        return
    resident = lambda: int(status.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    if resident() > stash.setdefault(LARGEST, ROOM):
        trim = ctypes.CDLL(None).malloc_trim
        trim(0)
        if resident() > stash[LARGEST] - GROWTH:
            jax.clear_caches()
            gc.collect()
            trim(0)
        stash[LARGEST] = max(ROOM, resident() + GROWTH)


@pytest.fixture(scope="session", autouse=True)
def spared_disk():
    """Wait for no disk: what a power cut leaves is asked by tests that count these calls."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda number: None)
        yield


@pytest.fixture
def kernels(monkeypatch):
    """Have processes that a test starts share the compiled kernels of this one."""
    if folder := jax.config.jax_compilation_cache_dir:
        monkeypatch.setenv("JAX_COMPILATION_CACHE_DIR", folder)
        monkeypatch.setenv("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")


@pytest.fixture(scope="session")
def shared():
    """Return a function that finds a file of the shared folder and skips the test, saying so, where it is
    absent.
    """

    def find(name):
        path = SHARED / name
        if not path.exists():
            pytest.skip(f"{name} is not here: the shared folder with golden values and recordings is absent")
        return path

    return find


@pytest.fixture(scope="session")
def golden(shared):
    """Return the golden values of Adrot 2000 and Ploix 2006."""
    return json.loads(shared("golden/adrot2000_ploix2006.json").read_text())


@pytest.fixture
def rng(request):
    """Return a generator seeded by the test's name, or by JAXBOUND_SEED: a number, or "fresh" for a new one,
    printed to repeat it.
    """
    return np.random.default_rng(_seed(request.node))


@pytest.fixture(scope="module")
def module_seed(request):
    """Return the seed, below 2^31, of what the tests of a file share: from the file's name, or from
    JAXBOUND_SEED.
    """
    return _seed(request.node) % 2**31


def _seed(node):
    chosen = os.environ.get("JAXBOUND_SEED", zlib.crc32(node.nodeid.encode()))
    seed = np.random.SeedSequence().entropy % 2**32 if chosen == "fresh" else int(chosen)
    print(f"{node.name}: JAXBOUND_SEED={seed}")
    return seed


@pytest.fixture(scope="session")
def case(tmp_path_factory):
    """Return a function that gives a recording larger than a chunk, and what `detect` finds in it: see
    `streaming_case.cases`.
    """
    from streaming_case import cases

    return cases(tmp_path_factory)


@pytest.fixture
def small(monkeypatch):
    """Make parts so small that this recording has several."""
    from streaming_case import shrink

    shrink(monkeypatch)
