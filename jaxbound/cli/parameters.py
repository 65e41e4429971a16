"""The command `jaxbound parameters`: values of constant parameters that can explain a whole recording."""

import argparse
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from jaxbound.cli.command import swift_imports
from jaxbound.cli.options import FORCE, JSON, Options, reading, share, test, whole_number
from jaxbound.cli.terminal import INTERRUPTED, OK, Conclusion, Refused, Row, door, progress_bars, some_device

if TYPE_CHECKING:
    from jaxbound.estimation.parameter_set import ParameterSet

NAME = "parameters"
HELP = "narrow the bounds of constant parameters by a recording, losing no value that explains it"
EXAMPLES = (
    (
        "jaxbound parameters plant.toml healthy.csv --out narrowed.toml",
        "the bounds of [[uncertainty]] with varying = false, narrowed by all windows of healthy.csv",
    ),
    (
        "jaxbound parameters plant.toml run.csv --test horizon=4 --plot parameters.png",
        "longer windows leave fewer values; a picture of each pair of parameters",
    ),
)
CODES = (
    "exit codes: 0 some values are left, 1 fault found: no values explain all windows, 2 bad input, "
    "70 internal error, 130 interrupted (what is left until then is shown)"
)
FAULTY = 1
OPTIONS = Options(
    {
        "model MODEL.toml": "with [[uncertainty]], varying = false",
        "data DATA": "one recording: CSV or Parquet",
        "--out NARROWED.toml": "the model with its bounds narrowed to the hull",
        "--plot PNG": "picture of each pair of parameters",
        **test(),
        **FORCE,
        **JSON,
    },
    {"precision": share, "budget": whole_number(1)},
    {"precision": 1 / 32, "budget": 20_000},
    more={
        **reading(),
        "--precision F": "boxes are not cut below this share of the hull (default: 1/32)",
        "--budget N": "boxes that are judged at most (default: 20 000)",
    },
)


def run(args: argparse.Namespace) -> int:
    """Narrow the bounds of parameters and describe them; return the exit code."""
    with swift_imports():
        from jaxbound.cli.window import asked_test, parity_windows, stated_model
        from jaxbound.estimation.parameter_search import STOPPED
        from jaxbound.estimation.parameters import parameters
        from jaxbound.files.whole import put
        from jaxbound.models.modelfile import model_text
        from jaxbound.plots.canvas import to_png
        from jaxbound.plots.parameters import plot_parameters
        from jaxbound.recordings.read import read
        from jaxbound.runs.outputs import refuse_targets

    refuse_targets({"--out": args.out, "--plot": args.plot}, [args.model, args.data], args.force)
    ask = asked_test(args, only=("joint",))
    if ask.test is not None:
        raise Refused("parameters are narrowed by plain windows: give --test horizon=30 or lags=0,1,4")
    with door(), progress_bars(("read", "relations", "parameters")) as step:
        model = stated_model(args.model, args.recording, ask)
        recording = read(args.data, model, lambda share: step("read", share))
        some_device()
        model, relations = parity_windows(model, ask, args.data, recording.samples, step)
        left = parameters(
            relations,
            recording,
            precision=args.precision,
            budget=args.budget,
            progress=lambda share: step("parameters", share),
        )
        written = []
        if args.out and len(left.lo):
            put(args.out, model_text(left.model).encode())
            written.append(str(args.out))
        if args.plot:
            put(args.plot, to_png(plot_parameters(left)))
            written.append(str(args.plot))
    ParameterConclusion(left, recording.label, written=written, hints=recording.hints).show(args.json)
    if left.status == STOPPED:
        return INTERRUPTED
    if len(left.lo):
        return OK
    return FAULTY


@dataclass(frozen=True)
class ParameterConclusion(Conclusion):
    """The values that are left. Fields: left: of them. label: the time of a sample by its number."""

    left: "ParameterSet"
    label: Callable[[int], str]

    @property
    def headline(self) -> str:
        """The names of the parameters, or that no values explain the recording."""
        names, windows = ", ".join(self.left.names), self.left.windows
        if not len(self.left.lo):
            return f"FAULT proved: no values of {names} explain all {windows} windows"
        return f"{names}: every value that explains all {windows} windows is in these bounds"

    def table(self) -> Iterator[Sequence[str]]:
        """Yield the bounds of each parameter."""
        if not len(self.left.lo):
            return
        yield "parameter", "at least", "at most", "before"
        for name, (lo, hi) in self.left.hull.items():
            before = "{:g} to {:g}".format(*self.left.bounds[name])
            yield name, f"{lo:.6g}", f"{hi:.6g}", before

    def rows(self) -> Iterator[Row]:
        """Yield the share that is left, and the window that refutes most."""
        left = self.left
        yield "left", f"{100 * left.share:.3g} % of the volume, in {len(left.lo)} boxes; {left.status}"
        if left.refuted:
            sample, boxes = next(iter(left.refuted.items()))
            yield "refuted most", f"the window that ends at {self.label(sample)}: {boxes} boxes"

    def plain(self) -> dict[str, object]:
        """Return the bounds before and now, and the counts of boxes."""
        left = self.left
        parameters = {}
        for name in left.names:
            parameters[name] = {"bounds": left.bounds[name], "hull": left.hull.get(name)}
        return {
            "status": left.status,
            "parameters": parameters,
            "share": left.share,
            "boxes": len(left.lo),
            "evaluated": left.evaluated,
            "windows": left.windows,
            "refuted": {str(sample): boxes for sample, boxes in left.refuted.items()},
            "written": self.written,
            "hints": self.hints,
        }
