"""Windows outside of training have wider bounds: they are judged as by a model that states these."""

from fractions import Fraction

import numpy as np
import pytest

import jaxbound as jb
from jaxbound.certificates import verify
from jaxbound.consistency.extrapolated import extrapolated
from jaxbound.consistency.strips import StripsTest

G = Fraction(3, 2)
NOISE, ROUNDED = Fraction(1, 10), Fraction(1, 20)


def plant(factor=None, wide=1, **changes):
    """Return a heater in a range of its input. wide: factor on all its bounds, as somebody would state it."""
    noise = wide * (NOISE + ROUNDED) - ROUNDED
    given = dict(noise=noise, resolution=ROUNDED, ranges={"u1": (-1, 1)}, extrapolation=factor)
    return jb.LinearSystem([["0.8"]], [["0.5"]], [[1]], **{**given, **changes})


def recording(rng, shape=(80,)):
    """Return samples that leave training twice: the first time with errors between the bounds that are stated
    and those outside, the second time with larger ones.
    """
    u = rng.uniform(-1, 1, (*shape, 1))
    u[..., 20:36, :], u[..., 60:70, :] = 1.4, -3  # .2 and 1 widths of the range outside
    x, y = np.zeros((*shape[:-1], 1)), np.zeros((*shape, 1))
    for k in range(shape[-1]):
        y[..., k, :] = x
        x = 0.8 * x + 0.5 * u[..., k, :]
    sizes = np.ones((shape[-1], 1))
    sizes[20:40], sizes[62:68] = 1.9, 8
    y += 0.1 * sizes * rng.uniform(0.9, 1, y.shape) * rng.choice([-1, 1], y.shape)
    y[..., 41, :] = np.nan
    return u, y


def averaged(wide):
    """Return bounds on means, which hold what is rounded away beside them."""
    return {"averages": {"y1": {2: wide * (NOISE + ROUNDED) * Fraction(3, 4) - ROUNDED}}}


def disturbed(wide):
    return {
        "disturbance": (
            [[1]],
            [(Fraction(1, 10) - wide * Fraction(1, 20), Fraction(1, 10) + wide * Fraction(1, 20))],
        )
    }


def nothing(wide):
    return {}


def uncertain(wide):
    """Return an uncertain pole, whose range stays as it is outside, beside bounds that grow there."""
    return {"uncertainties": [jb.Uncertainty(name="a", A=[[0.05]], varying=False)]} | disturbed(wide)


KINDS = {
    "windows": (nothing, lambda model: jb.parity_relations(model, 3)),
    "lags": (nothing, lambda model: jb.parity_relations(model, lags=(0, 2, 5))),
    "searched": (nothing, lambda model: jb.parity_relations(model, 30)),
    "means": (averaged, lambda model: jb.parity_relations(model, 4)),
    "disturbed": (disturbed, lambda model: jb.parity_relations(model, 3)),
    "tolerance": (
        lambda wide: {"tolerance": wide * Fraction(1, 50)},
        lambda model: jb.parity_relations(model, 2),
    ),
    "bank": (nothing, jb.redundancy),
    "uncertain": (uncertain, lambda model: jb.parity_relations(model, 2)),
}


@pytest.mark.parametrize("kind", KINDS)
def test_windows_outside_are_judged_as_by_a_model_that_states_the_wider_bounds(kind, rng):
    more, made = KINDS[kind]
    u, y = recording(rng, (2, 80))
    res, stated, near, far = (
        jb.detect(made(plant(factor, by, **more(by))), u, y, starts=[45])
        for factor, by in ((G, 1), (None, 1), (None, G), (None, G**3))
    )
    out, beyond = res.outside > 0, res.outside > 0.25

    def expected(name):
        inside, first, last = (getattr(found, name) for found in (stated, near, far))
        axes = (..., *[None] * (inside.ndim - out.ndim))
        return np.where(beyond[axes], last, np.where(out[axes], first, inside))

    np.testing.assert_array_equal(res.status, expected("status"))
    np.testing.assert_allclose(res.margin, expected("margin"), rtol=0, atol=1e-12)
    assert beyond.any() and (out & ~beyond & (stated.status > near.status)).any()
    assert (near.margin[beyond] < far.margin[beyond]).any() and (res.status[out] == jb.Status.FAULT).any()
    if kind == "bank":
        np.testing.assert_array_equal(res.violated, expected("violated"))


