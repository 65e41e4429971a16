"""Charts of a report: what they draw is what was recorded and violated, at any length, in times as they were
written, for every reader.
"""

import base64
import json
import re
from datetime import datetime, timedelta
from pathlib import Path
from xml.etree import ElementTree

import jax
import numpy as np
import pytest
from result_case import CONSISTENT, FAULT, MISSING, biased, recording_of, synthetic

import jaxbound as jb
from jaxbound import reports
from jaxbound.certificates.exact_window import exact_window
from jaxbound.plots.combination import combination, expected_readings
from jaxbound.recordings.recording import Recording
from jaxbound.reports.chart import VALUES, band_key, piece_of
from jaxbound.reports.clock import clock_of
from jaxbound.reports.detection import write_report
from jaxbound.runs.summary import summarised

STYLE = (Path(reports.__file__).parent / "style.css").read_text()


def page_of(folder, res, recording, alarms):
    write_report(folder / "report.html", res, recording, alarms, summarised(res, alarms, recording.label))
    return (folder / "report.html").read_text()


def numbers_of(page):
    found = json.loads(
        re.search(r'<script type="application/json" id="numbers">(.*?)</script>', page, re.S)[1]
    )
    decode = lambda text: np.frombuffer(base64.b64decode(text), "<f4")
    return found, decode


@pytest.fixture(scope="module")
def run():
    return biased()


@pytest.fixture(scope="module")
def page(run, tmp_path_factory):
    return page_of(tmp_path_factory.mktemp("page"), run[0], run[1], run[0].alarms())


class TestCombination:
    def test_it_is_that_of_exact_fractions_in_every_window(self, rng):
        """Tolerance, noise, resolution, offset, disturbance and an input: each enters, in each window, as
        `exact_window` has it.
        """
        m = jb.LinearSystem(
            [["0.8", 1], [0, "0.2"]],
            [[0], [1]],
            [[1, 0], [1, 1]],
            tolerance=["0.02", "0.1"],
            noise="0.1",
            resolution="0.05",
            disturbance=([[1], [0]], [[-0.1, 0.3]]),
            offset={"y": [3, 0], "u": [1]},
        )
        r = jb.parity_relations(m, 2)
        u, y = rng.normal(size=(12, 1)), 5 * rng.normal(size=(12, 2))
        y[9, 0] = np.nan
        res = jb.detect(r, u, y)
        c = res.explain(int(np.nanargmin(res.margin[:9])))
        value, width = combination(c, u, y)
        for k in range(2, 9):
            _, residual, allowed = exact_window(r, u[k - 2 : k + 1], y[k - 2 : k + 1]).relation(c.h)
            assert (
                abs(value[k] - float(residual)) < 1e-12 * abs(value[k]) + 1e-12
                and abs(width[k] / float(allowed) - 1) < 1e-12
            )
        assert (
            np.isnan(value[:2]).all()
            and np.isnan(value[9]) == any(c.h[4:5])
            and np.isnan(width[np.isnan(value)]).all()
        )

    def test_what_is_drawn_around_an_alarm_leaves_its_bounds_there(self, run, page):
        """In the worst window of each alarm, by as much as the bounds needed."""
        res, alarms = run[0], run[0].alarms()
        found, decode = numbers_of(page)
        seen = {}
        for near in found["near"]:
            for i, relation, share in near["combined"]:
                worst = next(row[3] for row in found["alarms"] if row[0] == i)
                k = round((worst - near["x"][0]) / near["x"][1])
                seen[i] = abs(decode(share)[k])
                assert relation == res.explain(alarms[i].worst).relation
        assert sorted(seen) == list(range(len(alarms))) and len(alarms) == 3
        for i, share in seen.items():
            assert share > 1 and abs(share - (1 - alarms[i].depth)) < 1e-5 * share

    def test_it_leaves_its_bounds_where_every_residual_alone_stays_inside(self, run):
        res = run[0]
        allowed = res.relations.internal(res.u, res.y)
        inside = (
            abs(np.asarray(res.relations.external(res.u, res.y)) - allowed.mid) < 0.99 * allowed.rad
        ).all(1)
        hidden = np.flatnonzero(inside & (res.status == FAULT))
        assert len(hidden)
        for k in hidden[:3]:
            value, width = combination(res.explain(int(k)), res.u, res.y)
            assert abs(value[k]) > width[k]

    def test_a_healthy_recording_shows_its_tightest_combination(self, tmp_path):
        m = jb.LinearSystem([[0.5]], [[1]], [[1]], noise=0.1)
        res = jb.detect(
            jb.parity_relations(m), np.zeros((50, 1)), 0.05 * np.random.default_rng(0).uniform(-1, 1, (50, 1))
        )
        text = page_of(tmp_path, res, recording_of(res), [])
        found, decode = numbers_of(text)
        ((i, relation, share),) = found["near"][0]["combined"]
        assert (
            i == -1
            and "around the tightest window" in text
            and abs(np.nanmax(abs(decode(share))) - (1 - np.nanmin(res.margin))) < 1e-6
        )

    def test_uncertain_parameters_show_each_relation(self, tmp_path):
        m = jb.LinearSystem([[0.5]], [[1]], [[1]], noise=0.1, uncertainties=[jb.Uncertainty("p", A=[[0.05]])])
        y = np.zeros((9, 1))
        y[5] = 9
        res = jb.detect(jb.parity_relations(m, 1), np.zeros((9, 1)), y)
        found, decode = numbers_of(page_of(tmp_path, res, recording_of(res), res.alarms()))
        share = decode(found["near"][0]["series"]["c0"][0])
        assert np.isnan(share[0]) and abs(share[5]) > 1 > abs(share[3])


