"""Many evaluations of the floors below: fitting, tuning, Monte-Carlo studies."""

from jaxbound.studies.identification.fit_result import FitCheck, Fitted
from jaxbound.studies.montecarlo.study_result import StudyResult
from jaxbound.studies.tuning.tuning import TuneResult

__all__ = ["FitCheck", "Fitted", "StudyResult", "TuneResult"]
