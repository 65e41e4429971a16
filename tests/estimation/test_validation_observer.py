"""Validation as an Observer: whatever the pieces, what `validate` says of the whole recording."""

import jax
import numpy as np
import pytest

import jaxbound as jb
from jaxbound.consistency.drive import drive
from jaxbound.consistency.interface import Watch
from jaxbound.consistency.monitorbank import MonitorBank
from jaxbound.estimation import validation_slide
from jaxbound.estimation.validation_observer import ValidationObserver
from jaxbound.estimation.validation_windows import slide
from jaxbound.recordings.recording import Recording
from jaxbound.sets.floats.kernel import is_outside_xla

MODEL = jb.interval_system([[[0.89, 0.91]]], [[1]], [[1], [1]], noise=0.1)


def recorded(rng, samples=30):
    """Return u, y: a plant with a wrong sensor for a while, a missing sample, and a stretch without any.

    No piece has more than 16 samples: as many are compiled for, however few there are.
    """
    x, y = 1.0, []
    for _ in range(samples):
        y.append([x + rng.uniform(-0.05, 0.05), x + rng.uniform(-0.05, 0.05)])
        x = 0.9 * x + 1
    y = np.array(y)
    y[9:12, 1] += 2
    y[5, 0] = np.nan
    u = np.ones((samples, 1))
    u[14:16], y[14:16] = np.nan, np.nan
    return u, y


def in_pieces(observer, u, y, cuts):
    carry, found = observer.init(), []
    for a, b in zip([0, *cuts], [*cuts, len(y)], strict=True):
        carry, judged = observer.fold(carry, Recording.of(observer.signals, u[a:b], y[a:b]))
        assert judged.status.shape == (b - a,)
        found.append(judged)
    return jax.tree.map(lambda *x: np.concatenate(x), *found)


def agree(found, want):
    np.testing.assert_array_equal(found.status, want.status)
    np.testing.assert_array_equal(found.faulty, want.faulty)
    for name in ("state", "output", "residual", "corrected"):
        for end in ("lo", "hi"):
            np.testing.assert_allclose(
                getattr(getattr(found, name), end), getattr(getattr(want, name), end), rtol=1e-12, atol=1e-12
            )


@pytest.mark.parametrize("method", ["joint", "sequential"])
def test_sample_by_sample_and_in_one_piece_it_is_validate(method, rng):
    u, y = (x[:17] for x in recorded(rng))
    want = jb.validate(MODEL, u, y, method=method)
    assert want.faulty[9].tolist() == [False, True] and want.status[15] == jb.Status.MISSING
    observer = ValidationObserver(MODEL, method=method)
    agree(in_pieces(observer, u, y, range(1, len(y))), want)
    agree(in_pieces(observer, u, y, [7, 13, 15]), want)
    agree(drive(observer, Recording.of(observer.signals, u, y)), want)


def test_a_first_state_and_a_gap_are_those_of_validate(rng):
    u, y = recorded(rng)
    x0 = jb.interval([0.5], [1.5])
    want = jb.validate(MODEL, u, y, x0=x0, starts=[9])
    observer = ValidationObserver(MODEL, x0=x0)
    carry, first = observer.fold(observer.init(), Recording.of(observer.signals, u[:9], y[:9]))
    _, second = observer.fold(carry, Recording.of(observer.signals, u[9:], y[9:], starts=[0]))
    agree(jax.tree.map(lambda *x: np.concatenate(x), first, second), want)


def test_recordings_side_by_side_have_gaps_of_their_own(rng):
    u, y = recorded(rng)
    other = y.copy()
    other[2:4, 0] = np.nan
    whole = np.where(np.isnan(u), 1.0, u)
    filled = np.where(np.isnan(u), 5.0, other)
    both = jb.validate(MODEL, np.stack([u, whole]), np.stack([y, filled]))
    for i, alone in enumerate((jb.validate(MODEL, u, y), jb.validate(MODEL, whole, filled))):
        agree(jax.tree.map(lambda x, i=i: x[i], both), alone)


def test_a_piece_without_samples_changes_nothing(rng):
    u, y = (x[:6] for x in recorded(rng))
    observer = ValidationObserver(MODEL)
    agree(in_pieces(observer, u, y, [0, 2, 4, 4]), jb.validate(MODEL, u, y))


def test_a_fault_that_numpy_does_not_find_again_is_none(rng, monkeypatch):
    """The box, and so what `state` encloses, is that of the windows before."""
    u, y = (x[:9] for x in recorded(rng))

    def lying(*args):
        carries, found, blamed = slide(*args)
        if is_outside_xla():
            return carries, found, blamed
        return carries, found, np.asarray(blamed).copy() | (np.arange(len(blamed)) >= 1)[:, None, None]

    monkeypatch.setattr(validation_slide, "slide", lying)
    found = jb.validate(MODEL, u, y)
    assert not (found.status == jb.Status.FAULT).any() and not found.faulty.any()


