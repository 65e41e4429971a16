"""What the help of a command says at its end: examples, and exit codes."""

__all__ = ["epilog"]

EPILOG = (
    "exit codes: 0 no fault, 1 fault found, 2 bad input or usage, 3 too little evidence or outside bounds "
    "that were "
    "fitted to shorter windows, 70 internal error, 130 interrupted, and as shells count 129 by SIGHUP, 143 "
    "by SIGTERM"
)
FIT_EPILOG = (
    "exit codes: 0, 2 bad input or usage, 70 internal error, 130 interrupted, 129 by SIGHUP, 143 "
    "by "
    "SIGTERM (nothing is written)"
)
TUNE_EPILOG = (
    "exit codes: 0, 2 bad input, 70 internal error, 130 interrupted, 129 by SIGHUP, 143 by SIGTERM (the best "
    "bounds until then are "
    "written; the same command goes on)"
)
STUDY_EPILOG = (
    "exit codes: 0, 2 bad input, 70 internal error, 130 interrupted, 129 by SIGHUP, 143 by "
    "SIGTERM (the same command goes on)"
)
SHARES_EPILOG = (
    ". In shares, by three machines that see one folder: jaxbound detect plant.toml recordings/ --out report "
    "--part 1/3, the same with "
    "--part 2/3 and --part 3/3, in any order, then with --merge; what was killed goes on when it is started "
    "again"
)
PIPE_EPILOG = (
    ". With -: SIGINT (Ctrl-C), SIGTERM and SIGHUP end the input. Stopped in any way, kill -9 too, and "
    "started again with the same --out, "
    "verdicts.csv holds each line that was taken once, whether the sender begins again (what was judged is "
    "known by the first line and its "
    "number, or by its time) or goes on. On standard output each verdict stands once, after kill -9 at least "
    "once, if --out or --state is "
    "given. What the pipe held when its reader was killed is lost, unless the sender sends it again"
)
FLEET_EPILOG = (
    "exit codes, the first that applies: 1 fault found in some unit, 2 some unit could not be tested (its "
    "row says why) "
    "or bad input or usage, 3 too little evidence for some unit or outside bounds that were fitted to "
    "shorter windows, "
    "0 no fault; 70 internal error, 130 interrupted, 129 by SIGHUP, 143 by SIGTERM (what was tested is "
    "written)"
)
DONE = "exit codes: 0, or 2 bad input"
VERIFY_EPILOG = (
    "exit codes: 0 confirmed, 1 not confirmed: it proves nothing, or something else than of this model and "
    "these data, and the sentence "
    "says what differs; 2 bad input or usage"
)
NO_COMMAND = (
    "which command? `jaxbound example heater` writes recordings to begin with, and `jaxbound "
    "detect "
    "--help` has examples"
)

ENDS = {
    "demo": "exit code: 0",
    "example": DONE,
    "detect": EPILOG + SHARES_EPILOG + PIPE_EPILOG,
    "explain": DONE,
    "verify": VERIFY_EPILOG,
    "fleet": FLEET_EPILOG,
    "fit": FIT_EPILOG,
    "tune": TUNE_EPILOG,
    "study": STUDY_EPILOG,
    "info": DONE,
}

EXAMPLES = {
    "demo": [
        (
            "jaxbound demo --out demo-report",
            "the example of a paper, with false alarms and detection rates counted",
        )
    ],
    "example": [
        ("jaxbound example", "which examples there are"),
        ("jaxbound example heater", "writes heater/healthy_1.csv and others"),
    ],
    "detect": [
        (
            "jaxbound detect plant.toml run.csv --out report/",
            "verdicts, alarms and one page with charts; exit code 1 if a fault is proved",
        ),
        (
            "jaxbound detect plant.toml run.csv --out report/ --alarm 3/5 -q",
            "one sentence; an alarm needs 3 FAULT among 5 windows",
        ),
        (
            "jaxbound detect plant.toml recordings/ --out report/",
            "a folder of Parquet files, larger than memory",
        ),
        (
            "jaxbound detect plant.toml run.csv --out report/ --method observer",
            "against all samples since it began: slow faults",
        ),
        (
            "jaxbound detect plant.toml run.csv --out report/ --method validation",
            "which sensor is wrong, and what it should have shown",
        ),
        ("logger | jaxbound detect plant.toml - --out live/", "line by line, each verdict at once"),
    ],
    "explain": [
        (
            "jaxbound explain report/ --at 60",
            "the window that ends at sample 60: the relation it violates, or what explains it",
        ),
        (
            "jaxbound explain report/ --at '2026-03-01 12:00:07' --all",
            "by its time, with every coefficient and every sample",
        ),
    ],
    "verify": [
        (
            "jaxbound verify report/certificate-60.json --model report/tested_model.toml --data run.csv",
            "inequalities built anew from model and samples, in exact fractions",
        ),
    ],
    "fleet": [
        (
            "jaxbound fleet units.csv --out fleet/",
            "units.csv has the columns unit, model and recording, a row a unit",
        )
    ],
    "fit": [
        ("jaxbound fit healthy.csv --inputs heater --outputs T1,T2 --out plant.toml", "signals are columns"),
        (
            "jaxbound fit a.csv b.csv --inputs 'Q=Heater 1' --outputs 'lift=`T out`-`T room`' --where 'fan > "
            "0' --out plant.toml",
            "names for columns, a signal computed from columns, only while the fan runs",
        ),
    ],
    "tune": [
        (
            "jaxbound tune plant.toml healthy.csv --out tuned.toml",
            "the smallest bounds that explain healthy.csv, times 1.25",
        ),
        (
            "jaxbound tune plant.toml healthy.csv --faulty leak.csv --out tuned.toml",
            "those that leave most of leak.csv outside",
        ),
    ],
    "study": [
        (
            "jaxbound study plant.toml --faults T1:bias,T2:drift --n 10000 --out study/",
            "sizes around those that are guaranteed",
        ),
        (
            "jaxbound study plant.toml --faults T1:bias --sizes 0.1:1:10 --at vertices --out study/",
            "ten sizes; unknowns at their bounds",
        ),
    ],
    "info": [
        ("jaxbound info --template > plant.toml", "a commented model file to fill in"),
        ("jaxbound info plant.toml", "what it says, its relations, what can be detected and told apart"),
        ("jaxbound info plant.toml --json", "the same for programs"),
    ],
}
"""(command line, what it does) of each command."""


def epilog(command: str) -> str:
    """Return what the help of a command ends with."""
    shown = [line for text, about in EXAMPLES[command] for line in (f"  {text}", f"      {about}")]
    return "\n".join(["examples:", *shown]) + "\n\n" + ENDS[command]
