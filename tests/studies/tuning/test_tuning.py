"""Tuned bounds against linear programs and exact rationals, and what must hold whatever the gradient does."""

import inspect
from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

import jaxbound as jb
from jaxbound.sets.floats.status import Status
from jaxbound.studies.tuning import descent, tuning
from jaxbound.studies.tuning.descent import Seen, gradient, log_factors, objective_of
from jaxbound.studies.tuning.parametrization import moving
from jaxbound.studies.tuning.scaling import joined_recordings, smallest_scale
from tests import tuning_case
from tests.oracles import Plant
from tests.systems import PAPER

pytestmark = pytest.mark.compiled

BASE = dict(A=PAPER["A"], B=PAPER["B"], C=PAPER["C"])
TOLERANT = dict(BASE, tolerance=[0.02, 0.1], noise=[0.1, 0.01])
BLOWN = dict(BASE, noise=[0.1, 0.01], disturbance=([[1], [0]], [[-0.02, 0.05]]))
slow = lambda *x: pytest.param(*x, marks=pytest.mark.long)
long = lambda *x: pytest.param(*x, marks=pytest.mark.long)


def relations(plant, s):
    return jb.parity_relations(jb.LinearSystem(**plant), s)


RAYS = [
    (TOLERANT, 1, ("tolerance", "noise")),
    slow(BLOWN, 2, ("noise", "disturbance")),
    slow(TOLERANT, 2, ("noise",)),
    slow(TOLERANT, 3, ("tolerance", "noise")),
    slow(TOLERANT, 4, ("tolerance", "noise")),
    slow(BLOWN, 3, ("noise", "disturbance")),
    long(TOLERANT, 20, ("tolerance", "noise")),
    long(BLOWN, 12, ("disturbance",)),
    long(dict(BLOWN, tolerance=[0.02, 0.1]), 8, None),
]


@pytest.mark.parametrize("plant, s, which", RAYS)
def test_smallest_scale_is_that_of_the_linear_programs_and_never_above(plant, s, which, rng):
    exact = Plant(**plant)
    u, y = tuning_case.recording(exact, 120 + s, rng, share=rng.uniform(0.3, 1.5))
    r = relations(plant, s)
    best = tuning_case.smallest_scale(
        exact, s, *tuning_case.windows_of(s, u, y), which or ("tolerance", "noise", "disturbance")
    )
    res = jb.tune(r, (u, y), steps=0, bounds=which)
    assert best * (1 - 1e-6) <= res.scale <= best * (1 + 1e-9)  # 1e-9: the programs' own error
    below = {name: (1 - 1e-9) * res.scale * r.bounds[name] for name in which or r.bounds}
    assert jb.detect(r.with_bounds(below), u, y).counts["FAULT"] > 0
    assert res.counts["CONSISTENT"] == 120


def test_scale_is_below_the_exact_one(rng):
    u, y = tuning_case.recording(Plant(**TOLERANT), 41, rng)
    scale = Fraction(jb.tune(relations(TOLERANT, 1), (u, y), steps=0).scale)
    scaled = {kind: [scale * Fraction(repr(x)) for x in TOLERANT[kind]] for kind in ("tolerance", "noise")}
    exact, at = Plant(**{**TOLERANT, **scaled}), tuning_case.windows_of(1, u, y)
    assert max(exact.gauge(1, *window) for window in zip(*at, strict=True)) > 1


SEVERAL = [
    (dict(BASE, noise=[0.1, 0.1]), 1, 0.0, 100),
    slow(dict(BASE, noise=[0.1, 0.1], disturbance=([[1], [0]], [0.1])), 2, 0.0, 200),
    slow(dict(BASE, noise=[0.1, 0.1], tolerance=[0.02, 0.1]), 2, 3.0, 300),
    long(dict(BASE, noise=[0.3, 0.02], disturbance=([[1], [0]], [[-0.1, 0.3]])), 3, 0.0, 300),
    long(dict(BASE, noise=[0.1, 0.1]), 12, 0.0, 300),
    long(dict(BASE, noise=[0.05, 0.05], tolerance=[0.05, 0.05]), 1, 3.0, 1000),
]