def test_bounds_outside_are_the_smallest_floats_that_hold_the_factor():
    least, lo, hi = Fraction(10**6 + 1, 10**6), Fraction(1000), Fraction("1000.3")
    means = {"y1": {2: 0}, "w1": {2: 2000}}
    factor = least**2
    model = plant(least, noise=0, disturbance=([[1]], [(lo, hi)]), averages=means)
    relations = jb.parity_relations(model, 3)
    stated = {"noise": 0.0, "tolerance": 0.1, "disturbance": [[-1.0, 1e9]], "average": [0.3, 1e5]}
    for moved in (relations, relations.with_bounds(stated)):  # by `tune`, as a user may
        start = {name: list(map(Fraction, np.ravel(bound).tolist())) for name, bound in moved.bounds.items()}
        more = {"noise": [ROUNDED], "tolerance": [0], "average": [ROUNDED, 0]}
        exact = {name: [(factor - 1) * x for x in rounds] for name, rounds in more.items()}
        for name, added in exact.items():
            exact[name] = [factor * x + one for x, one in zip(start[name], added, strict=True)]
        lo, hi = start["disturbance"]
        beyond = (factor - 1) * (hi - lo) / 2
        exact["disturbance"] = [beyond - lo, hi + beyond]
        for name, bound in extrapolated(moved).relations(1).bounds.items():
            own = np.ravel(bound * np.array([-1, 1]) if name == "disturbance" else bound)
            for x, least in zip(own.tolist(), exact[name], strict=True):
                assert least <= Fraction(x) and Fraction(np.nextafter(x, -np.inf)) < least, name


def test_a_tolerance_stays_below_one_outside():
    relations = jb.parity_relations(plant(Fraction(20), tolerance=Fraction(1, 10)), 3)
    assert 0.999 < extrapolated(relations).relations(0).bounds["tolerance"][0] < 1


def test_bounds_that_were_tuned_are_as_wide_outside_whoever_asks(rng, tmp_path):
    u, y = recording(rng)
    tuned = jb.tune(jb.parity_relations(plant(G, noise=1), 1), (u[:50], y[:50]), steps=0)
    assert tuned.counts["FAULT"] == 0 and tuned.bounds["noise"] < 0.4
    jb.save_model(tuned.model, tmp_path / "tuned.toml")
    kept = jb.parity_relations(jb.load_model(tmp_path / "tuned.toml"))
    noise = extrapolated(tuned.relations).relations(0).bounds["noise"]
    assert noise > 1.4 * tuned.bounds["noise"]
    stated = jb.detect(jb.parity_relations(tuned.model.replace(extrapolation=None)), u, y)
    for relations in (tuned.relations, kept):
        np.testing.assert_array_equal(extrapolated(relations).relations(0).bounds["noise"], noise)
        res, live = jb.detect(relations, u, y), jb.Monitor(relations)
        np.testing.assert_array_equal(live.run(live.init(), u, y)[1].status, res.status)
        eased = np.flatnonzero((res.outside > 0) & (res.status == 1) & (stated.status == jb.Status.FAULT))
        assert len(eased) and (res.status == jb.Status.FAULT).any()
        proof = res.explain(int(eased[0]))
        assert proof.window.claim["noise"] == [Fraction(noise[0])] and proof.proves == 1


def test_numbers_beside_the_verdicts_are_those_of_the_test_that_judged(rng, monkeypatch):
    judge = StripsTest.judge

    def with_noise(self, run, blocks):
        noise = float(self.relations.bounds["noise"][0])
        return [(*out, np.full(np.shape(out[0]), noise)) for out in judge(self, run, blocks)]

    monkeypatch.setattr(StripsTest, "columns", {"noise": (np.dtype(np.float64), np.nan)})
    monkeypatch.setattr(StripsTest, "judge", with_noise)
    res = jb.detect(jb.parity_relations(plant(G), 3), *recording(rng))
    seen = res.status > 0
    np.testing.assert_array_equal(res.columns["noise"][seen] > 0.12, res.outside[seen] > 0)
    assert len(np.unique(res.columns["noise"][seen])) == 3, "inside, near and far"


def test_a_stream_says_what_detect_says(rng):
    u, y = recording(rng)
    for relations in (
        jb.parity_relations(plant(G), 3),
        jb.monitor(plant(G), [{"name": "one", "horizon": 3}]),
    ):
        res, mon = jb.detect(relations, u, y), jb.Monitor(relations)
        for cuts in (range(81), (0, 7, 22, 23, 61, 80)):
            state, found = mon.init(), []
            for first, stop in zip(cuts, cuts[1:], strict=False):
                state, said = mon.run(state, u[first:stop], y[first:stop])
                found.append(said)
            np.testing.assert_array_equal(np.concatenate([one.status for one in found]), res.status)
            np.testing.assert_array_equal(np.concatenate([one.margin for one in found]), res.margin)


