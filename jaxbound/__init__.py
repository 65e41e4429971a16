"""Guaranteed fault detection with JAX: is there any behaviour inside the bounds that explains the data?"""

from jaxbound import sets
from jaxbound.diagnosis.alarms import Alarm
from jaxbound.diagnosis.certificate import Certificate
from jaxbound.diagnosis.consistency import detect, margins
from jaxbound.diagnosis.result import Result
from jaxbound.digest import Digest, detect_dataset
from jaxbound.modelfile import load_model, save_model
from jaxbound.models.conversion import from_control, from_scipy
from jaxbound.models.faults import Fault
from jaxbound.models.simulate import Trajectory, simulate
from jaxbound.models.system import LinearSystem
from jaxbound.plots import plot
from jaxbound.relations.parity import ParityRelation, parity_relations
from jaxbound.relations.residual import Residual, residual
from jaxbound.sets.inclusion import Inclusion, inclusion
from jaxbound.sets.interval import Interval, interval
from jaxbound.sets.paving import Paving, pave
from jaxbound.sets.status import Status
from jaxbound.sets.zonotope import Zonotope, membership, strips, zonotope

__all__ = [
    "Alarm", "Certificate", "Digest", "Fault", "Inclusion", "Interval", "LinearSystem", "ParityRelation", "Paving", "Residual", "Result",
    "Status", "Trajectory", "Zonotope", "detect", "detect_dataset", "from_control", "from_scipy", "inclusion", "interval", "load_model",
    "margins", "membership", "parity_relations", "pave", "plot", "residual", "save_model", "sets", "simulate", "strips", "zonotope",
]  # fmt: skip
__version__ = "0.1.0"
