"""A device that nobody examined searches: the host proves each FAULT, nothing is CONSISTENT, and MISSING is
what the samples say. Also where the device lies.
"""

import warnings
from concurrent.futures import ThreadPoolExecutor

import jax
import numpy as np
import pytest
from lying_device import lying, unexamined
from systems import paper
from test_twice import DISTURBED, METHODS, RELATIONS, healthy

import jaxbound as jb
from jaxbound.consistency import drive, parametric_windows
from jaxbound.consistency.searched import NOT_REFUTED
from jaxbound.consistency.twice import Doubtful
from jaxbound.sets.floats import kernel, probe
from jaxbound.sets.floats.status import Status
from jaxbound.sets.floats.threads import inherited

pytestmark = [pytest.mark.compiled, pytest.mark.usefixtures("many")]

OBSERVERS = "observer", "joint"
FAMILIES = RELATIONS | {
    "disturbed": lambda: jb.parity_relations(DISTURBED, 12),
    "lags": lambda: jb.parity_relations(paper(), lags=(0, 2, 5)),
    "means": lambda: jb.parity_relations(paper(tolerance=0, averages={"y1": {3: "0.05"}}), 4),
    "residual": lambda: jb.residual(drift, jb.interval([-0.01, -0.1], [0.01, 0.1]), horizon=1),
}
MANY = "strips", "float32", "bank", "long", "lags"
WINDOWS = [name for name in FAMILIES if name not in OBSERVERS]
BY_DAY = [name for name in WINDOWS if name not in ("disturbed", "residual")]
BY_DAY += [pytest.param(name, marks=pytest.mark.long) for name in ("disturbed", "residual")]


def drift(z, u, y):
    """A gain that is uncertain by 1 %, a sensor by 0.1."""
    return y[1, 0] - (1 + z[0]) * y[0, 0] - z[1]


def judged(name, relations, u, y):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # Doubtful, and NumPy over infinite lies
        return jb.detect(relations, u, y, method=METHODS.get(name, "joint"))


def healthy_of(name, rng, count, samples):
    """Return (relations, u, y) without faults."""
    relations = FAMILIES[name]()
    if name == "residual":
        return relations, np.zeros((count, samples, 0)), rng.uniform(-0.04, 0.04, (count, samples, 1)) + 1
    return relations, *healthy(name, relations.model, rng, count, samples)


