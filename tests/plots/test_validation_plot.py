"""Bands that hold the true values: every faulty sample is drawn, whatever the length of a recording."""

import numpy as np
from validated_case import found_in

import jaxbound as jb


def drawn(res, i=0):
    """Return the panel of output i of a validated recording."""
    return jb.plot(res.found, time=np.arange(float(len(res.y))), y=res.y).axes[i]


def test_faulty_stretches_are_marked_and_replaced():
    ax = drawn(found_in())
    lines = {x.get_label(): np.asarray(x.get_ydata(), float) for x in ax.lines}
    for name in ("measured, faulty", "corrected"):
        assert list(np.flatnonzero(np.isfinite(lines[name]))) == [20, 21, 22, 40]
    assert np.isfinite(lines["measured"]).sum() == 56
    assert "4 faulty samples in 2 stretches" in ax.get_title(loc="left")


def test_one_faulty_sample_in_a_million_is_drawn():
    ax = drawn(found_in(10**6, faulty=(654_321,)))
    corrected = next(x for x in ax.lines if x.get_label() == "corrected")
    at = 654_321 * 1200 // 10**6
    assert list(np.flatnonzero(np.isfinite(corrected.get_ydata()))) == [at]
    (area,) = (x for x in ax.collections if x.get_label() == "measured, faulty")
    drawn_at = np.concatenate([path.vertices[:, 0] for path in area.get_paths()])
    assert set(np.unique(drawn_at)) == {corrected.get_xdata()[at]}


def test_a_recording_without_any_band_is_drawn():
    assert drawn(found_in(missing=59), 1)