def test_an_observer_keeps_the_bounds_that_are_stated(rng):
    u, y = recording(rng)
    res, stated = (jb.detect(jb.observer(plant(factor)), u, y) for factor in (G, None))
    np.testing.assert_array_equal(res.status, stated.status)
    assert (res.outside > 0).any() and extrapolated(jb.observer(plant(G))) is None
    proof = res.explain(int(np.flatnonzero((res.status == jb.Status.FAULT) & (res.outside > 0))[0]))
    assert proof.proves == jb.Status.FAULT


def test_a_certificate_outside_proves_the_verdict(rng):
    u, y = recording(rng)
    res, stated = (jb.detect(jb.parity_relations(plant(factor), 3), u, y) for factor in (G, None))
    eased = np.flatnonzero((stated.status == jb.Status.FAULT) & (res.status == jb.Status.CONSISTENT))
    assert len(eased)
    for k in eased.tolist():
        assert res.explain(k).proves == jb.Status.CONSISTENT
    for k in np.flatnonzero((res.status == jb.Status.FAULT) & (res.outside > 0)).tolist():
        proof = res.explain(k)  # of the bounds as stated, which the model file has
        assert proof.proves == jb.Status.FAULT and proof.factor > G


def test_an_alarm_says_how_wide_bounds_outside_are(rng):
    u, y = recording(rng)
    alarms = jb.detect(jb.parity_relations(plant(G), 3), u, y).alarms()
    said = {alarm.outside_by for alarm in alarms if alarm.outside}
    assert "u1 at -3, training from -1, where bounds are 3.38 times as wide" in said


@pytest.mark.parametrize("speaks", ["long", "short"])
def test_an_alarm_of_a_monitor_names_the_factor_of_the_test_that_speaks(rng, speaks):
    factors = {"long": 1.2, "short": 1.3}
    tests = []
    for name, horizon in (("long", 3), ("short", 1)):
        own = {"extrapolation": factors[name], "outputs": [{"name": "y1", "noise": "0.2"}]}
        tests.append({"name": name, "horizon": horizon, "model": own, "factor": 1 if name == speaks else 9})
    res = jb.detect(jb.monitor(plant(), tests), *recording(rng))
    (alarm,) = (alarm for alarm in res.alarms() if alarm.outside)
    said = f"u1 at -3, training from -1, where bounds are {factors[speaks] ** 3:.3g} times as wide"
    assert alarm.test == speaks and alarm.outside_by == alarm.diagnose().outside == said
    assert res.beyond.words == f"{said.partition('are')[0]}are up to 2.2 times as wide"


def test_a_window_outside_that_the_stated_bounds_explain_has_a_certificate_that_is_confirmed(rng):
    u, y = recording(rng)
    res, stated = (jb.detect(jb.parity_relations(plant(factor), 3), u, y) for factor in (G, None))
    out, consistent = res.outside > 0, res.status == jb.Status.CONSISTENT
    (k, *_), (eased, *_) = (
        np.flatnonzero(out & consistent & (stated.status == status)).tolist()
        for status in (jb.Status.CONSISTENT, jb.Status.FAULT)
    )
    verify(res.explain(k).to_dict(), plant(G), u, y)
    with pytest.raises(ValueError, match=r"only the wider bounds there explain, extrapolation 1\.5, nothing"):
        verify(res.explain(eased).to_dict(), plant(G), u, y)


@pytest.mark.parametrize("made", [lambda model: jb.parity_relations(model, 3), jb.redundancy])
def test_the_cause_of_an_alarm_outside_is_no_more_excluded_than_the_wider_bounds_allow(made):
    ends = dict(ranges={"u1": (-1, 1)}, extrapolation=G, outputs=["T1", "T2"])
    model = jb.LinearSystem([[0]], [[1]], [[1], [1]], noise=NOISE, **ends)
    u = np.full((8, 1), 3.0)
    signs = [[1, 1], [-1, 1], [1, -1], [-1, 1], [1, 1], [1, -1], [-1, -1], [1, 1]]
    y = 3 + 0.29 * np.array(signs) + [2, 0]  # errors within bounds that are 3 times as wide, and a bias
    res = jb.detect(made(model), u, y)
    for k in range(4, 8):
        assert res.status[k] == jb.Status.FAULT
        proof = res.explain(k)
        assert "T1" in proof.candidates and proof.errors["T1"] < 2.2
        verify(proof.to_dict(), model, u, y)  # by the bounds as stated
    diagnosis = res.diagnose(4, 7)
    (bias, *_) = diagnosis.explains
    assert bias.fault.name == "bias of T1" and float(bias.size) < 2 < float(bias.largest)
