"""Set-membership estimation: data validation, multiple models, unknown inputs."""

from jaxbound.estimation.unknown_inputs import UnknownInputs
from jaxbound.estimation.validation import Validation
from jaxbound.estimation.validation_observer import ValidationObserver

__all__ = ["UnknownInputs", "Validation", "ValidationObserver"]
