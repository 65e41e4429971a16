"""Healthy recordings laid end to end, the second one at any sample of a block: nothing that was known before
a gap is believed behind it, by no observer, reader or monitor.
"""

from fractions import Fraction

import jax
import numpy as np
import pandas as pd
import pytest
from observer_case import first_decided_in_numpy, inside, recorded, systems

import jaxbound as jb
from jaxbound.consistency.twice import Doubtful
from jaxbound.estimation import joint_observer
from jaxbound.estimation.validation_observer import ValidationObserver
from jaxbound.recordings.recording import Recording
from jaxbound.sets.floats.kernel import outside_xla

PLANT = jb.LinearSystem([["0.999"]], [[1]], [[1]], noise="0.1", dt=1, inputs="u", outputs="y")
JUMPS = Fraction("0.2"), Fraction("0.3"), Fraction(50)
"""Of the state behind the gap: the small ones are explained by wrong sets, which then lose the state."""
JOINT = {"method": "joint", "window": 4}
METHODS = [
    (2, JOINT),
    (5, {"method": "joint", "window": 10}),
    (16, {"method": "joint"}),
    (16, {"method": "zonotope"}),
    (16, {"method": "strips"}),
]
"""(samples of a block, options): of a window's half, or of the piece that a kernel is compiled for."""


def laid_end_to_end(gap, T):
    """Return (u (3, T, 1), y (3, T, 1), x (3, T) exact): the state is 0, and a jump of each size at the
    gap.
    """
    y, states = np.zeros((len(JUMPS), T, 1)), []
    for i, jump in enumerate(JUMPS):
        x, row = Fraction(0), []
        for k in range(T):
            if k == gap:
                x = jump
            row.append(x)
            side = 0.09 if k < gap else -0.09
            y[i, k] = float(x) + side * (1 if k % 2 else 0.9)
            x *= Fraction("0.999")
        states.append(row)
    return np.zeros_like(y), y, states


def wrong(found, x):
    """Return how many samples are FAULT, or have an interval without the state."""
    lo, hi = np.asarray(found.state.lo)[..., 0], np.asarray(found.state.hi)[..., 0]
    bad = int((np.asarray(found.status) == jb.Status.FAULT).sum())
    for i, row in enumerate(x):
        bad += sum(not a <= float(v) <= b for a, b, v in zip(lo[i], hi[i], row, strict=True))
    return bad


@pytest.mark.parametrize("block, how", METHODS)
@pytest.mark.parametrize("restart", [True, False])
@pytest.mark.usefixtures("searched_in_numpy")
def test_at_every_sample_of_a_block_a_gap_ends_what_was_known(block, how, restart):
    found = {}
    for gap in range(block, 2 * block + 1):
        u, y, x = laid_end_to_end(gap, gap + block + 3)
        x0 = jb.interval([-0.3], [0.3]) if gap % 2 else None
        found[gap] = wrong(jb.observe(PLANT, u, y, x0=x0, starts=[gap], restart=restart, **how), x)
    assert found == dict.fromkeys(found, 0)


@pytest.mark.parametrize("block, how", [METHODS[0], *METHODS[3:]])
@pytest.mark.parametrize("size", [1, 3])
@pytest.mark.usefixtures("searched_in_numpy")
def test_in_pieces_of_any_size_too(block, how, size):
    watch, block = jb.observer(PLANT, **how).telling(enclosures=True), min(block, 4)
    found = {}
    for gap in range(block, 3 * block + 1):
        u, y, x = laid_end_to_end(gap, gap + block + 3)
        carry, parts = watch.init(), []
        for k in range(0, y.shape[1], size):
            starts = [gap - k] if k <= gap < k + size else []
            piece = Recording.of(PLANT, u[:, k : k + size], y[:, k : k + size], starts)
            carry, part = watch.fold(carry, piece)
            parts.append(part)
        found[gap] = wrong(jax.tree.map(lambda *x: np.concatenate(x, 1), *parts), x)
    assert found == dict.fromkeys(found, 0)


