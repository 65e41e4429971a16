"""Set observers: enclosures hold, against linear programs over everything since the start; FAULT is a proof,
and is for good.
"""

import json

import jax
import numpy as np
import pytest
from observer_case import PLANT, first_decided_in_numpy, inside, program, published, recorded, systems

import jaxbound as jb
from jaxbound.consistency.twice import Doubtful
from jaxbound.estimation import set_observer, zonotope_steps
from jaxbound.estimation.methods import OBSERVERS
from jaxbound.estimation.set_observer import SetObserver
from jaxbound.recordings.recording import Recording
from jaxbound.sets.floats.kernel import is_outside_xla, outside_xla

METHODS = tuple(OBSERVERS)
"""How an observer may carry its set."""


def test_an_enclosure_holds_what_linear_programs_over_all_samples_allow(rng):
    u, _, y = recorded(PLANT, 16, 1, at="uniform")
    y[6] = np.nan
    found, first = jb.observe(PLANT, u, y), ([-20.0, -20.0], [20.0, 20.0])
    known = jb.observe(PLANT, u, y, x0=jb.interval(*first))
    assert found.status[:2].tolist() == [jb.Status.MISSING] * 2 and known.status[0] == jb.Status.UNDECIDED
    assert found.since[:3].tolist() == [-1, 0, 0] and known.since[0] == 0
    assert found.status[6] == jb.Status.MISSING and found.since[7] == 0, "a missing sample is no end"
    for k in (3, 9, 15):
        for got, x0 in ((found, None), (known, first)):
            lo, hi = program(PLANT, u[: k + 1], y[: k + 1], x0)
            assert (got.state.lo[k] <= lo + 1e-9).all() and (hi - 1e-9 <= got.state.hi[k]).all()
            assert ((got.state.hi[k] - got.state.lo[k]) < 2.5 * (hi - lo)).all(), "and is not much wider"


@pytest.mark.compiled
def test_verdicts_and_enclosures_are_one_program():
    """It takes seconds to compile, and a report shows enclosures behind the verdicts."""
    u, _, y = recorded(PLANT, 16, 1, at="uniform")
    found = jb.observe(PLANT, u, y)
    programs = zonotope_steps.follow_lanes._cache_size()
    res = jb.detect(jb.observer(PLANT), u, y)
    assert zonotope_steps.follow_lanes._cache_size() == programs
    np.testing.assert_array_equal(res.margin, found.margin)


def test_every_proof_of_a_fault_is_one_of_a_linear_program(rng):
    """Near the boundary: jumps of a sensor from far below to far above what can be proved."""
    proved = possible = 0
    u, _, y = recorded(PLANT, 14, 3, N=48, at="uniform")
    y[:, 8:, 0] += np.linspace(0, 0.8, 48)[:, None]
    found = jb.observe(PLANT, u, y, restart=False)
    for j in range(48):
        wrong = found.status[j] == jb.Status.FAULT
        possible += program(PLANT, u[j], y[j]) is None
        if wrong.any():
            k = int(wrong.argmax())
            assert wrong[k:].all(), "what contradicts once contradicts for good"
            assert program(PLANT, u[j, : k + 1], y[j, : k + 1]) is None
            proved += 1
            assert found.margin[j, k] < 0 and (found.since[j, k:] == 0).all()
    print(f"{proved} of {possible} contradictions proved")
    assert possible >= 20 and proved >= 0.8 * possible


@pytest.mark.parametrize("order", [1, pytest.param(20, marks=pytest.mark.long)])
def test_published_intervals_of_a_zonotopic_kalman_filter(shared, order):
    """CORA's linearSysDT example: without a reduction to 1e-9; at order 20 rounding takes two of the 40
    generators, and ours holds it.
    """
    case = json.loads(shared("external/observer_2dim.json").read_text())[0]
    model, u, y, x0 = published(case)
    want, weight = (
        np.array(case["cora_interval_of_last_set"]["FRad-A"]),
        (1, 1, 1),
    )  # as many sets side by side as other tests have
    wide = jb.observe(model, u, y, order=40 if order > 1 else 1, weight=weight, x0=x0).state
    lo, hi = np.asarray(wide.lo)[-1], np.asarray(wide.hi)[-1]
    if order > 1:
        np.testing.assert_allclose([lo, hi], want, atol=1e-9)
        some = jb.observe(model, u, y, order=20, weight=weight, x0=x0).state
        assert (np.asarray(some.lo)[-1] <= want[0]).all() and (want[1] <= np.asarray(some.hi)[-1]).all()
        np.testing.assert_allclose([some.lo[-1], some.hi[-1]], want, atol=1e-6)
    exact = np.array(case["exact_hull_lp_here"]["x_19"]).T
    assert (lo <= exact[0] + 1e-9).all() and (exact[1] - 1e-9 <= hi).all()


