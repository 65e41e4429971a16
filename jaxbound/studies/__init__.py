"""Many evaluations of the floors below: fitting, tuning, Monte-Carlo studies, assessments."""

from jaxbound.studies.assessment.assessment import Assessment
from jaxbound.studies.identification.adding import Widened
from jaxbound.studies.identification.fit_result import FitCheck, Fitted
from jaxbound.studies.montecarlo.study_result import StudyResult
from jaxbound.studies.tuning.tuning import MonitorTuneResult, TuneResult

__all__ = ["Assessment", "FitCheck", "Fitted", "MonitorTuneResult", "StudyResult", "TuneResult", "Widened"]
