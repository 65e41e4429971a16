"""Statements about data not seen: formulas against other ones, and against what happens in simulations."""

import numpy as np
import pytest
from scipy.stats import binom

import jaxbound as jb
from jaxbound.studies.tuning.confidence import (
    Blocks,
    Search,
    blocks_of,
    distribution_band,
    held_out,
    rank_risk,
    rate_bound,
    risk_of,
    scenario_bound,
    touched,
)
from tests import tuning_case
from tests.oracles import Plant
from tests.systems import PAPER

TOLERANT = dict(A=PAPER["A"], B=PAPER["B"], C=PAPER["C"], tolerance=[0.02, 0.1], noise=[0.1, 0.01])


@pytest.mark.parametrize(
    "n, bounds, confidence", [(20, 1, 0.9), (100, 4, 0.95), (57, 6, 0.99), (1000, 3, 0.999)]
)
def test_scenario_bound_solves_the_binomial_equation(n, bounds, confidence):
    eps = scenario_bound(n, bounds, confidence)
    assert binom.cdf(bounds - 1, n, eps) == pytest.approx(1 - confidence, rel=1e-9)
    assert scenario_bound(n, 1, confidence) == pytest.approx(rate_bound(n, confidence), rel=1e-9)


def test_rank_and_rate_hold_and_are_sharp(rng):
    n, trials = 12, 40_000
    seen, new = rng.exponential(size=(trials, n)), rng.exponential(size=trials)
    alarms = np.mean(new > seen.max(1))
    assert abs(alarms - rank_risk(n)) < 4 * np.sqrt(rank_risk(n) / trials)
    rates = np.exp(-seen.max(1))  # of all blocks: the distribution is known here
    exceeded = np.mean(rates > rate_bound(n, 0.9))
    assert abs(exceeded - 0.1) < 4 * np.sqrt(0.09 / trials)
    above, at = np.sort(np.exp(-seen), 1), np.arange(n) / n
    far = np.maximum(abs(above - at), abs(above - at - 1 / n)).max(1) > distribution_band(n, 0.9)
    assert np.mean(far) < 0.1 + 4 * np.sqrt(0.09 / trials)


def test_blocks_share_no_sample_and_lie_within_runs(rng):
    s, across = 3, np.ones(200, bool)
    across[3:60], across[63:64], across[70:200] = False, False, False
    label, length, _ = blocks_of(across, s, 7)
    assert length == 7 and not across[label >= 0].any()
    samples = [
        set(np.concatenate([np.arange(e - s, e + 1) for e in np.flatnonzero(label == b)]))
        for b in range(label.max() + 1)
    ]
    assert all(len(x) == 7 + s for x in samples) and sum(map(len, samples)) == len(set().union(*samples))
    chosen = np.isin(label, [2, 9])
    near = {e for e in range(s, 200) if set(range(e - s, e + 1)) & (samples[2] | samples[9])}
    assert near == set(np.flatnonzero(touched(chosen, s)[s:]) + s)
    assert 80 < blocks_of(np.arange(20_000) < s, s)[0].max() <= 100
    assert held_out(100, 1 / 3).sum() == 33 and not held_out(5, 0).any()


def test_statement_says_what_it_rests_on(rng):
    u, y = tuning_case.recording(Plant(**TOLERANT), 300, rng)
    r = jb.parity_relations(jb.LinearSystem(**TOLERANT), 1)
    found = jb.tune(r, (u, y), steps=0, safety=1.3, block=9).risk
    assert (
        found.blocks == 30
        and found.average == 1 / 31
        and found.rate == rate_bound(30, 0.95)
        and not found.guide
    )
    assert "1/31 = 3.23 %" in found.text and "safety factor 1.3 comes on top and is not counted" in found.text
    assert found.factors.shape == (30,) and found.factors.max() <= 1
    bare = np.ones(40), Blocks(np.arange(40) // 4, 4, 1)
    guide = risk_of(*bare, Search(np.zeros(10, bool), 2, True, False), 0.95, 1.0)
    assert (
        guide.guide
        and guide.average == 2 / 11
        and guide.rate == scenario_bound(10, 2, 0.95)
        and "no guarantee" in guide.text
    )
    none = risk_of(*bare, Search(np.zeros(10, bool), 2, False, False), 0.95, 1.0)
    assert none.average is None and none.text.startswith("Nothing can be said")
    some = risk_of(*bare, Search(held_out(10, 0.5), 2, False, False), 0.95, 1.0)
    assert some.blocks == 5 and some.average == 1 / 6


@pytest.mark.long(by_day="test_statement_says_what_it_rests_on")
@pytest.mark.parametrize("steps, trials", [(0, 25), (40, 100)])
def test_new_blocks_alarm_no_more_often_than_stated(steps, trials, rng):
    r = jb.parity_relations(
        jb.LinearSystem(**{**TOLERANT, "tolerance": [0.05, 0.05], "noise": [0.05, 0.05]}), 1
    )
    plant, length, fresh = Plant(**TOLERANT), 6, 400
    make = lambda count: zip(
        *[tuning_case.recording(plant, length + 1, rng, level=3) for _ in range(count)], strict=True
    )
    rates, stated = [], None
    for _ in range(trials):
        u, y = (np.array(x) for x in make(24))
        res = jb.tune(r, (u, y), steps=steps, block=length, calibrate=0.5, confidence=0.8)
        stated = res.risk
        assert stated.blocks == (12 if steps else 24)
        u, y = (np.array(x) for x in make(fresh))
        rates.append(np.mean((jb.margins(r.with_bounds(res.smallest), u, y)[:, 1:] < 0).any(1)))
    rates = np.array(rates)
    assert rates.mean() <= stated.average + 3 * rates.std() / np.sqrt(trials)
    assert rates.mean() > 0.1 * stated.average  # or the test would not see a wrong statement
    assert np.mean(rates > stated.rate) <= 0.2 + 3 * np.sqrt(0.16 / trials)
    above = np.mean(rates > stated.rate)
    print(
        f"{trials} trials: mean rate {rates.mean():.4f} of {stated.average:.4f}, above {stated.rate:.3f} in "
        f"{above:.3f}"
    )
