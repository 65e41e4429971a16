"""Frozen and saturated stretches: found where they are, not where chance or rounding makes a signal rest, and
the same in chunks.
"""

import numpy as np
import pandas as pd
import pytest
from systems import paper

from jaxbound.recordings.stillness import Runs, follow_runs, signal_hints, still_hints, stretches


def followed(x, cuts=()):
    runs = Runs()
    for part in np.split(x, cuts):
        runs = follow_runs(runs, part)
    return runs


def found(x, driven=False):
    return [
        (s.kind, s.longest.start, s.longest.length, s.times, s.extreme)
        for s in stretches(followed(x), driven)
    ]


def coloured(rng, count, memory):
    """Return a signal with memory and unit variance."""
    x = np.zeros(count)
    for k, e in enumerate(rng.normal(size=count) * np.sqrt(1 - memory**2)):
        x[k] = memory * x[k - 1] + e
    return x


class TestFound:
    def test_a_frozen_stretch(self, rng):
        x = rng.normal(size=5000)
        x[1200:1300] = x[1200]
        assert found(x) == [("frozen", 1200, 100, 1, "")]

    def test_a_sensor_that_dies_and_stays_so(self, rng):
        x = rng.normal(size=5000)
        x[700:] = x[700]
        assert found(x) == [("frozen", 700, 4300, 1, "")]

    def test_one_that_falls_to_zero_twice(self, rng):
        x = 5 + rng.uniform(size=5000)
        x[100:160] = x[2000:2090] = 0
        assert found(x) == [("frozen", 2000, 90, 2, "smallest")]

    def test_a_rounded_signal(self, rng):
        x = np.round(coloured(rng, 20_000, 0.9), 1)
        x[4000:6000] = x[4000]
        (kind, start, length, _, _), *_ = found(x)
        assert (
            kind == "frozen" and start <= 4000 and start + length >= 6000 and length < 2030
        )  # the neighbours may happen to be equal

    def test_a_signal_that_never_changes(self):
        assert found(np.full(50, 3.5)) == [("constant", 0, 50, 1, "")]

    def test_a_clipped_signal(self, rng):
        x = np.minimum(5 * np.sin(np.arange(4000) / 20) + rng.normal(size=4000), 4.0)
        assert [f[0] for f in found(x)] in (["saturated"], ["frozen"]) and found(x)[0][4] == "largest"

    def test_missing_samples_end_a_run(self, rng):
        x = rng.normal(size=500)
        x[100:140] = 1.0
        assert found(x) == [("frozen", 100, 40, 1, "")]
        x[110:140:10] = np.nan
        assert found(x) == []
        assert found(np.full(90, np.nan)) == [] == found(np.zeros(0))

    @pytest.mark.parametrize("seed", range(6))
    def test_chunks_find_the_same(self, seed):
        rng = np.random.default_rng(seed)
        x = np.round(rng.normal(size=600), seed % 3)
        x[200:290] = x[-40:] = 0.5
        x[rng.integers(0, 600, 20)] = np.nan
        whole = followed(x)
        for _ in range(10):
            parts = followed(x, np.sort(rng.integers(0, 601, 25)))
            np.testing.assert_array_equal(parts.counts, whole.counts)
            fields = lambda r: (r.samples, r.present, r.longest, r.low, r.high, r.last)
            assert fields(parts) == fields(whole) and stretches(parts) == stretches(whole)

    def test_runs_are_those_of_a_plain_count(self, rng):
        x = rng.integers(0, 3, 400).astype(float)
        lengths = np.diff(np.flatnonzero(np.concatenate([[True], x[1:] != x[:-1], [True]])))
        runs = followed(x)
        np.testing.assert_array_equal(runs.counts, np.bincount(lengths[:-1], minlength=1001))
        assert runs.last.length == lengths[-1] and runs.longest[0].length == lengths[:-1].max()


class TestNotFound:
    def test_chance_and_rounding_seldom_freeze_a_signal(self, rng):
        called = 0
        for _ in range(60):
            x = coloured(rng, int(10 ** rng.uniform(2, 3.5)), rng.choice([0, 0.5, 0.9, 0.99]))
            step = 10 ** rng.uniform(-2, 0)
            called += bool(found(np.round(x / step) * step))
        assert called <= 2

    def test_an_input_may_stand_still(self, rng):
        u = np.repeat(rng.uniform(size=30), rng.integers(1, 90, 30))
        assert found(u, driven=True) == [] == found(np.ones(99), driven=True)

    def test_an_input_that_is_measured_may_freeze(self, rng):
        u = rng.normal(size=900)
        u[300:400] = u[300]
        assert found(u, driven=True) == [("frozen", 300, 100, 1, "")]

    @pytest.mark.parametrize(
        "file, columns",
        [
            ("ahu/szvav_four_days.csv", "Temperature"),
            ("tclab/mimo_energy_1s.csv", "Temperature"),
            ("tclab/mimo_prbs_3s.csv", "Temperature"),
            ("tclab/mimo_hybrid_3s.csv", "Temperature"),
            ("tclab/siso_step_1s_kelvin.csv", "299"),
        ],
    )
    def test_real_temperatures_are_not_called_frozen(self, shared, file, columns):
        table = pd.read_csv(shared(f"data/{file}"))
        chosen = [c for c in table if columns in c and "Set Point" not in c]
        assert chosen and all(found(table[c].to_numpy()) == [] for c in chosen)


def test_of_two_ends_of_a_range_the_upper_one_is_said_first(rng):
    x = rng.uniform(-1, 1, 600)
    for at in (50, 150, 250):
        x[at : at + 8], x[at + 300 : at + 308] = -2.0, 2.0
    ends = [s.extreme for s in stretches(followed(x)) if s.kind == "saturated"]
    assert ends == ["largest", "smallest"]


class TestSentences:
    def test_which_when_and_how_long(self, rng):
        x = rng.normal(size=500)
        x[100:140] = 0.25
        (hint,) = signal_hints("flow", followed(x), lambda k: f"{k} s")
        assert hint.startswith(
            "flow stays at exactly 0.25 for 40 samples from 100 s to 139 s: a frozen sensor can look "
            "consistent"
        )

    def test_a_recording(self, rng):
        u, y = np.zeros((500, 1)), rng.normal(size=(500, 2))
        y[200:, 1] = 99
        (hint,) = still_hints(paper(), u, y, str)
        assert hint.startswith(
            "y2 stays at exactly 99, its largest value, for 300 samples from 200 to 499: a saturated or "
            "frozen sensor"
        )
