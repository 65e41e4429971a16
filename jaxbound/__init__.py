"""Guaranteed fault detection with JAX: is there any behaviour inside the bounds that explains the data?"""

import importlib

from jaxbound import certificates, consistency, diagnosis, estimation, models, relations, sets, studies  # noqa: F401 (rooms of types)
from jaxbound.consistency.monitor import Monitor
from jaxbound.diagnosis.compensation import compensation
from jaxbound.diagnosis.detectability import detectable
from jaxbound.diagnosis.detection import detect, margins
from jaxbound.diagnosis.isolation import evaluate
from jaxbound.estimation.unknown_inputs import unknown_inputs
from jaxbound.estimation.validation import validate
from jaxbound.models.conversion import from_control, from_scipy
from jaxbound.models.faults import Fault
from jaxbound.models.intervals import interval_system
from jaxbound.models.linearize import linearize
from jaxbound.models.modelfile import load_model, save_model
from jaxbound.models.multimodel import MultiModel
from jaxbound.models.simulate import simulate
from jaxbound.models.system import LinearSystem
from jaxbound.models.uncertainty import Uncertainty
from jaxbound.plots.plot import plot
from jaxbound.recordings.read import read
from jaxbound.recordings.recording import Recording
from jaxbound.relations.decoupling import isolability, signatures, structured_relations
from jaxbound.relations.parity import parity_relations
from jaxbound.relations.redundancy import redundancy
from jaxbound.relations.residual import residual
from jaxbound.runs.digest import detect_dataset
from jaxbound.sets.floats.status import Status
from jaxbound.sets.inclusion.inclusion import inclusion
from jaxbound.sets.intervals.interval import interval
from jaxbound.sets.linear_systems.solve import solve_interval
from jaxbound.sets.paving.paving import pave
from jaxbound.sets.zonotopes.facets import membership, strips
from jaxbound.sets.zonotopes.zonotope import zonotope
from jaxbound.studies.identification.fitting import fit
from jaxbound.studies.montecarlo.montecarlo import study
from jaxbound.studies.tuning.tuning import tune

__all__ = [
    "Fault", "LinearSystem", "Monitor", "MultiModel", "Recording", "Status", "Uncertainty", "compensation", "detect", "detect_dataset",
    "detectable", "evaluate", "fit", "from_control", "from_scipy", "inclusion", "interval", "interval_system", "isolability", "linearize",
    "load_model", "margins", "membership", "parity_relations", "pave", "plot", "read", "redundancy", "residual", "save_model", "sets",
    "signatures", "simulate", "solve_interval", "strips", "structured_relations", "study", "tune", "unknown_inputs", "validate",
    "zonotope",
]  # fmt: skip
__version__ = "0.1.0"

_ROOMS = {
    "certificates": ("Certificate", "UncertainCertificate"),
    "diagnosis": ("Alarm", "BankResult", "GuaranteedSize", "Result"),
    "estimation": ("UnknownInputs", "Validation"),
    "models": ("IntervalSystem", "Trajectory"),
    "relations": ("Isolability", "ParityRelation", "Redundancy", "Residual", "Signatures", "UncertainRelations"),
    "runs": ("Digest",),
    "sets": ("Inclusion", "Interval", "Paving", "Solution", "Solvability", "Zonotope"),
    "studies": ("FitCheck", "Fitted", "StudyResult", "TuneResult"),
}


def __getattr__(name: str) -> object:
    """Return a type of results, which lives in its room: `jaxbound.diagnosis.Result` is `jaxbound.Result` too."""
    for room, types in _ROOMS.items():
        if name in types:
            return getattr(importlib.import_module(f"jaxbound.{room}"), name)
    raise AttributeError(f"module 'jaxbound' has no attribute {name!r}")
