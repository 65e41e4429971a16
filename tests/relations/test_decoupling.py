"""Banks, signatures and isolability: the paper's example with golden's corrections, published structures,
random systems.
"""

import json
from fractions import Fraction
from itertools import combinations

import numpy as np
import pytest
from oracles import Plant, rational_matrix
from systems import paper

import jaxbound as jb
from jaxbound.relations import shift


@pytest.fixture(scope="module")
def ragot(shared):
    return json.loads(shared("golden/ragot1993.json").read_text())


def example(ragot, leak=True):
    s = ragot["system"]
    return jb.LinearSystem(s["A"], s["B"], s["C"], unknown_inputs=s["F"] if leak else None)


CASES = [("v_unknown", True, 9), ("v_absent", False, 17)]


@pytest.mark.parametrize("case, leak, count", CASES)
def test_the_bank_of_minimal_supports_is_goldens(ragot, case, leak, count):
    known = ragot["isolability_signatures"][case]
    bank = jb.structured_relations(example(ragot, leak))
    table = jb.signatures(bank)
    supports = ["".join("1" if p else "0" for p in row) for row in bank.rows]
    assert sorted(supports) == known["minimal_support"] and bank.count == count
    order = sorted(range(count), key=lambda i: supports[i])
    for kind, signs in (("", {"t": "1"}), ("_dc", {})):
        for name, column in known[f"minimal_bank_columns{kind}"].items():
            mine = "".join(table.columns[name][i] for i in order)
            assert mine.translate(str.maketrans(signs)) == column
    assert table.faults == tuple(known["fault_order"])
    columns = list(known["minimal_bank_columns"].values())
    assert table.distance == min(
        sum(x != y for x, y in zip(a, b, strict=True)) for a, b in combinations(columns, 2)
    )
    assert not leak or table.distance == 4
    assert [set(ignored) for ignored in bank.insensitive] == [
        {n for n, p in zip(bank.names, row, strict=True) if not p} for row in bank.rows
    ]


def structures(model, faults):
    """Return {faults: (relations, order, least degree, constant)} of each set of faults to which relations
    can react, and to no other of `faults`.
    """
    found = {}
    for size in range(1, len(faults) + 1):
        for some in combinations(faults, size):
            try:
                bank = jb.structured_relations(model, [[f for f in faults if f not in some]])
            except ValueError:
                continue
            table = jb.signatures(bank)
            mine = [table.faults.index(f) for f in some]
            weak = table.weak[:, mine]
            if not weak.any(0).all():
                continue
            least = next(d for d in sorted(bank.degrees) if weak[bank.degrees <= d].any(0).all())
            steady = bool(table.constant[:, mine].any(0).all())
            found[some] = bank.count, bank.degrees.sum(), least, steady
    return found


@pytest.mark.parametrize("case, leak, count", CASES)
def test_every_achievable_structure_of_the_example(ragot, case, leak, count):
    model = example(ragot, leak)
    known = ragot["isolability_signatures"][case]["specs"]
    assert structures(model, model.outputs + model.inputs) == {
        tuple(s["faults"]): (s["rdim"], s["order"], s["least_degree"], s["strong_q1"]) for s in known
    }


@pytest.mark.parametrize("case, leak, count", CASES)
def test_which_single_faults_of_the_example_can_be_told_apart(ragot, case, leak, count):
    known, found = ragot["isolability_pairwise"][case], jb.isolability(example(ragot, leak))
    assert found.faults == tuple(known["order"])
    for mine, golden in (
        (found.detectable, "detect_weak"),
        (found.detectable_constant, "detect_persistent"),
        (found.isolable, "isolable_weak"),
        (found.isolable_constant, "isolable_persistent"),
    ):
        np.testing.assert_array_equal(mine.astype(int), known[golden])
    degrees = [[-1 if x is None else x for x in row] for row in known["min_degree"]]
    np.testing.assert_array_equal(found.degree, degrees)
    y2, y3, y4, u2 = (found.faults.index(name) for name in ("y2", "y3", "y4", "u2"))
    assert not found.detectable_constant[y2]
    assert not found.isolable_constant[y3, y4] and not found.isolable_constant[y4, y3]
    assert found.isolable_constant[u2, y2] == (not leak)


