"""The test that a run asks for, of whatever model: one value for recordings, Parquet, fleets and pipes."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from jaxbound.consistency.claims import CLAIMED
from jaxbound.consistency.interface import AUTO, FAMILIES, METHODS, MONITOR, OBSERVER, Relations
from jaxbound.diagnosis.detection import detect
from jaxbound.diagnosis.monitoring import monitor
from jaxbound.diagnosis.result import Result
from jaxbound.estimation.observer import observer
from jaxbound.models.system import LinearSystem
from jaxbound.models.testmodels import with_tests
from jaxbound.models.times import refuse_factors
from jaxbound.recordings.recording import Recording
from jaxbound.relations.parity import parity_relations


@dataclass(frozen=True)
class Ask:
    """A test that is asked for.

    Fields: method: the name of a family, "observer", "monitor", or a method of `detect`. horizon, lags: as
    for `parity_relations`; an observer and a family take no lags, a monitor neither. options: more keywords
    of `observer`. margins, outside: see `detect`.
    """

    method: str = METHODS[0]
    horizon: int | None = None
    lags: Sequence[int] | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    margins: str = AUTO
    outside: str = CLAIMED

    def of(self, model: LinearSystem) -> "Ask":
        """Return the test of a model: its own tests, where it has some and no other one is asked for."""
        if model.tests and self.method == METHODS[0] and self.horizon is None and self.lags is None:
            return replace(self, method=MONITOR)
        return self

    def recorded(self, model: LinearSystem) -> LinearSystem:
        """Return the model by which a recording is read: with all columns that its tests need.

        Raises:
            ValueError: tests that make no model.
        """
        if self.of(model).method == MONITOR:
            return with_tests(model)
        return model

    def relations(self, model: LinearSystem, progress: Callable[[float], object] | None = None) -> Relations:
        """Return the relations of a model: of a registered family, an observer, the monitor of its tests, or
        parity relations.

        Args:
            progress: called with the share of the relations that are there.

        Raises:
            ValueError: no relation, or no observer, of this model.
        """
        method = self.of(model).method
        if method in FAMILIES:
            refuse_factors(model)
            return FAMILIES[method](model, self.horizon)
        if method == MONITOR:
            return monitor(model, progress=progress)
        if method == OBSERVER:
            return observer(model, **{"horizon": self.horizon, **self.options})
        return parity_relations(model, self.horizon, lags=self.lags, progress=progress)

    def detect(
        self, relations: Relations, recording: Recording, progress: Callable[[float], object] | None = None
    ) -> Result:
        """Return the Result of a recording. relations: of its model. progress: as for `detect`."""
        return detect(
            relations,
            recording,
            method=self.method,
            progress=progress,
            margins=self.margins,
            outside=self.outside,
        )
