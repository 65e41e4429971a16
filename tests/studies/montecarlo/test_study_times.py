"""Studies of plants whose noise is times a factor: it follows the inputs of each scenario."""

from functools import partial

import numpy as np
import pytest

import jaxbound as jb
from jaxbound.studies.montecarlo.scenarios import Ground

PLANT = jb.LinearSystem(
    [["0.5"]], [[1]], [[1], [1]], noise=[0.1, 0.1], inputs="fan", times={"y1": "0.2 + 3*fan", "y2": "1 + fan"}
)
ABOUT = dict(samples=24, input_range=(0, 1), hold=4)


@pytest.mark.parametrize(
    "made", [partial(jb.parity_relations, horizon=2), jb.observer], ids=["windows", "observer"]
)
def test_no_healthy_scenario_is_a_fault_and_constant_noise_would_be(made, rng):
    about = ABOUT | {"at": "vertices", "key": int(rng.integers(2**31)), "n": 20}
    assert jb.study(PLANT, (), relations=made(PLANT), **about).false_alarms[0] == 0
    constant = jb.parity_relations(PLANT.replace(times=None), 2)
    assert jb.study(PLANT, (), relations=constant, **about).false_alarms[0] > 0


def test_the_inputs_of_a_study_say_how_wide_its_bounds_are(rng):
    relations, detected = jb.parity_relations(PLANT, 2), []
    for fan in (0.0, 30.0):  # bounds of .02 and .1, between which .25 is always seen; of 9 and 3
        inputs, key = np.full((24, 1), fan), int(rng.integers(2**31))
        found = jb.study(PLANT, "y1:bias", 30, key, relations, sizes=[0.25], inputs=inputs)
        assert np.isnan(found.trials[0].guaranteed), "sizes that are sure to be seen need stated factors"
        detected.append(int(found.tallies[0].detected[0]))
    assert detected[0] == 30 and detected[1] < 5


def test_usual_sizes_are_those_where_the_factors_are_one():
    sizes = []
    for model in (PLANT, PLANT.replace(times=None)):
        relations = jb.parity_relations(model, 2)
        (trial,) = Ground(model, relations, 24, np.array([1.0])).trials("y1:bias", None, None)
        sizes.append(trial.sizes)
    np.testing.assert_array_equal(*sizes)


def test_factors_of_other_columns_are_refused():
    other = PLANT.replace(times={"y1": "1 + load"})
    with pytest.raises(ValueError, match="'load'"):
        jb.study(other, "y1:bias", 10, 0, jb.parity_relations(other, 2), sizes=[1.0], **ABOUT)
