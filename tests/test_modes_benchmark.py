"""The benchmark of a monitor with modes: small, it says what it says of a million samples."""

import pytest

import jaxbound as jb
from benchmarks import modes


@pytest.fixture(scope="module")
def bank():
    return jb.monitor(modes.room(), modes.tests())


def test_a_monitor_with_modes_has_no_false_alarm_where_its_conditions_are_right(bank, rng):
    found = modes.healthy(bank, rng, runs=2, samples=150)
    for mode in ("mode known", "mode unknown", "no mode left unknown"):
        assert found[mode]["FAULT"] == 0
        assert found[mode]["judged"] > 0.9 * found[mode]["samples"] > 0
    assert found["the log says another mode"]["FAULT"] > 0


def test_what_is_proved_of_an_unknown_mode_is_what_linear_programs_say(bank, rng):
    found = modes.faulty(bank, rng, runs=4, size=1.0, count=60, samples=400)
    programs = found["programs"]
    assert programs["otherwise"] == 0 == found["alarms before"]
    assert 0 < programs["FAULT"] < programs["asked"] - programs["near the boundary"]
