"""Nothing is proved in a process that does not round to nearest, whoever changed that."""

import ctypes
import ctypes.util
import platform

import numpy as np
import proving
import pytest

import jaxbound as jb

UP, DOWN, TOWARDS_ZERO = 0x800, 0x400, 0xC00


@pytest.mark.skipif(platform.machine() != "x86_64", reason="the numbers of the modes are those of this processor family")
@pytest.mark.parametrize("mode", [UP, DOWN, TOWARDS_ZERO])
def test_other_modes_are_refused_at_every_door_that_proves(mode):
    doors, r = proving.doors(), jb.parity_relations(proving.MODEL)
    library = ctypes.CDLL(ctypes.util.find_library("m"))
    assert library.fesetround(mode) == 0
    try:
        for name, door in doors.items():
            with pytest.raises(RuntimeError, match="does not round to nearest"):
                door()
                print(f"{name} answered")
    finally:
        library.fesetround(0)
    assert jb.detect(r, None, np.zeros((3, 1))).counts["CONSISTENT"] == 2
