"""A second opinion: what an accelerator judged is judged again on the CPU, and a contradiction is never
passed over.
"""

import dataclasses

import numpy as np
import pytest
from systems import paper

import jaxbound as jb
from jaxbound.diagnosis import spot_checks
from jaxbound.diagnosis.spot_checks import again_hints, decided_again
from jaxbound.sets.floats.status import Status


@pytest.fixture(scope="module")
def judged():
    """Return a Result of two recordings with healthy, faulty and missing windows."""
    rng = np.random.default_rng(5)
    y = rng.uniform(-0.01, 0.01, (2, 400, 2))
    y[1, 200:, 0] += 3
    y[0, 50, :] = np.nan
    return jb.detect(jb.parity_relations(paper()), np.zeros((2, 400, 1)), y)


def test_windows_are_judged_as_before(judged):
    assert (judged.status == Status.FAULT).any() and (judged.status == Status.CONSISTENT).any()
    assert decided_again(judged, 10**6) == int((judged.status != Status.MISSING).sum())
    assert decided_again(judged, 10) == 10


@pytest.mark.parametrize("true, told", [(Status.CONSISTENT, Status.FAULT), (Status.FAULT, Status.CONSISTENT)])
def test_a_contradiction_is_refused(judged, true, told):
    status = judged.status.copy()
    place = tuple(np.argwhere(status == true)[-1])
    status[place] = told
    with pytest.raises(
        RuntimeError, match=f"1 of .* first the one that ends at {place[-1]}: {told.name}, there {true.name}"
    ):
        decided_again(dataclasses.replace(judged, status=status), 10**6)


def test_what_was_left_open_contradicts_nothing(judged):
    status = np.where(judged.status == Status.FAULT, np.int8(Status.UNDECIDED), judged.status)
    assert decided_again(dataclasses.replace(judged, status=status)) > 0


def test_a_report_says_so_where_another_device_judged(judged, monkeypatch):
    assert again_hints(judged) == ()
    monkeypatch.setattr(spot_checks, "judging_device", lambda: "gpu")
    (said,) = again_hints(judged)
    count = min(spot_checks.COUNT, int((judged.status != Status.MISSING).sum()))
    assert (
        said
        == f"judged on gpu; {count} windows drawn at random were decided again on the CPU, and none differs"
    )


def test_an_observer_is_not_asked_again():
    assert decided_again(jb.detect(jb.observer(paper()), np.zeros((50, 1)), np.zeros((50, 2)))) == 0
