"""The picture of a recording for readers without scripts: what its axis and its lines say."""

import re

import numpy as np
import pytest

from jaxbound.plots.canvas import CALM, COLOURS, FAULTY
from jaxbound.plots.timeline import Timeline
from jaxbound.reports.overview import overview
from jaxbound.sets.floats.status import Status


def drawn(margin, status=None, **asked):
    line = Timeline(len(margin))
    status = np.full(len(margin), Status.CONSISTENT, np.int8) if status is None else np.array(status, np.int8)
    line.add(0, np.arange(len(margin)) * 60.0, status, np.array(margin, float))
    line.mark(asked.pop("marked", []))
    return overview(line, "<plant>", ("08:00", "09:00"), **{"alarms": 0, "observes": False} | asked).decode()


@pytest.mark.parametrize(
    ("lowest", "steps"),
    [
        (0.3, ""),
        (-0.9, ""),
        (-1, "-1"),
        (-1.9, "-1"),
        (-2, "-1 -2"),
        (-6, "-1 -2 -5"),
        (-20, "-1 -5 -20"),
        (-2e4, "-1 -20 -500 -10000"),
    ],
)
def test_margins_below_minus_one_have_ticks_of_1_2_and_5_where_they_are_drawn(lowest, steps):
    page = drawn([1, 0.5, 0, lowest])
    words = re.findall(r'"end" fill="[^"]+">([^<]+)<', page)
    assert words == ["1", "0.5", "0", *steps.split(), "09:00"]
    heights = [float(y) for y in re.findall(r'd="M50 ([\d.]+)H870"', page)]
    assert heights == sorted(heights) and 30 < heights[0] and heights[-1] <= 270
    points = [float(y) for y in re.findall(r"[ML][\d.]+ ([\d.]+)", page)]
    if f"{lowest:g}" in steps.split():
        assert points[-1] == heights[-1]
    assert points[-4:-1] == heights[:3]


def test_a_line_has_a_hole_where_there_is_no_margin_and_verdicts_have_their_colours():
    found = [Status.CONSISTENT, Status.MISSING, Status.FAULT, Status.FAULT, Status.UNDECIDED]
    page = drawn([1, np.nan, -0.5, -0.5, 0], found, alarms=2, marked=[2])
    assert re.findall(r"([ML])([\d.]+) [\d.]+(?=[ML\"])", page) == [
        ("M", "50.0"),
        ("M", "460.0"),
        ("L", "665.0"),
        ("L", "870.0"),
    ]
    strip = re.findall(r'<rect x="([\d.]+)" width="([\d.]+)" fill="([^"]+)" y="282"', page)
    edges = [50, 152.5, 357.5, 767.5, 870]
    assert [float(x) for x, *_ in strip] == edges[:-1]
    assert [float(width) for _, width, _ in strip] == np.diff(edges).tolist()
    verdicts = [Status.CONSISTENT, Status.MISSING, Status.FAULT, Status.UNDECIDED]
    assert [colour for *_, colour in strip] == [COLOURS[verdict] for verdict in verdicts]
    assert page.count('y="30"') == 1 and f'd="M456.0 20h8l-4 7z" fill="{FAULTY}"' in page
    assert ">2 alarms<" in page and ">08:00<" in page and ">09:00<" in page and "&lt;plant&gt;" in page
    assert CALM not in page and CALM in drawn([0], [Status.UNDECIDED], observes=True)
    assert ">1 alarm<" in drawn([0], alarms=1) and "alarm" not in drawn([0])