class TestRecorded:
    def test_signals_and_verdicts_are_in_the_page_as_recorded(self, run, page):
        found, decode = numbers_of(page)
        whole = found["whole"]
        np.testing.assert_array_equal(decode(whole["series"]["s0"][0]), run[0].y[:, 0].astype(np.float32))
        np.testing.assert_array_equal(decode(whole["series"]["s2"][0]), run[0].u[:, 0].astype(np.float32))
        assert whole["status"] == "".join(map(str, run[0].status)) and all(
            f">{name}" in page for name in ("y1", "y2", "u1")
        )

    def test_long_recordings_keep_every_extreme_in_a_page_of_bounded_size(self, tmp_path):
        T = 60_000
        status = np.full(T, CONSISTENT, np.int8)
        status[0], status[3_000:T:4_321] = MISSING, FAULT
        res = synthetic(status)
        y = np.zeros((T, 2))
        y[54_321, 1] = 7
        object.__setattr__(res, "y", y)
        alarms = res.alarms()
        text = page_of(tmp_path, res, recording_of(res), alarms)
        found, decode = numbers_of(text)
        whole = found["whole"]
        assert (
            sum(decode(z).size for both in whole["series"].values() for z in both) <= VALUES
            and len(text) < 800_000
        )
        assert decode(whole["series"]["s1"][1]).max() == 7 and whole["status"].count("3") == len(alarms)
        assert len(found["near"]) == len(found["alarms"]) == len(alarms)

    @pytest.mark.parametrize("T", [200_000, pytest.param(1_000_000, marks=pytest.mark.long)])
    def test_a_million_rows_and_200_alarms_are_one_megabyte(self, T, tmp_path):
        status = np.full(T, CONSISTENT, np.int8)
        status[0], status[3_000 :: T // 230] = MISSING, FAULT
        res = synthetic(status)
        object.__setattr__(res, "y", np.random.default_rng(0).normal(size=(T, 2)))
        alarms = res.alarms()
        size = len(page_of(tmp_path, res, recording_of(res), alarms))
        print(f"{size} bytes for {T} rows")
        assert len(alarms) > 200 and size < 1_300_000

    def test_a_bin_holds_every_extreme_of_its_samples(self, rng):
        y, most = rng.normal(size=60_000), 1000
        piece = piece_of(np.arange(60_000.0), np.ones(60_000, np.int8), {"s0": y}).reduced(most)
        assert piece.binned and len(piece.x) == most and piece.x[0] == 0
        edges = np.append(piece.x.astype(int), 60_000)
        for k in range(most):
            held = y[edges[k] : edges[k + 1]]
            assert (piece.low["s0"][k], piece.high["s0"][k]) == (held.min(), held.max())

    def test_samples_that_fit_in_a_page_are_kept_one_by_one(self):
        piece = piece_of(np.arange(4000.0), np.ones(4000, np.int8), {"s0": np.arange(4000.0)}).fitting()
        assert not piece.binned and len(piece.cut(0, 60).x) == 60
        many = piece_of(np.arange(VALUES + 1.0), np.ones(VALUES + 1), {"s0": np.zeros(VALUES + 1)}).fitting()
        assert many.binned and 2 * len(many.x) <= VALUES

    def test_a_clock_that_goes_back_is_counted_in_samples(self, tmp_path):
        res = synthetic([MISSING] + [CONSISTENT] * 20)
        time = np.r_[0:15, 3:9].astype(float)
        text = page_of(tmp_path, res, Recording(res.u, res.y, time=time), [])
        assert numbers_of(text)[0]["clock"]["before"] == "sample " and "sample 0 to sample 20" in text


WRITTEN = (
    "%Y-%m-%d %H:%M:%S",
    "%d.%m.%Y %H:%M",
    "%m/%d/%Y %H:%M",
    "%-m/%-d/%Y %-H:%M",
    "%Y-%m-%dT%H:%M:%SZ",
    "%Y-%m-%d %H:%M:%S+01:00",
)


@pytest.mark.parametrize("form", WRITTEN)
def test_axes_have_times_as_they_were_written(form):
    begin, zone = datetime(2024, 2, 29, 22, 30), timedelta(hours=1) if "+01" in form else timedelta(0)
    time = np.arange(300) * 600.0
    label = lambda k: (begin + zone + timedelta(seconds=float(time[k]))).strftime(form)
    clock = clock_of(label, time, np.datetime64(begin, "ns"), 300, 600.0)
    assert [clock.text(x) for x in time] == [label(k) for k in range(300)]


@pytest.mark.parametrize("step, text", [(0.01, "2.5 s"), (60.0, "15000 s")])
def test_seconds_stay_seconds(step, text):
    time = np.arange(300) * step
    clock = clock_of(
        Recording(np.zeros((300, 1)), np.zeros((300, 1)), time=time).label, time, None, 300, step
    )
    assert clock.text(float(text.removesuffix(" s"))) == text


def test_a_clock_without_a_date_and_words_for_months():
    time = np.arange(300) * 60.0
    hour = lambda k: f"{(8 + k // 60) % 24:02d}:{k % 60:02d}:00"
    assert clock_of(hour, time, None, 300, 60.0).text(3600.0) == "09:00:00"
    month = lambda k: (datetime(2024, 3, 1) + timedelta(minutes=k)).strftime("%d-%b-%Y %H:%M")
    assert clock_of(month, time, np.datetime64("2024-03-01"), 300, 60.0).text(3600.0) == "2024-03-01 01:00:00"


def palettes():
    """Return {medium: {name: colour}} of the style sheet."""
    blocks = re.findall(r"(@media ([^{]*)\{ )?:root \{([^}]*)\}", STYLE)
    light = dict(re.findall(r"--(\w+): (#\w+)", blocks[0][2]))
    return {
        medium or "light": light | dict(re.findall(r"--(\w+): (#\w+)", body)) for _, medium, body in blocks
    }


def contrast(a, b):
    """Return the ratio of two colours. Source: WCAG 2.2, relative luminance."""

    def luminance(text):
        text = "".join(c + c for c in text[1:]) if len(text) == 4 else text[1:]
        parts = [int(text[i : i + 2], 16) / 255 for i in (0, 2, 4)]
        return np.dot(
            [0.2126, 0.7152, 0.0722],
            [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts],
        )

    dark, bright = sorted((luminance(a), luminance(b)))
    return (bright + 0.05) / (dark + 0.05)


@pytest.mark.parametrize("medium", palettes())
def test_colours_are_told_apart_on_screen_in_the_dark_and_in_grey(medium):
    colours = palettes()[medium]
    assert len(palettes()) == 3 and contrast(colours["FAULT"], colours["CONSISTENT"]) >= 3
    for text in ("ink", "soft", "accent", "fault", "ok", "open", "none"):
        for ground in ("page", "card"):
            assert contrast(colours[text], colours[ground]) >= 4.5, (text, ground)
    assert (
        contrast(colours["curve"], colours["shade"]) >= 4.5
        and contrast(colours["curve"], colours["allowed"]) >= 4.5
    )
    assert contrast(colours["FAULT"], colours["page"]) >= 3


def test_pictures_have_the_colours_of_the_pages():
    from jaxbound.plots.canvas import COLOURS

    assert {status.name: colour for status, colour in COLOURS.items()} == {
        s.name: palettes()["light"][s.name] for s in jb.Status
    }


def test_a_reader_without_eyes_or_mouse_gets_everything(page):
    assert all('alt="' in img for img in re.findall("<img[^>]*>", page)) and "<svg" not in page
    heads = re.findall("<th[^>]*>", page)
    assert heads and all("scope=" in head for head in heads if head != "<thead>")
    for target in set(re.findall('href="#([^"]*)"', page)):
        assert f'id="{target}"' in page
    assert '<figure id="zoom" tabindex="0"' in page and page.count("data-alarm=") == page.count("<option")
    assert page.index("data-alarm=") > page.index(
        'id="numbers"'
    )  # below the script, which must not look for links while it is read
    assert 'querySelectorAll("a[data-alarm]")' not in page
    buttons = re.findall("<button[^>]*>([^<]*)", page)
    assert len(buttons) == 9 and all('type="button"' in b for b in re.findall("<button[^>]*>", page))


def test_without_its_script_a_page_shows_one_picture_of_the_whole(page, run):
    plain = re.sub("<script.*?</script>", "", page, flags=re.S)
    worst = min(run[0].alarms(), key=lambda a: a.depth)
    assert f"around alarm {run[0].alarms().index(worst) + 1}: " in plain and 'class="moves" hidden' in plain
    (picture,) = re.findall(r'<noscript><img alt="([^"]+)" src="data:image/svg.xml;base64,([^"]+)">', plain)
    assert "margin of every window" in picture[0]
    drawn = ElementTree.fromstring(base64.b64decode(picture[1]))
    texts = [text.text for text in drawn.iter("{http://www.w3.org/2000/svg}text")]
    assert f"{len(run[0].alarms())} alarms" in texts and len(picture[1]) < 80_000


def test_a_band_of_which_nothing_is_left_is_not_drawn():
    band = jb.Interval(np.array([0.0, 2.0, -np.inf, 0.0]), np.array([1.0, 1.0, np.inf, 1.0]))
    piece = piece_of(np.arange(4), np.zeros(4, np.int8), {"s0": np.zeros(4)}, {band_key("s0"): band})
    assert (
        np.isnan(piece.low["s0:band"]).tolist()
        == np.isnan(piece.high["s0:band"]).tolist()
        == [False, True, True, False]
    )


class TestExpected:
    """What windows expect of each reading, as observers do."""

    @pytest.fixture
    def case(self):
        m = jb.LinearSystem(
            [["0.8", 1], [0, "0.2"]],
            [[0], [1]],
            [[1, 0], [1, 1]],
            tolerance=["0.02", "0.1"],
            noise="0.1",
            disturbance=([[1], [0]], [[-0.1, 0.3]]),
            offset={"y": [3, 0], "u": [1]},
        )
        t = jb.simulate(m, np.ones((40, 1)) + np.arange(40)[:, None] % 3, jax.random.key(1))
        return jb.parity_relations(m, 3), np.asarray(t.u), np.asarray(t.y)

    def test_a_reading_is_explained_by_its_window_inside_the_band_and_not_outside(self, case):
        relations, u, y = case
        band = expected_readings(relations, u, y)
        assert np.isnan(band.lo[:3]).all() and (band.lo[3:] <= y[3:]).all() and (y[3:] <= band.hi[3:]).all()
        windows = []  # (inputs, outputs, what they are)
        for k in range(3, 40, 5):
            for i in range(2):
                size = band.hi[k, i] - band.lo[k, i]
                for end, out in ((band.lo[k, i], -1), (band.hi[k, i], 1)):
                    for step, expected in ((out, FAULT), (-out, CONSISTENT)):
                        window = y[k - 3 : k + 1].copy()
                        window[3, i] = end + 1e-4 * step * size
                        windows.append((u[k - 3 : k + 1], window, expected))
        inputs, outputs, expected = map(np.array, zip(*windows, strict=True))
        assert len(expected) == 64
        np.testing.assert_array_equal(jb.detect(relations, inputs, outputs).status[:, 3], expected)

    def test_a_missing_sample_has_a_band_and_spoils_those_that_need_it(self, case):
        relations, u, y = case
        y = y.copy()
        y[20, 0] = np.nan
        band, whole = expected_readings(relations, u, y), expected_readings(relations, u, case[2])
        assert whole.lo[20, 0] == pytest.approx(band.lo[20, 0]) and not np.isnan(band.hi[20, 0])
        assert (np.nan_to_num(band.lo[21], nan=-np.inf) <= whole.lo[21] + 1e-12).all()

    def test_a_page_has_measured_and_expected(self, page, run):
        found, decode = numbers_of(page)
        piece, row = found["whole"], found["rows"][2]
        lo, hi = (decode(end) for end in piece["series"]["s0:band"])
        y = decode(piece["series"]["s0"][0])
        inside = (lo <= y) & (y <= hi)
        judged = np.isfinite(lo) & (run[0].status == CONSISTENT)
        assert row["name"] == "y1" and judged.sum() > 200 and inside[judged].all()
        assert (~inside & (run[0].status == FAULT)).any() and "where a healthy reading lies" in page

    def test_a_recording_shorter_than_a_window_expects_nothing(self, run):
        res = run[0]
        band = expected_readings(res.relations, res.u[:1], res.y[:1])
        assert np.isnan(band.lo).all() and np.isnan(band.hi).all()
