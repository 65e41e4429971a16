"""Set-membership estimation: set observers, data validation, multiple models, unknown inputs."""

from jaxbound.estimation.observer import Observation, ObserverState, SetObserver
from jaxbound.estimation.unknown_inputs import UnknownInputs
from jaxbound.estimation.validation import Validation
from jaxbound.estimation.validation_observer import ValidationObserver

__all__ = ["Observation", "ObserverState", "SetObserver", "UnknownInputs", "Validation", "ValidationObserver"]
