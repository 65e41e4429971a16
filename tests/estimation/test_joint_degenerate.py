"""Method "joint" where its programs degenerate: outputs without an error, averages without a disturbance."""

import numpy as np
import pytest

import jaxbound as jb

pytestmark = pytest.mark.usefixtures("searched_in_numpy")


@pytest.mark.parametrize("noise", [[0, 0], [0, "0.1"], ["1e-9", "1e-9"]])
def test_outputs_that_show_the_same_without_an_error_are_judged(noise):
    model = jb.LinearSystem([[1]], None, [[1], [1]], noise=noise)
    y = np.full((12, 2), 0.5)
    watch = jb.observer(model, method="joint", window=4)
    healthy = jb.detect(watch, None, y)
    y[7:, 0] += 1
    faulty = jb.detect(watch, None, y)
    assert healthy.counts["FAULT"] == 0 and healthy.counts["MISSING"] == 1
    assert faulty.status[7] == jb.Status.FAULT and (faulty.status[:7] == healthy.status[:7]).all()


def test_averages_are_used_without_a_disturbance():
    model = jb.LinearSystem([["0.9"]], [[1]], [[1]], outputs=["T1"], noise="0.5", averages={"T1": {8: "0.2"}})
    u, y = np.zeros((32, 1)), np.zeros((32, 1))
    y[16:] += 0.45  # each within its noise, their mean not
    watch = jb.observer(model, method="joint", window=16)
    found = jb.detect(watch, u, y)
    fault = np.flatnonzero(found.status == jb.Status.FAULT)
    assert len(fault) and 16 < fault[0] < 24
