"""The power of proofs with uncertain parameters: the verdict on every window against branch and bound in the
state space.
"""

import numpy as np
import pytest
from branch_and_bound import Oracle
from ploix_experiment import in_fault, record
from uncertain_systems import SYSTEMS, relations

import jaxbound as jb
from jaxbound.sets.floats.status import Status

CHANGE = [[0, 0.3, 0], [0, 0, 0]]
"""What golden adds to C."""
BUDGETS = (10, 30, 100, 1000, 10_000)


def windows(rng, name, at, count):
    """Return (u (count, s + 1, m), y (count, s + 1, p)): windows that lie in golden's fault."""
    s = SYSTEMS[name][2] - 1
    ends = in_fault(s)
    u, y = record(rng, name, -(-count // len(ends)), at, dC=CHANGE)
    return (x[:, ends[:, None] + np.arange(-s, 1)].reshape(-1, s + 1, x.shape[-1])[:count] for x in (u, y))


def answers(name, u, y, **changes):
    """Return (what the oracle says of each window, "feasible", "infeasible" or "open"; the boxes that it
    used).
    """
    matrices, parameters, samples = SYSTEMS[name]
    oracle = Oracle(matrices, parameters, samples - 1)
    found = [oracle.decide(*window, **changes) for window in zip(u, y, strict=True)]
    return np.array([answer for answer, _ in found]), np.array([used for _, used in found])


def verdicts(name, u, y, answer, budget=None):
    """Return the status of each window; none may contradict the oracle."""
    status = jb.detect(relations(name), u, y, budget=budget).status[:, -1]
    for verdict, never in ((Status.FAULT, "feasible"), (Status.CONSISTENT, "infeasible")):
        wrong = np.flatnonzero((status == verdict) & (answer == never))
        assert not len(wrong), f"{name}, {budget}: windows {wrong} are {verdict.name} but {never}"
    return status


def test_no_verdict_contradicts_the_oracle(rng):
    u, y = windows(rng, "n3p2_var3_h2", "vertices", 116)
    answer, _ = answers("n3p2_var3_h2", u, y)
    status = verdicts("n3p2_var3_h2", u, y, answer)
    assert (answer != "open").all() and (status != Status.UNDECIDED).all() and (answer == "infeasible").any()


long = lambda *x: pytest.param(*x, marks=pytest.mark.long)


@pytest.mark.parametrize(
    "name, at, count",
    [("n3p2_var3_h2", "vertices", 58), *(long("n3p2_mixed3_h3", at, 84) for at in ("uniform", "vertices"))],
)
def test_boxes_decide_every_window_within_1000_boxes(rng, name, at, count):
    u, y = windows(rng, name, at, count)
    answer, _ = answers(name, u, y)
    status = verdicts(name, u, y, answer, 1000)
    assert (
        (answer != "open").all()
        and (status != Status.UNDECIDED).mean() > 0.95
        and (answer == "infeasible").any()
    )


@pytest.mark.parametrize("name", ["n3p2_mixed3_h3", "n3p1_var2_h4"])
def test_the_oracle_explains_healthy_windows_and_never_drops_their_parameters(rng, name, monkeypatch):
    s = SYSTEMS[name][2] - 1
    for at in ("uniform", "vertices"):
        u, y = (x[0, np.arange(20, 100, 10)[:, None] + np.arange(-s, 1)] for x in record(rng, name, 1, at))
        assert (answers(name, u, y)[0] == "feasible").all()
        with monkeypatch.context() as patch:
            patch.setattr(Oracle, "reproduced", lambda *_: False)
            assert (answers(name, u, y, most=15)[0] == "open").all()


@pytest.mark.parametrize(
    "name, at, count",
    [
        ("n3p2_var3_h2", "vertices", 58),
        *(long(n, at, 600) for n in ("n3p2_mixed3_h3", "n3p2_var3_h2") for at in ("uniform", "vertices")),
    ],
)
def test_boxes_find_nine_tenths_of_the_infeasible_windows(rng, name, at, count):
    u, y = windows(rng, name, at, count)
    answer, used = answers(name, u, y)
    counts = ", ".join(f"{(answer == a).sum()} {a}" for a in ("infeasible", "feasible", "open"))
    print(f"\n{name}, {at}: {counts}; the oracle used {used.mean():.1f} boxes a window, at most {used.max()}")
    infeasible = answer == "infeasible"
    for budget in (1, *BUDGETS):
        status = verdicts(name, u, y, answer, budget)
        left = [(status[answer == a] == Status.UNDECIDED).sum() for a in ("infeasible", "feasible")]
        power = (status[infeasible] == Status.FAULT).mean()
        print(
            f"{budget:>5} boxes: {power:6.1%} of the infeasible are FAULT; {left[0]} infeasible, "
            f"{left[1]} feasible UNDECIDED"
        )
    assert infeasible.any() and (answer != "open").mean() > 0.99
    assert power >= 0.9
