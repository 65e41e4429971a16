"""What an object shows: its numbers in few words, and those that lead it."""

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from jaxbound.text.objects import readable


@dataclass(frozen=True, eq=False)
class Inner:
    bounds: np.ndarray


@readable
@dataclass(frozen=True, eq=False)
class Outer:
    inner: Inner
    size: Fraction
    names: tuple[str, ...]


def test_an_object_is_led_by_the_first_array_of_what_it_holds():
    shown = repr(Outer(Inner(np.zeros((40, 2))), Fraction(1, 3), ("a", "b"))).splitlines()
    assert shown[0] == "Outer (40, 2)"
    assert [line.strip() for line in shown[1:]] == [
        "inner: Inner (40, 2)",
        "size: 0.333333",
        "names: 'a', 'b'",
    ]
