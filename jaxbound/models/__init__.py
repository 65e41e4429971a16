"""Plants: models, sensors, faults, simulation."""

from jaxbound.models.intervals import IntervalSystem
from jaxbound.models.simulate import Trajectory

__all__ = ["IntervalSystem", "Trajectory"]
