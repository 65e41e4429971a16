"""Threefry gives the words that its authors published."""

import numpy as np
import pytest

from jaxbound.random.threefry import threefry

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
