"""Random numbers of a study: nothing in them that a study could notice."""

import numpy as np

from jaxbound.studies.montecarlo.draws import numbers_from_bits, words


def test_draws_are_uniform_and_do_not_know_of_each_other(rng):
    """Neighbouring scenarios, neighbouring steps and the draws of one step, 16384 of each: every statistic
    within 6 deviations.
    """
    N, key = 2**14, rng.integers(0, 2**32, 2, np.uint32)
    drawn = np.array(
        [
            numbers_from_bits(b, np.float64)
            for k in range(3)
            for b in words(tuple(key), np.arange(N, dtype=np.uint32), 2 * k, 4)
        ]
    )
    assert (abs(drawn) <= 1).all() and len(np.unique(drawn)) > 0.999 * drawn.size
    cells = np.array([np.bincount(((d + 1) * 32).astype(int), minlength=64) for d in drawn])
    chi = ((cells - N / 64) ** 2 / (N / 64)).sum(1)
    assert (abs(chi - 63) < 6 * 126**0.5).all()
    correlation = np.corrcoef(np.vstack([drawn, np.roll(drawn[:4], 1, 1)]))
    assert (abs(correlation - np.eye(16)) < 6 / N**0.5).all()
    assert (abs((drawn**2).mean(1) - 1 / 3) < 6 * (4 / 45 / N) ** 0.5).all()


def test_vertices_are_the_two_ends_equally_often(rng):
    (bits,) = words(tuple(rng.integers(0, 2**32, 2, np.uint32)), np.arange(2**14, dtype=np.uint32), 5, 1)
    ends = np.asarray(numbers_from_bits(bits, np.float64, vertices=True))
    assert set(ends) == {-1.0, 1.0} and abs(ends.mean()) < 6 / 2**7
