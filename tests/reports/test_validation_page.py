"""The page of a validated recording."""

import re
from types import SimpleNamespace

import numpy as np
from validated_case import found_in, recording_of

from jaxbound.reports.validation import output_charts, write_page
from jaxbound.runs.summary import summarised


def test_dates_on_its_axes_are_written_as_in_the_recording():
    days = np.datetime64("2024-03-01T08:00", "ns") + np.arange(60) * np.timedelta64(1, "h")
    written = [
        f"{d.day:02d}.{d.month:02d}.{d.year} {d.hour:02d}:00" for d in days.astype("datetime64[s]").tolist()
    ]
    recording = SimpleNamespace(
        time=np.arange(60) * 3600.0, stamps=days, axis=days, label=written.__getitem__
    )
    drawn = output_charts(found_in(), recording, ["y1"])
    assert drawn.ends == (written[0], written[-1]) and not drawn.whole.binned and drawn.near == []
    assert [drawn.clock.text(3600.0 * k) for k in range(60)] == written


def test_it_shows_each_output_and_each_stretch(tmp_path):
    res = found_in()
    said = summarised(res, res.alarms(), "{} s".format, hints=["a `hint`"])
    write_page(tmp_path / "report.html", res, recording_of(res), said)
    page = (tmp_path / "report.html").read_text()
    assert page.count('"kind": "enclosed"') == 2 and "two &amp; two" in page
    assert '<noscript><img alt="measured outputs' in page
    assert re.search(">y1<.*>20 s<.*>22 s<.*>3 s<.*>3<.*>4 bar<.*>0.75 to 1.25 bar<", page)
    assert "UNDECIDED (not refuted)" in page, "what a healthy sample is"
    assert "<code>hint</code>" in page and "nobody can promise more" in page


def test_faulty_samples_stand_beside_the_band_and_its_middle():
    res = found_in()
    whole = output_charts(res, recording_of(res), ["y1", "y2"]).whole
    faulty = np.asarray(res.found.faulty)
    for i in range(2):
        np.testing.assert_array_equal(np.isfinite(whole.low[f"y{i}:faulty"]), faulty[:, i])
        np.testing.assert_array_equal(np.isfinite(whole.low[f"y{i}:instead"]), faulty[:, i])
        assert (whole.low[f"y{i}:band"] < whole.high[f"y{i}:band"])[1:].all()
    wrong = faulty[:, 0]
    lo, hi = (np.asarray(end)[wrong, 0] for end in (res.found.corrected.lo, res.found.corrected.hi))
    assert wrong.any() and not faulty[:, 1].any()
    np.testing.assert_array_equal(whole.low["y0:instead"][wrong], (lo + hi) / 2)


def test_a_long_recording_is_shown_around_its_first_faulty_sample_too():
    res = found_in(20_000, range(9000, 9003))
    drawn = output_charts(res, recording_of(res), ["y1"])
    assert drawn.whole.binned and len(drawn.near) == 1 and drawn.about == "the first faulty sample"
    assert drawn.begin < 9000 < 9002 < drawn.end and drawn.near[0]["n"] == 600


def test_from_the_first_fault_on_the_page_says_what_its_bands_still_mean(tmp_path):
    """A fault that lasts may be accepted again: the band is then no place of the true value."""
    for faulty in ((20, 21), ()):
        res = found_in(faulty=faulty)
        write_page(
            tmp_path / "report.html", res, recording_of(res), summarised(res, res.alarms(), "{} s".format)
        )
        page = " ".join((tmp_path / "report.html").read_text().split())
        assert page.count("From 20 s on, the first FAULT, the true value is there only if") == (
            1 if faulty else 0
        )
        assert "true value within" not in page and "where the true value of an output is," not in page
