"""Intervals of shares: exact where they claim to be, and covering as often as they say."""

from fractions import Fraction
from math import comb

import numpy as np
import pytest

from jaxbound.studies.montecarlo.proportions import proportion_interval, rate_interval


def tail(n, k, p):
    """Return the exact chance of at most k of n."""
    p = Fraction(p)
    return sum(comb(n, j) * p**j * (1 - p) ** (n - j) for j in range(k + 1))


@pytest.mark.parametrize(("k", "n"), [(0, 1), (0, 20), (3, 20), (19, 20), (20, 20), (7, 60)])
def test_the_ends_leave_exactly_half_the_rest_on_each_side(k, n):
    lo, hi = (float(x) for x in proportion_interval(k, n, 0.95))
    if k < n:
        assert abs(float(tail(n, k, hi)) - 0.025) < 1e-9
    if k:
        assert abs(1 - float(tail(n, k - 1, lo)) - 0.025) < 1e-9
    assert (k > 0 or lo == 0) and (k < n or hi == 1)


def test_nothing_is_known_of_no_scenario():
    assert [float(x) for x in proportion_interval(0, 0)] == [0, 1]
    rate, lo, hi = rate_interval(0, 0, 0, 0, 0, 0)
    assert np.isnan(rate) and (lo, hi) == (0, 1)


def test_rates_of_windows_that_depend_on_each_other_are_covered(rng):
    """Scenarios of 1 to 40 windows, each with a rate of its own: an interval that took windows for
    independent covers 30 %.
    """
    covered = naive = 0
    for _ in range(400):
        w = rng.integers(1, 41, 300)
        own = rng.beta(0.5, 1.5, 300)
        h = rng.binomial(w, own)
        sums = h.sum(), w.sum(), (h * h).sum(), (h * w).sum(), (w * w).sum(), 300
        rate, lo, hi = rate_interval(*sums, confidence=0.9)
        covered += lo <= 0.25 <= hi
        naive += abs(rate - 0.25) < 1.645 * (rate * (1 - rate) / w.sum()) ** 0.5
    assert 0.83 < covered / 400 < 0.96
    assert naive / 400 < 0.7


def test_a_rate_never_seen_keeps_an_upper_end_above_0():
    rate, lo, hi = rate_interval(0, 3000, 0, 0, 90_000, 100)
    assert rate == 0 and lo == 0 and abs(hi - proportion_interval(0, 100)[1]) < 1e-12
