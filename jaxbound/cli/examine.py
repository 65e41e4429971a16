"""The command `jaxbound examine`: may the devices of this machine prove, or only search?"""

import argparse
import json
import os
import time
from typing import TYPE_CHECKING

from jaxbound.cli.command import swift_imports
from jaxbound.cli.options import add_json
from jaxbound.cli.terminal import OK, door, progress_bars, show, some_device, write

if TYPE_CHECKING:
    from jaxbound.sets.floats.probe import Examined

NAME = "examine"
HELP = "examine the arithmetic of this machine's accelerator, once, so that it may prove"
EXAMPLES = (
    ("jaxbound examine", "examine a card that JAX can use; from then on CONSISTENT counts there"),
    ("jaxbound examine --json", "the same as JSON: card, driver, jaxlib, date and outcome"),
)
CODES = (
    "exit codes: 0 every device may prove, 1 one may not (the sentence says what it broke), 2 bad input or "
    "usage. A changed card, driver, jax, jaxlib or jaxbound asks for another examination; "
    "JAX_PLATFORMS=cuda,cpu chooses the card in other commands too"
)
BROKEN = 1


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    add_json(parser)


def run(args: argparse.Namespace) -> int:
    """Examine the devices that work goes to, keep what came out; return the exit code."""
    begun = time.perf_counter()
    with swift_imports():
        import jax

        from jaxbound.sets.floats.probe import examined_devices

    if not os.environ.get("JAX_PLATFORMS"):  # elsewhere the shell keeps to the CPU
        jax.config.update("jax_platforms", None)  # type: ignore[no-untyped-call]  # of JAX
    with door(), progress_bars(("examination",)) as step:
        some_device()
        examined = examined_devices(lambda share: step("examination", share))
    seconds = time.perf_counter() - begun
    if args.json:
        devices = [{**each.record, "kept": each.kept, "assumed": list(each.premises)} for each in examined]
        text = json.dumps({"devices": devices, "seconds": seconds}, indent=1, ensure_ascii=False)
        write(text + "\n")
    else:
        for each in examined:
            _show(each)
    if all(each.may_prove for each in examined):
        return OK
    return BROKEN


def _show(examined: "Examined") -> None:
    """Print the outcome for a kind of device."""
    record = examined.record
    headline, style = f"{record['card']}: may not prove, it searches", "bold red"
    if examined.may_prove:
        headline, style = f"{record['card']}: may prove", "bold green"
    rows = [("examined on", record["date"])]
    for name in ("platform", "capability", "driver", "jaxlib"):
        if record[name]:
            rows.append((name, record[name]))
    rows.append(("outcome", record["outcome"]))
    rows.append(("kept in", examined.kept or "nowhere: the folder cannot be written, or it is a CPU"))
    for premise in examined.premises:
        rows.append(("assumed", premise))
    show(headline, style, rows)