def recordings(name, rng, count=2, samples=24):
    """Return (relations, u, y): healthy, with a fault in the last recording and holes in all."""
    relations, u, y = healthy_of(name, rng, count, samples)
    y[-1, 2 * samples // 3 :, 0] += 5
    y[:, 3] = np.nan
    y[:, samples // 3, 0] = np.nan
    return relations, u, y


@pytest.mark.parametrize("name", BY_DAY)
def test_an_honest_device_finds_every_fault_and_nothing_consistent(name, rng):
    relations, u, y = recordings(name, rng)
    here = judged(name, relations, u, y)
    with unexamined():
        there = judged(name, relations, u, y)
    consistent = here.status == Status.CONSISTENT
    want = np.where(consistent, np.int8(Status.UNDECIDED), here.status)
    np.testing.assert_array_equal(there.status, want)
    np.testing.assert_array_equal(there.margin, here.margin)
    assert (want == Status.FAULT).any() and (want == Status.MISSING).any()
    assert any(hint.startswith(NOT_REFUTED) for hint in there.hints)
    assert not any("not examined" in hint for hint in here.hints)


@pytest.mark.parametrize("name", BY_DAY)
def test_a_lying_device_makes_no_verdict(name, rng):
    relations, u, y = recordings(name, rng)
    here = judged(name, relations, u, y)
    with unexamined(), lying() as lies:
        there = judged(name, relations, u, y)
    assert lies.told > 10
    assert not (there.status == Status.CONSISTENT).any()
    fault = there.status == Status.FAULT
    assert not (fault & ~np.isin(here.status, (Status.FAULT, Status.UNDECIDED))).any()
    assert not (there.margin[fault] >= 0).any()
    lacking = there.status == Status.MISSING
    assert (here.status[lacking] == Status.MISSING).all()
    assert np.isnan(there.margin[lacking]).all()
    if name == "bank":
        every = np.stack([there.of(i) for i in range(relations.count)])
        assert not (every == Status.CONSISTENT).any()


def test_a_device_cannot_hide_that_data_are_missing_nor_make_them_missing(rng):
    relations, u, y = recordings("strips", rng, 2, 60)
    y[0, 20:40] = u[0, 20:40] = np.nan
    with unexamined(), lying(1.0):
        status = judged("strips", relations, u, y).status
    assert (status[0, 22:40] == Status.MISSING).all()
    whole = ~np.isnan(y).any(-1)
    for lag in range(1, relations.horizon + 1):
        whole[:, lag:] &= ~np.isnan(y[:, :-lag]).any(-1)
    whole[:, : relations.horizon] = False
    assert whole.any() and not (status[whole] == Status.MISSING).any()


@pytest.mark.long(by_day="cli/test_any_device::test_what_carries_a_set_is_followed_on_the_cpu")
@pytest.mark.parametrize("name", OBSERVERS)
def test_an_observer_follows_on_the_cpu(name, rng):
    relations, u, y = recordings(name, rng, 2, 18)
    here = judged(name, relations, u, y)
    with unexamined(), lying() as lies:
        there = judged(name, RELATIONS[name](), u, y)
    assert not lies.told
    np.testing.assert_array_equal(there.status, here.status)
    assert any(hint.startswith("followed on the CPU, since") for hint in there.hints)


def test_a_monitor_says_what_detect_says(rng):
    relations, u, y = recordings("strips", rng, 1, 40)
    with unexamined():
        monitor = jb.Monitor(relations)
        _, verdict = monitor.run(monitor.init(), u[0], y[0])
        np.testing.assert_array_equal(verdict.status, jb.detect(relations, u[0], y[0]).status)
    assert not (verdict.status == Status.CONSISTENT).any()


def test_studies_and_tuning_prove_on_the_cpu_beside_a_lying_device(rng):
    relations, (u, y) = jb.parity_relations(paper()), healthy("strips", paper(), rng, 1, 60)

    def both():
        found = jb.study(paper(), "y1:bias", 20, 0, sizes=[0.5], samples=30)
        tuned = jb.tune(relations, (u[0], y[0]), steps=0)
        return found.false_alarms, tuned.counts, tuned.bounds["noise"].tolist()

    here = both()
    with unexamined(), lying():
        assert both() == here


def test_loose_flags_of_a_cpu_are_refused_beside_a_card_too(monkeypatch):
    monkeypatch.setenv("XLA_FLAGS", "--xla_cpu_enable_fast_math")
    with pytest.raises(RuntimeError, match="keeps to no rounding"):
        jb.detect(jb.parity_relations(paper()), np.zeros((5, 1)), np.zeros((5, 2)))
    with unexamined(), pytest.raises(RuntimeError, match="keeps to no rounding"):
        jb.observer(paper())


def test_a_process_without_a_cpu_is_refused_in_one_sentence(monkeypatch):
    devices = jax.local_devices

    def none_of_that_name(backend=None):
        if backend is None:
            return devices()
        raise RuntimeError(f"Unknown backend {backend}")

    with unexamined():
        monkeypatch.setattr(probe.jax, "local_devices", none_of_that_name)
        for call in (probe.refuse_unusable, probe.where_proofs_hold().__enter__):
            with pytest.raises(
                RuntimeError, match="no CPU device: name it too, as in JAX_PLATFORMS=cuda,cpu"
            ):
                call()


def test_what_is_proved_on_the_host_is_placed_on_the_host(monkeypatch):
    chosen = []
    monkeypatch.setattr(kernel, "_platform", lambda: "gpu")
    with kernel.outside_xla():
        chosen.append(probe.default_device())
    with kernel.outside_xla(False):
        chosen.append(probe.default_device())
    assert chosen == [jax.local_devices(backend="cpu")[0], None]


def test_no_other_settings_are_asked_of_a_device_that_searches(rng):
    relations, u, y = recordings("strips", rng)
    with unexamined(), pytest.MonkeyPatch.context() as patch:
        patch.setattr(probe, "refuse_unverified", None)
        assert (jb.detect(relations, u, y).status == Status.FAULT).any()


def test_a_monitor_of_windows_is_followed_on_the_host(rng):
    relations, u, y = recordings("strips", rng)
    model = relations.model.replace(tests=[{"name": "one", "horizon": 1}, {"name": "two", "horizon": 2}])
    here = jb.detect(jb.monitor(model), u, y)
    with unexamined():
        there = jb.detect(jb.monitor(model), u, y)
    np.testing.assert_array_equal(there.status, here.status)
    assert (here.status == Status.CONSISTENT).any() and there.device.startswith("the CPU")


def miscopied(numbers):
    """Return other numbers of the same shapes, such as a device may hold that copied them wrongly."""
    rng = np.random.default_rng(0)

    def other(x):
        x = np.asarray(x)
        return x * rng.lognormal(0, 0.5, x.shape).astype(x.dtype) if x.dtype.kind == "f" and x.ndim else x

    return jax.tree.map(other, numbers)


@pytest.mark.long(by_day="test_a_lying_device_makes_no_verdict")
def test_what_a_device_copied_wrongly_proves_nothing(rng):
    """Numbers of relations are placed once and lie on the device; windows are read there."""
    relations = RELATIONS["uncertain"]()
    u, y = healthy("uncertain", relations.model, rng, 2, 20)
    said = pytest.warns(Doubtful, match="on a device that was not examined: .* UNDECIDED$")
    terms_of = parametric_windows.terms_of

    def on_device(*given):
        return terms_of(*given) if kernel.is_outside_xla() else miscopied(terms_of(*given))

    with unexamined(), pytest.MonkeyPatch.context() as patch, said:
        patch.setattr(parametric_windows, "terms_of", on_device)
        patch.setattr(drive, "everywhere", lambda constants, devices: miscopied(constants))
        status = jb.detect(relations, u, y).status
    assert not np.isin(status, (Status.FAULT, Status.CONSISTENT)).any()


def test_a_thread_searches_where_the_thread_that_asks_does():
    with probe.searching(), ThreadPoolExecutor(1) as threads:
        assert threads.submit(inherited(probe.is_searching)).result()
        assert not threads.submit(probe.is_searching).result()
    assert not probe.is_searching()


@pytest.mark.long(by_day="test_a_lying_device_makes_no_verdict")
@pytest.mark.parametrize("name", WINDOWS)
def test_no_lie_makes_a_fault_of_a_million_windows(name, rng):
    """Two thousand where a lie costs milliseconds: a search that goes on, kernels evaluated in NumPy."""
    relations, _, _ = healthy_of(name, rng, 1, 2)
    done, count, recordings = 0, 2000, 1
    if name in MANY:
        count, recordings = 10**6, 100
    while done < count:
        _, u, y = healthy_of(name, rng, recordings, 1000)
        with unexamined(), lying(0.05, seed=done):
            status = judged(name, relations, u, y).status
        assert not np.isin(status, (Status.FAULT, Status.CONSISTENT)).any()
        done += status.size