@pytest.mark.parametrize("guess, s, mean, steps", SEVERAL)
def test_several_bounds_come_within_2_percent_of_the_program_over_all_of_them(guess, s, mean, steps, rng):
    true = Plant(**{**guess, "noise": [0.1, 0.05]})
    u, y = tuning_case.recording(true, 150 + s, rng, share=0.7, level=5, mean=mean)
    g, tolerant = true.g, "tolerance" in guess
    weights = {"noise": 1 / np.array(guess["noise"])}
    if tolerant:
        weights["tolerance"] = 1 / np.array(guess["tolerance"])
    if g:
        ((lo, hi),) = true.disturbance
        weights["disturbance"] = np.array(
            [1 / float(hi)] if lo == -hi else [[-0.5 / float(lo), 0.5 / float(hi)]]
        )
    best, _ = tuning_case.smallest_width(true, s, *tuning_case.windows_of(s, u, y), weights, tolerant)
    res = jb.tune(relations(guess, s), (u, y), steps=steps, calibrate=0)
    found = {
        **res.smallest,
        **({"disturbance": res.smallest["disturbance"][..., -weights["disturbance"].ndim :]} if g else {}),
    }
    width = sum(
        float(np.sum(weights[name] * abs(np.reshape(found[name], np.shape(weights[name])))))
        for name in weights
    )
    assert (
        best * (1 - (1e-3 if tolerant else 1e-7)) <= width <= 1.02 * best
    )  # with tolerance the reference is a local optimum
    assert res.counts["FAULT"] == res.counts["UNDECIDED"] == 0
    assert jb.detect(res.relations, u, y).counts["CONSISTENT"] == 150


@pytest.mark.parametrize("plant, s", [(TOLERANT, 1), long(dict(BLOWN, tolerance=[0.02, 0.1]), 2)])
def test_gradient_is_that_of_the_proved_scale(plant, s, rng):
    u, y = tuning_case.recording(Plant(**plant), 30, rng)
    r = relations(plant, s)
    moved, good = moving(r), joined_recordings(r.model, s, (u, y))
    value = lambda z: np.log(moved.total(np.exp(z))) + np.log(smallest_scale(r, moved, np.exp(z), good)[1])
    z = np.log(moved.start * np.exp(rng.uniform(-0.3, 0.3, len(moved.start))))
    z += np.log(smallest_scale(r, moved, np.exp(z), good)[1])
    problem = objective_of(r, moved, 1.0, y.dtype)
    ends = np.flatnonzero(~good.without(s))
    healthy = tuple(jnp.asarray(np.moveaxis(x, 0, 2)) for x in good.gather(ends, s))
    z = jnp.asarray(z)
    inside = Seen(log_factors(z, problem, *healthy), np.ones(len(ends), bool))
    found, hard, _ = gradient(z, problem, (0, 1.0), inside, None)
    h = 1e-6
    for e in np.eye(len(z))[[0, -1]]:  # a tolerance and a noise
        np.testing.assert_allclose(found @ e, (value(z + h * e) - value(z - h * e)) / (2 * h), atol=2e-4)
    assert abs(float(hard)) < 1e-9


def healthy_and_faulty(rng, T=200):
    plant = Plant(**TOLERANT)
    recordings = [tuning_case.recording(plant, T, rng) for _ in range(3)]
    recordings[2][1][:, 1] += 0.2
    return recordings[:2], recordings[2:]


def test_faulty_windows_are_left_outside_and_no_healthy_one(rng):
    good, bad = healthy_and_faulty(rng)
    r = relations(dict(BASE, tolerance=[0.05, 0.05], noise=[0.05, 0.5]), 1)  # noise of y2 far too large
    before = jb.tune(r, good, bad, steps=0, safety=1.1)
    res = jb.tune(r, good, bad, steps=30, calibrate=0, safety=1.1)
    assert res.counts["FAULT"] == res.counts["UNDECIDED"] == 0 and res.counts["CONSISTENT"] == 2 * 199
    assert res.caught > before.caught + 0.1
    assert sum(jb.detect(res.relations, *x).counts["FAULT"] for x in bad) == res.faulty_counts["FAULT"]
    assert res.history["outside"][-1] > before.caught


