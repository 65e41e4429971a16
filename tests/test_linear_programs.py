"""A linear program has an answer, whatever ran before it in the process, or says that it has none."""

import linear_programs
import pytest


def one_variable(least, **options):
    """Return a program of one variable in [0, 1] that is to be at least so much."""
    solver = linear_programs.solver(**options)
    x = solver.addVariable(0, 1)
    solver.addConstr(x >= least)
    return solver


@pytest.mark.parametrize("presolve", ["choose", "off"])
def test_it_is_feasible_or_not(presolve):
    answers = [linear_programs.is_feasible(one_variable(least, presolve=presolve)) for least in (0.5, 2)]
    assert answers == [True, False]


def test_one_that_is_refused_raises_instead_of_being_infeasible():
    assert linear_programs.is_feasible(one_variable(0.5))
    refused = one_variable(0.5)
    refused.setOptionValue("threads", 2)
    with pytest.raises(AssertionError, match="no answer to a linear program, asked twice: .*kNotset"):
        linear_programs.is_feasible(refused)
