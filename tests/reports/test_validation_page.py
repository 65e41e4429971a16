"""The page of a validated recording."""

import re
from types import SimpleNamespace

import numpy as np
from validated_case import found_in, recording_of

from jaxbound.reports.validation import _charts, write_page
from jaxbound.runs.summary import summarised


def test_dates_on_its_axes_are_written_as_in_the_recording():
    days = np.datetime64("2024-03-01T08:00", "ns") + np.arange(60) * np.timedelta64(1, "h")
    written = [
        f"{d.day:02d}.{d.month:02d}.{d.year} {d.hour:02d}:00" for d in days.astype("datetime64[s]").tolist()
    ]
    recording = SimpleNamespace(
        time=np.arange(60) * 3600.0, stamps=days, axis=days, label=written.__getitem__
    )
    [(title, chart)] = _charts(found_in(), recording, ["y1"])
    shown = [tick["text"] for tick in chart["ticks"]]
    assert title == "The whole recording" and (chart["from"], chart["to"]) == (written[0], written[-1])
    assert 3 <= len(shown) <= 9 and set(shown) <= {
        text[:10] if text.endswith(" 00:00") else text for text in written
    } | set(written)


def test_it_shows_each_output_and_each_stretch(tmp_path):
    res = found_in()
    names = write_page(
        tmp_path, res, recording_of(res), summarised(res, res.alarms(), "{} s".format, hints=["a `hint`"])
    )
    page = (tmp_path / "report.html").read_text()
    assert names == ["report.html"] and page.count('class="panel enclosed"') == 2 and "two &amp; two" in page
    assert re.search(">y1<.*>20 s<.*>22 s<.*>3 s<.*>3<.*>4 bar<.*>0.75 to 1.25 bar<", page)
    assert "<code>hint</code>" in page and "nobody can promise more" in page


def test_faulty_samples_are_dots_beside_the_band_and_its_middle():
    res = found_in()
    [(_, chart)] = _charts(res, recording_of(res), ["y1", "y2"])
    first, second = chart["panels"]
    assert (
        first["out"].count("M") == int(np.asarray(res.found.faulty)[:, 0].sum()) > 0
        and second["out"] == second["instead"] == ""
    )
    assert first["hull"] and second["hull"] and first["instead"].count("M") == 2


def test_a_long_recording_is_shown_around_its_first_faulty_sample_too():
    res = found_in(1500, range(900, 903))
    whole, near = _charts(res, recording_of(res), ["y1"])
    assert (
        near[0] == "The samples around the first faulty one" and near[1]["panels"][0]["out"].count("M") == 3
    )
    panel = whole[1]["panels"][0]
    assert panel["binned"] and 1000 < panel["line"].count("V") <= 2000  # extremes of bins


def test_from_the_first_fault_on_the_page_says_what_its_bands_still_mean(tmp_path):
    """A fault that lasts may be accepted again: the band is then no place of the true value."""
    for faulty in ((20, 21), ()):
        res = found_in(faulty=faulty)
        write_page(tmp_path, res, recording_of(res), summarised(res, res.alarms(), "{} s".format))
        page = " ".join((tmp_path / "report.html").read_text().split())
        assert page.count("From 20 s on, the first FAULT, the true value is there only if") == (
            1 if faulty else 0
        )
        assert "true value within" not in page and "where the true value of an output is," not in page