def test_windows_across_seams_and_missing_samples_do_not_count(rng):
    plant = Plant(**SEVERAL[0][0])
    parts = [tuning_case.recording(plant, T, rng, level=3) for T in (60, 40)]
    r = relations(SEVERAL[0][0], 1)
    apart = [jb.tune(r, part, steps=0).scale for part in parts]
    whole = tuple(np.concatenate(x) for x in zip(*parts, strict=True))
    for given in (parts, (*whole, [60])):
        assert jb.tune(r, given, steps=0).scale == pytest.approx(max(apart), rel=1e-12)
    u, y = whole
    lost = np.where(rng.random(y.shape) < 0.1, np.nan, y)
    res = jb.tune(r, (u, lost, [60]), steps=10, safety=1.2)
    assert res.counts["FAULT"] == res.counts["UNDECIDED"] == 0 < res.counts["CONSISTENT"]
    assert (jb.detect(res.relations, u, lost, starts=[60]).status != Status.FAULT).all()


def test_interrupted_and_called_again_gives_the_same(rng, tmp_path):
    good, _ = healthy_and_faulty(rng, 50)
    r, state = relations(TOLERANT, 1), tmp_path / "state.npz"

    def stop(share):
        if share >= 0.3:
            raise KeyboardInterrupt

    whole = jb.tune(r, good, steps=20)
    part = jb.tune(
        r, good, steps=20, state=state, progress=lambda share: stop(share) if share < 0.9 else None
    )
    again = jb.tune(r, good, steps=20, state=state)
    assert part.stopped and 0 < part.steps < 20 and part.counts["FAULT"] == 0
    assert not again.stopped and again.steps == 20 and len(jb.plot(again).axes) == 3
    for name, bound in whole.smallest.items():
        np.testing.assert_array_equal(bound, again.smallest[name])
    np.testing.assert_array_equal(whole.history["width"], again.history["width"])
    with pytest.raises(
        ValueError,
        match="state.npz is of another healthy recordings and share held out: choose another place",
    ):
        jb.tune(r, good[:1], steps=20, state=state)
    with pytest.raises(ValueError, match="state.npz is of another optimizer: choose another place"):
        jb.tune(r, good, optimizer=optax.sgd(0.1, momentum=0.9), steps=20, state=state)


@pytest.mark.parametrize(
    "change, what",
    [
        ("F", "model"),
        ("D_v", "model"),
        ("version", "version of jaxbound"),
        ("dtype", "healthy recordings"),
        ("calibrate", "share held out"),
    ],
)
def test_the_state_of_another_tuning_is_not_taken_up(change, what, tmp_path, rng, monkeypatch):
    plant = lambda F, D_v: dict(BASE, noise=[0.1, 0.01], tolerance=0.02, unknown_inputs=(F, D_v))
    r, state = relations(plant([[1], [0]], [[0], [0]]), 3), tmp_path / "state.npz"
    good, more, given = (
        (np.zeros((60, 1)), rng.uniform(-0.01, 0.01, (60, 2))),
        {},
        dict(steps=1, every=1, state=state),
    )
    monkeypatch.setattr(
        tuning, "descend", lambda problem, optimizer, every, carry, *rest: (carry, carry[0])
    )  # only the file matters
    jb.tune(r, good, **given)
    jb.tune(r, good, **given)
    if change == "F":
        r = relations(plant([[0], [1]], [[0], [0]]), 3)
    elif change == "D_v":
        r = relations(plant([[1], [0]], [[0], [1]]), 3)
    elif change == "version":
        monkeypatch.setattr(jb, "__version__", "0.0.1")
    elif change == "dtype":
        good = tuple(x.astype(np.float32) for x in good)
    else:
        more = {"calibrate": 0.5}
    with pytest.raises(ValueError, match=f"state.npz is of another {what}"):
        jb.tune(r, good, **given, **more)


