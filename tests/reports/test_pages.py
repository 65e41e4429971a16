"""Every page: what a user wrote is escaped exactly once, a value that is missing is refused, style sheet and
templates travel along.
"""

import hashlib
import re
import shlex
import tomllib
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace

import jinja2
import numpy as np
import pytest
from page_case import foreign

import jaxbound as jb
from jaxbound import reports
from jaxbound.reports import page
from jaxbound.reports.detection import write_report
from jaxbound.reports.fleet import fleet_page
from jaxbound.reports.study import study_page
from jaxbound.reports.validated import Validated
from jaxbound.reports.validation import write_page
from jaxbound.runs.fleet import Unit, UnitResult
from jaxbound.runs.summary import Evidence, Summary, Window, summarised
from jaxbound.sets.intervals.interval import Interval

HOME = Path(reports.__file__).parent
PNG = b"\x89PNG"


def evil(what):
    """Return a name that would end an attribute, begin a script, or be taken for an entity or an
    expression.
    """
    return f"""'><script>alert("1")</script>&amp;{{{{ 7 * 7 }}}} {what}"""


MODEL = dict(
    A=[[0.5]],
    B=[[1]],
    C=[[1]],
    noise=0.1,
    disturbance=([[1]], [0.01]),
    name=evil("model"),
    inputs=[evil("u")],
    outputs=[evil("y")],
    states=[evil("x")],
    units={evil("y"): evil("unit"), evil("u"): evil("V")},
    columns={evil("y"): evil("column")},
    provenance={field: evil(field) for field in ("noise", "tolerance", "resolution", "disturbance", "model")},
)
OF_MODEL = ("model", "u", "y", "x", "unit", "V", "column", "noise", "tolerance", "resolution", "disturbance")


def recorded(T):
    return SimpleNamespace(
        time=np.arange(T) * 1.0,
        axis=np.arange(T) * 1.0,
        source=evil("source"),
        stamps=None,
        label=lambda k: evil(f"at {k}"),
    )


def detection(folder):
    y = np.zeros((30, 1))
    y[20] = 9
    res = jb.detect(jb.parity_relations(jb.LinearSystem(**MODEL)), np.zeros((30, 1)), y)
    table = [(evil("head"),), (evil("cell"),)]
    extra = [(evil("title"), PNG, evil("caption"), table), (evil("other"), None, evil("text"), None)]
    run, alarms = recorded(30), res.alarms()
    found = summarised(res, alarms, run.label, hints=[evil("hint")], sizes={evil("y"): 1.0})
    write_report(folder / "report.html", res, run, alarms, found, seconds={evil("stage"): 1.0}, extra=extra)
    return (folder / "report.html").read_text()


def uncertain(folder):
    parameter = jb.Uncertainty(evil("parameter"), A=[[0.05]])
    m = jb.LinearSystem([[0.5]], [[1]], [[1]], noise=0.1, name=evil("model"), uncertainties=[parameter])
    res = jb.detect(jb.parity_relations(m, 1), np.zeros((9, 1)), np.zeros((9, 1)))
    write_report(folder / "report.html", res, recorded(9), [], summarised(res, [], recorded(9).label))
    return (folder / "report.html").read_text()


def validation(folder):
    band = Interval(np.zeros((9, 1)), np.ones((9, 1)))
    faulty = np.arange(9)[:, None] == 5
    status = np.where(faulty[:, 0], jb.Status.FAULT, jb.Status.UNDECIDED).astype(np.int8)
    found = jb.Validation(band, band, band, faulty, band, status)
    res = Validated(jb.LinearSystem(**MODEL), 1, np.zeros((9, 1)), found)
    said = summarised(res, res.alarms(), recorded(9).label, hints=[evil("hint")])
    write_page(folder / "report.html", res, recorded(9), said, seconds={evil("stage"): 1.0})
    return (folder / "report.html").read_text()


def study(folder):
    res = jb.study(jb.LinearSystem(**MODEL), f"{evil('y')}:bias", 40, 0, sizes=[1.0], samples=20)
    res.settings["asked"] = evil("setting")
    return study_page(res, 0, 1.0)


def fleet(folder):
    unit = Unit(evil("unit"), Path(evil("file")), Path(evil("recording")))
    numbers = Evidence("joint", 1, 10, {"MISSING": 1, "CONSISTENT": 2, "UNDECIDED": 3, "FAULT": 4}, alarms=1)
    worst = Window(3, evil("worst"), -1.0)
    summary = Summary(
        "fault", evil("sentence"), numbers, worst, evil("first"), evil("ended"), (evil("hint"),)
    )
    found = UnitResult(unit, summary)
    wrong = UnitResult.untested(Unit(evil("other"), Path("m"), Path("r")), evil("why"))
    return fleet_page([found, wrong], ("fault", 1, evil("all")), evil("title"))


PAGES = {
    detection: (
        *OF_MODEL,
        "source",
        "at 0",
        "at 20",
        "at 29",
        "hint",
        "stage",
        "title",
        "caption",
        "head",
        "cell",
        "other",
        "text",
    ),
    uncertain: ("model", "parameter"),
    validation: (*OF_MODEL, "source", "at 0", "at 5", "at 8", "hint", "stage"),
    study: (*OF_MODEL, "setting"),
    fleet: ("unit", "sentence", "first", "hint", "ended", "other", "why", "all", "title"),
}
SCRIPTS = dict.fromkeys(PAGES, 3) | {fleet: 1}  # numbers, a library and what draws with it
every_page = pytest.mark.parametrize("make", PAGES, ids=lambda make: make.__name__)


