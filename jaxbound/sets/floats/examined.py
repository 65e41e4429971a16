"""Was this compiler examined, with these settings? By its version, which is listed, or now: once, and kept
in the user's folder.
"""

import hashlib
import json
import warnings
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import jax
import numpy as np

from jaxbound import __version__
from jaxbound.files.folders import cache_folder
from jaxbound.files.whole import whole
from jaxbound.sets.floats import settings
from jaxbound.sets.floats.examination import examination

__all__ = ["doubt_of"]


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
    if kind["jaxlib"] not in settings.VERSIONS:
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
    warnings.warn(
        f"{why}: {asked}, and that it passed is kept {where}",
        stacklevel=2,
    )
    if broken := _broken(device):
        return (
            f"{why}, and an examination found what proofs do not allow ({'; '.join(broken)}), "
            f"so nothing can be proved: install a jaxlib that was examined ({settings.examined_versions()}), "
            "and start without such settings"
        )
    if path is not None:
        _keep(path, about)
    return ""


def _broken(device: jax.Device) -> list[str]:
    """Return the claims of an examination, in both types, that do not hold, each in words."""
    found = []
    with jax.enable_x64(True):
        for dtype in (np.float32, np.float64):
            for claim, (value, most) in examination(device, dtype).items():
                if not value <= most:
                    found.append(f"{claim}, {np.dtype(dtype).name}: {value:.3g}, at most {most:g} assumed")
    return found


def _file_of(about: dict) -> Path | None:
    name = hashlib.sha256(json.dumps(about, sort_keys=True).encode()).hexdigest()[:32]
    try:
        return cache_folder() / "examined" / f"{name}.json"
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
    try:
        return json.loads(path.read_text()) == json.loads(json.dumps(about))
    except (OSError, ValueError):
        return False
