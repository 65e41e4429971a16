"""The scripts of pages in a real browser: what they draw is what Python drew, buttons do what they say, nothing fails in silence."""

import html
import json
import re
import shutil
import subprocess

import numpy as np
import pytest
from result_case import biased
from test_charts import page_of
from test_pages import fleet

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = [pytest.mark.slow, pytest.mark.skipif(BROWSER is None, reason="no browser on this machine")]


def seen(page, folder, deeds):
    """Return what a script `deeds` noted down on a page with note(value), and the errors of the page."""
    watch = "<script>const errors = [], notes = [], note = (x) => notes.push(x);"
    watch += "addEventListener('error', (e) => errors.push(e.message));</script>"
    told = "addEventListener('load', () => { document.title = JSON.stringify([notes, errors]); });"
    page = page.replace("<head>", f"<head>{watch}", 1).replace("</body>", f"<script>{deeds}\n{told}</script></body>", 1)
    (folder / "watched.html").write_text(page)
    command = [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=3000", "--dump-dom",
               f"--user-data-dir={folder / 'browser'}", (folder / "watched.html").as_uri()]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    return json.loads(html.unescape(re.search(r"<title>(.*?)</title>", done.stdout, re.S)[1]))


def points(path):
    """Return the corners (k, 2) of a path of M, L and V."""
    x, found = 0.0, []
    for letter, numbers in re.findall(r"([MLV])([-\d. ]+)", path):
        values = [float(v) for v in numbers.split()]
        x = x if letter == "V" else values[0]
        found.append((x, values[-1]))
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


def test_a_table_of_units_is_filtered_and_sorted(tmp_path):
    page = fleet(tmp_path)
    units = re.findall(r'<tr data-verdict="([^"]*)"', page)
    deeds = """
      const rows = () => [...document.querySelectorAll("#units tbody tr")], filter = document.getElementById("filter");
      const choose = (v) => { const s = filter.querySelector("select"); s.value = v; s.dispatchEvent(new Event("change")); };
      note(filter.hidden); choose("fault"); note(rows().filter((r) => !r.hidden).map((r) => r.dataset.verdict));
      choose(""); const head = document.querySelectorAll("#units th button")[3];
      const keys = () => rows().map((r) => Number(r.cells[3].dataset.key));
      head.click(); note(keys()); head.click(); note(keys());
      note(filter.querySelector(".said").textContent);
    """
    (hidden, faults, down, up, said), errors = seen(page, tmp_path, deeds)
    assert errors == [] and hidden is False and set(faults) <= {"fault"} and len(faults) == units.count("fault")
    assert down == sorted(down, reverse=True) and up == sorted(up) and said.startswith(f"{len(units)} of {len(units)}")
