"""Labels in files and columns become those of the samples."""

import pandas as pd
import pytest

import jaxbound as jb
from jaxbound.studies.assessment.labels import column_labels, file_labels

ROWS = {
    "time": [0, 1, 2, 3],
    "level": [1.0, 1.0, 1.0, 1.0],
    "anomaly": [0.0, 1.0, 1.0, 0.0],
    "who": ["", "level", "level", "pump"],
    "on": [1, 1, 0, 1],
}
MODEL = jb.LinearSystem([[0.5]], None, [[1]], noise=0.1, outputs=["level"], dt=1)


@pytest.fixture(params=["csv", "parquet"])
def recording(request, tmp_path):
    path = tmp_path / f"run.{request.param}"
    frame = pd.DataFrame(ROWS)
    if request.param == "csv":
        frame.to_csv(path, index=False)
    else:
        frame.to_parquet(path)
    return path


def test_a_column_of_numbers_marks_samples(recording):
    assert column_labels(recording, MODEL, "anomaly").tolist() == ["", "?", "?", ""]


def test_a_column_of_words_names_signals(recording):
    assert column_labels(recording, MODEL, "who").tolist() == ["", "level", "level", "?"]


def test_samples_that_the_model_leaves_out_have_no_label(recording):
    model = MODEL.replace(columns={"where": "on == 1"})
    assert column_labels(recording, model, "anomaly").tolist() == ["", "?", "", ""]


def test_a_column_that_is_not_there_is_refused(recording):
    with pytest.raises(ValueError, match="has no column 'fault'"):
        column_labels(recording, MODEL, "fault")


@pytest.mark.parametrize("name, rows", [("time", "0,0\n2,level\n3,0\n"), ("sample", "0,0\n2,level\n3,0\n")])
def test_a_label_in_a_file_holds_until_the_next_row(tmp_path, recording, name, rows):
    labels = tmp_path / "labels.csv"
    labels.write_text(f"{name},label\n{rows}")
    run = jb.read(recording, MODEL)
    assert file_labels(labels, MODEL, run).tolist() == ["", "", "level", ""]


def test_times_of_another_kind_are_refused(tmp_path, recording):
    labels = tmp_path / "labels.csv"
    labels.write_text("date,label\n2020-01-01 00:00,0\n2020-01-01 00:10,1\n")
    with pytest.raises(ValueError, match="not of one kind, dates and numbers"):
        file_labels(labels, MODEL, jb.read(recording, MODEL))


def test_a_file_without_a_column_of_labels_is_refused(tmp_path, recording):
    labels = tmp_path / "labels.csv"
    labels.write_text("time,one,two\n0,0,0\n1,1,1\n")
    with pytest.raises(ValueError, match="has no column that is called label"):
        file_labels(labels, MODEL, jb.read(recording, MODEL))
