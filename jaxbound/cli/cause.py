"""The cause of a FAULT window, as `jaxbound explain` prints it: the named faults that alone explain it."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from jaxbound.certificates.diagnosis import Diagnosis, size_text, why_excluded
from jaxbound.certificates.interface import WindowCertificate
from jaxbound.cli.terminal import json_text, show, write
from jaxbound.models.modelfile import load_model
from jaxbound.sets.floats.status import Status
from jaxbound.text.quantities import percent


def cause_of(certificate: WindowCertificate, k: int, file: Path | None) -> Diagnosis:
    """Return the Diagnosis of a window.

    Args:
        certificate: of a FAULT window. k: its last sample. file: a model file that names the faults; None:
            those of the tested model.

    Raises:
        ValueError, NotImplementedError: as `WindowCertificate.diagnose`, or the file names no fault.
    """
    faults = None
    if file is not None:
        faults = load_model(file).faults
        if not faults:
            raise ValueError(f"{file} names no fault: write [[fault]] above each of them")
    return replace(certificate.diagnose(faults), windows=(k,))


def cause_text(certificate: WindowCertificate, k: int, file: Path | None) -> list[tuple[str, str]]:
    """Return the row of the cause of a window, the answer; of a CONSISTENT window none."""
    if certificate.proves != Status.FAULT:
        return []
    try:
        return [("cause", str(cause_of(certificate, k, file)))]
    except NotImplementedError as e:
        return [("cause", f"not worked out: {e}")]


def show_cause(found: Diagnosis, labels: Sequence[str], as_json: bool) -> None:
    """Print a Diagnosis: the answer, then each fault; or as JSON and nothing else."""
    if as_json:
        write(json_text(found.to_dict()))
        return
    rows = []
    for weighed in found.explains:
        text = size_text(found.model, weighed)
        if weighed.fault.name in found.shares:
            text += f", {percent(float(found.shares[weighed.fault.name]))} of its usual range"
        rows.append((weighed.fault.name, text))
    for weighed in found.excluded:
        rows.append((weighed.fault.name, why_excluded(found.model, weighed)))
    rows += [(name, f"left open: {why}") for name, why in found.unweighed.items()]
    rows.append(("window", f"from {labels[0]} to {labels[-1]}; a fault may begin at any sample of it"))
    show(str(found), "bold", rows)
