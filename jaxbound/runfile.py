"""What a report was made of: run.json says which recording and which test, tested_model.toml is the model as it was."""

import json
import shutil
from pathlib import Path

from jaxbound.modelfile import load_model

__all__ = ["VALIDATION", "load_run", "save_run"]

VALIDATION = "validation"  # not a method of `detect`: the shell name of `validate`

RUN, MODEL = "run.json", "tested_model.toml"


def save_run(directory, model, data, method, horizon):
    """Write run.json and tested_model.toml, with which `load_run` finds again what was tested.

    Args:
        directory: of the report. model: path of the model file. data: path of the recording. method, horizon: of the test.
    """
    data, directory = Path(data).resolve(), Path(directory).resolve()
    named = data.name if data.parent == directory else str(data)  # a report that holds its recording may be moved
    found = {"data": named, "bytes": data.stat().st_size if data.is_file() else None, "method": method, "horizon": horizon}
    shutil.copyfile(model, directory / MODEL)
    (directory / RUN).write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


def load_run(directory):
    """Return (model, path of the recording, method, horizon) of a report; the recording may have moved into its folder.

    Raises:
        OSError: no report, or its recording is gone. ValueError: a damaged one, or a recording of another size.
    """
    directory = Path(directory)
    if not (directory / RUN).is_file():
        raise FileNotFoundError(f"{directory} holds no report of jaxbound detect: there is no {RUN} in it")
    try:
        tested = json.loads((directory / RUN).read_text(encoding="utf-8"))
        data, size, method, horizon = directory / tested["data"], tested["bytes"], tested["method"], tested["horizon"]
    except (ValueError, KeyError, TypeError) as e:
        raise ValueError(f"{directory / RUN} is damaged ({type(e).__name__}: {e}): run jaxbound detect again") from None
    data = data if data.exists() or not (directory / data.name).exists() else directory / data.name
    if not data.exists():
        raise FileNotFoundError(f"the recording of this report, {data}, is no longer there: put it back, or run jaxbound detect again")
    if data.is_file() and data.stat().st_size != size:
        raise ValueError(f"the recording of this report, {data}, has changed since: run jaxbound detect again")
    return load_model(directory / MODEL), data, method, horizon
