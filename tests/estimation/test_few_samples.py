"""Few samples are followed in NumPy, many are compiled: verdicts do not depend on it."""

import numpy as np
import pytest

import jaxbound as jb
from jaxbound.consistency.interface import Judged, Observer
from jaxbound.estimation.methods import OBSERVERS
from jaxbound.estimation.set_observer import ZonotopeObserver
from jaxbound.recordings.recording import Recording
from jaxbound.sets.floats.kernel import FEW, is_outside_xla, outside_xla
from jaxbound.sets.floats.probe import Unverified

pytestmark = [pytest.mark.compiled, pytest.mark.usefixtures("as_users_do")]

PLANT = jb.LinearSystem([[0.9, 0.2], [0, 0.8]], [[0], [1]], [[1, 0], [1, 1]], noise=0.1, tolerance=[0.01, 0])


@pytest.fixture
def ways(monkeypatch):
    """Return a list that gets an entry for each piece that is followed: whether by NumPy. All are here."""
    found = []

    def seen(where, name):
        whole = getattr(where, name)

        def followed(self, *given):
            found.append(is_outside_xla())
            with outside_xla():
                return whole(self, *given)

        monkeypatch.setattr(where, name, followed)

    seen(ZonotopeObserver, "found")
    seen(jb.estimation.ValidationObserver, "fold")
    return found


def recordings(rng, T=40):
    """Return (u, y) (3, T, .): without a fault, with one, and without some samples."""
    A, B, C = (np.array(getattr(PLANT, name), float) for name in "ABC")
    u, x, y = rng.uniform(-1, 1, (3, T, 1)), np.zeros((3, 2)), np.empty((3, T, 2))
    for k in range(T):
        y[:, k] = x @ C.T + rng.uniform(-0.09, 0.09, (3, 2))
        x = x @ A.T + u[:, k] @ B.T
    y[1, T // 2 :, 0] += 1
    y[2, rng.random((T, 2)) < 0.2] = np.nan
    return u, y


def observers():
    """Return {name: verdicts of recordings} of all methods."""
    found = {name: lambda u, y, name=name: jb.observe(PLANT, u, y, method=name) for name in OBSERVERS}
    for name in ("joint", "sequential"):
        found[f"validate {name}"] = lambda u, y, name=name: jb.validate(PLANT, u, y, method=name)
    return found


@pytest.mark.parametrize("name", observers())
def test_both_ways_say_the_same(name, rng):
    u, y = recordings(rng)
    few = observers()[name](u, y)
    jb.compile("always")
    many = observers()[name](u, y)
    np.testing.assert_array_equal(few.status, many.status)
    assert (few.status[1] == jb.Status.FAULT).any() and (few.status[0] != jb.Status.FAULT).all()
    np.testing.assert_allclose(few.state.lo, many.state.lo, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(few.state.hi, many.state.hi, rtol=1e-6, atol=1e-6)


def test_samples_in_memory_are_spared_the_compiler(ways, rng):
    u, y = recordings(rng)
    jb.observe(PLANT, u[0], y[0])
    jb.validate(PLANT, u[0], y[0])
    result = jb.detect(jb.observer(PLANT), u[0], y[0])
    assert result.observation.state.shape == (len(y[0]), 2) and ways == [True] * 4


def test_what_is_judged_in_pieces_is_compiled_at_once(ways, rng):
    u, y = recordings(rng)
    monitor = jb.Monitor(jb.observer(PLANT))
    monitor.run(monitor.init(), u[0], y[0])
    assert ways == [False]


class Watching(Observer):
    """An observer whose margins are given, and which notes whether NumPy evaluates it."""

    model = PLANT

    def __init__(self, margin=1.0, **more):
        self.margin, self.seen = margin, []
        vars(self).update(more)

    def init(self):
        return ()

    def fold(self, carry, piece):
        self.seen.append(is_outside_xla())
        shape = np.shape(piece.y)[:-1]
        return carry, Judged(np.full(shape, 2, np.int8), np.full(shape, self.margin))


def test_an_observer_says_what_its_samples_are_worth():
    u, y = np.zeros((FEW // 8, 1)), np.zeros((FEW // 8, 2))
    cases = (
        (Watching(), [False] * 3),
        (Watching(weight=3), [True, True, False]),
        (Watching(weight=4), [True, True, False]),
        (Watching(weight=5), [True, False, False]),
    )
    for observer, expected in cases:
        for _ in expected:
            jb.detect(observer, u, y)
        assert observer.seen == expected


def test_recordings_side_by_side_take_the_time_of_one():
    many = Watching(weight=1, batched=True)
    jb.detect(many, np.zeros((64, FEW // 2, 1)), np.zeros((64, FEW // 2, 2)))
    jb.detect(many, np.zeros((1, 1)), np.zeros((1, 2)))
    assert many.seen == [True, False]


def test_samples_at_their_bounds_are_compiled_after_all():
    near, far = [True, False], [True]
    cases = (1e-8, far), (-1e-8, far), (1e-10, near), (0.0, near), (np.float32(1e-5), near)
    for margin, expected in cases:
        observer = Watching(margin, weight=1)
        jb.detect(observer, np.zeros((9, 1)), np.zeros((9, 2)))
        assert observer.seen == expected


def test_a_compiler_that_broke_its_word_is_asked_nothing(monkeypatch, rng):
    u, y = recordings(rng, 16)
    observers = jb.observer(PLANT), jb.estimation.ValidationObserver(PLANT)
    monkeypatch.setattr("jaxbound.sets.floats.probe._found", lambda *about: "broken")
    piece = Recording.of(PLANT, u[0], y[0])
    for observer in observers:
        with pytest.raises(Unverified, match="broken"):
            observer.fold(observer.init(), piece)
    few = jb.observe(PLANT, u[1], y[1]), jb.validate(PLANT, u[1], y[1])
    assert all((found.status == jb.Status.FAULT).any() for found in few)
