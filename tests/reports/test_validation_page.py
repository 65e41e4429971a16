"""The page of a validated recording."""

import re
from types import SimpleNamespace

import numpy as np
from validated_case import found_in, recording_of

from jaxbound.plots.canvas import to_png
from jaxbound.plots.validation import plot_output
from jaxbound.reports.validation import _as_written, write_page
from jaxbound.runs.summary import summarised


def test_dates_on_its_axes_are_written_as_in_the_recording():
    days = np.datetime64("2024-03-01T08:00", "ns") + np.arange(60) * np.timedelta64(1, "h")
    written = [f"{d.day:02d}.{d.month:02d}.{d.year} {d.hour:02d}:00" for d in days.astype("datetime64[s]").tolist()]
    res = found_in()
    recording = SimpleNamespace(time=np.arange(60) * 3600.0, stamps=days, axis=days, label=written.__getitem__)
    fig = _as_written(plot_output(res, 0, days), recording)
    to_png(fig)
    shown = [t.get_text().replace("\n", " ") for t in fig.axes[0].get_xticklabels()]
    assert 3 <= len(shown) <= 9 and set(shown) <= set(written)


def test_it_shows_each_output_and_each_stretch(tmp_path):
    res = found_in()
    names = write_page(tmp_path, res, recording_of(res), summarised(res, res.alarms(), "{} s".format, hints=["a `hint`"]))
    page = (tmp_path / "report.html").read_text()
    assert names == ["report.html", "output1.png", "output2.png"] and page.count("<img") == 2 and "two &amp; two" in page
    assert re.search(">y1<.*>20 s<.*>22 s<.*>3 s<.*>3<.*>4 bar<.*>0.75 to 1.25 bar<", page)
    assert "<code>hint</code>" in page and "nobody can promise more" in page
