"""Origins of reports: run.json names recording and test, tested_model.toml is the model as it was."""

import hashlib
import json
from pathlib import Path
from typing import Any

from jaxbound.consistency.interface import MONITOR
from jaxbound.models.modelfile import load_model, model_text
from jaxbound.models.system import LinearSystem
from jaxbound.recordings.read import kind_of
from jaxbound.runs.sink import Outcome, Sink

VALIDATION = "validation"  # not a method of `detect`: the shell name of `validate`

RUN, MODEL = "run.json", "tested_model.toml"


class RunRecord(Sink):
    """run.json and tested_model.toml, with which `jaxbound explain` finds again what was tested."""

    names = (RUN,)  # the model may be the one that is tested again

    def close(self, outcome: Outcome) -> None:
        """Write both, with which `load_run` finds again what was tested.

        The digest of the recording was taken before it was read: what is written in between cannot pass for
        it then.
        """
        model, numbers = outcome.model, outcome.summary.found
        if outcome.ask.method != MONITOR:
            model = model.replace(tests=None)  # none of them was tested
        data, directory, text = outcome.data.resolve(), self.folder.resolve(), model_text(model).encode()
        named = str(data)
        if data.parent == directory:  # a report that holds its recording may be moved
            named = data.name
        size = None
        if data.is_file():
            size = data.stat().st_size
        record = {
            "data": named,
            "bytes": size,
            "method": outcome.ask.method,
            "horizon": outcome.horizon,
            "content": outcome.content,
            "model": hashlib.sha256(text).hexdigest(),
            "options": dict(outcome.ask.options),
            "outgrown": numbers is not None and numbers.outgrown,
        }
        (directory / MODEL).write_bytes(text)
        (directory / RUN).write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")


def is_outgrown(directory: Path) -> bool:
    """Return whether a report that `load_run` has read is of windows that its bounds were not found for."""
    return bool(json.loads((Path(directory) / RUN).read_text(encoding="utf-8")).get("outgrown"))


def load_run(directory: Path) -> tuple[LinearSystem, Path, str, int, dict[str, Any]]:
    """Return (model, path of the recording, method, horizon, options) of a report; the recording may have
    moved into its folder.

    Raises:
        OSError: no report, or its recording is gone. ValueError: a damaged one, another model, or a recording
            with another content.
    """
    directory = Path(directory)
    if not (directory / RUN).is_file():
        raise FileNotFoundError(f"{directory} holds no report of jaxbound detect: there is no {RUN} in it")
    try:
        tested = json.loads((directory / RUN).read_text(encoding="utf-8"))
        data, size = directory / tested["data"], tested["bytes"]
        method, horizon, options = tested["method"], tested["horizon"], dict(tested.get("options", {}))
        digest, model = tested.get("content"), tested.get("model")
    except (ValueError, KeyError, TypeError) as e:
        raise ValueError(
            f"{directory / RUN} is damaged ({type(e).__name__}: {e}): run jaxbound detect again"
        ) from None
    if digest is None:
        raise ValueError(
            f"{directory / RUN} keeps no digest of the recording (it came through a pipe, or an earlier "
            f"jaxbound wrote it): "
            "run jaxbound detect again on a file"
        )
    if hashlib.sha256((directory / MODEL).read_bytes()).hexdigest() != model:
        raise ValueError(
            f"the model of this report, {directory / MODEL}, has changed since: run jaxbound detect again"
        )
    beside = directory / data.name
    if not data.exists() and beside.exists():  # the recording was moved into the report
        data = beside
    if not data.exists():
        raise FileNotFoundError(
            f"the recording of this report, {data}, is no longer there: put it back, or run jaxbound detect "
            f"again"
        )
    if (data.is_file() and data.stat().st_size != size) or kind_of(data).digest(data) != digest:
        raise ValueError(
            f"the recording of this report, {data}, has changed since: run jaxbound detect again"
        )
    return load_model(directory / MODEL), data, method, horizon, options
