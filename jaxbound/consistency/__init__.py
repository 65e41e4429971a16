"""Can anything within the bounds explain a window? One file a test, one driver for all."""

from jaxbound.consistency.interface import Judged, Observer, Relations, Verdicts, WindowTest, family
from jaxbound.consistency.monitor import Monitor, MonitorState, Verdict

__all__ = [
    "Judged",
    "Monitor",
    "MonitorState",
    "Observer",
    "Relations",
    "Verdict",
    "Verdicts",
    "WindowTest",
    "family",
]
