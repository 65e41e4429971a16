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
from systems import paper
from test_charts import page_of
from test_pages import fleet
from validated_case import found_in
from validated_case import recording_of as validated

import jaxbound as jb
from jaxbound.recordings.recording import Recording
from jaxbound.reports.study import study_page
from jaxbound.reports.validation import write_page
from jaxbound.runs.summary import summarised

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = pytest.mark.skipif(BROWSER is None, reason="no browser on this machine")


WATCH = """
const errors = [], notes = [], note = (x) => notes.push(x), charts = [];
addEventListener("error", (e) => errors.push(e.message));
let library;
Object.defineProperty(window, "uPlot", { get: () => library, set: (found) => {
  library = new Proxy(found, { construct: (kind, args) => {
    charts.push(new kind(...args));
    return charts.at(-1);
  } });
} });
const chart = (id, key) => charts.find(({ root }) => root.closest(`#${id} [data-key=${key}]`));
const settled = () => new Promise((done) => setTimeout(done, 30));
const rgb = (c, x, y) => [...c.ctx.getImageData(Math.round(x), Math.round(y), 1, 1).data].slice(0, 4);
const named = (name) => { // the colour of a name as a canvas has it
  const c = document.createElement("canvas").getContext("2d");
  c.fillStyle = getComputedStyle(document.documentElement).getPropertyValue(`--${name}`);
  c.fillRect(0, 0, 1, 1);
  return [...c.getImageData(0, 0, 1, 1).data];
};
const over = (c) => c.root.querySelector(".u-over");
const client = (c, t) => over(c).getBoundingClientRect().left + c.valToPos(t, "x");
const at = (c, t) => ({ bubbles: true, cancelable: true, button: 0, movementX: 9, clientX: client(c, t),
  clientY: over(c).getBoundingClientRect().top + 20 });
const mouse = (c, kind, t, to = over(c)) => to.dispatchEvent(new MouseEvent(kind, at(c, t)));
"""


