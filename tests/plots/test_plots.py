"""Pictures: what they show, readable whatever the numbers."""

import re

import jax
import numpy as np
import pytest
from matplotlib.colors import to_hex
from result_case import CONSISTENT, FAULT, MISSING, UNDECIDED, biased, synthetic
from systems import paper

import jaxbound as jb
from jaxbound.plots.canvas import to_png
from jaxbound.plots.every import plot
from jaxbound.plots.figures import figure_1, figure_2
from jaxbound.reports.parts import distinct_relations


@pytest.fixture(scope="module")
def run():
    """Return (result, recording) of the paper's system with a bias."""
    return biased()


class TestPlot:
    def test_margin_ribbon_and_factor_axes(self, run):
        fig = plot(run[0], run[1].axis)
        margin, ribbon, factor = fig.axes
        line = next(x for x in margin.lines if len(x.get_xdata()) == 300)
        np.testing.assert_array_equal(line.get_ydata(), run[0].margin)
        assert [t.get_text() for t in fig.legends[0].texts] == [
            "MISSING",
            "CONSISTENT",
            "FAULT",
        ] and ribbon.get_xlabel() == "time (s)"
        assert factor.get_ylim() == margin.get_ylim()

    @pytest.mark.parametrize("span, unit", [(10, "s"), (600, "min"), (86400, "h"), (10**6, "days")])
    def test_time_in_sensible_units(self, span, unit):
        res = synthetic([MISSING] + [CONSISTENT] * 50)
        assert plot(res, np.linspace(0, span, 51)).axes[1].get_xlabel() == f"time ({unit})"

    def test_dates(self):
        res = synthetic([MISSING] + [CONSISTENT] * 20 + [FAULT] * 5 + [CONSISTENT] * 25)
        days = np.datetime64("2017-09-12") + np.arange(51) * np.timedelta64(1, "h")
        assert to_png(plot(res, days))[:4] == b"\x89PNG"

    def test_a_single_fault_in_a_million_is_drawn(self):
        status = np.full(1_000_000, CONSISTENT, np.int8)
        status[0], status[654_321] = MISSING, FAULT
        fig = plot(synthetic(status))
        colours = fig.axes[1].collections[0].get_array().ravel()
        assert (
            len(colours) == 1200
            and list(colours[colours != CONSISTENT]) == [FAULT]
            and np.argmax(colours) == 654_321 * 1200 // 10**6
        )
        assert min(x.get_ydata().min() for x in fig.axes[0].lines if len(x.get_ydata()) == 1200) == -1

    @pytest.mark.parametrize("worst", [-3.0, -50.0, -1e6, -1e15, -np.inf])
    def test_a_huge_excursion_does_not_flatten_the_rest(self, worst):
        status, margin = np.full(200, CONSISTENT), np.full(200, 0.5)
        status[100], margin[100] = FAULT, worst
        ax = plot(synthetic(status, margin)).axes[0]
        low, high = (ax.transData.transform((0, y))[1] for y in (0.0, 1.0))
        assert (high - low) / ax.bbox.height > 0.08  # the healthy band keeps its share of the picture

    def test_verdicts_without_margins_and_all_missing(self):
        for status in ([MISSING] + [FAULT] * 9 + [UNDECIDED] * 10, [MISSING] * 20):
            res = synthetic(status, np.full(20, np.nan))
            assert to_png(plot(res))

    def test_shifted_copies_are_drawn_once(self):
        r = jb.parity_relations(paper(), 4)
        assert r.count == 8 and len(distinct_relations(r)) == 2

    def test_long_integers_are_scaled_in_text_and_picture(self):
        m = jb.LinearSystem([["0.123457", "0.5"], ["0.1", "0.765432"]], [[1], [0]], [[1, 0]], noise=0.1)
        r = jb.parity_relations(m)
        text = r.text().splitlines()[0]
        y = np.random.default_rng(0).normal(size=(10, 1))
        value = float(r.external(np.zeros((10, 1)), y)[5, 0])
        coefficients = [float(x) / float(max(map(abs, r.W[0]))) for x in r.W[0]]
        assert abs(value - np.dot(coefficients, y[3:6, 0])) < 1e-9 and not re.search(
            r"(?<![.\d])\d{5,} ", text
        )

    def test_batches_and_wrong_times_are_refused(self, run):
        r = run[0].relations
        batch = jb.detect(r, np.zeros((2, 9, 1)), np.zeros((2, 9, 2)))
        with pytest.raises(ValueError, match="a plot shows one recording"):
            plot(batch)
        with pytest.raises(ValueError, match="time needs one entry for each of the 300 samples"):
            plot(run[0], np.arange(5))

    def test_a_name_with_dollar_signs_is_no_formula_in_axes_of_ones_own(self):
        import matplotlib.pyplot as plt

        model = jb.LinearSystem([[0.5]], [[1]], [[1]], noise=0.1, name=r"$\nonsense{$")
        fig, ax = plt.subplots()
        plot(jb.detect(jb.parity_relations(model), np.zeros((9, 1)), np.zeros((9, 1))), ax=ax)
        assert to_png(fig)
        plt.close(fig)

    def test_no_global_state_is_touched(self, run):
        import matplotlib

        before = dict(matplotlib.rcParams)
        to_png(plot(run[0]))
        assert dict(matplotlib.rcParams) == before


class TestPaper:
    def test_figure_1_shows_the_paper_and_its_numbers(self):
        left, right = figure_1().axes
        assert "261 boxes evaluated" in right.get_title(loc="left") + right.get_title()
        texts = [t.get_text() for t in left.get_legend().texts]
        assert "paving, q = 10: area 25.634" in texts and "paving, q = 20: area 23.554" in texts
        drawn = sum(len(c.get_paths()) for c in right.collections)
        assert drawn == 261 + 20  # evaluated, and kept once more in colour

    def test_figure_2(self):
        u = np.zeros((60, 1))
        faults = [jb.Fault("y1", "bias", 3.0, 20, 40)]
        t = jb.simulate(paper(), u, jax.random.key(0), faults=faults)
        axes = figure_2(t, jb.detect(jb.parity_relations(paper()), t.u, t.y), faults).axes
        assert [t.get_text() for t in axes[1].get_legend().texts] == ["x1 + x2 (true)", "y2 (measured)"]
        assert axes[0].texts[0].get_text().strip() == "A: bias of y1"


def test_undecided_of_an_observer_has_a_name_and_a_colour_that_do_not_warn():
    model = jb.LinearSystem([[0.5]], None, [[1]], noise=0.1)
    y = [[1.0], [0.5], [0.25], [0.125]]
    observed, windows = jb.observer(model), jb.parity_relations(model, 2)
    (legend,) = jb.plot(jb.detect(observed, None, y)).legends
    assert [text.get_text() for text in legend.get_texts()][-1] == "UNDECIDED (not refuted)"
    assert to_hex(legend.get_patches()[-1].get_facecolor()) == "#d3e9f8"
    box = jb.detect(windows, None, y, method="box")
    (legend,) = jb.plot(box).legends
    assert [text.get_text() for text in legend.get_texts()][-1] == "UNDECIDED"
