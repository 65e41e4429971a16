"""Pictures of tables and banks: drawn for what they say, and readable whatever the length of a recording."""

import jax
import numpy as np
import pytest
from systems import paper

import jaxbound as jb
import jaxbound.runs.digest  # noqa: F401  registers its picture, whatever other tests have imported


def labels(axis):
    return [t.get_text() for t in axis.get_ticklabels()]


def test_a_table_of_signatures_is_drawn_row_by_row():
    table = jb.signatures(jb.structured_relations(paper(), [("y1",), ("u1",)]))
    (ax,) = jb.plot(table).axes
    assert labels(ax.xaxis) == ["y1", "y2", "u1"] and labels(ax.yaxis) == list(table.relations)
    level = np.asarray(ax.collections[0].get_array()).reshape(len(table.relations), 3)
    np.testing.assert_array_equal(level, table.weak.astype(int) + table.constant)


def test_isolability_is_drawn_with_what_shows_at_all():
    (ax,) = jb.plot(found := jb.isolability(paper())).axes
    level = np.asarray(ax.collections[0].get_array()).reshape(3, 4)
    np.testing.assert_array_equal(level[:, 0], found.detectable.astype(int) + found.detectable_constant)
    assert labels(ax.xaxis)[0] == "no other" and level[0, 1] == level[1, 2] == -1


@pytest.mark.parametrize("T", [40, 9000])
def test_a_bank_shows_every_violation_and_every_candidate(T):
    y = np.zeros((T, 2))
    y[30, 0] = 9.0
    res = jb.detect(jb.structured_relations(paper()), np.zeros((T, 1)), y)
    top, bottom = jb.plot(res).axes
    for ax, on in ((top, res.violated), (bottom, res.candidates)):
        drawn = np.asarray(ax.collections[0].get_array()).reshape(on.shape[1], -1)
        np.testing.assert_array_equal(drawn.any(1), on.any(0))
        assert drawn.shape[1] == min(T, 1200)
    assert labels(bottom.yaxis) == ["y1", "y2", "u1"]


def test_residuals_from_elsewhere_need_no_model():
    fig = jb.plot(jb.evaluate(np.eye(3) * 9, [1, 1, 1], np.eye(3)))
    assert [labels(ax.yaxis) for ax in fig.axes] == [["r1", "r2", "r3"], ["f1", "f2", "f3"]]
    with pytest.raises(ValueError, match="a plot shows one recording"):
        jb.plot(jb.detect(jb.redundancy(paper()), np.zeros((2, 9, 1)), np.zeros((2, 9, 2))))


def test_sets_in_the_plane_are_drawn_with_their_outlines():
    Z = jb.zonotope([1.0, 2.0], [[1.0, 0.5, 0.2], [0.0, 1.0, -0.4]])
    C = jb.sets.intersection(Z, jb.sets.interval([2.8], [3.1]), [[1.0, 1.0]])
    (ax,) = jb.plot([Z, C]).axes
    outer, inner = (line.get_xydata() for line in ax.lines)
    assert len(outer) == 7 and np.ptp(outer, 0).round(9).tolist() == [3.4, 2.8]
    assert abs(inner.sum(1).min() - 2.8) < 0.02 and abs(inner.sum(1).max() - 3.1) < 0.02
    with pytest.raises(ValueError, match="linear_map"):
        jb.plot(jb.zonotope([0.0], [[1.0]]))


def test_what_is_one_chart_is_drawn_into_axes_of_ones_own():
    """In the style that its owner has: nothing else of the figure changes."""
    from matplotlib.figure import Figure

    res, bank = (
        jb.detect(jb.parity_relations(paper()), np.zeros((9, 1)), np.zeros((9, 2))),
        jb.structured_relations(paper()),
    )
    Z = jb.zonotope([1.0, 2.0], [[1.0, 0.5, 0.2], [0.0, 1.0, -0.4]])
    things = (res, Z, [Z, Z], jb.signatures(bank), jb.isolability(paper()))
    fig = Figure()
    before = fig.subplotpars.left
    for thing, ax in zip(things, fig.subplots(len(things)), strict=True):
        assert jb.plot(thing, ax=ax) is ax and (ax.lines or ax.collections or ax.patches)
        assert isinstance(jb.plot(thing), Figure)
    assert not fig.legends and fig.subplotpars.left == before and fig.axes[0].get_xlabel() == "time (s)"
    with pytest.raises(TypeError, match="ax"):
        jb.plot(jb.detect(bank, np.zeros((9, 1)), np.zeros((9, 2))), ax=fig.axes[0])


def test_a_new_kind_of_thing_registers_in_three_lines():
    @jb.plot.register(complex)
    def drawn(number, time=None):
        return number, time

    assert jb.plot(1j) == (1j, None) and jb.plot(2j, time=3) == (2j, 3)