@pytest.mark.usefixtures("searched_in_numpy")
def test_behind_a_gap_where_blocks_begin_verdicts_are_those_of_a_recording_of_its_own():
    """Those of a slow fault too, and for as long as it lasts."""
    T = 32
    for gap in (4, 8):
        u, y, _ = laid_end_to_end(gap, T)
        y[:, gap + 10 :, 0] += 0.03 * np.arange(T - gap - 10)
        for restart in (True, False):
            watch = jb.observer(PLANT, **JOINT, restart=restart)
            whole, alone = jb.detect(watch, u, y, starts=[gap]), jb.detect(watch, u[:, gap:], y[:, gap:])
            np.testing.assert_array_equal(whole.status[:, gap:], alone.status)
            np.testing.assert_allclose(whole.margin[:, gap:], alone.margin, rtol=1e-9, atol=1e-9)
            assert (alone.status == jb.Status.FAULT).any(1).all()


def test_a_set_that_outlives_a_gap_is_not_believed_twice(monkeypatch):
    """The first decision forgets no gap on purpose: the second one begins behind it, with the samples."""
    u, y, _ = laid_end_to_end(8, 16)
    watch = jb.observer(PLANT, **JOINT)
    monkeypatch.setattr(joint_observer, "_believed", lambda state, *sets: state)
    state = watch.init()
    _, samples = watch.side_by_side(state, Recording.of(PLANT, u, y, [8]))
    _, once = watch.found(state, samples)
    assert (once.status == jb.Status.FAULT).any()
    first_decided_in_numpy(monkeypatch, joint_observer.JointObserver)
    with outside_xla(False), pytest.warns(Doubtful):
        status = jb.detect(watch, u, y, starts=[8]).status
    assert not (status == jb.Status.FAULT).any()


def as_read(kind, table, gap):
    """Return (table, starts) of a recording whose gap is told in one of the ways there are."""
    number = np.arange(len(table))
    seconds = number + 600.0 * (number >= gap)
    if kind == "starts":
        return table, [gap]
    if kind == "seconds":
        return table.set_axis(seconds), ()
    if kind == "dates":
        return table.set_axis(pd.Timestamp("2026-01-01") + pd.to_timedelta(seconds, "s")), ()
    if kind == "where":
        return table.assign(on=(number != gap - 1).astype(float)), ()
    return table.assign(u=np.where(number == gap - 1, np.nan, 0.0)), ()


@pytest.mark.parametrize("kind", ["starts", "seconds", "dates", "where", "an input is missing"])
def test_however_a_gap_is_told_at_any_sample_it_ends_what_was_known(kind):
    model = PLANT
    if kind == "where":
        model = PLANT.replace(columns={"where": "on > 0"})
    watch, found = jb.observer(model, **JOINT), {}
    for gap in (8, 9):
        _, y, _ = laid_end_to_end(gap, gap + 6)
        for i in range(len(JUMPS)):
            table, starts = as_read(kind, pd.DataFrame({"u": 0.0, "y": y[i, :, 0]}), gap)
            found[gap, i] = jb.detect(watch, table, starts=starts).counts["FAULT"]
    assert found == dict.fromkeys(found, 0)


def test_means_across_a_gap_at_any_row():
    """A state that stays: the mean of two rows obeys the model as each does."""
    model = PLANT.replace(A=[[1]], dt=2, columns={"every": "2s"})
    watch, found = jb.observer(model, **JOINT), {}
    for gap in range(8, 12):
        for wait in (600, 601):
            seconds = np.arange(40) + float(wait) * (np.arange(40) >= gap)
            y = np.where(np.arange(40) < gap, 0.0, 50.0) + np.where(np.arange(40) % 3, 0.09, -0.09)
            found[gap, wait] = jb.detect(watch, pd.DataFrame({"u": 0.0, "y": y}, seconds)).counts
    assert {key: counts["FAULT"] for key, counts in found.items()} == dict.fromkeys(found, 0)
    assert all(counts["UNDECIDED"] >= 15 for counts in found.values())