def test_the_printed_relations_have_goldens_signatures(ragot):
    known = ragot["isolability_signatures"]
    table = jb.signatures(jb.redundancy(example(ragot)))  # r2, r3, r1 of the paper
    order = [2, 0, 1]
    assert {n: "".join(c[i] for i in order) for n, c in table.columns.items()} == known["paper_r_dc"]
    weak = {n: "".join("01"[c[i] != "0"] for i in order) for n, c in table.columns.items()}
    assert weak == known["paper_r_weak"]


@pytest.mark.parametrize("case", ["xiong_saif2000_ex1", "varga_ex5_4"])
def test_published_structures(case, shared):
    c = json.loads(shared("external/fdi_structures.json").read_text())["cases"][case]
    m = jb.LinearSystem(c["A"], c["Bu"], c["C"], c["Du"], unknown_inputs=(c["Bd"], c["Dd"]))
    faults = []
    for column in range(len(c["Bf"][0])):  # a fault of an input, or of the output that it alone acts on
        drive, direct = [[row[column] for row in c[x]] for x in ("Bf", "Df")]
        inputs = [[[row[j] for row in c[x]] for x in ("Bu", "Du")] for j in range(m.m)]
        faults.append(m.inputs[inputs.index([drive, direct])] if any(drive) else m.outputs[direct.index(1)])
    found = structures(m, faults)
    wanted, order = c["expected"], c["our_exact_result"]["S_weak"]
    name = lambda row: tuple(f for f, on in zip(faults, row, strict=True) if on)
    assert set(found) == {name(row) for row in wanted["S_weak"]} == {name(row) for row in order}
    binary = [name([j >> 1 & 1, j & 1]) for j in range(1, 4)]
    for i, specification in enumerate(binary):
        *mine, steady = found.get(specification, (0, -1, -1, None))
        assert mine == [wanted["rdims"][i], wanted["orders"][i], wanted["leastorders"][i]]
        assert steady is None or steady == (
            list(map(int, (f in specification for f in faults))) in c["our_exact_result"]["S_strong_DC"]
        )


def test_each_part_of_a_bank_holds_whatever_its_faults_do(rng):
    """A fault that takes any values leaves every relation that ignores it at zero, exactly."""
    draw = lambda r, c: [[Fraction(int(x), 10) for x in row] for row in rng.integers(-9, 10, (r, c))]
    spec = dict(
        A=draw(4, 4), B=draw(4, 2), C=draw(4, 4), D=draw(4, 2), unknown_inputs=(draw(4, 1), draw(4, 1))
    )
    plant, m = Plant(**spec), jb.LinearSystem(**spec)
    bank = jb.structured_relations(m, [("u1",), ("y1", "y3"), ("u2", "y4"), ()])
    assert set(bank.insensitive) == {("u1",), ("y1", "y3"), ("u2", "y4"), ()}
    W, K = bank.windows()
    s = bank.horizon
    state, u, v = (draw(rows, c) for rows, c in ((1, 4), (s + 1, 2), (s + 1, 1)))
    for ignored in set(bank.insensitive):
        applied = [
            [
                x + (Fraction(int(rng.integers(-99, 99))) if f"u{j + 1}" in ignored else 0)
                for j, x in enumerate(row)
            ]
            for row in u
        ]
        y = plant.trajectory(state[0], applied, v=v)
        y = [
            [
                x + (Fraction(int(rng.integers(-99, 99))) if f"y{i + 1}" in ignored else 0)
                for i, x in enumerate(row)
            ]
            for row in y
        ]
        flat_y, flat_u = [x for row in y for x in row], [x for row in u for x in row]
        for h, k, group in zip(W, K, bank.insensitive, strict=True):
            value = sum(a * b for a, b in zip(h, flat_y, strict=True)) - sum(
                a * b for a, b in zip(k, flat_u, strict=True)
            )
            assert (value == 0) == (ignored in ((), group))


