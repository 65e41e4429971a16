"""Nothing is proved in a process that does not round to nearest, whoever changed that."""

import ctypes
import ctypes.util
import platform

import numpy as np
import pytest

import jaxbound as jb

UP, DOWN, TOWARDS_ZERO = 0x800, 0x400, 0xC00
MODEL = jb.LinearSystem([[0.5]], None, [[1]], noise=0.1)


@pytest.mark.skipif(platform.machine() != "x86_64", reason="the numbers of the modes are those of this processor family")
@pytest.mark.parametrize("mode", [UP, DOWN, TOWARDS_ZERO])
def test_other_modes_are_refused_at_every_door_that_proves(mode):
    r, m, b = jb.parity_relations(MODEL), jb.interval_system([[0.5]], None, [[1]]), jb.interval(np.zeros(1), np.ones(1))
    z, y = jb.zonotope([0.0], [[1.0]]), np.zeros((3, 1))
    doors = (
        lambda: jb.detect(r, None, y),
        lambda: jb.Monitor(r),
        lambda: jb.validate(m, None, y),
        lambda: jb.pave(lambda x: x, b, b),
        lambda: jb.membership(z, y),
        lambda: jb.solve_interval(np.eye(1), np.ones(1)),
    )
    library = ctypes.CDLL(ctypes.util.find_library("m"))
    assert library.fesetround(mode) == 0
    try:
        for door in doors:
            with pytest.raises(RuntimeError, match="does not round to nearest"):
                door()
    finally:
        library.fesetround(0)
    assert jb.detect(r, None, y).counts["CONSISTENT"] == 2
