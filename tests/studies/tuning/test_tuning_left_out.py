"""What a recording that was left out of tuning asks for: against scales of linear programs, and against
observers built by hand.
"""

from fractions import Fraction

import numpy as np
import pytest

import jaxbound as jb
from jaxbound.studies.tuning.left_out import of_needs
from jaxbound.studies.tuning.scaling import joined_recordings
from tests import tuning_case
from tests.oracles import Plant
from tests.systems import PAPER

pytestmark = pytest.mark.compiled

NOISY = dict(A=PAPER["A"], B=PAPER["B"], C=PAPER["C"], noise=[0.1, 0.1])


def days(rng, shares=(1.0, 0.7, 1.6)):
    plant = Plant(**NOISY)
    return [tuning_case.recording(plant, 60, rng, share=share) for share in shares]


def scales(recordings, s):
    """The smallest factor on all bounds for each recording, by linear programs."""
    exact = Plant(**NOISY)
    return [
        tuning_case.smallest_scale(exact, s, *tuning_case.windows_of(s, *r), ("noise",)) for r in recordings
    ]


def test_factors_are_those_of_linear_programs(rng):
    recordings, s = days(rng), 1
    r = jb.parity_relations(jb.LinearSystem(**NOISY), s)
    found = jb.tune(r, recordings, steps=0, safety=1.2)
    expected = of_needs(scales(recordings, s))
    np.testing.assert_allclose(found.left_out, expected, rtol=1e-6)
    assert found.factor == pytest.approx(max(expected), rel=1e-6) and found.factor > 1.2
    np.testing.assert_allclose(found.bounds["noise"], 1.2 * found.factor * found.smallest["noise"], rtol=1e-3)
    assert float(found.model.left_out) == pytest.approx(found.factor, rel=1e-3)
    assert "of what was left out" in found.model.provenance["noise"]


def test_bounds_of_the_others_are_searched_again(rng):
    """With several bounds that move, their ratio is not that of all recordings."""
    loud, other = days(rng, (1.0, 1.0))
    other[1][:, 0] = other[1][:, 0] * 1.0 + 0.3 * rng.uniform(-1, 1, 60)  # this day, y1 is poor
    r = jb.parity_relations(jb.LinearSystem(**NOISY), 1)
    found = jb.tune(r, [loud, other], steps=40, calibrate=0)
    alone = jb.tune(r, loud, steps=40, calibrate=0)
    need = 1 - jb.detect(r.with_bounds(alone.smallest), *other).margin
    assert found.left_out[1] == pytest.approx(np.nanmax(need), rel=1e-6)


def test_a_factor_that_the_fit_found_stays(rng):
    recordings = days(rng)
    recording = recordings[0]
    model = jb.LinearSystem(**NOISY, horizon=1, left_out="1.5")
    kept = jb.tune(jb.parity_relations(model), recordings, steps=0)
    assert kept.factor == 1.5 and kept.left_out == () and kept.model.left_out == Fraction("1.5")
    assert any("so wide they are" in note for note in kept.notes)
    other = jb.tune(jb.parity_relations(model, 2), recording, steps=0)  # windows that it says nothing of
    assert other.factor == 1 and other.model.left_out is None
    assert any("there is one recording" in note for note in other.notes)


def test_a_recording_without_a_window_has_no_factor(rng):
    one, two, _ = days(rng)
    r = jb.parity_relations(jb.LinearSystem(**NOISY), 1)
    short = one[0][:1], one[1][:1]
    found = jb.tune(r, [one, short, two], steps=0)
    assert np.isnan(found.left_out[1]) and np.isfinite(found.left_out[0])


def test_recordings_are_split_as_they_were_given(rng):
    one, two, three = days(rng)
    model = jb.LinearSystem(**NOISY)
    whole = joined_recordings(model, 1, [one, (*two, [20]), three])
    own, others = whole.split(1)
    for got, expected in (
        (own, joined_recordings(model, 1, [(*two, [20])])),
        (others, joined_recordings(model, 1, [one, three])),
    ):
        for name in ("u", "y", "starts", "first", "entries"):
            np.testing.assert_array_equal(getattr(got, name), getattr(expected, name))


DRIFTING = dict(NOISY, disturbance=([[1], [0]], [0.02]))


@pytest.mark.parametrize("method", ["zonotope", pytest.param("joint", marks=pytest.mark.long)])
@pytest.mark.usefixtures("by_numpy")
def test_an_observer_gets_the_factor_at_which_it_follows_each_recording(method, rng):
    plant = Plant(**DRIFTING)
    recordings = [tuning_case.recording(plant, 40, rng, share=share) for share in (1.0, 1.5)]

    def follows(scale, recording):
        model = jb.LinearSystem(
            **NOISY | {"noise": [scale * 0.1] * 2}, disturbance=([[1], [0]], scale * 0.02)
        )
        watch = jb.observer(model, method=method, restart=False)
        return not jb.detect(watch, *recording).counts["FAULT"]

    watch = jb.observer(jb.LinearSystem(**DRIFTING), method=method, restart=False)
    found = jb.tune(watch, recordings, safety=1)
    assert all(follows(found.scale, r) for r in recordings)
    assert not all(follows(0.99 * found.scale, r) for r in recordings)
    worst = int(np.argmax(found.left_out))
    assert follows(found.scale / found.left_out[worst], recordings[1 - worst])
    assert not follows(0.98 * found.scale / found.left_out[worst], recordings[1 - worst])
    assert found.counts["FAULT"] == 0 and found.model.horizon is None
    final = jb.observer(found.model, method=method, restart=False)
    assert all(jb.detect(final, *r).counts["FAULT"] == 0 for r in recordings)
    scaled = found.factor * found.scale
    assert float(found.model.noise[0]) == pytest.approx(scaled * 0.1, rel=1e-3)
    assert float(found.model.disturbance[0][1]) == pytest.approx(scaled * 0.02, rel=1e-3)
    assert "for an observer" in found.model.provenance["noise"]


def test_an_observer_of_an_interval_system_is_refused():
    watch = jb.observer(jb.interval_system([[0.5]], None, [[1]], noise=0.1))
    with pytest.raises(TypeError, match="interval_system"):
        jb.tune(watch, (None, np.zeros((5, 1))))
