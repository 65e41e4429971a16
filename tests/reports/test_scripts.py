"""The scripts of pages in a real browser: what they draw is what Python drew, buttons do what they say,
nothing fails in silence.
"""

import html
import json
import re
import shutil
import subprocess

import numpy as np
import pytest
from result_case import CONSISTENT, FAULT, MISSING, biased, recording_of, synthetic
from test_charts import page_of
from test_pages import fleet

from jaxbound.recordings.recording import Recording

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = [pytest.mark.slow, pytest.mark.skipif(BROWSER is None, reason="no browser on this machine")]


def seen(page, folder, deeds):
    """Return what a script `deeds` noted down on a page with note(value), and the errors of the page."""
    watch = "<script>const errors = [], notes = [], note = (x) => notes.push(x);"
    watch += "addEventListener('error', (e) => errors.push(e.message));</script>"
    told = "addEventListener('load', () => { document.title = JSON.stringify([notes, errors]); });"
    page = page.replace("<head>", f"<head>{watch}", 1).replace(
        "</body>", f"<script>{deeds}\n{told}</script></body>", 1
    )
    (folder / "watched.html").write_text(page)
    command = [
        BROWSER,
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--virtual-time-budget=3000",
        "--dump-dom",
        f"--user-data-dir={folder / 'browser'}",
        (folder / "watched.html").as_uri(),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    return json.loads(html.unescape(re.search(r"<title>(.*?)</title>", done.stdout, re.S)[1]))


def points(path):
    """Return the corners (k, 2) of a path of M, L, H and V."""
    x, y, found = 0.0, 0.0, []
    for letter, numbers in re.findall(r"([MLHV])([-\d. ]+)", path):
        values = [float(v) for v in numbers.split()]
        x = x if letter == "V" else values[0]
        y = y if letter == "H" else values[-1]
        found.append((x, y))
    return np.array(found)


def test_the_zoom_draws_what_python_drew_and_goes_where_it_is_told(tmp_path):
    res, recording = biased()[:2]
    alarms = res.alarms()
    page = page_of(tmp_path, res, recording, alarms)
    drawn = page[page.index('id="zoom"') :]
    first = dict(re.findall(r'data-key="(\w+)">.*?<path class="line" d="([^"]*)"', drawn, re.S))
    deeds = """
      const zoom = document.getElementById("zoom"), said = () => zoom.querySelector(".said").textContent;
      const press = (what) => zoom.querySelector(`[data-do=${what}]`).click();
      const lines = () => Object.fromEntries([...zoom.querySelectorAll("[data-key]")].filter((p) => !p.hidden)
        .map((p) => [p.dataset.key, p.querySelector(".line").getAttribute("d")]));
      note(zoom.querySelector(".moves").hidden); note(lines());
      press("all"); note(said());
      press("worst"); note(lines()); const there = said();
      press("in"); press("out"); note(said() === there); press("right"); note(said() === there);
      zoom.querySelector("input").value = "20"; press("go"); note(said());
    """
    (hidden, drawn, whole, again, same, moved, gone), errors = seen(page, tmp_path, deeds)
    assert errors == [] and hidden is False and same is True and moved is False
    assert drawn.keys() == first.keys() and drawn == again
    for key, path in first.items():
        np.testing.assert_allclose(points(drawn[key]), points(path), atol=0.11, err_msg=key)
    assert recording.label(0) in whole and recording.label(len(recording.time) - 1) in whole and gone != whole


@pytest.fixture(scope="module")
def long_page(tmp_path_factory):
    """The page of 60 000 samples: kept in bins of a few, but for those around an alarm."""
    status = np.full(60_000, CONSISTENT, np.int8)
    status[0], status[30_000:30_040] = MISSING, FAULT
    res = synthetic(status)
    object.__setattr__(res, "y", np.random.default_rng(0).uniform(-8, 8, (60_000, 2)))
    return page_of(tmp_path_factory.mktemp("long"), res, recording_of(res), res.alarms())


ZOOM = """
  const zoom = document.getElementById("zoom"), field = zoom.querySelector("input");
  const wrong = zoom.querySelector(".wrong");
  const said = () => zoom.querySelector(".said").textContent;
  const press = (what) => zoom.querySelector(`[data-do=${what}]`).click();
  const go = (x) => { field.value = x; press("go"); };
  const path = (key) => zoom.querySelector(`[data-key=${key}] .line`).getAttribute("d");
"""


def test_far_from_alarms_the_bins_are_drawn_and_said(long_page, tmp_path):
    deeds = """
      go("200"); note(path("s0")); note(said());
      for (let i = 0; i < 9; i++) press("in");
      note(path("s0")); press("all"); note(path("s0"));
    """
    (some, text, deep, whole), errors = seen(long_page, tmp_path, ZOOM + deeds)
    assert errors == [] and "lowest and the highest of 6 samples" in text
    for drawn in (some, deep, whole):
        assert "L" not in drawn and drawn.count("M") == 1 and drawn.endswith("Z")
    assert points(deep)[:, 0].min() <= 0 and points(deep)[:, 0].max() >= 1000  # the bins there fill the chart
    assert points(whole)[:, 0].min() == 0 and points(whole)[:, 0].max() == 1000


def test_a_line_goes_from_edge_to_edge_and_not_beyond(long_page, tmp_path):
    deeds = """
      press("worst"); for (let i = 0; i < 9; i++) press("in");
      note(path("s0")); note(getComputedStyle(zoom.querySelector("svg")).clipPath);
    """
    (drawn, clip), errors = seen(long_page, tmp_path, ZOOM + deeds)
    across = points(drawn)[:, 0]
    assert (
        errors == [] and 4 <= drawn.count("L") <= 8 and across.min() <= 0 and across.max() >= 1000
    )  # the line goes on at both sides
    assert clip.startswith("inset(")


def tried(texts):
    """Return deeds that note of each time typed into the field: whether the chart moved, and what is said
    beside the field.
    """
    each = """{
      press("worst"); press("in");
      const before = said();
      go(text); note([said() !== before, wrong.hidden ? "" : wrong.textContent]);
    }"""
    return f"{ZOOM} for (const text of {json.dumps(texts)}) {each}"


def test_a_time_that_is_none_of_the_recording_is_said_beside_the_field(long_page, tmp_path):
    found, errors = seen(
        long_page, tmp_path, tried(["200", "200 s", "tomorrow", "", "12 apples", "1e9", "-5", "NaN", "1,5"])
    )
    refused = [False, "this is no time of the recording, which goes from 0 s to 599.99 s"]
    assert errors == [] and found == [[True, ""]] * 2 + [refused] * 7


def test_a_date_of_the_recording_is_found_and_another_refused(tmp_path):
    good = ["2024-02-29 12:00:00", "2024-03-01", "2024-03-01T01:00"]
    bad = [
        "noon",
        "2024-13-01 00:00:00",
        "2024-02-30 12:00",
        "2024-02-29 12:00:00 99",
        "2023-02-28",
        "99",
        "",
        "2024-02-29 12h",
    ]
    res = synthetic([MISSING] + [CONSISTENT] * 299)
    stamps = np.datetime64("2024-02-28T22:30") + np.arange(300) * np.timedelta64(10, "m")
    page = page_of(
        tmp_path, res, Recording(res.u, res.y, time=600.0 * np.arange(300), stamps=stamps, index=stamps), []
    )
    found, errors = seen(page, tmp_path, tried(good + bad))
    refused = [
        False,
        "this is no time of the recording, which goes from 2024-02-28 22:30:00 to 2024-03-02 00:20:00",
    ]
    assert errors == [] and found == [[True, ""]] * len(good) + [refused] * len(bad)


def test_a_table_of_units_is_filtered_and_sorted(tmp_path):
    page = fleet(tmp_path)
    units = re.findall(r'<tr data-verdict="([^"]*)"', page)
    deeds = """
      const rows = () => [...document.querySelectorAll("#units tbody tr")];
      const filter = document.getElementById("filter");
      const choose = (v) => {
        const s = filter.querySelector("select"); s.value = v; s.dispatchEvent(new Event("change"));
      };
      note(filter.hidden); choose("fault");
      note(rows().filter((r) => !r.hidden).map((r) => r.dataset.verdict));
      choose(""); const head = document.querySelectorAll("#units th button")[3];
      const keys = () => rows().map((r) => Number(r.cells[3].dataset.key));
      head.click(); note(keys()); head.click(); note(keys());
      note(filter.querySelector(".said").textContent);
    """
    (hidden, faults, down, up, said), errors = seen(page, tmp_path, deeds)
    assert (
        errors == [] and hidden is False and set(faults) <= {"fault"} and len(faults) == units.count("fault")
    )
    assert (
        down == sorted(down, reverse=True)
        and up == sorted(up)
        and said.startswith(f"{len(units)} of {len(units)}")
    )
