"""Guaranteed fault detection with JAX: is there any behaviour inside the bounds that explains the data?"""

from jaxbound import sets
from jaxbound.certificates.certificate import Certificate
from jaxbound.certificates.uncertain_certificate import UncertainCertificate
from jaxbound.consistency.monitor import Monitor
from jaxbound.diagnosis.alarms import Alarm
from jaxbound.diagnosis.compensation import compensation
from jaxbound.diagnosis.detectability import GuaranteedSize, detectable
from jaxbound.diagnosis.detection import detect, margins
from jaxbound.diagnosis.isolation import BankResult, evaluate
from jaxbound.diagnosis.result import Result
from jaxbound.estimation.unknown_inputs import UnknownInputs, unknown_inputs
from jaxbound.estimation.validation import Validation, validate
from jaxbound.models.conversion import from_control, from_scipy
from jaxbound.models.faults import Fault
from jaxbound.models.intervals import IntervalSystem, interval_system
from jaxbound.models.linearize import linearize
from jaxbound.models.modelfile import load_model, save_model
from jaxbound.models.multimodel import MultiModel
from jaxbound.models.simulate import Trajectory, simulate
from jaxbound.models.system import LinearSystem
from jaxbound.models.uncertainty import Uncertainty
from jaxbound.plots.plot import plot
from jaxbound.recordings.read import read
from jaxbound.recordings.recording import Recording
from jaxbound.relations.decoupling import Isolability, Signatures, isolability, signatures, structured_relations
from jaxbound.relations.parity import ParityRelation, parity_relations
from jaxbound.relations.redundancy import Redundancy, redundancy
from jaxbound.relations.residual import Residual, residual
from jaxbound.relations.uncertain import UncertainRelations
from jaxbound.runs.digest import Digest, detect_dataset
from jaxbound.sets.floats.status import Status
from jaxbound.sets.inclusion.inclusion import Inclusion, inclusion
from jaxbound.sets.intervals.interval import Interval, interval
from jaxbound.sets.linear_systems.solve import Solution, Solvability, solve_interval
from jaxbound.sets.paving.paving import Paving, pave
from jaxbound.sets.zonotopes.facets import membership, strips
from jaxbound.sets.zonotopes.zonotope import Zonotope, zonotope
from jaxbound.studies.identification.fitting import FitCheck, Fitted, fit
from jaxbound.studies.montecarlo.montecarlo import study
from jaxbound.studies.montecarlo.study_result import StudyResult
from jaxbound.studies.tuning.tuning import TuneResult, tune

__all__ = [
    "Alarm", "BankResult", "Certificate", "Digest", "Fault", "FitCheck", "Fitted", "GuaranteedSize", "Inclusion", "Interval",
    "IntervalSystem", "Isolability", "LinearSystem", "Monitor", "MultiModel", "ParityRelation", "Paving", "Recording", "Redundancy",
    "Residual", "Result", "Signatures", "Solution", "Solvability", "Status", "StudyResult", "Trajectory", "TuneResult",
    "UncertainCertificate", "UncertainRelations", "Uncertainty", "UnknownInputs", "Validation", "Zonotope", "compensation", "detect",
    "detect_dataset", "detectable", "evaluate", "fit", "from_control", "from_scipy", "inclusion", "interval", "interval_system",
    "isolability", "linearize", "load_model", "margins", "membership", "parity_relations", "pave", "plot", "read", "redundancy",
    "residual", "save_model", "sets", "signatures", "simulate", "solve_interval", "strips", "structured_relations", "study", "tune",
    "unknown_inputs", "validate", "zonotope",
]  # fmt: skip
__version__ = "0.1.0"
