"""`jaxbound detect --part i/n` and `--merge`: a recording larger than memory in shares that know nothing of
each other.
"""

import shlex
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from jaxbound.cli.options import OUTSIDE, MethodOptions
from jaxbound.cli.terminal import OK, door, json_text, progress_bars, show, usable_device, write
from jaxbound.cli.window import recorded, stated_model, window_relations
from jaxbound.consistency.interface import AUTO
from jaxbound.recordings.parquet import PARTIAL
from jaxbound.recordings.read import open_source
from jaxbound.runs.outputs import shared_folder
from jaxbound.runs.parts import part_files
from jaxbound.runs.refusals import Interrupted
from jaxbound.runs.shares import numbers_of
from jaxbound.runs.streaming import CHUNK, Asked, part_count, samples_of, write_parts

__all__ = ["judge_share", "opened", "same_test"]


def judge_share(
    model: Path,
    data: Path | str,
    out: Path,
    options: MethodOptions,
    part: tuple[int, int],
    *,
    chunk: int | None = None,
    overlap: int | None = None,
    as_json: bool = False,
) -> int:
    """Test one share of a Parquet recording and say what was written; return the exit code.

    Args:
        model, data, out: paths. options: of the test. part: (i, n), the i-th of n shares.
        chunk: samples in memory at once. overlap: of an observer, samples before each part. as_json: what was
            done as JSON on stdout.
    """
    name, where, start = "{}/{}".format(*part), out / PARTIAL, time.perf_counter()
    with (
        door(),
        shared_folder(out, (PARTIAL,), (model, data)),
        progress_bars(("relations", "test")) as step,
    ):
        source, how = opened(model, data, options, step, overlap, chunk)
        count = part_count(source)
        mine = numbers_of(part, count)
        try:
            progress = lambda share: step("test", share)
            _, seconds = write_parts(how, source, out, progress, part)
        except KeyboardInterrupt:
            if part_files(where, mine):
                said = (
                    f"interrupted: what part {name} has done is kept in {where}; the same command goes on "
                    f"from there"
                )
                raise Interrupted(said) from None
            raise
    files = part_files(where, mine)
    first, last = samples_of(mine, source)
    if as_json:
        found = {
            "part": name,
            "exit_code": OK,
            "model": source.model.name,
            "data": str(data),
            "method": options.method,
            "horizon": how.relations.horizon,
            "samples": source.samples,
            "first_sample": first,
            "last_sample": last,
            "parts": count,
            "files": [str(file) for file in files],
            "out": str(out),
            "seconds": {k: round(v, 3) for k, v in seconds.items()},
        }
        write(json_text(found, 2))
        return OK
    done = f"the verdicts of samples {first} to {last} are in {where}"
    if not mine:
        done = f"there are {count} parts, and none of them is in this share"
    rows = [
        ("seconds", f"{time.perf_counter() - start:.1f}"),
        ("then", f"{same_test(model, data, out, options, overlap, '--merge')}, once all shares are done"),
    ]
    show(f"Part {name} is done: {done}", "bold", rows)
    return OK


def opened(
    model: Path,
    data: Path | str,
    options: MethodOptions,
    step: Callable[[str, float], object],
    overlap: int | None,
    chunk: int | None,
) -> tuple[Any, Asked]:
    """Return (Source, its test) of what is to be tested chunk by chunk."""
    stated = stated_model(model, options.every)
    usable_device()
    source = open_source(data, recorded(stated, options))
    _, relations = window_relations(stated, options, data, source.samples, step)
    kinds = options.margins, options.outside
    return source, Asked(relations, options.method, *kinds, overlap, chunk or CHUNK)


def same_test(
    model: Path, data: Path | str, out: Path, options: MethodOptions, overlap: int | None, *more: str
) -> str:
    """Return the command that makes the same test of the same recording, as the shell reads it."""
    words: list[object] = ["jaxbound", "detect", model, data, "--out", out]
    if options.method != "joint":
        words += ["--method", options.method]
    if options.lags is not None:
        words += ["--lags", ",".join(map(str, options.lags))]
    valued = {
        "--every": options.every,
        "--horizon": options.horizon,
        "--order": options.order,
        "--observer": options.observer,
        **options.flags,
        "--overlap": overlap,
    }
    for flag, value in valued.items():
        if value is not None:
            words += [flag, value]
    if options.latched:
        words.append("--latched")
    if options.margins != AUTO:
        words += ["--margins", options.margins]
    if options.outside != OUTSIDE[0]:
        words += ["--outside", options.outside]
    return shlex.join(map(str, (*words, *more)))
