"""A monitor says of every sample what `detect` says of the whole recording, bit by bit."""

import io
import threading

import jax
import numpy as np
import pandas as pd
import pytest
from systems import paper

import jaxbound as jb
from jaxbound.consistency import Verdict, exchange, strips
from jaxbound.consistency.monitor import Monitor
from jaxbound.consistency.strips import StripsTest
from jaxbound.runs import judges
from jaxbound.sets.floats import kernel


def recording(rng, model, n, missing=0, dtype=float, spread=1.5):
    """Return (u, y): outputs of a plant with errors around their bounds, so that there are all kinds of
    windows, and missing samples.
    """
    A, B, C = (np.array(M, float) for M in (model.A, model.B, model.C))
    u, y, x = rng.uniform(-1, 1, (n, model.m)), np.empty((n, model.p)), np.zeros(model.n)
    for k in range(n):
        y[k], x = C @ x, A @ x + B @ u[k]
    sigma, delta = (np.array(b, float) for b in (model.tolerance, model.noise))
    y += rng.uniform(-spread, spread, y.shape) * (sigma * abs(y) + delta)
    y[rng.integers(0, n, missing), rng.integers(0, model.p, missing)] = np.nan
    u[rng.integers(0, n, missing // 4)] = np.nan
    return u.astype(dtype), y.astype(dtype)


def stepped(mon, u, y, starts=(), state=None):
    """Return (state, status, margin) of samples taken one by one."""
    state, found = state or mon.init(), []
    for k in range(len(y)):
        state, verdict = mon.step(state, u[k], y[k], new=k in starts)
        found.append(verdict)
    return state, np.array([v.status for v in found]), np.array([v.margin for v in found])


def assert_equal(found, res):
    status, margin = found[:2] if isinstance(found, Verdict) else found[-2:]
    np.testing.assert_array_equal(status, res.status)
    assert (margin.dtype, status.dtype) == (res.margin.dtype, res.status.dtype)
    np.testing.assert_array_equal(margin, res.margin)


CASES = {
    "section 5": (lambda: paper(), None, "joint"),
    "box": (lambda: paper(), 2, "box"),
    "many circuits": (lambda: paper(), 4, "joint"),
    "disturbance": (lambda: paper(disturbance=([[1], [0]], [0.01])), 3, "joint"),
    "one sample": (lambda: jb.LinearSystem([[0.5]], [[1]], [[1], [2]], noise=[0.1, 0.1]), 0, "joint"),
    "one relation": (lambda: jb.LinearSystem([[0.5]], None, [[1]], noise=0.1), None, "box"),
}


@pytest.mark.parametrize(
    "name, dtype",
    [
        ("section 5", float),
        ("box", float),
        ("one sample", float),
        *(
            pytest.param(name, dtype, marks=pytest.mark.long)
            for name, dtype in (
                ("section 5", np.float32),
                ("box", np.float32),
                ("many circuits", float),
                ("many circuits", np.float32),
                ("disturbance", float),
                ("one relation", float),
            )
        ),
    ],
)
def test_steps_and_bursts_equal_detect_bit_by_bit(rng, name, dtype):
    model, horizon, method = CASES[name]
    r = jb.parity_relations(model(), horizon)
    u, y = recording(rng, r.model, 700, 30, dtype)
    starts = [40, 41, 333]
    res = jb.detect(r, u, y, method=method, starts=starts)
    mon = Monitor(r, method, dtype)
    assert_equal(
        stepped(mon, u[:60], y[:60], starts), jb.detect(r, u[:60], y[:60], method=method, starts=starts[:2])
    )
    state, parts = mon.init(), []
    for a, b in ((0, 1), (1, 30), (30, 30), (30, 600), (600, 601), (601, 700)):  # short, none, long
        state, verdict = mon.run(state, u[a:b], y[a:b], starts=[k - a for k in starts if a <= k < b])
        parts.append(verdict)
    assert_equal((np.concatenate([v.status for v in parts]), np.concatenate([v.margin for v in parts])), res)
    assert {jb.Status.MISSING, jb.Status.FAULT} < set(res.status.tolist())
    assert state.samples == 700 and state.follows == r.horizon


@pytest.mark.compiled
@pytest.mark.long(by_day="test_the_exchange_search_with_missing_samples")
def test_the_exchange_search_too(rng):
    r = jb.parity_relations(paper(), 20)
    u, y = recording(rng, r.model, 1600, spread=1.03)
    res = jb.detect(r, u, y, starts=[70], margins="exact")
    mon = Monitor(r)
    state, *first = stepped(mon, u[:100], y[:100], [70])
    state, verdict = mon.run(state, u[100:], y[100:])
    assert_equal([np.concatenate(pair) for pair in zip(first, verdict[:2], strict=True)], res)
    assert {jb.Status.CONSISTENT, jb.Status.FAULT} < set(res.status.tolist())


def test_the_exchange_search_with_missing_samples(rng):
    r = jb.parity_relations(paper(), 20)
    u, y = recording(rng, r.model, 90)
    y[[30, 60], [0, 1]] = np.nan
    u[75] = np.nan
    y[80:82] = np.nan
    res = jb.detect(r, u, y, margins="exact")
    _, status, margin = stepped(Monitor(r), u, y)
    np.testing.assert_array_equal(status, res.status)
    np.testing.assert_allclose(margin, res.margin, rtol=1e-9, atol=1e-9)


def test_whatever_the_block_the_kernels_give_the_same_bits(rng):
    """What the module says of short blocks, measured on this machine: from 4 windows on."""
    r = jb.parity_relations(paper())
    u, y = recording(rng, r.model, 513, 20)
    test = r.reading(y.dtype)
    bits = lambda size: np.concatenate(
        [
            np.asarray(strips.verdicts(test, u[k : k + size + 1], y[k : k + size + 1])[1])
            for k in range(0, 512, size)
        ]
    )
    for size in (4, 16, StripsTest.short):
        np.testing.assert_array_equal(bits(size), bits(512))


def test_a_time_stamp_that_is_not_dt_later_empties_the_window(rng):
    r = jb.parity_relations(paper())
    u, y = recording(rng, r.model, 40)
    time = 0.01 * np.arange(40)
    time[10:] += 0.5  # a gap
    time[20:] -= 0.2  # back
    time[30] += 0.001  # jitter
    starts = [10, 20]
    res = jb.detect(r, u, y, starts=starts)
    mon = Monitor(r)
    assert_equal(mon.run(mon.init(), u, y, time=time)[1], res)
    state, status = mon.init(), []
    for k in range(40):
        state, verdict = mon.step(state, u[k], y[k], time=time[k])
        status.append(verdict.status)
    np.testing.assert_array_equal(status, res.status)


def test_a_state_is_a_tree_of_numpy_arrays_that_a_file_holds(rng):
    r = jb.parity_relations(paper())
    u, y = recording(rng, r.model, 60)
    mon = Monitor(r)
    state, _ = mon.run(mon.init(), u[:30], y[:30])
    assert all(isinstance(x, (np.ndarray, np.generic)) for x in jax.tree.leaves(state))
    file = io.BytesIO()
    np.savez(file, **state._asdict())
    file.seek(0)
    with np.load(file) as kept:
        restored = Monitor(r).init()._replace(**kept)
    _, status, margin = stepped(Monitor(r), u[30:50], y[30:50], state=restored)
    res = jb.detect(r, u[:50], y[:50])
    np.testing.assert_array_equal(status, res.status[30:])
    np.testing.assert_array_equal(margin, res.margin[30:])


@pytest.mark.compiled
def test_windows_that_lack_samples_wait_for_no_compiling(rng):
    """A shape takes seconds of compiling: no stream waits for these."""
    r = jb.parity_relations(paper(), 20)
    u, y = recording(rng, r.model, 70, spread=0.5)
    mon = Monitor(r)
    state, *_ = stepped(mon, u[:21], y[:21])
    shapes = exchange.candidates._cache_size()
    y[22], y[47, 0], u[30] = np.nan, np.nan, np.nan
    _, status, _ = stepped(mon, u[21:], y[21:], state=state)
    assert exchange.candidates._cache_size() == shapes
    assert set(status.tolist()) == {jb.Status.CONSISTENT}


@pytest.mark.compiled
def test_numpy_judges_the_first_searched_windows_whatever_the_pieces(rng, monkeypatch):
    """No sample waits for a compiler there, and another cut is the same bits; a process that follows many
    streams compiles.
    """
    blocks, search = [], exchange.candidates

    def seen(*args, **kwargs):
        blocks.append(args)
        return search(*args, **kwargs)

    monkeypatch.setattr(kernel, "_mode", kernel.AUTO)
    monkeypatch.setattr(kernel, "FIRST", 40)
    monkeypatch.setattr(exchange, "candidates", seen)
    r = jb.parity_relations(paper(), 20)
    u, y = recording(rng, r.model, 50, spread=0.9)
    y[35:] += 1
    mon = Monitor(r)
    state, verdict = mon.run(mon.init(), u[:40], y[:40])
    assert not blocks
    status, margin = mon.run(state, u[40:], y[40:])[1][:2]
    assert len(blocks) == 1
    together = np.concatenate([verdict.status, status]), np.concatenate([verdict.margin, margin])
    assert_equal(stepped(mon, u, y), Verdict(*together))
    assert {jb.Status.CONSISTENT, jb.Status.FAULT} < set(together[0].tolist())
    blocks.clear()
    with monkeypatch.context() as patch:
        patch.setattr("jaxbound.consistency.drive._decided_all", lambda judged: False)
        again = mon.run(mon.init(), u[:24], y[:24])[1]
    assert len(blocks) == 4, "what rounding leaves open is searched by XLA"
    np.testing.assert_array_equal(again.status, together[0][:24])
    kernel._evaluated.clear()
    early = [kernel.first_in_numpy(0, 50, 1, mon._test.kind) for _ in range(5)]
    assert early == [40, 40, 40, 40, 0] and kernel.first_in_numpy(38, 50, 1, "another") == 2
    with kernel.sparing():  # `detect` by a monitor has all samples at once
        assert kernel.first_in_numpy(0, 50, 1, "a third") == 0


@pytest.mark.compiled
@pytest.mark.parametrize("mode, threads", [(kernel.NEVER, 0), (kernel.AUTO, 1)])
def test_a_live_stream_waits_for_no_compiler(rng, monkeypatch, mode, threads):
    """Beside the samples that NumPy judges, another thread compiles, once: the same verdicts."""
    called = []

    def seen(*args, search=exchange.candidates, **kwargs):
        called.append(threading.current_thread())
        return search(*args, **kwargs)

    monkeypatch.setattr(kernel, "_mode", mode)
    monkeypatch.setattr(exchange, "candidates", seen)
    r = jb.parity_relations(paper(), 20)
    u, y = recording(rng, r.model, 30, spread=0.9)
    y[25:] += 1
    together = Monitor(r).run(Monitor(r).init(), u, y)[1]
    monkeypatch.setattr(judges, "AHEAD", -1.0)
    live, found = judges.Live(Monitor(r)), []
    for k in range(30):
        found += [verdicts for _, verdicts in live((k, jb.Recording(u[k : k + 1], y[k : k + 1])))]
    if live._ahead is not None:
        live._ahead.join()
    assert [thread is live._ahead for thread in called] == [True] * threads
    assert_equal(Verdict(*(np.concatenate([v[i] for v in found]) for i in (0, 1))), together)
    assert {jb.Status.CONSISTENT, jb.Status.FAULT} < set(together.status.tolist())


@pytest.mark.compiled
@pytest.mark.parametrize("mode", [kernel.NEVER, kernel.AUTO])
def test_strips_are_compiled_at_once_or_never(rng, monkeypatch, mode):
    outside, judge = set(), strips.verdicts
    monkeypatch.setattr(kernel, "_mode", mode)
    monkeypatch.setattr(strips, "verdicts", lambda *x: outside.add(kernel.is_outside_xla()) or judge(*x))
    mon = Monitor(jb.parity_relations(paper()))
    mon.run(mon.init(), *recording(rng, paper(), 9))
    assert outside == {mode == kernel.NEVER}


@pytest.mark.compiled
def test_a_second_step_does_not_compile(rng):
    r = jb.parity_relations(paper())
    u, y = recording(rng, r.model, 8)
    mon = Monitor(r)
    state, _ = mon.step(mon.init(), u[0], y[0])
    before = strips.verdicts._cache_size()
    for k in range(1, 8):
        state, _ = mon.step(state, u[k], y[k])
    other = Monitor(jb.parity_relations(paper(noise=[0.2, 0.02])))  # another model of this shape
    other.step(other.init(), u[0], y[0])
    assert strips.verdicts._cache_size() == before


@pytest.mark.parametrize(
    "model",
    [
        dict(constant_tolerance=True),
        pytest.param(
            dict(uncertainties=[jb.Uncertainty("a", A=[[0.01, 0], [0, 0]])]), marks=pytest.mark.long
        ),
    ],
    ids=["constant tolerance", "uncertain"],
)
def test_slower_tests_equal_detect(rng, model):
    r = jb.parity_relations(paper(**model))
    u, y = recording(rng, r.model, 12)
    assert_equal(stepped(Monitor(r), u, y), jb.detect(r, u, y))


def test_data_frames_and_models_without_inputs(rng):
    r = jb.parity_relations(paper())
    u, y = recording(rng, r.model, 20)
    frame = pd.DataFrame({"u1": u[:, 0], "y1": y[:, 0], "y2": y[:, 1]})
    mon = Monitor(r)
    assert_equal(mon.run(mon.init(), frame, frame)[1], jb.detect(r, u, y))
    alone = Monitor(jb.parity_relations(jb.LinearSystem([[0.5]], None, [[1]], noise=0.1)))
    assert alone.step(alone.init(), None, [1.0])[1].status == jb.Status.MISSING


def test_what_does_not_fit_is_refused_in_a_sentence():
    r = jb.parity_relations(paper())
    mon = Monitor(r)
    state = mon.init()
    for u, y, message in (
        ([0.0, 1.0], [0.0, 0.0], r"u must have shape \(..., T, 1\)"),
        ([0.0], [np.inf, 0.0], "y must be finite"),
        ([[0.0]], [[0.0, 0.0]], "a Monitor follows one recording"),
    ):
        with pytest.raises(ValueError, match=message):
            mon.step(state, u, y)
    with pytest.raises(ValueError, match="starts needs the numbers of samples, 0 to 1 here"):
        mon.run(state, np.zeros((2, 1)), np.zeros((2, 2)), starts=[2])
    with pytest.raises(ValueError, match="time needs one number a sample: 1 for 2"):
        mon.run(state, np.zeros((2, 1)), np.zeros((2, 2)), time=[0.0])
    with pytest.raises(ValueError, match="not 'exact'"):
        Monitor(r, "exact")
    with pytest.raises(TypeError, match="needs relations, not LinearSystem"):
        Monitor(paper())
