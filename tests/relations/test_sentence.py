"""Relations as a reader would write them: long ones by their largest terms, everywhere."""

import jaxbound as jb
from jaxbound.cli.model_summary import isolation_text
from jaxbound.relations.sentence import main_terms


def test_a_long_relation_is_told_by_its_largest_terms():
    long = "0.5 a - b[k] - 1e-05 c d[k-1] + 3e+02 e + 0.1 f = 0"
    assert (
        main_terms(long, 3) == "0.5 a - b[k] + 3e+02 e + ... = 0"
        and main_terms(long, 5) == long
        and main_terms("- a + 2 b = 0", 1) == "2 b + ... = 0"
    )
    for text in (
        "",
        "is 1 at the samples, and the bounds allow ± 2",
        "no error of this sensor alone explains the window",
    ):
        assert main_terms(text, 1) == text


def test_sums_in_brackets_are_one_term_and_shortened_too():
    polynomial = (
        "r2: - (5 q^3 - 7 q^2 + 0.1 q + 9) T1[k-1] + (0.16 + 0.02 a[k-2]) y + u1 - (mean of 16 "
        "samples of T1)[k] = 0"
    )
    assert main_terms(polynomial, 9) == polynomial
    assert (
        main_terms(polynomial, 3)
        == "r2: - (5 q^3 - 7 q^2 + 9 + ...) T1[k-1] + u1 - (mean of 16 samples of T1)[k] + ... = 0"
    )
    assert main_terms("y1[k] - 0.5 y1[k-1] = 0", 1) == "y1[k] + ... = 0"


def test_a_relation_of_many_terms_is_short_at_a_prompt_and_in_info():
    """A plant of twenty states in one row: its relation has forty terms, its bank polynomials of order
    twenty.
    """
    weights = [f"{i / 100}" for i in range(1, 21)]
    rows = [weights, *([int(i == j) for j in range(20)] for i in range(19))]
    plant = jb.LinearSystem(rows, [[1], *[[0]] * 19], [[f"{1 + i / 7:.3f}" for i in range(20)]], noise="0.1")
    relations = jb.parity_relations(plant)
    whole = relations.text()
    assert whole.count("[k") > 36
    (line,) = [line for line in repr(relations).splitlines() if "r1:" in line]
    assert line.count("[k") == 6 and "+ ... = 0" in line
    told = isolation_text(plant, relations.horizon).splitlines()
    assert max(len(line) for line in told) < 250 and any("..." in line for line in told)
    found = jb.detect(relations, [[0.0]] * 21, [[100.0 * (k % 2)] for k in range(21)])
    assert found.counts["FAULT"] == 1 and str(found.explain(20)).count("[k") <= 6