SETS = ((6, None), (6, jb.interval([-50] * 3, [50] * 3)))
"""(order, x0): sizes that the tests of joint observers compile too."""


def fault_free(rng, seeds, N, T, method, dtype=np.float64, sets=SETS):
    """Return how many fault-free samples were observed: the state inside all, no FAULT; half of them with
    unknowns at vertices.
    """
    samples, bounded = 0, []
    for seed in seeds:
        kind = ("stable", "integrating", "unstable")[seed % 3]
        recorded_as = (dtype, np.float32)[seed % 2]
        model = systems(rng, kind)
        u, x, y = recorded(model, T, seed, N, ("vertices", "uniform")[seed // 2 % 2], recorded_as)
        y[rng.random(y.shape) < 0.03] = np.nan
        for order, x0 in sets:
            try:
                found = jb.observe(
                    model, u, y, order=order, weight=(0.1, 1, 10), x0=x0, starts=[T // 2], method=method
                )
            except ValueError as e:
                assert x0 is None and "uncertain" in str(e)
                continue
            assert inside(found, x, recorded_as).all() and not (found.status == jb.Status.FAULT).any()
            bounded.append((kind, x0 is None, np.isfinite(found.state.lo).all(-1)[:, : T // 2].mean()))
            samples += y[..., 0].size
    assert all(share == 1 for kind, free, share in bounded if kind != "unstable" and not free)
    assert np.mean([share > 0.5 for *_, share in bounded]) > 0.8, "what encloses nothing proves nothing"
    print(f"{method}, {np.dtype(dtype).name}: {samples} fault-free samples, the state inside all, 0 FAULT")
    return samples


@pytest.mark.parametrize(
    "method", [METHODS[0], *(pytest.param(one, marks=pytest.mark.long) for one in METHODS[1:])]
)
def test_the_state_of_fault_free_recordings_is_inside_and_nothing_is_a_fault(rng, method):
    assert fault_free(rng, range(6), 24, 20, method) > 5_000


@pytest.mark.long(by_day="test_the_state_of_fault_free_recordings_is_inside_and_nothing_is_a_fault")
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("method", METHODS)
def test_two_million_fault_free_samples(rng, method, dtype):
    """Of a method that takes milliseconds a sample, a tenth."""
    seeds, least = (60, 2_000_000) if method in ("zonotope", "strips") else (6, 200_000)
    with jax.enable_x64(dtype == np.float64):
        assert fault_free(rng, range(seeds), 144, 144, method, dtype, ((2, None), (8, SETS[1][1]))) > least


def test_in_pieces_sample_by_sample_and_in_a_batch_it_says_the_same(rng):
    u, _, y = recorded(PLANT, 20, 5, N=2, at="uniform")
    y[1, 10:] += 3
    watch = jb.observer(PLANT, order=20, weight=(1, 30, 1000))
    whole = jb.observe(PLANT, u, y)
    for j in range(2):
        alone = jb.observe(PLANT, u[j], y[j])
        for a, b in zip(jax.tree.leaves(whole), jax.tree.leaves(alone), strict=True):
            np.testing.assert_allclose(
                a[j], b, rtol=1e-12, atol=1e-12
            )  # one recording is scalar code: other last digits
        found = jb.detect(jb.observer(PLANT), u[j], y[j])
        np.testing.assert_array_equal(found.status, alone.status)
        np.testing.assert_allclose(found.margin, alone.margin, rtol=1e-12)
        for cuts in ([7, 13], range(1, 20)):
            pieces, watching = [], watch.telling(enclosures=True)
            carry = watching.init()
            for a, b in zip([0, *cuts], [*cuts, 20], strict=True):
                carry, told = watching.fold(carry, Recording.of(PLANT, u[j, a:b], y[j, a:b]))
                pieces.append(told)
            for a, b in zip(
                jax.tree.leaves(jax.tree.map(lambda *x: np.concatenate(x), *pieces)),
                jax.tree.leaves(alone),
                strict=True,
            ):
                np.testing.assert_array_equal(a, b)
    monitor = jb.Monitor(jb.observer(PLANT))
    state, said = monitor.init(), []
    for k in range(20):
        state, verdict = monitor.step(state, u[1, k], y[1, k])
        said.append(int(verdict.status))
    assert said == np.asarray(whole.status[1]).tolist() and said[10] == jb.Status.FAULT


@pytest.mark.compiled
def test_a_second_recording_compiles_nothing(rng):
    from jaxbound.estimation.zonotope_steps import follow_lanes

    u, _, y = recorded(PLANT, 40, 5)
    jb.observe(PLANT, u, y)
    known = follow_lanes._cache_size()
    jb.observe(PLANT.replace(noise=0.2), u[:33], y[:33])
    assert follow_lanes._cache_size() == known


def test_gaps_missing_inputs_and_contradictions_begin_anew(rng):
    u, _, y = recorded(PLANT, 30, 7, at="uniform")
    y[12] += 5
    u[20] = np.nan
    found = jb.observe(PLANT, u, y, starts=[26])
    named = [jb.Status(s).name[0] for s in np.asarray(found.status)]
    assert "".join(named) == "MM" + "U" * 10 + "F" + "MM" + "U" * 6 + "MM" + "U" * 3 + "MM" + "UU"
    assert found.since[[11, 12, 14, 20, 22, 27, 29]].tolist() == [0, 0, 13, 13, 21, 26, 26]
    latched = jb.detect(jb.observer(PLANT, restart=False), u, y, starts=[26])
    assert (latched.status[12:26] == jb.Status.FAULT).all() and (
        latched.status[26:28] == jb.Status.MISSING
    ).all()
    assert np.isinf(found.state.hi[13]).all() and np.isfinite(found.state.hi[14]).all()


@pytest.mark.parametrize("more", [{}, {"method": "joint", "window": 8}])
def test_nothing_is_enclosed_behind_a_contradiction_that_stays(more):
    u, _, y = recorded(PLANT, 60, 5)
    y[20:, 0] += 0.05 * np.arange(40)
    watch = jb.observer(PLANT, restart=False, **more).telling(enclosures=True)
    carry, first = watch.fold(watch.init(), Recording(u[:40], y[:40]))
    _, second = watch.fold(carry, Recording(u[40:], y[40:], np.array([15])))
    status = np.concatenate([first.status, second.status])
    proved = int((status == jb.Status.FAULT).argmax())
    assert 20 < proved < 40 and (status[proved:55] == jb.Status.FAULT).all()
    for name in ("state", "predicted", "output"):
        lo, hi = (
            np.concatenate([getattr(getattr(x, name), end) for x in (first, second)]) for end in ("lo", "hi")
        )
        assert np.isnan(lo[proved + 1 : 55]).all() and np.isnan(hi[proved + 1 : 55]).all()
        assert (lo[: proved + 1] <= hi[: proved + 1]).all() and (lo[55:] <= hi[55:]).all(), (
            "no sooner, and not behind a gap"
        )


def test_what_a_window_of_sixteen_never_sees_an_observer_does():
    """A slow plant and a drifting sensor: a window with a free first state takes the drift for the
    plant's.
    """
    slow = jb.LinearSystem(
        [["0.999", 0], [0, "0.999"]],
        [["0.001"], ["0.001"]],
        [[1, 0], [0, 1]],
        noise="0.5",
        disturbance=([[1, 0], [0, 1]], "0.0005"),
    )  # of sizes that other tests compile
    u, noise = np.ones((400, 1)), np.random.default_rng(0).uniform(-0.4, 0.4, (400, 2))
    y = 1 + noise + 0.005 * np.maximum(np.arange(400) - 100, 0)[:, None] * [1, 0]
    assert not (jb.detect(jb.parity_relations(slow, 15), u, y).status == jb.Status.FAULT).any()
    found = jb.detect(jb.observer(slow), u, y)
    assert (found.status == jb.Status.FAULT).any() and found.alarms()[0].start > 100


def test_what_an_observer_cannot_take_is_said():
    hidden = jb.LinearSystem([[0.5, 0], [0, 0.5]], None, [[1, 0]], noise=0.1)
    for match, args, more in (
        ("do not show all states", (hidden,), {}),
        ("at least 1", (PLANT,), {"order": 0.5}),
        ("positive number", (PLANT,), {"weight": (1, 0)}),
        ("one interval for each of 2 states", (PLANT,), {"x0": jb.interval([0.0], [1.0])}),
        ("must be bounded", (PLANT,), {"x0": jb.interval([0.0, -np.inf], [1.0, 1.0])}),
        ("1 samples do not show all states", (PLANT,), {"horizon": 0}),
        ("whole number", (PLANT,), {"horizon": -1}),
        ("unknown input 1 alone explains", (PLANT.replace(unknown_inputs=[[1], [0]]),), {}),
    ):
        with pytest.raises(ValueError, match=match):
            jb.observer(*args, **more)
    assert jb.observer(hidden, x0=jb.interval([-1.0, -1.0], [1.0, 1.0])).horizon == 0
    with pytest.raises(ValueError, match="belong to windows"):
        jb.detect(jb.observer(PLANT), np.ones((3, 1)), np.ones((3, 1)), method="box")
    with pytest.raises(TypeError, match="LinearSystem"):
        jb.observer(3)


def test_a_fault_is_explained_by_the_shortest_window_that_proves_it():
    u, _, y = recorded(PLANT, 30, 9, at="uniform")
    y[20] += 3
    found = jb.detect(jb.observer(PLANT), u, y)
    why = found.explain(20)
    assert (
        why.proves == jb.Status.FAULT
        and why.at == (20,)
        and len(json.loads(why.to_json())["numbers"]["y"]) == 3
    )
    assert "observer" in repr(found)
    with pytest.raises(NotImplementedError, match="exhibits no behaviour"):
        found.explain(19)
    with pytest.raises(NotImplementedError, match="are those of windows"):
        jb.margins(jb.observer(PLANT), u, y)


def test_a_long_beginning_holds_the_state_where_large_inputs_cancel(rng):
    """The centre is off by 1e5 times the noise then, by rounding alone."""
    model = jb.LinearSystem([[0, 1], [-1, 0]], [[1, -1], [1, -1]], [[1, 0]], noise="1e-12")
    A, C = (np.array(M, float) for M in (model.A, model.C))
    x = (np.stack([np.linalg.matrix_power(A, k) for k in range(40)]) @ rng.uniform(-1, 1, (32, 1, 2, 1)))[
        ..., 0
    ]
    u = np.repeat(rng.uniform(-1e9, 1e9, (32, 40, 1)), 2, -1)
    found = jb.observe(model, u, x @ C.T, horizon=31, order=4, weight=1)
    assert inside(found, x).all() and not (found.status == jb.Status.FAULT).any()
    assert np.isfinite(found.state.hi[:, 31:]).all()


def test_a_gap_ends_the_proof_of_a_fault_that_stays(monkeypatch):
    """What XLA alone says behind the gap is UNDECIDED, however well the FAULT before it is proved."""
    m = jb.LinearSystem([[0.5]], None, [[1], [1]], dt=1, noise=[0.1, 0.1])
    first_decided_in_numpy(monkeypatch, SetObserver, slice(6, None))
    y = np.zeros((12, 2))
    y[5] = [5, -5]
    with outside_xla(False), pytest.warns(Doubtful):
        status = jb.detect(jb.observer(m, restart=False), None, y, starts=[6]).status
    assert status[5] == jb.Status.FAULT and (status[6:] == jb.Status.UNDECIDED).all()


def test_no_sample_of_a_proof_is_followed_by_xla(monkeypatch):
    """However far back a FAULT reaches: a set that XLA carried wrongly proves nothing."""
    real = SetObserver.found

    def found(self, carry, samples):
        if is_outside_xla():
            return real(self, carry, samples)
        with outside_xla():  # nothing compiles
            state, verdicts = real(self, carry, samples)
        status = np.array(verdicts.status)
        status[10:] = jb.Status.FAULT
        wrong = state.carry._replace(c=state.carry.c + 100)
        return state._replace(carry=wrong), verdicts._replace(status=status)

    monkeypatch.setattr(SetObserver, "found", found)
    monkeypatch.setattr(set_observer, "LENGTHS", (2,))
    m = jb.LinearSystem([[0.5]], None, [[1]], dt=1, noise=0.1)
    with outside_xla(False), pytest.warns(Doubtful):
        status = jb.detect(jb.observer(m), None, np.zeros((11, 1))).status
    assert status[10] == jb.Status.UNDECIDED
