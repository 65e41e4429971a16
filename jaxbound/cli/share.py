"""`jaxbound detect --part i/n` and `--merge`: a recording larger than memory in shares that know nothing of
each other.
"""

import argparse
import json
import shlex
import time
from collections.abc import Callable
from typing import Any

from jaxbound.cli.terminal import OK, door, progress_bars, show, usable_device, write
from jaxbound.cli.window import OBSERVER, window_relations
from jaxbound.models.modelfile import load_model
from jaxbound.recordings.parquet import PARTIAL
from jaxbound.recordings.read import open_source
from jaxbound.runs.outputs import shared_folder
from jaxbound.runs.parts import part_files
from jaxbound.runs.refusals import Interrupted, Refused
from jaxbound.runs.runfile import VALIDATION
from jaxbound.runs.shares import numbers_of
from jaxbound.runs.streaming import CHUNK, part_count, samples_of, write_parts

__all__ = ["opened", "refuse_shares", "run_share"]


def refuse_shares(args: argparse.Namespace, kind: Any) -> None:
    """Raise Refused if --part or --merge is given where there are no parts. kind: of source."""
    given = [option for option, on in (("--part", args.part is not None), ("--merge", args.merge)) if on]
    if len(given) > 1:
        raise Refused("--merge reports on what --part makes: give one of the two")
    if given and args.method == VALIDATION:
        raise Refused(f"{given[0]} is for other methods: {VALIDATION} reads {args.data} as a whole")
    if given and args.method == OBSERVER and args.overlap is None:
        raise Refused(
            f"{given[0]} is for windows: an observer carries what it knows from sample to sample, its work "
            f"can be shared only "
            "where --overlap N lets one begin anew N samples before each part"
        )
    if args.overlap is not None and args.method != OBSERVER:
        raise Refused(f"--overlap is for --method {OBSERVER}: windows know how far they reach back")
    if args.overlap is not None:
        given.append("--overlap")
    if given and not kind.parts:
        raise Refused(f"{given[0]} is for Parquet: {args.data} is read as a whole")


def run_share(args: argparse.Namespace) -> int:
    """Test one share of a Parquet recording and say what was written; return the exit code."""
    name, where, start = "{}/{}".format(*args.part), args.out / PARTIAL, time.perf_counter()
    with (
        door(),
        shared_folder(args.out, (PARTIAL,), (args.model, args.data)),
        progress_bars(("relations", "test")) as step,
    ):
        source, relations = opened(args, step)
        count = part_count(source)
        mine = numbers_of(args.part, count)
        try:
            progress = lambda share: step("test", share)
            _, seconds = write_parts(
                relations,
                source,
                args.out,
                args.method,
                args.chunk or CHUNK,
                progress,
                args.part,
                overlap=args.overlap,
            )
        except KeyboardInterrupt:
            if part_files(where, mine):
                said = (
                    f"interrupted: what part {name} has done is kept in {where}; the same command goes "
                    f"on "
                    f"from there"
                )
                raise Interrupted(said) from None
            raise
    files = part_files(where, mine)
    first, last = samples_of(mine, source)
    if args.json:
        found = {
            "part": name,
            "exit_code": OK,
            "model": source.model.name,
            "data": str(args.data),
            "method": args.method,
            "horizon": relations.horizon,
            "samples": source.samples,
            "first_sample": first,
            "last_sample": last,
            "parts": count,
            "files": [str(file) for file in files],
            "out": str(args.out),
            "seconds": {k: round(v, 3) for k, v in seconds.items()},
        }
        write(json.dumps(found, indent=2) + "\n")
        return OK
    done = f"the verdicts of samples {first} to {last} are in {where}"
    if not mine:
        done = f"there are {count} parts, and none of them is in this share"
    rows = [
        ("seconds", f"{time.perf_counter() - start:.1f}"),
        ("then", f"{_again(args, '--merge')}, once all shares are done"),
    ]
    show(f"Part {name} is done: {done}", "bold", rows)
    return OK


def opened(args: argparse.Namespace, step: Callable[[str, float], object]) -> tuple[Any, Any]:
    """Return (Source, relations) of what is to be tested chunk by chunk."""
    model = load_model(args.model)
    usable_device()
    source = open_source(args.data, model)
    return source, window_relations(model, args, args.data, source.samples, step)[1]


TOLD = ("horizon", "lags", "order", "observer", "span", "overlap")
"""Options beside --method and --latched that all shares of a recording, and the report on them, have in
common.
"""


def _again(args, *more):
    """Return the command that makes the same test, as the shell reads it."""
    given = [] if args.method == "joint" else ["--method", args.method]
    for name in TOLD:
        if (value := getattr(args, name)) is not None:
            given += [f"--{name}", ",".join(map(str, value)) if name == "lags" else value]
    given += ["--latched"] * bool(args.latched)
    return shlex.join(
        map(str, ("jaxbound", "detect", args.model, args.data, "--out", args.out, *given, *more))
    )
