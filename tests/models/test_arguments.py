"""Arguments that are no table or list: one sentence that names the argument and shows what is meant."""

import numpy as np
import pytest

import jaxbound as jb

MODEL = jb.LinearSystem([[0.8]], [[0.5]], [[1]], noise=0.1)
RECORDING = np.zeros((60, 1)), np.zeros((60, 1))


@pytest.mark.parametrize(
    ("argument", "value"),
    [
        ("averages", 8),
        ("averages", {"y1": 8}),
        ("averages", {"y1": [8]}),
        ("averages", {"y1": ([1, 1, 1], 0.3)}),
        ("offset", 3),
        ("offset", (1, 2)),
        ("lags", 5),
        ("lags", "12"),
        ("inputs", 3),
        ("outputs", 4),
        ("ranges", 3),
        ("provenance", 3),
        ("times", 2),
        ("units", "degC"),
        ("tests", 3),
        ("faults", 3),
        ("A", 3),
    ],
)
def test_a_model_names_the_argument_and_shows_what_is_meant(argument, value):
    with pytest.raises(ValueError, match=rf"^{argument}\b.* like .*not ") as refusal:
        MODEL.replace(**{argument: value})
    assert repr(value)[:5] in str(refusal.value) or argument == "averages"


def test_a_fit_says_where_a_field_of_recordings_belongs():
    with pytest.raises(
        ValueError, match=r"^every is how recordings are read.*: recording=\{'every': '5min'\}"
    ):
        jb.fit([], every="5min")


@pytest.mark.parametrize(
    ("argument", "value", "beside"),
    [
        ("lags", 5, {"horizon": None}),
        ("inputs", 3, {}),
        ("outputs", 3, {}),
        ("safety", "a", {}),
        ("safety", [1], {}),
        ("held_out", None, {}),
        ("follow", [1], {}),
        ("follow", None, {}),
        ("see", 3, {"disturbances": "auto"}),
        ("see", "y1:bias:1", {"disturbances": "auto"}),
        ("see", ["y1:bias:1"], {"disturbances": "auto"}),
        ("columns", 3, {}),
        ("direct", "yes", {}),
    ],
)
def test_a_fit_names_the_argument(argument, value, beside):
    with pytest.raises(ValueError, match=rf"^{argument}\b.*not "):
        jb.fit(RECORDING, order=1, **{"horizon": 3, argument: value} | beside)


@pytest.mark.parametrize(
    ("argument", "value"),
    [
        ("bounds", 3),
        ("weights", 3),
        ("weights", {"noise": "a"}),
        ("safety", "a"),
        ("calibrate", "a"),
        ("confidence", [1]),
        ("state", 3),
        ("optimizer", "adam"),
        ("progress", True),
    ],
)
def test_a_tune_names_the_argument(argument, value):
    with pytest.raises(ValueError, match=rf"^{argument}\b.*not "):
        jb.tune(jb.parity_relations(MODEL, 2), RECORDING, **{argument: value})


def test_bounds_of_relations_are_a_table():
    with pytest.raises(ValueError, match="bounds must be a table, like .* not 3"):
        jb.parity_relations(MODEL, 2).with_bounds(3)


@pytest.mark.parametrize(
    ("argument", "value"),
    [("faults", 3), ("sizes", "a"), ("onset", "a"), ("onset", 1.5), ("confidence", "a"), ("progress", 3)],
)
def test_a_study_names_the_argument(argument, value):
    with pytest.raises(ValueError, match=rf"^{argument}\b.*not "):
        jb.study(MODEL, **{"faults": "y1:bias", "n": 10, "key": 0, argument: value})


@pytest.mark.parametrize("argument", ["healthy", "faulty", "labels", "training", "rules", "factors"])
def test_an_assessment_names_the_argument(argument):
    with pytest.raises(ValueError, match=rf"^{argument}\b.* like .*not 3"):
        jb.assess(RELATIONS, **{"healthy": [RECORDING], argument: 3})


PLANT = jb.LinearSystem([[0.9]], None, [[1]], noise=0.01, unknown_inputs=[[-1]])
RELATIONS = jb.parity_relations(MODEL, 2)


@pytest.mark.parametrize(
    "verb",
    [
        lambda progress: jb.assess(RELATIONS, [RECORDING], progress=progress),
        lambda progress: jb.detect(RELATIONS, *RECORDING, progress=progress),
        lambda progress: jb.detect_dataset(RELATIONS, "run.parquet", "out", progress=progress),
        lambda progress: jb.fit(RECORDING, order=1, horizon=3, progress=progress),
        lambda progress: jb.monitor(MODEL, [{"name": "short", "horizon": 2}], progress=progress),
        lambda progress: jb.parameters(RELATIONS, *RECORDING, progress=progress),
        lambda progress: jb.parity_relations(MODEL, 2, progress=progress),
        lambda progress: jb.pave(lambda z: z, jb.interval([0.0], [1.0]), [0.5], progress=progress),
        lambda progress: jb.read("run.csv", MODEL, progress=progress),
        lambda progress: jb.study(MODEL, "y1:bias", 10, 0, sizes=[1], progress=progress),
        lambda progress: jb.unknown_inputs(PLANT, None, np.zeros((9, 1)), progress=progress),
    ],
)
def test_progress_is_a_function(verb):
    with pytest.raises(ValueError, match="^progress must be a function of .* like print, not True$"):
        verb(True)
