"""What XLA hands back is corrupted at random: no FAULT of a healthy recording reaches anybody, and faults are
still found without it.
"""

import warnings

import jax
import numpy as np
import pytest
from systems import paper

import jaxbound as jb
from jaxbound.consistency import Relations, WindowTest, drive
from jaxbound.consistency.twice import Doubtful
from jaxbound.sets.floats import kernel
from jaxbound.sets.floats.status import Status

pytestmark = pytest.mark.compiled

SHAKY = [jb.Uncertainty("a", A=[["0.02", 0], [0, "0.01"]])]
RELATIONS = {
    "strips": lambda: jb.parity_relations(paper()),
    "float32": lambda: jb.parity_relations(paper()),
    "bank": lambda: jb.redundancy(paper()),
    "long": lambda: jb.parity_relations(paper(), 20),
    "uncertain": lambda: jb.parity_relations(paper().replace(uncertainties=SHAKY)),
    # of the sizes that tests of observers compile
    "observer": lambda: jb.observer(DISTURBED),
    "joint": lambda: jb.observer(DISTURBED, method="joint", window=8, order=6),
}
DISTURBED = jb.LinearSystem(
    [["0.9", "0.2"], ["-0.1", "0.95"]],
    [[0], [1]],
    [[1, 0]],
    noise="0.1",
    disturbance=([[1], ["0.5"]], "0.02"),
)
METHODS = {"bank": "box"}


class Corrupted:
    """Stands in the place of XLA: returns other statuses, margins, numbers and copies than it was handed, now
    and then.
    """

    def __init__(self, rng, share):
        self.rng, self.share, self.changed = rng, share, 0

    def __call__(self, call):
        def corrupted(program, *args, **kwargs):
            out = call(program, *args, **kwargs)
            leaves = jax.tree.leaves(out)
            if kernel.is_outside_xla() or any(isinstance(x, jax.core.Tracer) for x in leaves):
                return out
            return jax.tree.map(self.changed_array, out)

        return corrupted

    def changed_array(self, x):
        x = np.array(x)
        if x.size > 1 and self.rng.random() < 0.1:  # another part of the array was copied
            return np.roll(x, int(self.rng.integers(x.size)), -1)
        wrong = self.rng.random(x.shape) < self.share
        self.changed += int(wrong.sum())
        if x.dtype == np.int8:
            return np.where(wrong, np.int8(Status.FAULT), x)
        if x.dtype == bool:
            return x ^ wrong
        if np.issubdtype(x.dtype, np.integer):
            return np.where(wrong, np.flip(x), x)
        return np.where(wrong, -x * self.rng.lognormal(0, 2, x.shape), x).astype(x.dtype)


@pytest.fixture
def corrupted(monkeypatch, rng):
    """Return a function that has XLA lie from then on."""

    def begin(share=0.2):
        liar = Corrupted(rng, share)
        monkeypatch.setattr(kernel.Kernel, "__call__", liar(kernel.Kernel.__call__))
        return liar

    return begin


def healthy(name, model, rng, recordings, samples):
    dtype = np.float32 if name == "float32" else np.float64
    u = rng.uniform(-1, 1, (recordings, samples, 1)).astype(dtype)
    found = jb.simulate(model, u, jax.random.key(int(rng.integers(2**31))), at="uniform")
    return u, np.array(found.y, dtype)


def faults_under_corruption(name, rng, corrupted, recordings, samples):
    """Return (verdicts, FAULTs, numbers that were corrupted, whether a warning came) of healthy
    recordings.
    """
    relations = RELATIONS[name]()
    u, y = healthy(name, relations.model, rng, recordings, samples)
    liar = corrupted()
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        status = jb.detect(relations, u, y, method=METHODS.get(name, "joint")).status
    warned = any(issubclass(w.category, Doubtful) for w in said)
    return status.size, int((status == Status.FAULT).sum()), liar.changed, warned


BY_DAY = [pytest.param(name, marks=pytest.mark.long) if name == "joint" else name for name in RELATIONS]


