"""`jaxbound detect --part i/n` and `--merge`: a recording larger than memory in shares that know nothing of
each other.
"""

import shlex
import time
from collections.abc import Sequence
from typing import Any

from jaxbound.cli.terminal import OK, door, json_text, progress_bars, show, usable_device, write
from jaxbound.cli.window import DetectRun, Step, stated_model, window_relations
from jaxbound.recordings.parquet import PARTIAL
from jaxbound.recordings.read import open_source
from jaxbound.runs.outputs import shared_folder
from jaxbound.runs.parts import part_files
from jaxbound.runs.refusals import Interrupted
from jaxbound.runs.shares import part_numbers
from jaxbound.runs.streaming import CHUNK, Asked, part_count, sample_range, write_parts


def judge_share(run: DetectRun, part: tuple[int, int]) -> int:
    """Test one share of a Parquet recording and say what was written; return the exit code.

    Args:
        part: (i, n), the i-th of n shares.
    """
    name, where, start = f"{part[0]}/{part[1]}", run.out / PARTIAL, time.perf_counter()
    with (
        door(),
        shared_folder(run.out, (PARTIAL,), (run.model, run.data)),
        progress_bars(("relations", "test")) as step,
    ):
        source, how = opened_share(run, step)
        count = part_count(source)
        mine = part_numbers(part, count)
        try:
            progress = lambda share: step("test", share)
            _, seconds = write_parts(how, source, run.out, progress, part)
        except KeyboardInterrupt:
            if part_files(where, mine):
                said = (
                    f"interrupted: what part {name} has done is kept in {where}; the same command goes on "
                    f"from there"
                )
                raise Interrupted(said) from None
            raise
    files = part_files(where, mine)
    first, last = sample_range(mine, source)
    if run.json:
        found = {
            "part": name,
            "exit_code": OK,
            "model": source.model.name,
            "data": str(run.data),
            "method": run.ask.method,
            "horizon": how.relations.horizon,
            "samples": source.samples,
            "first_sample": first,
            "last_sample": last,
            "parts": count,
            "files": list(map(str, files)),
            "out": str(run.out),
            "seconds": {k: round(v, 3) for k, v in seconds.items()},
        }
        write(json_text(found))
        return OK
    done = f"the verdicts of samples {first} to {last} are in {where}"
    if not mine:
        done = f"there are {count} parts, and none of them is in this share"
    rows = [
        ("seconds", f"{time.perf_counter() - start:.1f}"),
        ("then", f"{same_test(run.words)}, once all shares are done"),
    ]
    show(f"Part {name} is done: {done}", "bold", rows)
    return OK


def opened_share(run: DetectRun, step: Step) -> tuple[Any, Asked]:
    """Return (Source, its test) of what is to be tested chunk by chunk."""
    stated = stated_model(run.model, run.recording, run.ask)
    usable_device()
    source = open_source(run.data, run.ask.recorded(stated))
    _, relations = window_relations(stated, run.ask, run.data, source.samples, step)
    return source, Asked(relations, run.ask, run.overlap, run.chunk or CHUNK)


def same_test(words: Sequence[str]) -> str:
    """Return the command that reports on all shares, as the shell reads it. words: that judged one share."""
    kept: list[str] = []
    is_value = False
    for number, word in enumerate(words):
        if word == "--" and not is_value:
            kept += words[number:]
            break
        name, equals, _ = word.partition("=")
        if is_value:
            is_value = False
        elif len(name) > 2 and "--part".startswith(name):  # argparse takes its beginning for it
            is_value = not equals
        else:
            kept.append(word)
    return shlex.join(["jaxbound", "detect", "--merge", *kept])
