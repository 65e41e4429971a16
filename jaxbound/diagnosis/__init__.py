"""Verdicts, alarms, isolation, what can be detected."""

from jaxbound.diagnosis.alarmrule import AlarmRule
from jaxbound.diagnosis.alarms import Alarm
from jaxbound.diagnosis.detectability import GuaranteedSize
from jaxbound.diagnosis.isolability import FaultIsolability
from jaxbound.diagnosis.isolation import BankResult
from jaxbound.diagnosis.memory import SuggestedLags
from jaxbound.diagnosis.monitored import MonitorResult
from jaxbound.diagnosis.observed import ObserverResult
from jaxbound.diagnosis.region import Outside
from jaxbound.diagnosis.result import Result
from jaxbound.models.region import Departure

__all__ = [
    "Alarm",
    "AlarmRule",
    "BankResult",
    "Departure",
    "FaultIsolability",
    "GuaranteedSize",
    "MonitorResult",
    "ObserverResult",
    "Outside",
    "Result",
    "SuggestedLags",
]
