"""The report: complete, escaped, readable whatever the numbers."""

import itertools
from html.parser import HTMLParser
from types import SimpleNamespace

import jax
import numpy as np
import pytest
from page_case import foreign
from result_case import CONSISTENT, FAULT, MISSING, UNDECIDED, biased, recording_of, synthetic

import jaxbound as jb
from jaxbound.recordings.recording import Recording
from jaxbound.reports import causes, detection
from jaxbound.reports import page as pages
from jaxbound.reports.detection import write_report
from jaxbound.reports.parts import computed
from jaxbound.runs.summary import summarised

WORST = "its worst window alone"


def write(folder, res, recording, alarms, hints=(), **options):
    said = summarised(res, alarms, recording.label, hints=hints)
    write_report(folder / "report.html", res, recording, alarms, said, **options)


@pytest.fixture(scope="module")
def run():
    """Return (result, recording) of the paper's system with a bias."""
    return biased()


class Reader(HTMLParser):
    """Collects tags, attributes and text; complains about tags that do not match."""

    def __init__(self, page):
        super().__init__()
        self.open, self.seen, self.links, self.text = [], [], [], ""
        self.feed(page)
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.seen.append(tag)
        self.links += [v for k, v in attrs if k in ("src", "href")]
        if tag not in ("meta", "img", "br", "input", "path", "rect"):
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.seen.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


@pytest.fixture(scope="module")
def page(run, tmp_path_factory):
    """Return the parsed report of the run and its folder."""
    folder = tmp_path_factory.mktemp("report")
    write(folder, run[0], run[1], run[0].alarms(), hints=["mind `this`"], seconds={"read": 0.1})
    assert [f.name for f in folder.iterdir()] == ["report.html"]
    return Reader((folder / "report.html").read_text()), folder


class TestAlarmsTable:
    def test_names_the_smallest_error_of_each_sensor_that_would_explain_it(self, page, run):
        deepest = min(run[0].alarms(), key=lambda a: a.depth)
        first, *rest = deepest.candidates
        assert (
            f"wrong alone, another error at each sample: either {first} by "
            f"{float(deepest.errors[first]):.3g}, or {rest[0]}" in page[0].text
        )

    def test_says_where_no_single_sensor_explains_it(self, tmp_path):
        m = jb.LinearSystem([[1]], None, [[1], [1], [1], [1]], noise=0.1, units={"y2": "bar"})
        y = np.zeros((9, 4))
        y[3], y[6, 1] = [0, 0, 5, 5], 2
        res = jb.detect(jb.parity_relations(m, 0), None, y)
        write(tmp_path, res, recording_of(res), res.alarms())
        text = Reader((tmp_path / "report.html").read_text()).text
        assert "none alone" in text and "wrong alone, another error at each sample: y2 by 1.8 bar" in text


