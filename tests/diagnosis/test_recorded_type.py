"""A recording is known to four roundoffs of the type in which it was recorded, whatever type it is computed
in.
"""

from fractions import Fraction

import numpy as np
import pytest
from oracles import Plant

import jaxbound as jb

BARE = dict(A=[[0.8, 1], [0, 0.2]], B=[[0], [1]], C=[[1, 0], [1, 1]])
T = 24


def recorded(rng, **bounds):
    """Return (model, u, y, x): y as float32, the nearest to the exact outputs of a healthy plant with no
    error at all; x its states.
    """
    plant, u = Plant(**BARE), rng.uniform(-50, 50, (T, 1)).astype(np.float32)
    x0 = [Fraction(float(v)) for v in rng.uniform(-300, 300, 2)]
    y = plant.trajectory(x0, [[Fraction(float(v)) for v in row] for row in u])
    x = np.array([[float(a), float(b - a)] for a, b in y])  # C is [1 0; 1 1]
    return (
        jb.LinearSystem(**BARE, **bounds),
        u,
        np.array([[np.float32(float(v)) for v in row] for row in y]),
        x,
    )


@pytest.mark.parametrize("noise", [0, 1e-8])
@pytest.mark.parametrize("method", ["joint", "sequential"])
def test_validate_counts_the_rounding_of_a_float32_recording(rng, method, noise):
    model, u, y, x = recorded(rng, noise=noise)
    found = jb.validate(model, u, y, method=method)
    assert not (np.asarray(found.status) == jb.Status.FAULT).any() and not np.asarray(found.faulty).any()
    assert ((found.state.lo <= x) & (x <= found.state.hi)).all()


def test_validate_counts_it_for_every_sub_model_of_measured_parts(rng):
    model, u, y, _ = recorded(rng)
    parts = jb.MultiModel([model, model], lambda u: np.full((*np.shape(u)[:-1], 2), 0.5), partial=True)
    found = jb.validate(parts, u, np.stack([y, y], -2))
    assert not np.asarray(found.faulty).any() and not (np.asarray(found.status) == jb.Status.FAULT).any()


def test_validate_takes_whole_numbers_and_float64_and_refuses_half_precision(rng):
    model, u, y, x = recorded(rng)
    exact = np.zeros((T, 2), int)
    assert not np.asarray(jb.validate(model, np.zeros((T, 1), int), exact).faulty).any()
    with pytest.raises(ValueError, match="y is in half precision: convert it to float32"):
        jb.validate(model, u, y.astype(np.float16))


def test_validate_never_allows_less_than_detect_does(rng):
    """The last digit of a small sample beside a large one is nothing to blame a sensor for."""
    model, u, y, _ = recorded(rng)
    y[10, 0] = np.nextafter(y[10, 0], np.float32(np.inf))
    assert not (jb.detect(jb.parity_relations(model), u, y).status == jb.Status.FAULT).any()
    assert not (np.asarray(jb.validate(model, u, y).status) == jb.Status.FAULT).any()


def test_detect_margins_and_unknown_inputs_count_it(rng):
    model, u, y, _ = recorded(rng)
    relations = jb.parity_relations(model)
    assert not (jb.detect(relations, u, y).status == jb.Status.FAULT).any()
    assert jb.margins(relations, u, y).dtype == np.float32
    leaking = jb.LinearSystem(**BARE, unknown_inputs=[[1], [0]])
    values = jb.unknown_inputs(leaking, u, y).values
    assert ((values.lo <= 0) & (values.hi >= 0)).all()


def test_a_monitor_in_float64_refuses_float32_outputs_and_one_in_float32_takes_both(rng):
    model, u, y, _ = recorded(rng)
    relations = jb.parity_relations(model)
    wide = jb.Monitor(relations)
    with pytest.raises(
        ValueError, match=r"y is in float32, .* build it as Monitor\(relations, dtype=np.float32\)"
    ):
        wide.run(wide.init(), u, y)
    narrow = jb.Monitor(relations, dtype=np.float32)
    for given in (y, y.astype(np.float64)):
        _, verdict = narrow.run(narrow.init(), u, given)
        np.testing.assert_array_equal(verdict.status, jb.detect(relations, u, y).status)
        assert not (verdict.status == jb.Status.FAULT).any()


@pytest.mark.parametrize("kind", ["plain", "computed", "nullable"])
def test_one_float32_column_makes_the_recording_float32(rng, kind):
    import pandas as pd

    model, u, y, _ = recorded(rng)
    frame = pd.DataFrame({"y1": y[:, 0], "y2": y[:, 1].astype(np.float64), "u1": u[:, 0]})
    if kind == "computed":
        frame["half"] = frame.pop("y1") / 2
        model = jb.LinearSystem(**BARE, columns={"y1": "= 2 * half"})
    if kind == "nullable":
        frame["y1"] = frame["y1"].astype("Float32")
    found = jb.detect(jb.parity_relations(model), frame, frame)
    assert found.y.dtype == np.float32 and not (found.status == jb.Status.FAULT).any()


def test_a_column_in_half_precision_is_refused_beside_wider_ones(rng):
    import pandas as pd

    model, u, y, _ = recorded(rng)
    frame = pd.DataFrame({"y1": y[:, 0].astype(np.float16), "y2": y[:, 1].astype(np.float64)})
    with pytest.raises(ValueError, match="y is in half precision"):
        jb.detect(jb.parity_relations(model), u, frame)


def test_inputs_narrowed_for_float32_outputs_are_not_taken_as_exact(rng):
    """detect and unknown_inputs compute in the type of y; float64 inputs of a noise-free plant lose digits
    there.
    """
    plant, u = Plant(**BARE), rng.uniform(-50, 50, (T, 1))
    y = np.array(
        [
            [np.float32(float(v)) for v in row]
            for row in plant.trajectory([Fraction(1), Fraction(2)], [[Fraction(float(v))] for v in u[:, 0]])
        ]
    )
    assert not (jb.detect(jb.parity_relations(jb.LinearSystem(**BARE)), u, y).status == jb.Status.FAULT).any()
    values = jb.unknown_inputs(jb.LinearSystem(**BARE, unknown_inputs=[[1], [0]]), u, y).values
    assert ((values.lo <= 0) & (values.hi >= 0)).all()
    assert not np.asarray(jb.validate(jb.LinearSystem(**BARE), u, y).faulty).any()


def test_a_dataset_of_float32_columns_without_noise_raises_no_fault(rng, tmp_path):
    import pandas as pd

    model, u, y, _ = recorded(rng)
    pd.DataFrame({"y1": y[:, 0], "y2": y[:, 1], "u1": u[:, 0]}).to_parquet(tmp_path / "run.parquet")
    found = jb.detect_dataset(jb.parity_relations(model), tmp_path / "run.parquet", tmp_path / "out")
    assert found.counts["FAULT"] == 0 and found.counts["CONSISTENT"] > 0


def test_uncertain_relations_count_the_rounding_of_float32(rng):
    uncertain = jb.LinearSystem(
        **BARE | {"C": [[1, 0]]}, uncertainties=[jb.Uncertainty("a", A=[["1e-9", 0], [0, 0]])]
    )
    relations, (_, u, y, _) = jb.parity_relations(uncertain), recorded(rng)
    y = y[:, :1]
    assert not (jb.detect(relations, u, y).status == jb.Status.FAULT).any()
