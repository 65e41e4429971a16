"""Nothing is proved in a process that does not round to nearest, whoever changed that."""

import ctypes
import ctypes.util
import platform

import numpy as np
import proving
import pytest

import jaxbound as jb

UP, DOWN, TOWARDS_ZERO = 0x800, 0x400, 0xC00


@pytest.mark.skipif(
    platform.machine() != "x86_64", reason="the numbers of the modes are those of this processor family"
)
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


@pytest.mark.skipif(
    platform.machine() != "x86_64" or platform.system() != "Linux",
    reason="where the processor's register lies is known here",
)
@pytest.mark.parametrize("bits", [0x8000, 0x0040], ids=["results", "operands"])
def test_small_numbers_that_are_flushed_are_refused_at_every_door_that_proves(bits):
    doors, library = proving.doors(), ctypes.CDLL(ctypes.util.find_library("m"))
    usual = (ctypes.c_uint32 * 8)()  # fenv_t; the register of vectors is its last number
    assert library.fegetenv(usual) == 0
    flushing = (ctypes.c_uint32 * 8)(*usual)
    flushing[7] |= bits
    assert library.fesetenv(flushing) == 0
    try:
        for name, door in doors.items():
            with pytest.raises(RuntimeError, match="reads numbers below the smallest normal one as 0"):
                door()
                print(f"{name} answered")
    finally:
        assert library.fesetenv(usual) == 0
    assert np.finfo(np.float64).tiny / 2 > 0
