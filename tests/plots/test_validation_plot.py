"""Bands that hold the true values: every faulty sample is drawn, whatever the length of a recording."""

import numpy as np
from validated_case import found_in

from jaxbound.plots.validation import plot_output


def test_faulty_stretches_are_marked_and_replaced():
    res = found_in()
    (ax,) = plot_output(res, 0, np.arange(60.0)).axes
    lines = {x.get_label(): np.asarray(x.get_ydata(), float) for x in ax.lines}
    assert (
        list(np.flatnonzero(np.isfinite(lines["measured, faulty"])))
        == [20, 21, 22, 40]
        == list(np.flatnonzero(np.isfinite(lines["corrected"])))
    )
    assert np.isfinite(lines["measured"]).sum() == 56 and "4 faulty samples in 2 stretches" in ax.get_title(
        loc="left"
    )


def test_one_faulty_sample_in_a_million_is_drawn():
    whole, near = plot_output(found_in(10**6, faulty=(654_321,)), 0, np.arange(1e6)).axes
    corrected = [next(x for x in ax.lines if x.get_label() == "corrected") for ax in (whole, near)]
    assert list(np.flatnonzero(np.isfinite(corrected[0].get_ydata()))) == [654_321 * 1200 // 10**6]
    at = corrected[1].get_xdata()[np.isfinite(corrected[1].get_ydata())]
    assert len(corrected[1].get_xdata()) == 600 and np.allclose(at, [654_321 / 86400])


def test_a_recording_without_any_band_is_drawn():
    assert plot_output(found_in(missing=59), 1, np.arange(60.0)).axes