def test_a_monitor_takes_an_observer(rng):
    u, y = recorded(rng)
    want = jb.validate(MODEL, u, y)
    mon = jb.Monitor(ValidationObserver(MODEL))
    state, found = mon.init(), []
    for k in range(16):
        state, judged = mon.step(state, u[k], y[k])
        found.append(judged.faulty.tolist())
    assert found == want.faulty[:16].tolist()
    _, rest = mon.run(state, u[16:], y[16:])
    np.testing.assert_array_equal(rest.status, want.status[16:])
    with pytest.raises(ValueError, match="an Observer has no clock"):
        mon.step(state, u[0], y[0], time=3.0)


def test_what_a_float32_recording_rounded_away_counts_as_it_does_for_validate():
    """At a level of 10^6 float32 rounds by more than the noise: a healthy plant is not accused, as by
    `validate`.
    """
    model = jb.LinearSystem([[1.0]], None, [[1], [1]], noise=1e-3)
    y = np.float32(1e6 - 0.01 * np.arange(12))[:, None] * np.float32([1, 1 + 2e-7])
    want = jb.validate(model, None, y)
    assert not np.asarray(want.faulty).any() and y.dtype == np.float32
    observer = ValidationObserver(model)
    carry, found = observer.init(), []
    for k in range(len(y)):
        carry, judged = observer.fold(carry, Recording.of(observer.signals, None, y[k : k + 1], narrow=False))
        found.append(judged)
    agree(jax.tree.map(lambda *x: np.concatenate(x), *found), want)
    with pytest.raises(ValueError, match="y is in float64, the samples before are in float32"):
        observer.fold(carry, Recording.of(observer.signals, None, y[:1].astype(float), narrow=False))


def test_an_infinite_sample_is_refused_in_a_sentence():
    observer = ValidationObserver(MODEL)
    with pytest.raises(ValueError, match="y must be finite"):
        observer.fold(observer.init(), Recording.of(observer.signals, [[0.0]], [[np.inf, 1.0]]))


def test_a_missing_input_beside_a_sample_is_refused_in_a_sentence():
    observer = ValidationObserver(MODEL)
    with pytest.raises(ValueError, match="validation needs every input: 1 samples of u are missing"):
        observer.fold(observer.init(), Recording.of(observer.signals, [[np.nan]], [[1.0, 1.0]]))


def test_a_first_state_is_that_of_each_recording_of_a_batch(rng):
    u, y = (x[:9] for x in recorded(rng))
    observer = ValidationObserver(MODEL, x0=jb.Interval(np.array([0.9]), np.array([1.1])))
    alone = drive(observer, Recording.of(observer.signals, u, y))
    both = drive(observer, Recording.of(observer.signals, np.stack([u, u]), np.stack([y, y])))
    for i in range(2):
        agree(jax.tree.map(lambda x, i=i: x[i], both), alone)


def test_a_monitor_whose_observer_knows_a_first_state_knows_it_of_each_recording_of_a_batch(rng):
    model = jb.LinearSystem([["0.9"]], [[1]], [[1], [1]], noise="0.1")
    observer = jb.observer(model, x0=jb.Interval(np.array([0.9]), np.array([1.1])))
    bank = MonitorBank(model, [Watch("set", observer)])
    u, y = np.ones((3, 6, 1)), np.full((3, 6, 2), 5.0)
    u[:2], y[:2] = (x[:6] for x in recorded(rng))
    assert (jb.detect(bank, u, y).status[:, 0] == jb.detect(observer, u, y).status[:, 0]).all()


def test_behind_a_batch_nothing_is_known_and_an_empty_one_is_refused_in_a_sentence(rng):
    u, y = recorded(rng)
    observer = ValidationObserver(MODEL)
    carry, _ = observer.fold(observer.init(), Recording.of(observer.signals, u[:8], y[:8]))
    batch = np.stack([u] * 3), np.stack([y] * 3)
    going_on, alone = (jb.detect(observer.continued(carry), *given) for given in (batch, (u, y)))
    np.testing.assert_array_equal(going_on.status, [alone.status] * 3)
    behind, _ = observer.fold(observer.init(), Recording.of(observer.signals, *batch))
    _, fresh = observer.fold(behind, Recording.of(observer.signals, u, y))
    agree(fresh, observer.fold(observer.init(), Recording.of(observer.signals, u, y))[1])
    with pytest.raises(ValueError, match="no stretch of 2 complete samples"):
        jb.validate(MODEL, np.ones((0, 8, 1)), np.ones((0, 8, 2)))
