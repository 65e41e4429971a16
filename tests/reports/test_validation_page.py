"""The page of a validated recording."""

import re

from validated_case import found_in, recording_of

from jaxbound.reports.validation import write_page
from jaxbound.runs.summary import summarised


def test_it_shows_each_output_and_each_stretch(tmp_path):
    res = found_in()
    names = write_page(tmp_path, res, recording_of(res), summarised(res, res.alarms(), "{} s".format, hints=["a `hint`"]))
    page = (tmp_path / "report.html").read_text()
    assert names == ["report.html", "output1.png", "output2.png"] and page.count("<img") == 2 and "two &amp; two" in page
    assert re.search(">y1<.*>20 s<.*>22 s<.*>3 s<.*>3<.*>4 bar<.*>0.75 to 1.25 bar<", page)
    assert "<code>hint</code>" in page and "nobody can promise more" in page
