"""A report on Parquet shows the recorded signals over the whole recording, as one on CSV does."""

from dataclasses import replace

import numpy as np
import pytest
from streaming_case import N, recording, shrink

from jaxbound.plots.canvas import bins
from jaxbound.plots.plot import plot
from jaxbound.reports.chartdata import Shown, charts
from jaxbound.runs.digest import detect_dataset
from jaxbound.runs.partnotes import read_extremes
from jaxbound.runs.parts import part_files

pytestmark = pytest.mark.compiled


@pytest.fixture(scope="module")
def found(case, tmp_path_factory):
    """Return the Digest of a recording in six parts, and the folder of its verdicts."""
    relations, folder, _, _ = case("section 5")
    out = tmp_path_factory.mktemp("page")
    with pytest.MonkeyPatch.context() as patch:
        shrink(patch)
        return detect_dataset(relations, folder, out), out


def test_the_extremes_of_every_bin_are_those_of_the_samples(found):
    digest, out = found
    _, u, y = recording()
    low, high = read_extremes(part_files(out / "verdicts.parquet"), N)
    assert len(part_files(out / "verdicts.parquet")) == 6 and low.shape == (3, len(bins(N))) == (3, 1200)
    edges = bins(N)
    for i, x in enumerate((y[:, 0], y[:, 1], u[:, 0])):
        np.testing.assert_array_equal(low[i], np.fmin.reduceat(x, edges).astype(np.float32))
        np.testing.assert_array_equal(high[i], np.fmax.reduceat(x, edges).astype(np.float32))


def test_the_overview_has_the_signals_that_one_of_a_whole_recording_has(found, case):
    _, _, res, whole = case("section 5")
    there, expected = (charts(x, r, Shown(worst=100)) for x, r in ((found[0], found[0]), (res, whole)))
    assert [row.key for row in there.rows] == [row.key for row in expected.rows]
    assert set(there.whole.low) == {"margin", "s0", "s1", "s2"} <= set(expected.whole.low)


@pytest.mark.parametrize(
    "margins, about", [("exact", "the tightest window"), ("bounds", "the window with the lowest bound")]
)
def test_the_page_does_not_call_a_window_the_tightest_by_bounds(found, margins, about):
    counts = found[0].counts | {"FAULT": 0}
    numbers = replace(found[0].found, margins=margins, bounded=margins == "bounds", counts=counts)
    healthy = replace(found[0], found=numbers)
    assert charts(healthy, healthy, Shown(worst=100)).about == about


@pytest.mark.parametrize("margins, words", [("exact", ""), ("bounds", ", above 0 a lower bound")])
def test_a_picture_of_bounds_says_so_in_its_title(found, margins, words):
    figure = plot(replace(found[0], found=replace(found[0].found, margins=margins)))
    titles = [figure.axes[0].get_title(at) for at in ("left", "center", "right")]
    name = found[0].relations.model.name
    assert any(title.split("   ")[0] == f"Margin of {name}{words}" for title in titles)
