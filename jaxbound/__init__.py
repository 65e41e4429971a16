"""Guaranteed fault detection with JAX: is there any behaviour inside the bounds that explains the data?

Names are imported when they are first asked for: a program pays for what it uses.
"""

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jaxbound import (  # noqa: F401
        certificates,
        consistency,
        diagnosis,
        estimation,
        models,
        recordings,
        relations,
        runs,
        sets,
        studies,
    )
    from jaxbound.consistency.monitor import Monitor
    from jaxbound.diagnosis.alarmrule import AlarmRule
    from jaxbound.diagnosis.detectability import detectable
    from jaxbound.diagnosis.detection import detect, margins
    from jaxbound.diagnosis.isolability import isolability
    from jaxbound.diagnosis.isolation import evaluate
    from jaxbound.diagnosis.memory import suggest_lags
    from jaxbound.diagnosis.monitoring import monitor
    from jaxbound.diagnosis.result import Result
    from jaxbound.estimation.observer import observe, observer
    from jaxbound.estimation.parameters import parameters
    from jaxbound.estimation.unknown_inputs import unknown_inputs
    from jaxbound.estimation.validation import validate
    from jaxbound.models.conversion import from_control, from_scipy
    from jaxbound.models.fault_states import with_faults
    from jaxbound.models.faults import Fault
    from jaxbound.models.intervals import interval_system
    from jaxbound.models.linearize import linearize
    from jaxbound.models.modelfile import load_model, save_model
    from jaxbound.models.multimodel import MultiModel
    from jaxbound.models.named_faults import NamedFault
    from jaxbound.models.simulate import simulate
    from jaxbound.models.system import LinearSystem
    from jaxbound.models.uncertainty import Uncertainty
    from jaxbound.plots.every import plot
    from jaxbound.recordings.look import look
    from jaxbound.recordings.read import read
    from jaxbound.recordings.recording import Recording
    from jaxbound.relations.decoupling import signatures, structured_relations
    from jaxbound.relations.parity import parity_relations
    from jaxbound.relations.redundancy import redundancy
    from jaxbound.relations.residual import residual
    from jaxbound.runs.cache import use_cache
    from jaxbound.runs.digest import detect_dataset
    from jaxbound.sets.floats.kernel import compile
    from jaxbound.sets.floats.status import Status
    from jaxbound.sets.inclusion.inclusion import inclusion
    from jaxbound.sets.intervals.interval import interval
    from jaxbound.sets.linear_systems.solve import solve_interval
    from jaxbound.sets.paving.paving import pave
    from jaxbound.sets.zonotopes.facets import membership, strips
    from jaxbound.sets.zonotopes.zonotope import zonotope
    from jaxbound.studies.assessment.assessment import assess
    from jaxbound.studies.identification.fitting import fit
    from jaxbound.studies.identification.recipe import Recipe
    from jaxbound.studies.montecarlo.montecarlo import study
    from jaxbound.studies.tuning.tuning import tune

__all__ = [
    "AlarmRule",
    "Fault",
    "LinearSystem",
    "Monitor",
    "MultiModel",
    "NamedFault",
    "Recipe",
    "Recording",
    "Result",
    "Status",
    "Uncertainty",
    "assess",
    "compile",
    "detect",
    "detect_dataset",
    "detectable",
    "evaluate",
    "fit",
    "from_control",
    "from_scipy",
    "inclusion",
    "interval",
    "interval_system",
    "isolability",
    "linearize",
    "load_model",
    "look",
    "margins",
    "membership",
    "monitor",
    "observe",
    "observer",
    "parameters",
    "parity_relations",
    "pave",
    "plot",
    "read",
    "redundancy",
    "residual",
    "save_model",
    "sets",
    "signatures",
    "simulate",
    "solve_interval",
    "strips",
    "structured_relations",
    "study",
    "suggest_lags",
    "tune",
    "unknown_inputs",
    "use_cache",
    "validate",
    "with_faults",
    "zonotope",
]
__version__ = "0.3.0.dev2"

# where a name is imported from when it is first asked for; types of results live in rooms, and answer at the
# top too; all users write down the type Result
_HOMES = {
    "consistency.monitor": "Monitor",
    "diagnosis.alarmrule": "AlarmRule",
    "diagnosis.detectability": "detectable",
    "diagnosis.detection": "detect margins",
    "diagnosis.isolability": "isolability",
    "diagnosis.isolation": "evaluate",
    "diagnosis.memory": "suggest_lags",
    "diagnosis.monitoring": "monitor",
    "diagnosis.result": "Result",
    "estimation.observer": "observe observer",
    "estimation.parameters": "parameters",
    "estimation.unknown_inputs": "unknown_inputs",
    "estimation.validation": "validate",
    "models.conversion": "from_control from_scipy",
    "models.fault_states": "with_faults",
    "models.faults": "Fault",
    "models.intervals": "interval_system",
    "models.linearize": "linearize",
    "models.modelfile": "load_model save_model",
    "models.multimodel": "MultiModel",
    "models.named_faults": "NamedFault",
    "models.simulate": "simulate",
    "models.system": "LinearSystem",
    "models.uncertainty": "Uncertainty",
    "plots.every": "plot",
    "recordings.look": "look",
    "recordings.read": "read",
    "recordings.recording": "Recording",
    "relations.decoupling": "signatures structured_relations",
    "relations.parity": "parity_relations",
    "relations.redundancy": "redundancy",
    "relations.residual": "residual",
    "runs.cache": "use_cache",
    "runs.digest": "detect_dataset",
    "sets.floats.kernel": "compile",
    "sets.floats.status": "Status",
    "sets.inclusion.inclusion": "inclusion",
    "sets.intervals.interval": "interval",
    "sets.linear_systems.solve": "solve_interval",
    "sets.paving.paving": "pave",
    "sets.zonotopes.facets": "membership strips",
    "sets.zonotopes.zonotope": "zonotope",
    "studies.assessment.assessment": "assess",
    "studies.identification.fitting": "fit",
    "studies.identification.recipe": "Recipe",
    "studies.montecarlo.montecarlo": "study",
    "studies.tuning.tuning": "tune",
    "certificates": "Certificate Diagnosis UncertainCertificate",
    "diagnosis": "Alarm BankResult GuaranteedSize MonitorResult",
    "estimation": "Observation ParameterSet UnknownInputs Validation",
    "models": "IntervalSystem Trajectory",
    "recordings": "Look",
    "relations": "Isolability ParityRelation Redundancy Residual Signatures UncertainRelations",
    "runs": "Digest",
    "sets": "Inclusion Interval Paving Solution Solvability Zonotope",
    "studies": "Assessment FitCheck Fitted StudyResult TuneResult",
    "consistency": "",
}


def __getattr__(name: str) -> object:
    home = next((module for module, names in _HOMES.items() if name in names.split()), None)
    if home is not None:
        found = getattr(importlib.import_module(f"jaxbound.{home}"), name)
    elif name in _HOMES:
        found = importlib.import_module(f"jaxbound.{name}")
    else:
        raise AttributeError(f"module 'jaxbound' has no attribute {name!r}")
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted({*__all__, *(home for home in _HOMES if "." not in home), "__version__"})
