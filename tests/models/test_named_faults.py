"""Named faults of a model: a file says them, reads back as the same, and refuses what makes no sense."""

from fractions import Fraction

import pytest

import jaxbound as jb
from jaxbound.models.modelfile import changed_text, model_text
from jaxbound.models.unknown_directions import with_direct_states

PLANT = dict(A=[[0.5]], B=[[1]], C=[[1]], noise=0.1, inputs=["heat"], outputs=["T"], states=["in tank"])
FAULTS = (
    jb.NamedFault("heating valve leaks", input="heat", sign="+", most="1/3"),
    jb.NamedFault("leak", states={"in tank": "-1/3"}, times="heat", unit="kg"),
    jb.NamedFault("scale of T", output="T", kind="gain", least=0.1),
    jb.NamedFault("valve sticks", input="heat", between=[0, "1/3"]),
    jb.NamedFault("fouled", A=[["-1/3"]], C=[[2]], sign="+", most=0.2, unit="W/K"),
)


def written(tmp_path, fields, name="x"):
    path = tmp_path / "plant.toml"
    text = model_text(jb.LinearSystem(**PLANT))
    path.write_text(f'{text}\n[[fault]]\nname = "{name}"\n{fields}\n')
    return path


def test_a_file_keeps_them(tmp_path):
    model = jb.LinearSystem(**PLANT, faults=FAULTS)
    jb.save_model(model, tmp_path / "plant.toml")
    assert jb.load_model(tmp_path / "plant.toml") == model
    assert model.replace(noise=0.2).faults == FAULTS and jb.LinearSystem(**PLANT) != model


def test_a_change_of_bounds_leaves_them_as_they_are_spelled(tmp_path):
    path = written(tmp_path, 'input = "heat"   # by hand\nkind = "offset"\nsign = "+"')
    model = jb.load_model(path)
    assert "# by hand" in changed_text(path.read_text(), model.replace(noise=0.2))


def test_states_may_be_a_list_of_names(tmp_path):
    (fault,) = jb.load_model(written(tmp_path, 'states = ["in tank"]')).faults
    assert fault.states == (("in tank", 1),) and fault.kind == "leak"


@pytest.mark.parametrize(
    "fields, sentence",
    [
        ('input = "heat"\nsing = "+"', "unknown field 'sing'; did you mean 'sign'"),
        ('input = "heater"', "fault 'x' has no input 'heater'; did you mean 'heat'"),
        ('output = "heat"', "fault 'x' has no output 'heat'"),
        ('states = ["tank"]', "fault 'x' has no state 'tank'; did you mean 'in tank'"),
        ('output = "T"\ntimes = "T"', "fault 'x' has no input 'T'"),
        ('input = "heat"\nkind = "bias"', "kind of fault 'x' must be offset or gain (input), not 'bias'"),
        ('input = "heat"\noutput = "T"', "fault 'x' needs one of output, input and states"),
        ("", "fault 'x' needs one of output, input and states"),
        ('input = "heat"\nsign = "plus"', "sign of fault 'x' must be '+' or '-', not 'plus'"),
        ('input = "heat"\nleast = 2\nmost = 1', "fault 'x' needs least <= most, not 2 and 1"),
        ('input = "heat"\nmost = -1', "most of fault 'x' must be >= 0"),
        ('input = "heat"\nkind = "gain"\ntimes = "heat"', "a gain multiplies its own signal"),
        ('output = "T"\nbetween = [0, 1]', "between of fault 'x' is of an actuator: give it with input"),
        ('input = "heat"\nbetween = [1, 0]', "between of fault 'x' needs lo <= hi, not [1, 0]"),
        ("A = [[1]]", "fault 'x' needs most > 0: sizes of a parameter are searched up to it"),
        ("B = [[1]]\nmost = 1", "fault 'x': a parameter acts in A or C"),
        ("A = [[0]]\nmost = 1", "A of fault 'x' is 0: leave it out"),
        ("A = [[1, 0]]\nmost = 1", "A of fault 'x' must have the shape of the model's A, (1, 1)"),
        ('A = [[1]]\nmost = 1\ntimes = "heat"', "a parameter multiplies what its matrices say"),
        ('A = [[1]]\nmost = 1\nkind = "gain"', "kind of fault 'x' must be parameter (parameter), not 'gain'"),
        ('A = [[1]]\nmost = 1\noutput = "T"', "fault 'x' needs one of output, input and states"),
        ('states = {"in tank" = 0}', "the share of 'in tank' is 0"),
    ],
)
def test_a_file_that_makes_no_sense_is_refused(fields, sentence, tmp_path):
    with pytest.raises(ValueError) as refused:
        jb.load_model(written(tmp_path, fields))
    assert sentence in str(refused.value)


def test_a_name_stands_for_one_fault():
    with pytest.raises(ValueError, match="each fault needs its own name: 'a' is used twice"):
        jb.LinearSystem(**PLANT, faults=[jb.NamedFault("a", input="heat"), jb.NamedFault("a", output="T")])
    with pytest.raises(TypeError, match="faults of a model must be NamedFault, not Fault"):
        jb.LinearSystem(**PLANT, faults=[jb.Fault("T")])


def test_states_of_simulated_faults_leave_them(tmp_path):
    *same, fouled = jb.with_faults(jb.LinearSystem(**PLANT, faults=FAULTS), "T:bias").faults
    assert tuple(same) == FAULTS[:-1]
    assert fouled.A == ((Fraction(-1, 3), 0), (0, 0)) and fouled.C == ((2, 0),)


def test_unknown_inputs_that_act_on_outputs_leave_them():
    model = jb.LinearSystem([[0.5]], None, [[1], [1]], noise=1, unknown_inputs=([[1]], [[0], [1]]))
    model = model.replace(faults=[jb.NamedFault("fouled", A=[[1]], most=1)])
    assert with_direct_states(model).faults[0].A == ((1, 0), (0, 0))
