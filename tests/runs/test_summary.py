"""What the test of a recording comes to: the verdict in a sentence, and numbers that read well."""

import re

import numpy as np
from result_case import CONSISTENT, FAULT, MISSING, synthetic
from systems import paper

import jaxbound as jb
from jaxbound.diagnosis.hints import bound_hints
from jaxbound.runs.summary import summarised


def summary(*given):
    found = summarised(*given)
    return found.verdict, found.sentence


class TestSummary:
    label = staticmethod(lambda k: f"sample {k}")

    def test_no_fault(self):
        res = synthetic([MISSING] + [CONSISTENT] * 9, [np.nan] + [0.4] * 8 + [0.2])
        assert summary(res, [], self.label) == (
            "no fault",
            "No fault found: the model explains all 9 windows within its bounds; the tightest, at sample 9, "
            "uses 80 % of them.",
        )

    def test_fault(self):
        res = synthetic([MISSING] + [CONSISTENT] * 8 + [FAULT] * 2, [np.nan] + [0.4] * 8 + [-0.5, -1.9])
        verdict, sentence = summary(res, res.alarms(), self.label)
        assert verdict == "fault" and "2 of 10 windows (20 %)" in sentence and "in 1 alarm;" in sentence
        assert sentence.endswith("the worst, at sample 10, would need bounds 2.9 times as wide.")

    def test_all_fault_says_that_model_or_bounds_do_not_fit(self):
        res = synthetic([MISSING] + [FAULT] * 9, [np.nan] + [-1.0] * 8 + [-11.0])
        assert summary(res, [], self.label)[1] == (
            "Every one of the 9 windows with data is FAULT: a fault lasts all through, or the "
            "model or its bounds do not fit this "
            "recording: "
            "all bounds times about 12 would make every window consistent; or a column is in another unit, "
            "or another signal, than the model has there: compare `jaxbound info MODEL.toml`."
        )

    def test_the_common_factor_would_make_every_window_consistent(self, rng):
        """With noise alone, the bounds times this factor are the intervals times it."""
        y = np.cumprod(np.full(30, 0.5))[:, None] + 10.0 + rng.uniform(0, 3, (30, 1))
        r = jb.parity_relations(jb.LinearSystem([[0.5]], None, [[1]], noise=0.1))
        res = jb.detect(r, None, y)
        assert res.counts["FAULT"] == 29
        said = re.search(
            "all bounds times about ([0-9.]+) would make every window consistent",
            summary(res, [], self.label)[1],
        )
        for share, left in ((0.99, True), (1.01, False)):
            wider = jb.detect(r.with_bounds({"noise": 0.1 * share * float(said[1])}), None, y)
            assert (wider.counts["FAULT"] > 0) == left

    def test_too_little_evidence(self):
        res = synthetic([MISSING] * 8 + [CONSISTENT] * 3)
        verdict, sentence = summary(res, [], self.label, 0.5)
        assert verdict == "too little evidence" and "only 3 of 10 windows (30 %)" in sentence
        assert summarised(res, [], self.label).decided == 0.3
        assert summary(res, [], self.label, 0.3)[0] == "no fault"

    def test_a_fault_is_news_whatever_the_coverage(self):
        assert summary(synthetic([MISSING] * 9 + [FAULT]), [], self.label)[0] == "fault"

    def test_nothing_at_all(self):
        res = synthetic([MISSING] * 5)
        assert (
            summary(res, [], self.label)[0] == "too little evidence"
            and summarised(res, [], self.label).worst is None
        )

    def test_bounds_that_nobody_can_mean(self):
        assert bound_hints(paper()) == []
        (hint,) = bound_hints(paper(noise=[0.1, 0], tolerance=0))
        assert "no tolerance, noise or resolution for y2:" in hint

    def test_a_bound_that_is_missing(self):
        assert bound_hints(paper(noise=0.1, tolerance=0, resolution=0.01)) == []
        only = bound_hints(paper(noise=[0.1, 0], tolerance=0, resolution=0.01))
        assert only == ["y2 has only a resolution: state noise or tolerance, what the sensor errs by"]
        assert "y1, y2 have only a resolution" in bound_hints(paper(noise=0, tolerance=0, resolution=0.01))[0]


def test_bounds_from_data_are_asked_whether_they_hold_so_long():
    """They were found for windows of four samples: longer ones, and an observer, may contradict what is
    healthy.
    """
    fitted = jb.LinearSystem(
        [["0.9"]], None, [[1]], noise=1, horizon=3, provenance={"noise": "fitted to 2 recordings"}
    )
    stated = fitted.replace(provenance={"noise": "data sheet"})
    longer, lags = (
        jb.parity_relations(fitted, 8),
        jb.parity_relations(fitted.replace(horizon=None), lags=(0, 3, 9)),
    )
    assert (
        bound_hints(fitted, jb.parity_relations(fitted, 3))
        == bound_hints(fitted)
        == bound_hints(stated, longer)
        == []
    )
    (said,) = bound_hints(fitted, longer)
    assert said.startswith(
        "the bounds were found from data for windows of 4 samples, and these windows reach over 9: "
    )
    assert said.endswith("fit again with --recipe horizon=8") and bound_hints(fitted, lags)[0].endswith(
        "fit again with --recipe lags=0,3,9"
    )
    assert "an observer looks back on all samples" in bound_hints(fitted, jb.observer(fitted))[0]
