"""Set-membership estimation: set observers, data validation, multiple models, unknown inputs."""

from jaxbound.estimation import observer_evidence as observer_evidence
from jaxbound.estimation.constrained import ConstrainedObserver, ConstrainedState
from jaxbound.estimation.joint import JointObserver, JointState
from jaxbound.estimation.observer import Observation, ObserverState, SetObserver
from jaxbound.estimation.unknown_inputs import UnknownInputs
from jaxbound.estimation.validation import Validation
from jaxbound.estimation.validation_observer import ValidationObserver

__all__ = [
    "ConstrainedObserver",
    "ConstrainedState",
    "JointObserver",
    "JointState",
    "Observation",
    "ObserverState",
    "SetObserver",
    "UnknownInputs",
    "Validation",
    "ValidationObserver",
]