@pytest.mark.parametrize("name", BY_DAY)
def test_no_corruption_makes_a_fault(name, rng, corrupted):
    recordings, samples = (2, 24) if name in ("observer", "joint") else (6, 40)
    count, faults, changed, warned = faults_under_corruption(name, rng, corrupted, recordings, samples)
    assert count == recordings * samples and changed > 10 and faults == 0
    assert warned == (name != "long"), "what a search claims wrongly NumPy decides: nothing is in doubt"


@pytest.mark.parametrize("part", [20, pytest.param(1, marks=pytest.mark.long)])
def test_no_corruption_makes_a_fault_of_a_million_windows(part, rng, corrupted):
    """By day a twentieth of them."""
    total = changed = 0
    for name, recordings in (("strips", 700 // part), ("bank", 300 // part), ("float32", 100 // part)):
        with pytest.MonkeyPatch.context() as patch:
            liar = Corrupted(rng, 0.05)
            relations = RELATIONS[name]()
            u, y = healthy(name, relations.model, rng, recordings, 1000)
            patch.setattr(kernel.Kernel, "__call__", liar(kernel.Kernel.__call__))
            with pytest.warns(Doubtful):
                status = jb.detect(relations, u, y, method=METHODS.get(name, "joint")).status
        assert not (status == Status.FAULT).any()
        total, changed = total + status.size, changed + liar.changed
    print(f"{total} verdicts, {changed} numbers corrupted, 0 FAULT")
    assert total >= 1_100_000 / part and changed > 10**5 / part


@pytest.mark.parametrize("name", RELATIONS)
def test_faults_of_faulty_recordings_are_confirmed(name, rng):
    """The same verdicts as from XLA alone, no warning: warnings are errors here."""
    relations, method = RELATIONS[name](), METHODS.get(name, "joint")
    u, y = healthy(name, relations.model, rng, 2, 30)
    y[:, 20:, 0] += 5
    status = jb.detect(relations, u, y, method=method).status
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(drive, "_contradicted", lambda test, u, y, starts, size: np.ones(len(starts), bool))
        patch.setattr(
            drive._Gathering,
            "_proved",
            lambda self, part, block, judged: judged[: len(self.filling.outs) + 1],
        )
        patch.setattr(
            "jaxbound.estimation.set_observer.SetObserver._doubtful",
            lambda watch, carry, samples, fault: np.zeros_like(fault),
        )
        once = jb.detect(relations, u, y, method=method).status
    assert (status == Status.FAULT).any(1).all()
    np.testing.assert_array_equal(status, once)


class Jumps(WindowTest):
    """A test of a user's own, whose compiled kernel calls the first window FAULT."""

    block, short, lags = 64, 64, 2

    def judge(self, run, blocks):
        out = []
        for _, y in blocks:
            margin = 1 - np.abs(y[1, 0] - y[0, 0])
            if not kernel.is_outside_xla():
                margin[0] = -1
            out.append((np.where(margin < 0, Status.FAULT, Status.CONSISTENT).astype(np.int8), margin))
        return out


class OfJumps(Relations):
    model, horizon, made = jb.LinearSystem([["0.5"]], None, [[1]], noise="0.1"), 1, ("jumps",)
    A = B = C = D = dt = None  # a user may keep matrices there, too: it is no plant

    def test(self, method, dtype, budget=None):
        return Jumps(self, method, dtype)


@pytest.mark.parametrize("when", ["always", "auto"])
def test_a_fault_of_a_family_of_a_users_own_is_evaluated_again_in_numpy(when, monkeypatch):
    monkeypatch.setattr(kernel, "_mode", when)
    y = np.array([[0.0], [0.1], [3.0], [3.1]])
    with pytest.warns(Doubtful, match="the first of them ends at sample 1: NumPy does not confirm it"):
        status = jb.detect(OfJumps(), None, y).status
    assert status.tolist() == [Status.MISSING, Status.UNDECIDED, Status.FAULT, Status.CONSISTENT]
