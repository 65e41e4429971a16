"""The command `jaxbound info`: what a model file says, and what can be detected and isolated with it."""

import argparse
import os

from jaxbound.cli.command import swift_imports
from jaxbound.cli.options import Options, test
from jaxbound.cli.terminal import OK, Refused, door, json_text, progress_bars, some_device, write

NAME = "info"
HELP = "show what a model file says and what can be tested"
EXAMPLES = (
    ("jaxbound info --template > plant.toml", "a commented model file to fill in"),
    ("jaxbound info plant.toml", "what it says, its relations, what can be detected and told apart"),
    ("jaxbound info plant.toml --json", "the same for programs"),
    (
        "jaxbound info --device",
        "examine the arithmetic of a card, once: from then on CONSISTENT counts there",
    ),
)
CODES = "exit codes: 0, or 2 bad input; --device: 1 where a device may not prove"
BROKEN = 1
OPTIONS = Options(
    {
        "model [MODEL.toml]": "the model file to show",
        "--template": "print a commented model file",
        "--device": "examine the devices that JAX can use, so that they may prove (JAX_PLATFORMS chooses)",
        **test(),
        "--json": "the same as JSON on stdout, nothing else",
    }
)


def run(args: argparse.Namespace) -> int:
    """Print the template, or describe a model; return the exit code."""
    with swift_imports():
        from jaxbound.cli.model_summary import ModelConclusion
        from jaxbound.cli.window import asked_test, parity_windows, stated_model
        from jaxbound.consistency.interface import MONITOR
        from jaxbound.diagnosis.hints import bound_hints
        from jaxbound.diagnosis.monitoring import monitor
        from jaxbound.models.template import template

    if args.template + args.device + (args.model is not None) != 1:
        raise Refused("jaxbound info needs either a model file or --template or --device")
    if args.model is None and args.test:
        raise Refused("--test says which windows of a model file are shown: none is given")
    if args.device:
        return _examine(args.json)
    if args.template:
        write(template())
        return OK
    with door(), progress_bars(("relations",)) as step:
        ask, bank = asked_test(args, only=("joint",)), None
        model = stated_model(args.model, None, ask)
        if ask.of(model).method == MONITOR:
            bank = monitor(model)
        model, relations = parity_windows(model, ask, args.model, None, step)
    ModelConclusion(model, relations, bank, hints=bound_hints(model)).show(args.json)
    return OK


def _examine(as_json: bool) -> int:
    """Examine the devices that work goes to; return the exit code."""
    with swift_imports():
        import jax

        from jaxbound.sets.floats.probe import examined_devices

    if not os.environ.get("JAX_PLATFORMS"):  # elsewhere the shell keeps to the CPU
        jax.config.update("jax_platforms", None)  # type: ignore[no-untyped-call]  # of JAX
    with door():
        some_device()
        devices = examined_devices()
    if as_json:
        write(json_text({"devices": devices}))
    else:
        for device, broken in devices.items():
            outcome = "may prove"
            if broken:
                outcome = f"may not prove, it searches: {broken}"
            write(f"{device}: {outcome}\n")
    if any(devices.values()):
        return BROKEN
    return OK