class TestReport:
    def test_is_one_self_contained_file(self, page):
        reader, folder = page
        links = {link for link in reader.links if not link.startswith("data:image/")}
        assert links == {"#main", "#zoom"}
        assert reader.seen.count("script") == 3  # numbers, a library, and what draws with it
        assert not {"link", "iframe", "object"} & set(reader.seen)
        assert foreign((folder / "report.html").read_text()) == []

    def test_says_what_an_engineer_needs(self, page, run):
        text, res = page[0].text, run[0]
        for part in (
            "Fault proved",
            "would need bounds",
            str(res.counts["FAULT"]),
            "Please check",
            "mind this",
            "y1[k-1] - 5 y2[k-1]",
            "origin not stated",
            "mathematical proof",
            f"jax {jax.__version__}",
            np.__version__,
            "float64",
            "run.csv",
            "10 %",
        ):
            assert part in text, part

    def test_every_alarm_has_its_row(self, page, run):
        assert (
            page[0].seen.count("tr") > len(run[0].alarms())
            and f"Alarms ({len(run[0].alarms())})" in page[0].text
        )

    def test_names_are_escaped(self, tmp_path):
        evil = "<script>alert('1')</script>&\"$x_1$"
        m = jb.LinearSystem(
            [[0.5]],
            [[1]],
            [[1]],
            noise=0.1,
            name=evil,
            inputs=[f"u{evil}"],
            outputs=[f"y{evil}"],
            states=[f"x{evil}"],
            units={f"y{evil}": evil},
            provenance={"noise": evil, "model": evil},
        )
        y = np.zeros((50, 1))
        y[20] = 9
        res = jb.detect(jb.parity_relations(m), np.zeros((50, 1)), y)
        recording = Recording(res.u, res.y, time=np.arange(50.0), source=evil)
        write(
            tmp_path,
            res,
            recording,
            res.alarms(),
            hints=[evil],
            extra=[(evil, None, evil, [(evil,), (evil,)])],
        )
        text = (tmp_path / "report.html").read_text()
        assert text.count("<script") == 3 and Reader(text).text.count(evil) > 12

    def test_letters_that_the_font_lacks_do_not_disturb(self, tmp_path):
        m = jb.LinearSystem([[0.5]], [[1]], [[1]], noise=0.1, name="温度 Ω 🔥")
        res = jb.detect(jb.parity_relations(m), np.zeros((50, 1)), np.zeros((50, 1)))
        write(tmp_path, res, recording_of(res), [])
        assert "温度 Ω 🔥" in (tmp_path / "report.html").read_text()

    def test_many_alarms_are_cut_with_a_note(self, tmp_path):
        status = np.tile([CONSISTENT, FAULT], 300)
        status[0] = MISSING
        res = synthetic(status, np.where(status == FAULT, -np.arange(600.0), 0.5))
        object.__setattr__(res, "y", np.random.default_rng(0).normal(size=(600, 2)) * 100)
        write(tmp_path, res, recording_of(res), res.alarms())
        reader = Reader((tmp_path / "report.html").read_text())
        assert (
            "The 200 deepest of 300 alarms; alarms.csv has all of them" in reader.text
            and "× 600" in reader.text
            and "Triangles: the worst windows of the 200 deepest of 300 alarms." in reader.text
        )
        assert 200 < reader.seen.count("tr") < 230 and reader.seen.count("option") == 200

    @pytest.mark.parametrize("status", [[MISSING] * 6, [MISSING] + [FAULT] * 5, [MISSING] + [UNDECIDED] * 5])
    def test_any_mixture_of_verdicts_makes_a_report(self, tmp_path, status):
        res = synthetic(status)
        write(tmp_path, res, recording_of(res), res.alarms())
        assert Reader((tmp_path / "report.html").read_text()).text

    def test_a_model_without_states_has_its_equation_and_no_empty_matrices(self, tmp_path):
        res = jb.detect(
            jb.parity_relations(jb.LinearSystem(None, None, None, D=[[1], [2]], noise=0.1), 0),
            np.zeros((5, 1)),
            np.zeros((5, 2)),
        )
        write(tmp_path, res, recording_of(res), [])
        text = " ".join(Reader((tmp_path / "report.html").read_text()).text.split())
        assert "yk = D uk, one sample every 1 s; numbers" in text and "D = 1 2" in text and "A =" not in text


def test_a_long_relation_is_shown_by_its_largest_terms_and_whole_at_a_click():
    shown = pages._template_environment().from_string(
        "{% import 'templates/parts.html' as parts %}{{ parts.relation(text) }}"
    )
    long = "9 a + 8 b + 7 c + 6 d + 5 e + 4 f + 3 g = 0"
    text = shown.render(text=long)
    assert "<code>9 a + 8 b + 7 c + 6 d + 5 e + 4 f + ... = 0</code>" in text
    assert text.count(f"<code>{long}</code>") == 1 and "<summary>" in text
    assert "<summary>" not in shown.render(text="a - b = 0")


def test_long_windows_leave_the_errors_of_single_sensors_to_explain():
    """122 readings take a minute each: a report is not to wait for them."""

    class Long:
        window = SimpleNamespace(y=[0] * 65)
        errors = property(lambda self: pytest.fail("this takes minutes"))

    assert detection._sensor_errors(Long()) == ""


