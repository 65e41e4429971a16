"""Set-membership estimation: set observers, data validation, multiple models, unknown inputs, constant
parameters.

Names are imported when they are first asked for: the command line reads the table of methods before anything
is computed.
"""

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jaxbound.estimation.joint_observer import JointObserver, JointState
    from jaxbound.estimation.methods import Joint, LeastZonotope, ObserverMethod, WeightedZonotopes
    from jaxbound.estimation.observation import Observation
    from jaxbound.estimation.parameter_set import ParameterSet
    from jaxbound.estimation.set_observer import ObserverState, SetObserver, ZonotopeObserver
    from jaxbound.estimation.unknown_inputs import UnknownInputs
    from jaxbound.estimation.validation_observer import ValidationObserver
    from jaxbound.estimation.validation_result import Validation

__all__ = [
    "Joint",
    "JointObserver",
    "JointState",
    "LeastZonotope",
    "Observation",
    "ObserverMethod",
    "ObserverState",
    "ParameterSet",
    "SetObserver",
    "UnknownInputs",
    "Validation",
    "ValidationObserver",
    "WeightedZonotopes",
    "ZonotopeObserver",
]

_HOMES = {
    "joint_observer": "JointObserver JointState",
    "methods": "Joint LeastZonotope ObserverMethod WeightedZonotopes",
    "observation": "Observation",
    "parameter_set": "ParameterSet",
    "set_observer": "ObserverState SetObserver ZonotopeObserver",
    "unknown_inputs": "UnknownInputs",
    "validation_result": "Validation",
    "validation_observer": "ValidationObserver",
}
_MODULES = {name: module for module, names in _HOMES.items() for name in names.split()}


def __getattr__(name: str) -> object:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