def test_any_optimiser_and_no_second_compilation(rng):
    good, _ = healthy_and_faulty(rng, 50)
    r = relations(dict(BASE, noise=[0.3, 0.02]), 1)
    start = jb.tune(r, good, steps=0, calibrate=0).scale
    own = optax.chain(optax.clip_by_global_norm(1.0), optax.sgd(0.3))
    res = jb.tune(r, good, optimizer=own, steps=30, calibrate=0)
    assert res.scale < 0.95 * start
    traced = sum(f._cache_size() for f in (descent._slopes_along, descent._advance))
    jb.tune(r, [good[0]], optimizer=own, steps=20, calibrate=0)
    assert sum(f._cache_size() for f in (descent._slopes_along, descent._advance)) == traced


def test_model_file_holds_the_bounds_rounded_up_and_says_where_they_come_from(rng, tmp_path):
    good, _ = healthy_and_faulty(rng, 150)
    r = relations(dict(TOLERANT, provenance={"tolerance": "datasheet"}), 1)
    res = jb.tune(r, good, steps=0, bounds="noise", safety=1.25)
    jb.save_model(res.model, tmp_path / "tuned.toml")
    model = jb.load_model(tmp_path / "tuned.toml")
    assert (
        model.tolerance == r.model.tolerance
        and model.provenance["tolerance"] == "datasheet"
        and model.horizon == 1
    )
    assert model.provenance["noise"] == (
        f"fitted to 298 healthy windows, factor {res.factor:.3g} of what was left out, safety factor 1.25"
    )
    for exact, smallest, bound in zip(model.noise, res.smallest["noise"], res.bounds["noise"], strict=True):
        assert (
            Fraction(smallest) * Fraction(res.factor) * Fraction(5, 4)
            <= exact
            <= Fraction(smallest) * Fraction(res.factor) * Fraction(5, 4) * Fraction(1002, 1000)
        )
        assert float(exact) == pytest.approx(bound, rel=1e-15)
    again = jb.parity_relations(model)
    assert all(jb.detect(again, *x).counts["CONSISTENT"] == 149 for x in good)


def test_float32_recordings(rng):
    u, y = (x.astype(np.float32) for x in tuning_case.recording(Plant(**TOLERANT), 60, rng))
    res = jb.tune(relations(TOLERANT, 1), (u, y), steps=10)
    assert res.counts["FAULT"] == res.counts["UNDECIDED"] == 0
    wide = jb.tune(relations(TOLERANT, 1), (u.astype(float), y.astype(float)), steps=0)
    narrow = jb.tune(relations(TOLERANT, 1), (u, y), steps=0)
    assert narrow.scale == pytest.approx(wide.scale, rel=1e-3)


@pytest.mark.long(by_day="test_smallest_scale_is_that_of_the_linear_programs_and_never_above")
def test_parameters_move_and_detect_has_the_last_word(rng):
    gain = jb.Uncertainty("gain", C=[[1]], between=(0.9, 1.1))
    m = jb.LinearSystem([[0.9]], [[1]], [[0]], noise=0.02, uncertainties=[gain])
    u = rng.uniform(0.5, 1.5, (200, 1))
    y = np.asarray(jb.simulate(m, u, jax.random.key(int(rng.integers(2**31)))).y)
    res = jb.tune(jb.parity_relations(m, 2), (u, y), steps=30, every=10)
    assert res.counts["FAULT"] == 0
    model = res.model
    assert float(model.uncertainties[0].radius) == pytest.approx(0.1 * res.bounds["parameters"][0], rel=1e-9)
    assert jb.detect(jb.parity_relations(model, 2), u, y).counts["FAULT"] == 0


SMALL = dict(
    A=[[0.5]], B=[[0]], C=[[1]], noise=[0.1], tolerance=[0.02]
)  # of the sizes that the families of studies compile


