"""Units in the names of columns reach the model, its reports, and a sentence where they contradict it."""

import pytest

import jaxbound as jb
from jaxbound.diagnosis.hints import bound_hints
from jaxbound.text.units import without_unit


@pytest.mark.parametrize(
    "column, unit",
    [
        ("T_room [degC]", "degC"),
        ("Pump (bar)", "bar"),
        ("flow (m3/h)", "m3/h"),
        ("x [a.u.]", "a.u."),
        ("T (upper)", ""),
        ("T", ""),
        ("[degC]", ""),
        ("= a - `b [V]`", ""),
    ],
)
def test_the_unit_of_a_column_is_read_and_no_other_word(column, unit):
    assert without_unit(column)[1] == unit


def model(**signals):
    return jb.LinearSystem([["0.5"]], [[1]], [[1]], noise=0.1, outputs="T", **signals)


def test_a_signal_has_the_unit_of_its_column_where_the_model_states_none():
    assert model(columns={"T": "Room [degC]"}).unit("T") == "degC"
    assert model(columns={"T": "Room [degC]"}, units={"T": "K"}).unit("T") == "K"
    assert model(columns={"T": "Room (upper)"}).unit("T") == model().unit("T") == ""


def test_a_unit_that_contradicts_the_column_is_a_sentence():
    (hint,) = bound_hints(model(columns={"T": "Room [degC]"}, units={"T": "K"}))
    assert hint.startswith("the model has T in K, and its column 'Room [degC]' is in degC: ")
    assert not bound_hints(model(columns={"T": "Room [°C]"}, units={"T": "degC"}))
