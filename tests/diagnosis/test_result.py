"""What a Result tells: counts, suspects, the violated relation in exact numbers, a table."""

from fractions import Fraction

import numpy as np
import pandas as pd
import pytest
from oracles import MODELS, Plant, draw
from systems import paper

import jaxbound as jb
from jaxbound.sets.floats.status import Status


@pytest.fixture
def result(rng):
    plant = Plant(**MODELS["offsets"])
    u, _, y = draw(plant, 1, 200, rng, level=1.0)
    y[:10, 0, 1] = np.nan
    return jb.detect(jb.parity_relations(jb.LinearSystem(**MODELS["offsets"]), horizon=1), u, y)


def test_counts_add_up(result):
    assert list(result.counts) == ["MISSING", "CONSISTENT", "UNDECIDED", "FAULT"]
    assert sum(result.counts.values()) == result.status.size
    assert result.counts["FAULT"] == (result.status == 3).sum() > 0


def test_status_is_the_sign_of_the_margin(result):
    sign = np.sign(result.margin)
    expected = np.select(
        [np.isnan(sign), sign > 0, sign < 0],
        [Status.MISSING, Status.CONSISTENT, Status.FAULT],
        Status.UNDECIDED,
    )
    np.testing.assert_array_equal(result.status, expected)
    assert result.status.dtype == np.int8


def test_every_fault_is_suspect_and_nothing_consistent(result):
    np.testing.assert_array_equal(result.suspect, result.status == Status.FAULT)


def at_random(result, status, rng, count=25):
    found = np.argwhere(result.status == status)
    return [tuple(map(int, at)) for at in found[rng.permutation(len(found))[:count]]]


def window_of(result, at):
    """Return (exact ends or None of each sample, known inputs) of the offsets model's window, from
    decimals.
    """
    plant = Plant(**MODELS["offsets"])
    ends = plant.true_values(result.y[at[0]], result.y.dtype)
    known = [
        None if np.isnan(v) else Fraction(float(v)) - plant.offset_u[c]
        for row in result.u[at[0]]
        for c, v in enumerate(row)
    ]
    return ends, known


def test_the_relation_that_is_explained_annihilates_the_state(result, rng):
    O, H = Plant(**MODELS["offsets"]).window(1)
    for at in at_random(result, Status.FAULT, rng):
        c = result.explain(at)
        assert all(sum(x * row[j] for x, row in zip(c.h, O, strict=True)) == 0 for j in range(2))
        assert list(c.k) == [sum(x * row[j] for x, row in zip(c.h, H, strict=True)) for j in range(4)]


@pytest.mark.parametrize("status", [Status.FAULT, Status.CONSISTENT])
def test_residual_and_width_are_those_of_the_recorded_samples(status, result, rng):
    for at in at_random(result, status, rng):
        c, (ends, known) = result.explain(at), window_of(result, at)
        used = [
            (x, *ends[i]) for i, x in enumerate(c.h) if x
        ]  # the bounds of a relation are floats, a hair above the decimals
        residual = sum(x * (lo + hi) / 2 for x, lo, hi in used) - sum(
            (x * v for x, v in zip(c.k, known, strict=True) if x), Fraction(0)
        )
        width = sum(abs(x) * (hi - lo) / 2 for x, lo, hi in used)
        assert abs(residual - c.residual) < Fraction(1, 10**12) * (1 + width)
        assert 0 <= c.width - width < Fraction(1, 10**12) * (1 + width)
        assert c.factor == abs(c.residual) / c.width
        assert (c.factor > 1) == (status == Status.FAULT)


def test_the_factor_that_is_explained_is_the_margins(result, rng):
    for at in at_random(result, Status.FAULT, rng) + at_random(result, Status.CONSISTENT, rng):
        assert float(result.explain(at).factor) == pytest.approx(1 - result.margin[at], rel=1e-10)


def test_the_witness_of_a_consistent_window_explains_every_sample_exactly(result, rng):
    O, H = Plant(**MODELS["offsets"]).window(1)
    checked = 0
    for at in at_random(result, Status.CONSISTENT, rng, count=60):
        if result.margin[at] < 0.01:
            continue
        state, (ends, known) = result.explain(at).state, window_of(result, at)
        assert state is not None
        for end, row, drive in zip(ends, O, H, strict=True):
            value = sum(a * x for a, x in zip(row, state, strict=True)) + sum(
                b * v for b, v in zip(drive, known, strict=True)
            )
            assert end is None or end[0] <= value <= end[1]
        checked += 1
    assert checked > 10


def test_a_fault_has_no_witness(result, rng):
    assert all(result.explain(at).state is None for at in at_random(result, Status.FAULT, rng))


def test_the_explanation_is_a_sentence_with_the_relation(result, rng):
    lines = [line.split(": ")[1] for line in result.relations.text(circuits=True).split("\n")]
    for at in at_random(result, Status.FAULT, rng, count=5):
        c = result.explain(at)
        assert c.relation in lines
        assert str(c) == f"{c.relation} cannot hold: it would need bounds {float(c.factor):.4g} times as wide"


def test_a_missing_sample_is_not_part_of_the_explanation(result):
    jump = np.array(
        [[-9.0, 0.0, 0.0], [9.0, 0.0, 0.0]]
    )  # of the other output: a fault that the samples left prove
    res = jb.detect(result.relations, result.u, result.y + jump)
    assert np.isnan(res.y[:10, 0, 1]).all() and (res.status[:10, 1] == Status.FAULT).all()
    assert [res.explain((i, 1)).h[1] for i in range(10)] == [0] * 10


def test_a_window_without_data_cannot_be_explained():
    with pytest.raises(ValueError, match="window 0 is MISSING: there is nothing to explain"):
        jb.detect(jb.parity_relations(paper()), np.zeros((3, 1)), np.zeros((3, 2))).explain(0)


def test_a_table_has_one_row_a_sample_and_names_for_verdicts(rng):
    y = pd.DataFrame({"y1": [0.0, 0.0, 9.0], "y2": [0.0] * 3}, index=[10, 11, 12])
    table = jb.detect(jb.parity_relations(paper()), np.zeros((3, 1)), y).to_pandas()
    assert list(table.columns) == ["status", "margin", "suspect"] and list(table.index) == [10, 11, 12]
    assert list(table["status"]) == ["MISSING", "CONSISTENT", "FAULT"] and list(table["suspect"]) == [
        False,
        False,
        True,
    ]


def test_a_batch_has_no_single_table(result):
    with pytest.raises(
        ValueError, match=r"to_pandas is for one recording, this result has the shape \(200, 2\)"
    ):
        result.to_pandas()