def rank_at(q, A, B, C, D, F, faults):
    """Return the rank of [[q - A, F, ..], [C, 0, ..]] with the columns of faults, outputs first, by
    python-flint.
    """
    n, p = len(A), len(C)
    rows = [[q * (i == j) - x for j, x in enumerate(row)] + F[i] for i, row in enumerate(A)] + [
        c + [Fraction(0)] * len(F[0]) for c in C
    ]
    for f in faults:
        column = [row[f - p] for row in B + D] if f >= p else [Fraction(int(i == f)) for i in range(-n, p)]
        rows = [[*row, x] for row, x in zip(rows, column, strict=True)]
    return rational_matrix(rows).rank()


def test_isolability_of_random_systems_by_ranks(rng):
    """Fault i shows although fault j is ignored iff eliminating i as well costs a relation."""
    for _ in range(8):
        n, p, m, d = 4, 3, 2, int(rng.integers(0, 2))
        draw = lambda r, c: [
            [Fraction(int(x)) for x in row]
            for row in rng.integers(-3, 4, (r, c)) * (rng.uniform(size=(r, c)) < 0.5)
        ]
        plant = draw(n, n), draw(n, m), draw(p, n), draw(p, m), draw(n, d)
        q = Fraction(int(rng.integers(10**6)), 997)
        found = jb.isolability(jb.LinearSystem(*plant[:4], unknown_inputs=plant[4] if d else None))
        for i in range(p + m):
            assert found.detectable[i] == (rank_at(q, *plant, [i]) > rank_at(q, *plant, []))
            for j in range(p + m):
                assert found.isolable[i, j] == (rank_at(q, *plant, [j, i]) > rank_at(q, *plant, [j])), (i, j)


def test_a_bank_of_many_relations_keeps_those_that_tell_signals_apart(rng):
    A = [[Fraction(int(x), 10) for x in row] for row in rng.integers(-9, 10, (2, 2))]
    C = [[Fraction(int(x), 10) for x in row] for row in rng.integers(1, 10, (5, 2))]
    bank = jb.structured_relations(jb.LinearSystem(A, [[1, 0], [0, 1]], C))
    assert bank.count == 24 and jb.signatures(bank).distance >= 5


def test_tables_read_well(ragot):
    table = jb.signatures(jb.structured_relations(example(ragot), [("u1",), ("u2",)])).text().splitlines()
    assert table[0].split() == ["y1", "y2", "y3", "y4", "u1", "u2"] and table[1].split() == [
        "r1",
        ".",
        "t",
        "1",
        "1",
        ".",
        "1",
    ]
    lines = jb.isolability(example(ragot)).text().splitlines()
    assert lines[0].split()[0] == "seen" and lines[2].split() == ["y2", "t", "t", "-", "t", "t", "t", "t"]
    r = jb.parity_relations(paper())
    assert [shift.row_text(row, r.model.outputs + r.model.inputs) for row in jb.redundancy(paper()).rows]
    assert jb.signatures(r).weak.shape == (2, 3)


def test_what_cannot_be_is_refused(ragot):
    m = example(ragot)
    with pytest.raises(
        ValueError,
        match="no relation ignores y1, y2, y3: that many unknown signals can explain whatever is left",
    ):
        jb.structured_relations(m, [("y1",), ("y1", "y2", "y3")])
    with pytest.raises(ValueError, match="the model has no signal 'y9': it has y1, y2, y3, y4, u1, u2"):
        jb.structured_relations(m, ["y9"])
    with pytest.raises(TypeError, match="signatures needs relations, not int"):
        jb.signatures(3)
