"""Random numbers by counting: the published ones, and nothing that a study could notice."""

import numpy as np
import pytest

from jaxbound.studies.montecarlo.draws import share, threefry, words

PUBLISHED = {  # of the authors' own test vectors: key, counter, 13 rounds, 20 rounds
    "zeros": ((0, 0), (0, 0), (0x9D1C5EC6, 0x8BD50731), (0x6B200159, 0x99BA4EFE)),
    "ones": ((0xFFFFFFFF,) * 2, (0xFFFFFFFF,) * 2, (0xFD36D048, 0x2D17272C), (0x1CB996FC, 0xBB002BE7)),
    "pi": (
        (0x13198A2E, 0x03707344),
        (0x243F6A88, 0x85A308D3),
        (0xBA3E4725, 0xF27D669E),
        (0xC4923A9C, 0x483DF7A0),
    ),
}


@pytest.mark.parametrize("name", PUBLISHED)
def test_threefry_gives_the_published_words(name):
    key, counter, *expected = PUBLISHED[name]
    row = lambda pair: tuple(np.full(3, x, np.uint32) for x in pair)
    for rounds, words_ in zip((13, 20), expected, strict=True):
        assert tuple(int(x[0]) for x in threefry(row(key), row(counter), rounds)) == words_


def test_draws_are_uniform_and_do_not_know_of_each_other(rng):
    """Neighbouring scenarios, neighbouring steps and the draws of one step, 16384 of each: every statistic
    within 6 deviations.
    """
    N, key = 2**14, rng.integers(0, 2**32, 2, np.uint32)
    drawn = np.array(
        [
            share(b, np.float64)
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
    ends = np.asarray(share(bits, np.float64, vertices=True))
    assert set(ends) == {-1.0, 1.0} and abs(ends.mean()) < 6 / 2**7