def seen(page, folder, deeds):
    """Return what a script `deeds` noted down on a page with note(value), and the errors of the page."""
    ended = "document.title = JSON.stringify([notes, errors]);"
    told = f"(async () => {{ {deeds} }})().catch((e) => errors.push(String(e))).then(() => {{ {ended} }});"
    page = page.replace("<head>", f"<head><script>{WATCH}</script>", 1)
    head, body, tail = page.rpartition("</body>")
    (folder / "watched.html").write_text(f"{head}<script>{told}</script>{body}{tail}")
    command = [
        BROWSER,
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--window-size=1280,1000",
        "--virtual-time-budget=5000",
        "--dump-dom",
        f"--user-data-dir={folder / 'browser'}",
        (folder / "watched.html").as_uri(),
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    return json.loads(html.unescape(re.search(r"<title>(.*?)</title>", done.stdout, re.S)[1]))


ZOOM = """
  const zoom = document.getElementById("zoom"), field = zoom.querySelector("input");
  const wrong = zoom.querySelector(".wrong");
  const said = () => zoom.querySelector(".said").textContent;
  const press = (what) => zoom.querySelector(`[data-do=${what}]`).click();
  const go = (x) => { field.value = x; press("go"); };
  const shown = (c) => [c.scales.x.min, c.scales.x.max];
  const value = (c) => c.root.closest(".panel").querySelector(".value").textContent;
"""


@pytest.fixture(scope="module")
def run():
    """Return (result, recording) of the paper's system with a bias."""
    return biased()


@pytest.fixture(scope="module")
def page(run, tmp_path_factory):
    return page_of(tmp_path_factory.mktemp("page"), run[0], run[1], run[0].alarms())


@pytest.fixture(scope="module")
def long_page(tmp_path_factory):
    """Return the page of a recording whose overview is bins, with one alarm in its middle."""
    status = np.full(60_000, CONSISTENT, np.int8)
    status[0], status[30_000:30_040] = MISSING, FAULT
    res = synthetic(status)
    object.__setattr__(res, "y", np.random.default_rng(0).uniform(-8, 8, (60_000, 2)))
    return page_of(tmp_path_factory.mktemp("long"), res, recording_of(res), res.alarms())


def test_the_zoom_goes_where_it_is_told_and_draws_what_was_recorded(run, page, tmp_path):
    res, recording = run
    deeds = """
      note(zoom.querySelector(".moves").hidden);
      press("worst"); const there = said(); note(there);
      press("in"); press("out"); note(said() === there); press("right"); note(said() === there);
      go("1.2"); note(said()); press("all"); note(said());
      await settled();
      const c = chart("zoom", "s0"); note(shown(c)); note(c.data[3].slice(0, 300));
      zoom.focus();
      zoom.dispatchEvent(new KeyboardEvent("keydown", { key: "+" })); await settled(); note(shown(c));
      zoom.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowLeft" })); await settled(); note(shown(c));
    """
    found, errors = seen(page, tmp_path, ZOOM + deeds)
    hidden, worst, same, moved, gone, whole, ends, drawn, closer, left = found
    assert errors == [] and hidden is False and same is True and moved is False
    assert worst.startswith("around alarm 3: ") and "1.2 s" not in gone and gone != whole
    assert whole == f"{recording.label(0)} to {recording.label(299)}" and ends == pytest.approx([0, 2.99])
    np.testing.assert_array_equal(np.float32(drawn), np.float32(res.y[:, 0]))
    assert closer[1] - closer[0] == pytest.approx(2.99 / 2) and left[0] == pytest.approx(0, abs=1e-9 + 0.375)


def test_hover_shows_the_value_of_the_sample_under_the_pointer(run, page, tmp_path):
    res, recording = run
    deeds = """
      const c = chart("zoom", "s0");
      mouse(c, "mousemove", 1.363); await settled();
      note(["s0", "s1", "s2", "verdicts"].map((key) => value(chart("zoom", key))));
      mouse(c, "mouseleave", 1.363); await settled(); note(value(c));
    """
    (values, gone), errors = seen(page, tmp_path, ZOOM + deeds)
    assert errors == [] and gone == ""
    shown = [float(text.split(",")[0]) for text in values[:3]]
    np.testing.assert_allclose(shown, [*res.y[136], res.u[136, 0]], rtol=1e-5)
    assert (
        values[3] == f"FAULT at {recording.label(136)}" and "expected" in values[0] and "," not in values[2]
    )


def test_hover_over_bins_shows_their_extremes(long_page, tmp_path):
    deeds = """
      press("all"); await settled();
      const c = chart("zoom", "s0"); mouse(c, "mousemove", 250.0); await settled(); note(value(c));
    """
    ((text,), errors) = seen(long_page, tmp_path, ZOOM + deeds)
    low, high = map(float, text.split(" to "))
    assert errors == [] and -8 <= low < high <= 8


def test_the_wheel_zooms_about_the_pointer_and_scrolls_the_page_otherwise(page, tmp_path):
    deeds = """
      const c = chart("zoom", "s1"), before = shown(c);
      const turn = (more) => {
        const e = new WheelEvent("wheel", { ...at(c, 1.4), deltaY: -100, ...more });
        over(c).dispatchEvent(e);
        return e.defaultPrevented;
      };
      note(turn()); await settled(); note(shown(c)); note(before);
      const place = c.valToPos(1.4, "x");
      note(turn({ ctrlKey: true })); await settled(); note(shown(c)); note([place, c.valToPos(1.4, "x")]);
      zoom.focus(); note(turn({ deltaY: 300 })); await settled(); note(shown(c));
    """
    found, errors = seen(page, tmp_path, ZOOM + deeds)
    scrolled, same, before, turned, closer, places, focused, wider = found
    span = lambda ends: ends[1] - ends[0]
    assert errors == [] and scrolled is False and same == before and turned is True and focused is True
    assert 0.7 < span(closer) / span(before) < 0.9 and places[0] == pytest.approx(places[1], abs=0.5)
    assert span(wider) > span(closer)


def test_fingers_keep_the_times_under_them(page, tmp_path):
    deeds = """
      const c = chart("zoom", "s0"), t = [1.2, 1.6];
      const touch = (kind, id, x) => over(c).dispatchEvent(new PointerEvent(kind,
        { bubbles: true, pointerType: "touch", pointerId: id, clientX: x }));
      const x = t.map((at) => client(c, at));
      touch("pointerdown", 1, x[0]); touch("pointerdown", 2, x[1]);
      touch("pointermove", 1, x[0] - 60); touch("pointermove", 2, x[1] + 90); await settled();
      note(t.map((at) => client(c, at))); note([x[0] - 60, x[1] + 90]);
      touch("pointerup", 1, x[0] - 60); touch("pointermove", 2, x[1] + 50); await settled();
      note([client(c, t[1]), x[1] + 50]);
    """
    (places, fingers, one), errors = seen(page, tmp_path, ZOOM + deeds)
    assert errors == [] and places == pytest.approx(fingers, abs=1) and one[0] == pytest.approx(one[1], abs=1)


def test_a_click_and_a_drag_in_the_whole_recording_show_that_time(page, tmp_path):
    deeds = """
      const whole = chart("overview", "s0"), c = chart("zoom", "s0");
      const drag = (from, to) => {
        mouse(whole, "mousemove", from);
        mouse(whole, "mousedown", from);
        mouse(whole, "mousemove", to);
        mouse(whole, "mouseup", to, document);
        if (from === to) mouse(whole, "click", to);
      };
      drag(2.0, 2.0); await settled(); note((shown(c)[0] + shown(c)[1]) / 2);
      drag(0.5, 0.8); await settled(); note(shown(c));
      const box = whole.root.querySelector(".u-select").getBoundingClientRect();
      note([box.left, box.right]); note([client(whole, 0.5), client(whole, 0.8)]);
    """
    (middle, ends, box, expected), errors = seen(page, tmp_path, ZOOM + deeds)
    assert errors == [] and middle == pytest.approx(2.0, abs=0.02)
    assert ends == pytest.approx([0.5, 0.8], abs=0.02) and box == pytest.approx(expected, abs=3)


def test_an_input_holds_until_its_next_sample(run, page, tmp_path):
    """Drawn are steps: at the old value until the new sample, none of what lies between the two."""
    u = run[0].u[:, 0]
    k = 1 + int(np.flatnonzero(np.diff(u[110:]))[0]) + 110
    deeds = f"""
      go("{0.01 * k}"); for (let i = 0; i < 4; i++) press("in"); go("{0.01 * k}"); await settled();
      const c = chart("zoom", "s2"), [a, b] = [{u[k - 1]}, {u[k]}];
      const x = c.valToPos({0.01 * (k - 0.5)}, "x", true);
      const row = (v) => [-1, 0, 1].some((d) => rgb(c, x, c.valToPos(v, "y", true) + d)[3] > 120);
      note([row(a), row((a + b) / 2)]);
    """
    ((found,), errors) = seen(page, tmp_path, ZOOM + deeds)
    assert errors == [] and found == [True, False]


def test_a_band_and_a_line_beyond_their_chart_are_cut_off(run, page, tmp_path):
    deeds = """
      const c = chart("zoom", "s0"), { left, top, width, height } = c.bbox;
      const p = c.data[0].findIndex((t, i) => t > c.scales.x.min + 0.1 && c.data[1][i] !== null);
      const middle = (c.data[1][p] + c.data[2][p]) / 2, size = (c.data[2][p] - c.data[1][p]) / 2;
      c.setScale("y", { min: middle - 0.3 * size, max: middle + 0.3 * size }); await settled();
      const x = c.valToPos(c.data[0][p], "x", true);
      const inside = [0.1, 0.3, 0.7, 0.9].map((part) => rgb(c, x, top + part * height));
      const outside = [-3, -2, height + 2, height + 3].map((d) => rgb(c, x, top + d));
      note(named("allowed")); note(inside); note(outside.map((z) => z[3]));
    """
    (allowed, inside, outside), errors = seen(page, tmp_path, ZOOM + deeds)
    assert errors == [] and sum(z == allowed for z in inside) >= 3 and outside == [0, 0, 0, 0]


def test_what_is_shaded_with_a_combination_is_proved_by_it(page, tmp_path):
    deeds = """
      press("worst"); await settled();
      const c = chart("zoom", "combination"), shade = String(named("shade")), { top } = c.bbox;
      note(c.data[0].map((t, i) => [c.data[3][i], t]).filter(([v]) => v !== null)
        .map(([v, t]) => [v, String(rgb(c, c.valToPos(t, "x", true) + 0.5, top + 3)) === shade]));
    """
    ((points,), errors) = seen(page, tmp_path, ZOOM + deeds)
    clear = [(abs(v) > 1, shaded) for v, shaded in points[2:-2] if abs(v) < 3.5]
    assert errors == [] and {proved for proved, _ in clear} == {True, False}
    assert all(proved == shaded for proved, shaded in clear)


@pytest.mark.parametrize("worst", [-3.0, -1e6, -np.inf])
def test_a_huge_excursion_does_not_flatten_the_rest(worst, tmp_path):
    status = np.full(200, CONSISTENT, np.int8)
    status[0], status[100] = MISSING, FAULT
    margin = np.where(status == FAULT, worst, 0.5)
    res = synthetic(status, margin)
    text = page_of(tmp_path, res, recording_of(res), res.alarms())
    deeds = """
      const c = chart("overview", "margin");
      note([c.valToPos(1, "y"), c.valToPos(0, "y"), c.bbox.height / devicePixelRatio]); note(c.scales.y.min);
    """
    ((one, zero, height), least), errors = seen(text, tmp_path, deeds)
    assert errors == [] and zero - one > 0.04 * height and least <= max(worst, -1e15)


def test_nothing_is_drawn_over_a_gap(tmp_path):
    res = synthetic([MISSING] + [CONSISTENT] * 99)
    time = np.r_[0:50, 500:550].astype(float)
    text = page_of(tmp_path, res, Recording(res.u, res.y, time=time), [])
    deeds = """
      for (const key of ["s0", "s2", "margin"]) {
        const c = chart("overview", key), y = c.valToPos(key === "margin" ? 0.5 : 0, "y", true);
        const dark = ([, , blue, alpha]) => alpha > 120 && blue < 150;
        const on = (t) => [-1, 0, 1].some((d) => dark(rgb(c, c.valToPos(t, "x", true), y + d)));
        note([on(20), on(250), on(520)]);
      }
      const c = chart("overview", "s0"); mouse(c, "mousemove", 250); await settled();
    """
    found, errors = seen(text, tmp_path, deeds)
    assert errors == [] and found == [[True, False, True]] * 3


def test_a_printer_gets_its_own_colours_and_the_screen_its_own_again(page, tmp_path):
    deeds = """
      const c = chart("overview", "margin"), i = c.data[5].findIndex((v) => v !== null) + 2;
      const bottom = c.bbox.top + c.bbox.height;
      const shade = () => rgb(c, c.valToPos(c.data[0][i], "x", true), bottom - 4).slice(0, 3);
      note(shade()); dispatchEvent(new Event("beforeprint")); await settled(); note(shade()); note(c.width);
      dispatchEvent(new Event("afterprint")); await settled(); note(shade()); note(c.width);
    """
    (screen, paper, narrow, again, wide), errors = seen(page, tmp_path, deeds)
    assert errors == [] and paper == [0xDD] * 3 and screen == again != paper and narrow == 680 < wide


def test_far_from_alarms_the_bins_are_drawn_and_said(long_page, tmp_path):
    deeds = """
      go("200"); note(said());
      for (let i = 0; i < 9; i++) press("in");
      await settled();
      const c = chart("zoom", "s0"), [a, b] = shown(c), inside = c.data[0].filter((t) => a <= t && t <= b);
      note(inside.length); note(c.series[3].paths === c.series[4].paths);
      const x = c.valToPos((a + b) / 2, "x", true), k = c.data[0].findLastIndex((t) => t <= (a + b) / 2);
      const low = c.valToPos(c.data[3][k], "y", true), high = c.valToPos(c.data[4][k], "y", true);
      note([0.1, 0.5, 0.9].map((part) => rgb(c, x, low + part * (high - low))[3] > 60));
      press("worst"); note(said());
    """
    (text, inside, _, filled, worst), errors = seen(long_page, tmp_path, ZOOM + deeds)
    assert errors == [] and "the lowest and the highest of " in text and inside < 40
    assert filled == [True] * 3 and "the lowest" not in worst and worst.startswith("around alarm 1: ")


def test_times_are_marked_as_the_recording_writes_them(tmp_path):
    res = synthetic([MISSING] + [CONSISTENT] * 299)
    stamps = np.datetime64("2024-02-28T22:30") + np.arange(300) * np.timedelta64(10, "m")
    recording = Recording(res.u, res.y, time=600.0 * np.arange(300), stamps=stamps, index=stamps)
    deeds = """
      const c = chart("overview", "verdicts");
      note(c.axes[0]._values.filter(Boolean)); note(c.root.closest(".plot").getAttribute("aria-label"));
    """
    (marks, label), errors = seen(page_of(tmp_path, res, recording, []), tmp_path, deeds)
    written = {str(stamp).replace("T", "\n") for stamp in stamps.astype("datetime64[s]")}
    assert errors == [] and 2 <= len(marks) <= 9 and set(marks) <= written
    assert label.endswith("from 2024-02-28 22:30:00 to 2024-03-02 00:20:00")


def test_a_table_and_every_chart_name_what_they_show(page, tmp_path):
    deeds = """
      note([...document.querySelectorAll(".plot")].filter((p) => p.offsetParent)
        .every((p) => p.getAttribute("role") === "img" && p.getAttribute("aria-label").includes(" from ")));
      note([...document.querySelectorAll(".plot")].map((p) => p.dataset.none).filter(Boolean));
    """
    (labelled, empty), errors = seen(page, tmp_path, deeds)
    assert errors == [] and labelled is True and empty == []


def test_a_study_draws_its_shares(tmp_path):
    res = jb.study(paper(), "y1:bias", 40, 0, sizes=[0.5, 1.0], samples=30)
    (tmp_path / "page").mkdir()
    deeds = "note(charts.map((c) => c.data)); note(charts.map((c) => c.bbox.width > 200));"
    (data, wide), errors = seen(study_page(res, 0, 1.0), tmp_path, deeds)
    share = res.tallies[0].share(res.confidence)
    assert errors == [] and wide == [True, True] and data[0][0] == [0.5, 1.0]
    np.testing.assert_allclose([data[0][k] for k in (3, 1, 2)], share, rtol=1e-12)


def test_a_validation_draws_bands_faulty_samples_and_what_replaces_them(tmp_path):
    res = found_in()
    write_page(tmp_path / "report.html", res, validated(res), summarised(res, res.alarms(), "{} s".format))
    deeds = """
      const c = chart("overview", "y0"), there = (k) => c.data[0].filter((t, i) => c.data[k][i] !== null);
      note([5, 6].map(there)); note(c.data[1].some((v) => v !== null));
      const y = c.data[5].find((v) => v !== null); note(c.scales.y.min < y && y < c.scales.y.max);
    """
    (marked, band, inside), errors = seen((tmp_path / "report.html").read_text(), tmp_path, deeds)
    faulty = np.flatnonzero(np.asarray(res.found.faulty)[:, 0]).tolist()
    assert errors == [] and marked == [faulty, faulty] and band is True and inside is True


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


def test_margins_below_minus_one_have_ticks(page, tmp_path):
    """Down to where the chart ends; none is drawn below it."""
    lowest = [-0.6, -1.6, -2.4, -6, -9.9, -60, -2e4]
    deeds = "const c = chart('overview', 'margin'); note(%s.map((v) => c.axes[1].splits(c, 1, v, 1.06)));"
    found, errors = seen(page, tmp_path, deeds % lowest)
    assert errors == []
    for bottom, marks in zip(lowest, *found, strict=True):
        assert marks == sorted(marks) and len(marks) >= 3 and max(marks) == 1
        assert bottom > -1 or bottom <= min(marks) < -1, (bottom, marks)
        assert min(marks) <= bottom / 10
