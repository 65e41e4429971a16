"""What an object shows at a prompt and in a notebook: a few lines, whatever it holds. The table is printed
with -s.
"""

import dataclasses
import enum
import inspect
from html.parser import HTMLParser

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from result_case import biased
from systems import paper
from validated_case import found_in

import jaxbound as jb
from jaxbound.consistency.interface import Judged, WindowTest
from jaxbound.consistency.monitor import MonitorState
from jaxbound.text.objects import readable

ROOMS = (
    jb.certificates,
    jb.consistency,
    jb.diagnosis,
    jb.estimation,
    jb.models,
    jb.relations,
    jb.runs,
    jb.sets,
    jb.studies,
    jb,
)
ABSTRACT = (
    WindowTest,
    jb.consistency.Observer,
    jb.consistency.Relations,
    jb.consistency.Verdicts,
    jb.estimation.ObserverMethod,
    jb.estimation.SetObserver,
    jb.certificates.WindowCertificate,
)
LONG = np.zeros((1000, 400))


def public_classes():
    every = {
        thing for room in ROOMS for name in room.__all__ if inspect.isclass(thing := getattr(room, name))
    }
    plain = [
        c
        for c in every
        if issubclass(c, enum.Enum | float) or (issubclass(c, tuple) and not hasattr(c, "_fields"))
    ]
    return sorted((c for c in every if c not in (*plain, *ABSTRACT)), key=lambda c: c.__name__)


def filled(kind):
    """Return an object of a class whose fields are all as large as they come, for those that tell their
    fields alone.
    """
    thing = object.__new__(kind)
    for f in dataclasses.fields(kind):
        object.__setattr__(thing, f.name, LONG)
    return thing


@pytest.fixture(scope="module")
def things():
    """Return {class: an object of it}: real ones where what is shown is more than the fields."""
    res, recording = biased()
    r, model = res.relations, paper()
    bank = jb.structured_relations(model)
    wide = jb.LinearSystem(
        np.eye(2).tolist(),
        None,
        [[1, 0]] * 90,
        noise=0.1,
        outputs=[f"a rather long name of a sensor {i}" for i in range(90)],
    )
    uncertain = jb.parity_relations(
        jb.LinearSystem([[0.5]], [[1]], [[1]], noise=0.1, uncertainties=[jb.Uncertainty("p", A=[[0.05]])]), 1
    )
    fitted = object.__new__(jb.studies.Fitted)
    check = filled(jb.studies.FitCheck)
    object.__setattr__(check, "sentences", ("a sentence " * 40,) * 30)
    fitted.__init__(wide, check)
    study = filled(jb.studies.StudyResult)
    vars(study).update(trials=(), tallies=(), scenarios=10**6, at="random")
    real = [
        res,
        recording,
        r,
        model,
        bank,
        wide,
        uncertain,
        fitted,
        study,
        res.explain(103),
        res.alarms()[0],
        jb.Monitor(r),
        jb.Fault("y1", "bias", 1.0),
        jb.Uncertainty("p", A=[[0.05]]),
        jb.detect(bank, res.u, res.y),
        found_in().found,
        Judged(LONG, LONG),
        jb.signatures(bank),
        MonitorState(LONG, LONG, np.int64(0), np.int64(0), np.float64(0)),
    ]
    return {type(thing): thing for thing in real}


def test_public_values_are_frozen():
    """A model, and what is fitted, which is one, refuse by themselves."""
    values = [kind for kind in public_classes() if dataclasses.is_dataclass(kind)]
    assert {v.__name__ for v in values if not v.__dataclass_params__.frozen} == {"LinearSystem", "Fitted"}


class Tags(HTMLParser):
    """Tags of a page that were opened and not closed, and those that were closed and not open."""

    def __init__(self):
        super().__init__()
        self.open, self.astray = [], []

    def handle_starttag(self, tag, attrs):
        if tag not in ("br", "hr", "img", "meta", "link", "input"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        if self.open[-1:] == [tag]:
            self.open.pop()
        else:
            self.astray.append(tag)


def unclosed(page):
    """Return the tags of a page that have no partner."""
    tags = Tags()
    tags.feed(page)
    return [*tags.open, *tags.astray]


def test_a_tag_without_a_partner_is_found():
    assert unclosed("<p>a<br><b>c</b></p>") == []
    assert unclosed("<p><b>c</p>") == ["p", "b", "p"]


@pytest.mark.parametrize("kind", public_classes(), ids=lambda kind: kind.__name__)
def test_every_public_object_is_told_in_less_than_two_kilobytes(kind, things):
    special = any(hasattr(kind, name) for name in ("_head", "_rows")) or not dataclasses.is_dataclass(kind)
    if kind not in things and (
        special or "__repr__" in vars(kind) and kind.__repr__.__module__ != "jaxbound.text.objects"
    ):
        assert kind._repr_html_ and kind.__repr__ is not object.__repr__
        return
    thing = things[kind] if kind in things else filled(kind)
    text, page = repr(thing), thing._repr_html_()
    print(f"{kind.__name__:24}{len(text):6} bytes  {text.splitlines()[0][:90]}")
    assert text.startswith(kind.__name__) and len(text.encode()) < 2000 and len(page.encode()) < 4000
    assert len(text.splitlines()) <= 14
    assert unclosed(page) == []


def test_a_result_says_what_was_found():
    res, recording = biased()
    assert (
        repr(res).splitlines()[0]
        == f"Result (300,): {', '.join(f'{n} {name}' for name, n in res.counts.items() if n)}"
    )
    assert "joint, windows of 2 samples" in repr(res) and "u (300, 1), y (300, 2) float64" in repr(res)
    assert (
        repr(recording).splitlines()[0] == "Recording of run.csv: 300 samples, u (300, 1), y (300, 2) float64"
    )
    assert "MISSING" in repr(jb.detect(res.relations, np.zeros((2, 3, 1)), np.full((2, 3, 2), np.nan)))


def test_small_objects_are_told_as_python_builds_them():
    assert repr(jb.Fault("y1", "bias", 1.0)).startswith(
        "Fault(signal='y1', kind='bias'"
    ) and "\n" not in repr(jb.Fault("y1", "bias", 1.0))
    assert repr(jb.interval(np.zeros(2), np.ones(2))).startswith("Interval(lo=")


def test_what_is_inside_jit_is_told_by_its_shape():
    seen = []

    @jax.jit
    def f(lo):
        seen.append(repr(jb.Interval(lo, lo + 1)))
        return lo

    f(jnp.zeros(50))
    assert "(50,)" in seen[0] and len(seen[0]) < 500


def test_names_are_escaped_in_a_notebook():
    @readable
    @dataclasses.dataclass
    class Named:
        name: str
        numbers: np.ndarray

    evil = "<script>alert(1)</script>\x1b[2J"
    page = Named(evil, np.zeros(100))._repr_html_()
    assert (
        "<script" not in page
        and "&lt;script&gt;" in page
        and "\x1b" not in page + repr(Named(evil, np.zeros(100)))
    )