class Reader(HTMLParser):
    """Collects what a browser would show and which tags it would see."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.shown, self.attributes, self.scripts = set(), "", [], 0
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.tags.add(tag)
        self.scripts += tag == "script"
        self.attributes += [name for name, _ in attributes]
        self.shown += " ".join(
            value or "" for name, value in attributes if name in ("alt", "aria-label", "value")
        )

    def handle_data(self, data):
        self.shown += data


@every_page
def test_what_a_user_wrote_is_escaped_exactly_once(make, tmp_path):
    """Read back by a parser of HTML, each name is what was written: not less (a tag, an attribute), not more
    (escaped twice).
    """
    reader = Reader(make(tmp_path))
    ours = SCRIPTS[make]  # and none of a user's
    assert reader.scripts == ours and not reader.tags & {"iframe", "link", "object"}
    assert not [a for a in reader.attributes if a.startswith("on")]
    assert [what for what in PAGES[make] if evil(what) not in reader.shown] == []


def test_the_command_of_a_fleet_is_quoted_for_the_shell_and_escaped(tmp_path):
    assert (
        shlex.join(["jaxbound", "detect", evil("file"), evil("recording")]) in Reader(fleet(tmp_path)).shown
    )


def test_a_fleet_leads_to_the_reports_of_its_units_and_tells_what_it_is_sorted_by(tmp_path):
    unit = Unit(evil("unit"), Path("m"), Path("r"))
    page = fleet_page(
        [UnitResult(unit, Summary("fault", "s"), "units/1-x.html"), UnitResult.untested(unit, "why")],
        ("fault", 1, "s"),
        "t",
    )
    assert page.count('<a href="units/1-x.html">') == 1 and "leads to its own report" in page
    rows = re.findall(r"<tr data-verdict=.*?</tr>", page, re.S)
    assert len(rows) == 2 and all(row.count("data-key=") == 4 and '<th scope="row"' in row for row in rows)
    assert 'id="filter" hidden' in page and "<option>fault</option>" in page


def test_a_healthy_unit_of_observers_has_a_bar_that_does_not_warn():
    def unit(observes):
        found = Evidence("observer", 0, 10, {"MISSING": 1, "CONSISTENT": 0, "UNDECIDED": 9, "FAULT": 0})
        summary = Summary("no fault", "all is well", replace(found, observes=observes))
        return fleet_page([UnitResult(Unit("a", Path("m"), Path("r")), summary)], ("no fault", 0, "one"), "f")

    assert 'class="calm"' in unit(True) and 'class="calm"' not in unit(False)


@every_page
def test_a_page_is_one_file_that_asks_nobody(make, tmp_path):
    text = make(tmp_path)
    assert foreign(text) == []
    assert text.startswith("<!doctype html>") and text.rstrip().endswith("</html>")
    assert all(src.startswith("data:image/") for src in re.findall('src="([^"]*)"', text))


def test_a_value_that_is_missing_is_refused_by_name():
    values = dict(name="x", verdict="fault", title="t", sentence="s", units=[], command=None)
    with pytest.raises(jinja2.UndefinedError, match="'written' is undefined"):
        page.render("fleet.html", **values)
    assert "at noon" in page.render("fleet.html", **values, written="at noon")


def test_every_class_of_the_style_sheet_is_on_a_page():
    sheet = (HOME / "style.css").read_text()
    makers = [*(HOME / "templates").iterdir(), *HOME.glob("*.js"), HOME / "vendor/uplot/uPlot.iife.min.js"]
    templates = "".join(f.read_text() for f in makers)
    styled = set(re.findall(r"\.([A-Za-z][\w-]*)", re.sub(r"\{[^{}]*\}", "{}", sheet)))
    drawn = {
        "fault",
        "too",
        "not",
        *(status.name for status in jb.Status),
    }  # verdicts and statuses become classes
    drawn |= {
        "enclosed",
        "seen",
        "windows",
        "size0",
        "size1",
        "size2",
        "size3",
    }  # and what a chart or a curve is of
    assert styled and [name for name in styled - drawn if not re.search(rf"\b{name}\b", templates)] == []


def test_what_is_no_python_is_installed_too():
    data = tomllib.loads((HOME.parents[1] / "pyproject.toml").read_text())["tool"]["setuptools"][
        "package-data"
    ]["jaxbound.reports"]
    kept = {f for pattern in data for f in HOME.glob(pattern)}
    assert kept == {f for f in HOME.rglob("*") if f.is_file() and f.suffix not in (".py", ".pyc")}


def test_a_library_in_a_page_is_as_released_and_has_its_licence_with_it(tmp_path):
    folder = HOME / "vendor"
    stated = re.findall(
        r"\| (\w+) \| ([\d.]+) \| (\w+), `(.+?)` \|.* (\w{64}) \|", (folder / "README.md").read_text()
    )
    project = tomllib.loads((HOME.parents[1] / "pyproject.toml").read_text())["project"]
    assert [name for name, *_ in stated] == ["uPlot"]
    for name, version, _, licence, digest in stated:
        script = (folder / licence).parent / f"{name}.iife.min.js"
        assert hashlib.sha256(script.read_bytes()).hexdigest() == digest
        assert f"(v{version})" in script.read_text()[:80]
        assert f"jaxbound/reports/vendor/{licence}" in project["license-files"]
        assert (folder / licence).read_text() in study(tmp_path)


def test_pages_show_control_characters_as_escapes(tmp_path):
    unit = Unit("\x1b[2J<b>", tmp_path / "m.toml", tmp_path / "r\udcff.csv")
    page = fleet_page([UnitResult.untested(unit, "\u202e")], ("not tested", 2, "x"), "t")
    page.encode()
    assert "\\x1b[2J&lt;b&gt;" in page and "\u202e" not in page
