"""What a Result says beside its verdicts is what the shell prints of the same recording."""

import json

import numpy as np
import pandas as pd
import pytest
from result_case import CONSISTENT, FAULT, MISSING, UNDECIDED, synthetic

import jaxbound as jb
from jaxbound.cli import main
from jaxbound.diagnosis.hints import fit_hints
from jaxbound.runs.summary import summarised


@pytest.mark.parametrize(
    "status, said",
    [
        (
            [FAULT] * 9,
            "every one of the 9 windows with data is FAULT: a fault lasts all through, or the "
            "model or its bounds do not fit this "
            "recording: ",
        ),
        (
            [CONSISTENT] + [FAULT] * 32,
            "32 of 33 windows with data (97 %) are FAULT: a fault lasts all through, or the model or its",
        ),
        ([UNDECIDED] * 2 + [FAULT] * 9, ""),
        ([FAULT], ""),
    ],
)
def test_a_model_that_does_not_fit_is_pointed_out(status, said):
    res = synthetic([MISSING, *status])
    found = fit_hints(res)
    assert [hint[: len(said)] for hint in found] == [said] * bool(said) and set(found) <= set(res.hints)
    wider = "all bounds times about 2 would make every window consistent; or a column is in another unit"
    assert all(wider in hint for hint in found)
    assert sum("do not fit" in text for text in (summarised(res, [], str).sentence, *found)) <= 2
    told = summarised(res, [], str, hints=res.hints)
    assert sum("do not fit" in text for text in (told.sentence, *told.hints)) == bool(said), (
        "once, in the sentence or as a hint"
    )


def test_each_recording_of_a_batch_is_asked():
    plant = jb.LinearSystem([["0.5"]], None, [[1]], noise="0.1")
    y = np.stack([np.zeros((8, 1)), np.arange(8.0)[:, None] ** 2])
    (hint,) = fit_hints(jb.detect(jb.parity_relations(plant), None, y))
    assert hint.startswith("recording 1: every one of the 7 windows")


def test_an_observer_whose_fault_stays_says_nothing_of_the_fit():
    disturbance = [[1]], "0.01"  # of the sizes that the examples of observers compile
    plant = jb.LinearSystem([["0.5"]], [[1]], [[1]], noise="0.1", disturbance=disturbance)
    u, y = np.zeros((40, 1)), np.full((40, 1), 3.0)
    assert not fit_hints(jb.detect(jb.observer(plant, restart=False), u, y))
    assert fit_hints(jb.detect(jb.observer(plant), u, y))


def test_the_shell_prints_what_a_result_says(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(main, "_configure", lambda: None)
    plant = jb.LinearSystem(
        [["0.5"]], None, [[1], [1]], noise=["0.1", 0], horizon=1, provenance={"noise": "fitted"}
    )
    jb.save_model(plant, "plant.toml")
    y = np.cumprod(np.full(30, 0.5))[:, None] * [1, 1] + [[3.0, 2.0]]
    y[4, 0] = np.nan
    pd.DataFrame({"y1": y[:, 0], "y2": y[:, 1]}).to_csv("run.csv", index=False)
    assert (
        main.main(["detect", "plant.toml", "run.csv", "--test", "horizon=3", "--out", "out", "--json"]) == 3
    )
    told = json.loads(capsys.readouterr().out)
    of = jb.detect(jb.parity_relations(plant, 3), jb.read("run.csv", plant))
    plain = jb.detect(jb.parity_relations(plant, 3), None, y)
    unsaid = [hint for hint in of.hints if hint[1:] not in told["summary"]]
    assert told["hints"][: len(unsaid)] == unsaid and len(unsaid) >= 3
    for words in (
        "states no tolerance, noise or resolution for y2",
        "windows of 2 samples",
        "samples of y1 are missing",
        "do not fit",
    ):
        assert any(words in hint for hint in of.hints) and any(words in hint for hint in plain.hints)
