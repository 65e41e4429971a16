"""Inputs in float32 may have been rounded: far from an operating point that is more than what is left."""

import numpy as np
import pytest

import jaxbound as jb

FAR, MORE = 10**6, 0.03
"""An operating point, and by how much more each input was than the nearest number of float32 says."""


def recording(direct):
    """Return (u, y) of x+ = x / 2 + v, y = x, or of y = v, where v was MORE and is recorded as 0."""
    y = np.full((40, 1), MORE) if direct else 2 * MORE * (1 - 0.5 ** np.arange(40))[:, None]
    return np.full((40, 1), FAR, np.float32), y.astype(np.float32)


def plant(gain, unsure, direct):
    """Return the plant whose input has a gain, and an uncertain one."""
    where, other = ("D", "B") if direct else ("B", "D")
    about = {where: [[gain]], other: [[0]]}
    if unsure:
        about["uncertainties"] = [jb.Uncertainty("gain", **{where: [[unsure]]})]
    return jb.LinearSystem([["0.5"]], C=[[1]], noise=0.001, offset={"u": [FAR], "y": [0]}, **about)


@pytest.mark.parametrize("direct", [False, True])
@pytest.mark.parametrize(
    "options", [{}, pytest.param({"method": "joint", "window": 4}, marks=pytest.mark.long)], ids=len
)
def test_an_uncertain_gain_multiplies_what_rounding_took_from_an_input(options, direct):
    found = jb.detect(jb.observer(plant(0, 1, direct), **options), *recording(direct))
    assert not found.counts["FAULT"]
    state, truth = found.observation.state, 0 if direct else recording(direct)[1]
    assert ((np.asarray(state.lo) <= truth) & (truth <= np.asarray(state.hi)))[2:].all()


@pytest.mark.parametrize("gain, unsure", [(1, 0), (-1, 0), (0, 1)])
def test_a_validation_allows_for_inputs_that_were_rounded(gain, unsure):
    found = jb.validate(plant(gain, unsure, False), *recording(False))
    assert not (np.asarray(found.status) == jb.Status.FAULT).any()