@pytest.mark.parametrize("thing", [1.5, "run.csv", paper(), None], ids=lambda x: type(x).__name__)
def test_what_cannot_be_drawn_gets_one_sentence(thing):
    with pytest.raises(
        TypeError, match=f"^plot draws .*BankResult.* Result.* Zonotope.*, not {type(thing).__name__}$"
    ):
        jb.plot(thing)


def test_every_file_of_a_picture_is_registered_where_its_type_is_drawn():
    drawn = {
        kind.__name__: draw.__module__.rpartition(".")[2]
        for kind, draw in jb.plot.registry.items()
        if kind.__module__ != "builtins"
    }
    assert drawn == {
        "Assessment": "assessment",
        "BankResult": "bank",
        "ConstrainedZonotope": "sets",
        "Diagnosis": "diagnosis",
        "Digest": "digest",
        "Fitted": "fit",
        "Isolability": "signatures",
        "Look": "look",
        "Observation": "observation",
        "ParameterSet": "parameters",
        "Result": "result",
        "Signatures": "signatures",
        "StudyResult": "study",
        "TuneResult": "tune",
        "Validation": "validation",
        "Zonotope": "sets",
    }


@pytest.fixture
def validated():
    """Return (Validation, y) made up: the truth is 1 +- 0.5 from sample 1 on, y1 shows 4 in samples 8 to 10
    and 20.
    """
    band = jb.Interval(
        *(
            np.concatenate([np.full((1, 2), side * np.inf), np.full((29, 2), 1 + side * 0.5)])
            for side in (-1, 1)
        )
    )
    faulty = np.zeros((30, 2), bool)
    faulty[[8, 9, 10, 20], 0] = True
    status = np.where(faulty.any(1), jb.Status.FAULT, jb.Status.UNDECIDED).astype(np.int8)
    return jb.Validation(band, band, band, faulty, band, status), np.where(faulty, 4.0, 1.0)


def test_a_validation_shows_the_band_of_every_output_and_marks_what_is_faulty(validated):
    found, y = validated
    first, second = jb.plot(found, time=np.arange(30.0), y=y).axes
    lines = {line.get_label(): np.asarray(line.get_ydata(), float) for line in first.lines}
    assert np.flatnonzero(np.isfinite(lines["measured, faulty"])).tolist() == [8, 9, 10, 20]
    assert first.get_title(loc="left").startswith("y1: 4 faulty samples in 2 stretches")
    assert "no faulty sample" in second.get_title(loc="left") and second.get_xlabel() == "time (s)"
    assert first.get_ylim()[0] < 0.5 < 1.5 < first.get_ylim()[1]


def test_a_validation_without_its_samples_claims_no_measurement(validated):
    names = [t.get_text() for t in jb.plot(validated[0]).axes[0].get_legend().texts]
    assert names == ["by accepted samples", "corrected"]


def test_a_validation_of_other_samples_or_of_a_batch_is_refused(validated):
    found, y = validated
    for options, says in (
        ({"time": np.arange(3)}, "one entry for each of the 30 samples"),
        ({"y": y[:5]}, "samples that were validated"),
    ):
        with pytest.raises(ValueError, match=says):
            jb.plot(found, **options)
    with pytest.raises(ValueError, match="a plot shows one recording"):
        jb.plot(jax.tree.map(lambda x: x[None], found))


def test_a_diagnosis_has_a_bar_for_each_fault_that_explains_and_words_for_the_others():
    faults = jb.NamedFault("valve leaks", input="u", most=2), jb.NamedFault("y1 is off", output="y1")
    model = jb.LinearSystem(None, None, None, [[1], [1]], noise=0.1, inputs=["u"], faults=faults)
    found = jb.detect(jb.parity_relations(model, 0), [[0.5]], [[1.5, 1.5]]).diagnose(0)
    (axes,) = jb.plot(found).axes
    assert [tick.get_text() for tick in axes.get_yticklabels()] == ["valve leaks", "y1 is off"]
    (bar,) = axes.patches
    assert bar.get_width() == pytest.approx(0.45)  # 0.9 of 2
    assert [text.get_text().split(":")[0] for text in axes.texts] == ["+0.9 to +1.1 of u", "excluded"]


def test_a_notebook_that_never_heard_of_pyplot_shows_the_picture():
    """By the display hook that Jupyter asks every object for; the formatter is Jupyter's own."""
    from IPython.core.formatters import DisplayFormatter

    shown, _ = DisplayFormatter().format(jb.plot(jb.isolability(paper())))
    assert set(shown) == {"image/png", "text/plain"} and shown["image/png"].startswith(b"\x89PNG")