def test_long_windows_of_many_inputs_leave_actuators_to_explain():
    """An exact program for each of 6 inputs over 61 samples takes some seconds: a report does not wait."""

    class Wide:
        window = SimpleNamespace(y=[0] * 61, model=SimpleNamespace(m=6, unit=lambda name: "kW"))
        errors = {"heating": 2.5}
        sensor_candidates = ("heating",)
        candidates = property(lambda self: pytest.fail("this takes seconds"))

    assert detection._sensor_errors(Wide()) == "heating by 2.5 kW; actuators: see explain"


def test_an_alarm_names_its_cause_where_the_model_names_faults(tmp_path):
    faults = (
        jb.NamedFault("valve <leaks>", input="u", sign="+"),
        jb.NamedFault("y1 is off", output="y1"),
        jb.NamedFault("both at once", input="u", sign="-"),
    )
    model = jb.LinearSystem(None, None, None, [[1], [1]], noise=0.1, inputs=["u"], faults=faults)
    res = jb.detect(jb.parity_relations(model, 0), [[0.5]] * 3, [[0.5, 0.5], [1.5, 1.5], [1.5, 1.6]])
    write(tmp_path, res, recording_of(res), res.alarms())
    reader = Reader((tmp_path / "report.html").read_text())
    assert "cause: valve <leaks>: +1 to +1.1 of u" in reader.text
    assert "y1 is off: excluded: no size of it, from no sample on, explains this" in reader.text
    assert "both at once: excluded" in reader.text and "Cause: the named faults" in reader.text


@pytest.mark.parametrize(
    "patience, looked_at", [(0, [WORST] * 3), (3, [WORST, WORST, WORST]), (5, ["", WORST, ""])]
)
def test_all_alarms_have_a_cause_before_one_has_it_of_all_its_windows(patience, looked_at, monkeypatch):
    """The clock goes on by one at each look: at each alarm, the longer ones once more."""
    ticks = itertools.count(-1)
    monkeypatch.setattr(causes, "time", SimpleNamespace(perf_counter=lambda: next(ticks)))
    monkeypatch.setattr(causes, "PATIENCE", patience)
    model = jb.LinearSystem(
        None, None, None, [[1], [1]], noise=0.1, inputs=["u"], faults=[jb.NamedFault("leak", input="u")]
    )
    y = np.array([1.5, 1.6, 0.5, 1.4, 1.4, 0.5, 1.3])[:, None] + [[0.0, 0.0]]
    res = jb.detect(jb.parity_relations(model, 0), np.full((7, 1), 0.5), y)
    alarms = res.alarms(rule=jb.AlarmRule(suspects=True))
    found = causes.causes_of(model, alarms, range(3))
    answers = [found[i].answer for i in range(3)]
    assert all(answer.startswith("leak: +") for answer in answers)
    assert [answer.partition("; looked at ")[2] for answer in answers] == looked_at


@pytest.mark.parametrize("rule", [jb.AlarmRule(), jb.AlarmRule(suspects=True)])
def test_each_alarm_has_its_suspects_in_a_cell(rule, tmp_path):
    """Two sensors of one known input, of which the second is off by 1 once."""
    model = jb.LinearSystem(None, None, None, [[1], [1]], noise=0.1, inputs=["u"])
    res = jb.detect(jb.parity_relations(model, 0), [[0.5]] * 3, [[0.5, 0.5], [0.5, 1.5], [0.5, 0.5]])
    write(tmp_path, res, recording_of(res), res.alarms(rule=rule))
    page = (tmp_path / "report.html").read_text()
    assert '<td data-of="suspect">y2</td>' in page and "Suspect: the signals that alone" in page


def test_the_page_says_who_judged():
    rows = dict(computed("joint", "windows of 3 samples", np.dtype(np.float64), {}, "NumPy and XLA"))
    assert rows["device and numbers"].endswith(", float64, evaluated by NumPy and XLA")
    assert dict(computed("joint", "", np.dtype(np.float64), {}))["device and numbers"].endswith(", float64")
