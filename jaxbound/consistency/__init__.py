"""Can anything within the bounds explain a window? One file a test, one driver for all."""

from jaxbound.consistency.interface import Judged, Observer, Relations, Verdicts, WindowTest, family
from jaxbound.consistency.monitor import Monitor, MonitorState
from jaxbound.consistency.monitorbank import MonitorBank

Verdict = Judged  # what a Monitor says of a sample

__all__ = [
    "Judged",
    "Monitor",
    "MonitorBank",
    "MonitorState",
    "Observer",
    "Relations",
    "Verdict",
    "Verdicts",
    "WindowTest",
    "family",
]