@pytest.mark.parametrize("plant, s", [(SMALL, 1), (TOLERANT, 1), long(TOLERANT, 2)])
def test_constant_tolerance_is_scaled(rng, plant, s):
    free = {**plant, "B": None} if plant is SMALL else plant
    r = relations(dict(free, constant_tolerance=True), s)
    u, y = tuning_case.recording(Plant(**plant), 30, rng, level=0.3 if s > 1 else 3)
    good = (None if plant is SMALL else u, y)
    with pytest.raises(NotImplementedError, match="steps=0"):
        jb.tune(r, good)
    res = jb.tune(r, good, steps=0)
    assert res.counts["FAULT"] == 0 and res.scale >= jb.tune(relations(free, s), good, steps=0).scale


GOOD = np.zeros((5, 1)), np.ones((5, 2))
WRONG = [
    (dict(healthy=GOOD[1]), "needs a tuple"),
    (dict(healthy=[]), "needs a tuple"),
    (dict(healthy=(GOOD[0][:1], GOOD[1][:1])), "no window of 2 samples"),
    (dict(healthy=(*GOOD, [1, 2, 3, 4])), "no window of 2 samples"),
    (dict(healthy=(GOOD[0], np.full((5, 2), np.nan))), "no window of 2 samples"),
    (dict(healthy=(GOOD[0], GOOD[1] + np.inf)), "must be finite"),
    (dict(bounds="noises"), "no bound 'noises' to move"),
    (dict(bounds=()), "no bound can move"),
    (dict(bounds="disturbance"), "no bound 'disturbance'"),
    (dict(weights={"noise": -1}), "weights must be > 0"),
    (dict(weights={"noise": [1, 2, 3]}), "the weights of noise"),
    (dict(safety=0.9), "factor >= 1"),
    (dict(calibrate=1), "0 <= calibrate < 1"),
    (dict(confidence=1), "between 0 and 1"),
    (dict(steps=-1), "steps must be a whole number"),
    (dict(every=0), "every must be"),
    (dict(block=0.5), "block must be"),
    (dict(faulty=[GOOD]), "faulty recording 1 is the same as healthy recording 1"),
]


@pytest.mark.parametrize("given, sentence", WRONG)
def test_bad_input_gets_a_sentence(given, sentence):
    with pytest.raises(ValueError, match=sentence):
        jb.tune(relations(TOLERANT, 1), **{"healthy": GOOD, **given})


def test_bounds_that_cannot_explain_are_refused(rng):
    good = tuning_case.recording(Plant(**TOLERANT), 50, rng)
    with pytest.raises(ValueError, match="every entry of tolerance and noise is 0"):
        jb.tune(relations(BASE, 1), good)
    u, y = good
    with pytest.raises(
        ValueError,
        match=r"tolerance of y\d would reach 1 before the healthy window that ends at sample \d+ "
        r"is explained",
    ):
        jb.tune(
            relations(TOLERANT, 1),
            (u, y + 3 * (np.arange(50) % 2)[:, None] * [1, 0]),
            steps=0,
            bounds="tolerance",
        )
    blown = relations(dict(BASE, disturbance=([[1], [0]], [0.1])), 1)
    with pytest.raises(ValueError, match="no size of disturbance of w1 explains the healthy window"):
        jb.tune(blown, (u, y + rng.normal(size=y.shape)), steps=0)
    with pytest.raises(ValueError, match="there is nothing to tune"):
        jb.tune(relations(dict(TOLERANT, noise=[9, 9]), 1), good, steps=0, bounds="tolerance")
    with pytest.raises(ValueError, match="away from 0"):
        jb.tune(relations(dict(BLOWN, disturbance=([[1], [0]], [[0.1, 0.2]])), 1), good)
    with pytest.raises(
        TypeError, match="tune takes no argument 'stepz'; the rare ones are 'bounds', 'weights'"
    ):
        jb.tune(relations(TOLERANT, 1), good, stepz=3)
    assert inspect.signature(jb.tune).parameters["safety"].default == 1.25
    with pytest.raises(TypeError, match="from parity_relations"):
        jb.tune(jb.redundancy(jb.LinearSystem(**TOLERANT)), good)
