"""Linear programs by HiGHS: whoever asks one gets an answer or an error, never silence that looks like one.

HiGHS starts its threads once a process, as many as the first program asks for. A later program that asks for
another number is refused: its status stays kNotset, and a test that compares it with kOptimal reads
"infeasible". So all programs of tests ask for one thread.
"""

import highspy

ANSWERS = highspy.HighsModelStatus.kOptimal, highspy.HighsModelStatus.kInfeasible


def solver(**options):
    """Return a silent solver with one thread and these options."""
    new = highspy.Highs()
    for name, value in dict(output_flag=False, threads=1, **options).items():
        assert new.setOptionValue(name, value) == highspy.HighsStatus.kOk, name
    return new


def is_feasible(program):
    """Run a program and say whether it has a solution; asked again where HiGHS has no answer, since the basis
    of another case can lead it astray and presolving leaves open what it is that has none.
    """
    program.run()
    if program.getModelStatus() not in ANSWERS:
        program.clearSolver()
        program.setOptionValue("presolve", "off")
        program.run()
    answer = program.getModelStatus()
    assert answer in ANSWERS, f"HiGHS has no answer to a linear program, asked twice: {answer}"
    return answer == highspy.HighsModelStatus.kOptimal