@pytest.mark.parametrize("before, after", [(1, 0), (np.nan, 1), (1, np.nan)])
def test_a_monitor_whose_mode_changes_at_any_sample(before, after):
    tests = [
        {"name": "one", "observer": "joint", "window": 4, "when": "mode > 0"},
        {"name": "other", "observer": "joint", "window": 4, "when": "otherwise"},
        {"name": "latched", "observer": "zonotope", "latched": True, "when": "mode > 0"},
        {"name": "windows", "horizon": 3, "when": "otherwise"},
    ]
    bank, found = jb.monitor(PLANT, tests), {}
    monitor = jb.Monitor(bank)
    for gap in (4, 5):
        _, y, _ = laid_end_to_end(gap, gap + 6)
        mode = np.where(np.arange(gap + 6) < gap, before, after)
        for i in range(len(JUMPS)):
            table = pd.DataFrame({"u": 0.0, "mode": mode, "y": y[i, :, 0]})
            state, status = monitor.init(), []
            for k in range(gap + 6):
                row = table.iloc[k].to_dict()
                state, verdict = monitor.step(state, row, row)
                status.append(verdict.status)
            found[gap, i] = jb.detect(bank, table).counts["FAULT"] + status.count(jb.Status.FAULT)
    assert found == dict.fromkeys(found, 0)


def test_a_monitor_that_is_told_of_a_gap_at_any_sample():
    monitor, found = jb.Monitor(jb.observer(PLANT, **JOINT)), {}
    for gap in (4, 5):
        _, y, _ = laid_end_to_end(gap, gap + 6)
        for i in range(len(JUMPS)):
            state, status = monitor.init(), []
            for k in range(gap + 6):
                state, verdict = monitor.step(state, [0.0], y[i, k], new=k == gap)
                status.append(verdict.status)
            found[gap, i] = status.count(jb.Status.FAULT)
    assert found == dict.fromkeys(found, 0)


def test_validation_begins_anew_at_any_sample():
    observer, found = ValidationObserver(PLANT), {}
    for gap in (3, 14):
        u, y, x = laid_end_to_end(gap, 17)
        found[gap] = wrong(jb.validate(PLANT, u, y, starts=[gap]), x)
        carry = observer.init()
        carry, first = observer.fold(carry, Recording.of(PLANT, u[2, :gap], y[2, :gap]))
        carry, second = observer.fold(carry, Recording.of(PLANT, u[2, gap:], y[2, gap:], [0]))
        parts = jax.tree.map(lambda *x: np.concatenate(x)[None], first, second)
        found[gap] += wrong(parts, x[2:])
    assert found == dict.fromkeys(found, 0)


def many_laid_end_to_end(rng, seeds, N, block, **how):
    """Return how many samples of random plants were observed, laid end to end where blocks begin: the state
    inside all, no FAULT.
    """
    samples = 0
    for seed in seeds:
        dtype, kind = (np.float64, np.float32)[seed % 2], ("stable", "integrating", "unstable")[seed % 3]
        model = systems(rng, kind)
        lengths = block * rng.integers(1, 4, 3) + rng.choice([0, 0, 1], 3)
        at = ("vertices", "uniform")[seed // 2 % 2]
        parts = [recorded(model, int(T), 10 * seed + i, N, at, dtype) for i, T in enumerate(lengths)]
        u, x, y = (np.concatenate(part, 1) for part in zip(*parts, strict=True))
        y[rng.random(y.shape) < 0.03] = np.nan
        found = jb.observe(model, u, y, starts=np.cumsum(lengths)[:-1], **how)
        assert inside(found, x, dtype).all() and not (found.status == jb.Status.FAULT).any()
        samples += y[..., 0].size
    print(f"{samples} samples of recordings laid end to end: the state inside all, 0 FAULT")
    return samples


@pytest.mark.usefixtures("searched_in_numpy")
def test_random_plants_laid_end_to_end(rng):
    assert many_laid_end_to_end(rng, [8], 24, 4, method="joint", window=8, order=6) > 24 * 12


@pytest.mark.long(by_day="test_random_plants_laid_end_to_end")
def test_a_hundred_thousand_samples_laid_end_to_end(rng):
    joint = many_laid_end_to_end(rng, range(48), 64, 4, method="joint", window=8, order=6)
    others = [many_laid_end_to_end(rng, range(48), 32, 16, method=m) for m in ("zonotope", "strips")]
    assert joint + sum(others) > 100_000
