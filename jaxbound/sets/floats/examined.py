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
Record = dict[str, str]
"""Of an examined device: {"card", "platform", "capability", "driver", "jaxlib", "jax", "jaxbound", "date",
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
    about = _identity(device, kind) | {
        "processor": " ".join(settings.processor()),
        "unknown": " and ".join(unknown),
    }
    if admitted(_read(about)):
        return ""
    why, path = " and ".join(reasons), _file_of(about)
    where = "nowhere, for want of a home folder" if path is None else f"in {path}"
    asked = "all that proofs rest on is examined before anything is proved, once; it takes some seconds"
    warn(f"{why}: {asked}, and that it passed is kept {where}")
    record = _examined(device, about)
    if not admitted(record):
        return (
            f"{why}, and an examination found what proofs do not allow ({record['outcome']}), "
            f"so nothing can be proved: install a jaxlib that was examined ({settings.examined_versions()}), "
            "and start without such settings"
        )
    _keep(about, record)
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
    about = _identity(device, kind)
    record = _examined(device, about, progress)
    if kind["platform"] == "cpu":  # known by its version
        return record, None
    _keep(about, record)
    return record, _file_of(about) if _read(about) == record else None


def record_of(device: jax.Device, kind: dict[str, str]) -> Record | None:
    """Return the Record of a card with its driver and these versions; None: nobody has examined it so.

    Args:
        device: of jax. kind: its `kinds.kind_of_device`.
    """
    return _read(_identity(device, kind))


def admitted(record: Record | None) -> bool:
    """Return whether a device with this Record may prove."""
    return record is not None and record.get("outcome") == PASSED and bool(record.get("date"))


def _identity(device: jax.Device, kind: dict[str, str]) -> Record:
    """Return the part of a Record for which an examination holds."""
    card = str(getattr(device, "device_kind", "") or kind["platform"])
    return {"card": card, **kind, "jax": jax.__version__, "jaxbound": __version__}


def _examined(device: jax.Device, about: Record, progress: Callable[[float], object] | None = None) -> Record:
    """Return the Record of an examination now, in both types."""
    broken, report = [], reporter(progress)
    with jax.enable_x64(True):
        for done, dtype in enumerate((np.float32, np.float64)):
            report(done / 2)
            for claim, (value, most) in examination(device, dtype).items():
                if not value <= most:
                    broken.append(f"{claim}, {np.dtype(dtype).name}: {value:.3g}, at most {most:g} assumed")
    report(1.0)
    return about | {"date": datetime.date.today().isoformat(), "outcome": "; ".join(broken) or PASSED}


def _file_of(about: Record) -> Path | None:
    """Return the file for the Record of this very thing, None where there is no place for it."""
    name = hashlib.sha256(json.dumps(about, sort_keys=True).encode()).hexdigest()[:32]
    folder = "" if "unknown" in about else "cards"
    with suppress(RuntimeError):
        return cache_folder() / "examined" / folder / f"{name}.json"
    return None


def _read(about: Record) -> Record | None:
    """Return the Record that is kept of this very thing, which the name of its file alone does not prove."""
    path = _file_of(about)
    if path is None:
        return None
    try:
        record = json.loads(path.read_text())
    except (OSError, ValueError):
        return None
    same = isinstance(record, dict) and all(record.get(name) == value for name, value in about.items())
    return record if same else None


def _keep(about: Record, record: Record) -> None:
    """Write down what came out; in a folder that cannot be written, or beside another process that writes,
    it is examined anew next time.
    """
    path = _file_of(about)
    with suppress(OSError, ValueError):
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            with whole(path) as file:
                file.write(json.dumps(record, sort_keys=True, indent=1).encode())
