"""Few windows are evaluated in NumPy, many are compiled: verdicts do not depend on it."""

import numpy as np
import pytest

import jaxbound as jb
from benchmarks.first_call import compilations
from benchmarks.same_bits import FAMILIES, recording
from jaxbound.consistency.drive import windows
from jaxbound.sets.floats.kernel import FEW, PRIMITIVES, outside_xla, spared, sparing

pytestmark = [pytest.mark.compiled, pytest.mark.usefixtures("as_users_do")]


@pytest.fixture
def compiled():
    """Return a list that gets an entry for each program that is handed to XLA."""
    with compilations() as found:
        yield found


BY_DAY = [("short", np.float64), ("constant tolerance", np.float64), ("short", np.float32)]
CASES = [(name, dtype) for name in FAMILIES for dtype in (np.float64, np.float32)]


@pytest.mark.parametrize(
    ("name", "dtype"),
    [case if case in BY_DAY else pytest.param(*case, marks=pytest.mark.long) for case in CASES],
)
def test_both_ways_say_the_same(name, dtype):
    make, how = FAMILIES[name]
    relations = jb.parity_relations(make(), **how)
    for at in ("uniform", "vertices"):  # of these rounding may leave some open, which are compiled after all
        u, y = recording(relations.model, 200, at=at, dtype=dtype)
        jb.compile()
        few = jb.detect(relations, u, y.astype(dtype), margins="exact")
        jb.compile("always")
        many = jb.detect(relations, u, y.astype(dtype), margins="exact")
        np.testing.assert_array_equal(few.status, many.status)
        assert many.evaluated == ("NumPy" if name == "constant tolerance" else "XLA")
        assert few.evaluated == "NumPy" or (few.evaluated, at) == ("XLA", "vertices")
        assert (few.status == jb.Status.FAULT).any() or "uncertain" in name
        close = dict(rtol=1e-9, atol=1e-9) if dtype == np.float64 else dict(rtol=1e-2, atol=1e-2)
        np.testing.assert_allclose(few.margin, many.margin, **close)


def test_a_compiled_search_asks_numpy_of_what_rounding_leaves_open(monkeypatch):
    """Its kernels are evaluated in NumPy here: what XLA makes of them is asked by night."""
    make, how = FAMILIES["averages"]
    relations = jb.parity_relations(make(), **how)
    u, y = recording(relations.model, 100, at="vertices", dtype=np.float32)
    with outside_xla():
        few = jb.detect(relations, u, y.astype(np.float32))
        monkeypatch.setattr("jaxbound.consistency.exchange.is_outside_xla", lambda: False)
        many = jb.detect(relations, u, y.astype(np.float32))
    np.testing.assert_array_equal(few.status, many.status)
    assert (few.status == jb.Status.CONSISTENT).any()


def test_the_first_windows_of_a_kind_compile_nothing_and_later_ones_do(compiled):
    noise = "0.1234567"  # of a shape that no other test has compiled
    model = jb.LinearSystem(np.diag([0.9, 0.8, 0.7]), np.ones((3, 1)), np.eye(3)[:2] + 0.1, noise=noise)
    relations, run = jb.parity_relations(model, 3), (np.zeros((700, 1)), np.zeros((700, 2)))
    first = jb.detect(relations, *run)
    compiled.clear()
    for _ in range(FEW // 700 - 1):
        jb.detect(relations, *run)
    assert not compiled
    later = jb.detect(relations, *run)
    assert compiled
    np.testing.assert_array_equal(first.status, later.status)


def test_never_and_always_mean_it_and_other_words_are_refused(compiled, monkeypatch):
    model = jb.LinearSystem([[0.9, 0.1], [0, 0.8]], None, [[1, 2], [3, 5], [1, 1]], noise=0.1)
    relations, y = jb.parity_relations(model, 2), np.zeros((3000, 3))
    jb.compile("never")
    jb.detect(relations, None, y)
    compiled.clear()
    never = jb.detect(relations, None, y)
    assert not compiled
    jb.compile("always")
    np.testing.assert_array_equal(jb.detect(relations, None, y[:9]).status, never.status[:9])
    assert compiled
    with pytest.raises(ValueError, match='must be "auto", "always" or "never", not \'sometimes\''):
        jb.compile("sometimes")
    monkeypatch.setattr("jaxbound.sets.floats.kernel._mode", "sometimes")
    with pytest.raises(ValueError, match="JAXBOUND_COMPILE must be auto, always or never, not 'sometimes'"):
        jb.detect(relations, None, y[:9])


def test_who_forbids_it_forbids_it_to_all_within_and_other_devices_compile(monkeypatch):
    assert not spared(1, "asked by nobody")
    with sparing():
        assert spared(1, "few") and not spared(FEW, "few") and not spared(1, "few")
        with sparing(None):
            assert spared(1, "others")
        with sparing(False), sparing():
            assert not spared(1, "others")
        assert spared(1, "others")
        with monkeypatch.context() as m:
            m.setattr("jaxbound.sets.floats.kernel._platform", lambda: "gpu")
            assert not spared(1, "others")


def test_windows_that_take_longer_count_for_more(monkeypatch):
    """Of 3 disturbances over 16 samples NumPy judges some hundred a second."""
    done = []
    monkeypatch.setattr("jaxbound.sets.floats.kernel.spared", lambda work, kind: done.append(work) or False)
    monkeypatch.setattr("jaxbound.consistency.drive._decided", lambda *about: None)
    for asked in ({}, {"disturbance": (np.eye(3), 0.1)}):
        model = jb.LinearSystem(np.diag([0.9, 0.8, 0.7]), None, np.ones((3, 3)), noise=1, **asked)
        test = jb.parity_relations(model, 15).test("joint", np.float64)
        windows(test, jb.Recording(np.zeros((40, 0)), np.zeros((40, 3))))
    assert 25 <= done[0] <= 50 and 5 * done[0] < done[1] < FEW


def test_each_function_has_its_own_first_windows():
    box = jb.interval([-0.2], [0.2])
    functions = [lambda z, u, y, a=a: y[1] - a * y[0] - z for a in (0.5, 0.25)]
    tests = [jb.residual(f, box, horizon=1).recording(None, np.zeros((3, 1)))[0] for f in functions * 2]
    kinds = [relations.test("joint", np.float64).kind for relations in tests]
    assert kinds[:2] == kinds[2:] and len(set(kinds)) == 2


def test_progress_rises_to_one_once_where_the_compiled_way_is_asked_too():
    model, calls = jb.LinearSystem([[1]], None, [[1]], noise="0.1"), []
    y = [[0.1], [0.3], [0.1], [0.1], [0.3]]  # at the bounds, which rounding leaves open
    jb.detect(jb.parity_relations(model, 1), None, y, progress=calls.append)
    assert calls == [1.0]


def test_a_program_that_numpy_does_not_know_is_compiled(compiled, monkeypatch):
    for name in ("add", "mul"):
        monkeypatch.delitem(PRIMITIVES, name)
    model = jb.LinearSystem([[0.9]], np.ones((1, 5)), [[1], [2], [3], [4]], noise=0.1)
    status = jb.detect(jb.parity_relations(model), np.zeros((5, 5)), np.zeros((5, 4))).status
    assert status.tolist() == [1, 1, 1, 1, 1] and compiled
