"""Was this compiler examined, with these settings? By its version, which is listed, or now: once, and kept
in the user's folder. And was this card examined, by its user (`examine`)? Then its record is kept there too.
"""

import datetime
import hashlib
import json
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

import jax
import numpy as np

from jaxbound import __version__
from jaxbound.files.folders import cache_folder
from jaxbound.files.whole import whole
from jaxbound.sets.floats import settings
from jaxbound.sets.floats.examination import examination
from jaxbound.text.progress import reporter
from jaxbound.text.warned import warn

__all__ = ["Record", "admitted", "doubt_of", "examine", "record_of"]

PASSED = "passed"
CARDS = "cards"
Record = dict[str, str]
"""Of an examined card: {"card", "platform", "capability", "driver", "jaxlib", "jax", "jaxbound", "date",
"outcome"}, the outcome "passed" or the claims that do not hold, in words."""


def doubt_of(device: jax.Device, kind: dict[str, str], unknown: Sequence[str]) -> str:
    """Return why nothing is proved with this compiler and these settings, in a sentence; empty where an
    examination found no fault.

    A listed version without settings is known. Anything else is examined by all of `examination`, in float32
    and float64, which takes seconds and is said in a warning. What passes is kept in the user's cache
    folder, and asked from there by the processes that follow.

    Args:
        device: of jax. kind: its `probe.kind_of_device`. unknown: settings that no table knows, each in
        words.
    """
    reasons = list(unknown)
    on_cpu = kind["platform"] == "cpu"  # a card has a record for its jaxlib
    if on_cpu and kind["jaxlib"] not in settings.VERSIONS:
        reasons.insert(0, f"jaxlib {kind['jaxlib']} is not among the versions that were examined")
    if not reasons:
        return ""
    about = {
        "jaxbound": __version__,
        "jax": jax.__version__,
        "device": kind,
        "processor": settings.processor(),
        "unknown": list(unknown),
    }
    path = _file_of(about)
    if path is not None and _kept(path, about):
        return ""
    why = " and ".join(reasons)
    where = "nowhere, for want of a home folder" if path is None else f"in {path}"
    asked = "all that proofs rest on is examined before anything is proved, once; it takes some seconds"
    warn(f"{why}: {asked}, and that it passed is kept {where}")
    if broken := _broken(device):
        return (
            f"{why}, and an examination found what proofs do not allow ({'; '.join(broken)}), "
            f"so nothing can be proved: install a jaxlib that was examined ({settings.examined_versions()}), "
            "and start without such settings"
        )
    if path is not None:
        _keep(path, about)
    return ""


def examine(
    device: jax.Device, kind: dict[str, str], progress: Callable[[float], object] | None = None
) -> tuple[Record, Path | None]:
    """Examine a card by all of `examination`, in float32 and float64, and keep what came out.

    Args:
        device: of jax. kind: its `kinds.kind_of_device`. progress: called with the share of the work done.

    Returns:
        (Record, the file that it is kept in, None where there is no place for it).
    """
    broken = _broken(device, progress)
    about = _identity(device, kind)
    outcome = "; ".join(broken) or PASSED
    record = about | {"date": datetime.date.today().isoformat(), "outcome": outcome}
    path = _card_file(about)
    if kind["platform"] == "cpu":  # known by its version
        path = None
    if path is not None:
        _keep(path, record)
        if _read(path) != record:
            path = None
    return record, path


def record_of(device: jax.Device, kind: dict[str, str]) -> Record | None:
    """Return the Record of a card with its driver and these versions; None: nobody has examined it so.

    Args:
        device: of jax. kind: its `kinds.kind_of_device`.
    """
    about = _identity(device, kind)
    path = _card_file(about)
    record = None if path is None else _read(path)
    if record is None or any(record.get(name) != value for name, value in about.items()):
        return None
    return record


def admitted(record: Record | None) -> bool:
    """Return whether a card with this Record may prove."""
    return record is not None and record.get("outcome") == PASSED and bool(record.get("date"))


def _identity(device: jax.Device, kind: dict[str, str]) -> Record:
    """Return the part of a Record for which an examination holds."""
    card = str(getattr(device, "device_kind", "") or kind["platform"])
    return {"card": card, **kind, "jax": jax.__version__, "jaxbound": __version__}


def _card_file(about: Record) -> Path | None:
    return _file_of(about, CARDS)


def _read(path: Path) -> Record | None:
    """Return the record in a file, None if it cannot be read."""
    try:
        record = json.loads(path.read_text())
    except (OSError, ValueError):
        return None
    return record if isinstance(record, dict) else None


def _broken(device: jax.Device, progress: Callable[[float], object] | None = None) -> list[str]:
    """Return the claims of an examination, in both types, that do not hold, each in words."""
    found = []
    report = reporter(progress)
    with jax.enable_x64(True):
        for done, dtype in enumerate((np.float32, np.float64)):
            report(done / 2)
            for claim, (value, most) in examination(device, dtype).items():
                if not value <= most:
                    found.append(f"{claim}, {np.dtype(dtype).name}: {value:.3g}, at most {most:g} assumed")
    report(1.0)
    return found


def _file_of(about: dict, *folder: str) -> Path | None:
    name = hashlib.sha256(json.dumps(about, sort_keys=True).encode()).hexdigest()[:32]
    try:
        return cache_folder().joinpath("examined", *folder, f"{name}.json")
    except RuntimeError:
        return None


def _keep(path: Path, about: dict) -> None:
    """Write down what passed; in a folder that cannot be written, or beside another process that writes, it
    is examined anew next time.
    """
    with suppress(OSError, ValueError):
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole(path) as file:
            file.write(json.dumps(about, sort_keys=True, indent=1).encode())


def _kept(path: Path, about: dict) -> bool:
    """Return whether a file says that this very thing passed: its name alone, a digest, proves nothing."""
    return _read(path) == json.loads(json.dumps(about))
