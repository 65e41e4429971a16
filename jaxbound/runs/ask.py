"""The test that a run asks for, of whatever model: one value for recordings, Parquet, fleets and pipes."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from jaxbound.consistency.claims import CLAIMED, OUTSIDE
from jaxbound.consistency.interface import AUTO, FAMILIES, MARGINS, METHODS, MONITOR, OBSERVER, Relations
from jaxbound.diagnosis.detection import detect
from jaxbound.diagnosis.monitoring import monitor, observer_keywords
from jaxbound.diagnosis.result import Result
from jaxbound.estimation.methods import OBSERVERS
from jaxbound.estimation.observer import observer
from jaxbound.models.arguments import whole_horizon
from jaxbound.models.filevalues import known_fields
from jaxbound.models.statedtests import FIELDS, StatedTest, stated_test
from jaxbound.models.system import LinearSystem
from jaxbound.models.testmodels import with_tests
from jaxbound.models.times import refuse_factors
from jaxbound.recordings.recording import Recording
from jaxbound.relations.parity import parity_relations
from jaxbound.text.names import listed, quoted

SAYS = (*(name for name in FIELDS if name != "model"), "method", "margins", "outside")
"""Fields by which a test is said outside a model file."""


@dataclass(frozen=True)
class Ask:
    """A test that is asked for.

    Fields: method: the name of a family, "observer", "monitor", or a method of `detect`. horizon, lags: as
    for `parity_relations`; an observer and a family take no lags, a monitor neither. options: more keywords
    of `observer`. margins, outside: see `detect`. test: the name of one of the tests that the model states,
    or another one, whose bounds or condition are its own; None: all that the model states.
    """

    method: str = METHODS[0]
    horizon: int | None = None
    lags: Sequence[int] | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    margins: str = AUTO
    outside: str = CLAIMED
    test: str | StatedTest | None = None

    @classmethod
    def of_fields(cls, fields: Mapping[str, Any], where: str = "--test") -> "Ask":
        """Return the test that fields ask for: those of a `[[test]]` table, or its name alone; besides
        method, margins and outside.

        Raises:
            ValueError: fields that make no test, or do not go together.

        Example:
            >>> Ask.of_fields({"observer": "joint", "order": 5}).method
            'observer'
        """
        table = known_fields(where, dict(fields), SAYS)
        how: dict[str, Any] = {}
        for name, words in (("margins", MARGINS), ("outside", OUTSIDE)):
            how[name] = table.pop(name, words[0])
            if how[name] not in words:
                raise ValueError(f"{name} of {where} must be one of {', '.join(words)}, not {how[name]!r}")
        method = table.pop("method", METHODS[0])
        if "name" in table and (len(table) > 1 or method != METHODS[0]):
            raise ValueError(f"{where} {table['name']} names a test, which says all: leave the rest out")
        if "name" in table:
            return cls(test=table["name"], **how)
        horizon = None
        if method == OBSERVER:
            table = {"observer": next(iter(OBSERVERS))} | table
        if "observer" in table and not {"factor", "when"} & table.keys():
            horizon = table.pop("horizon", None)  # by which an observer begins
        test = stated_test(where, {"name": "asked"} | table)
        own = test.factor != 1 or test.when is not None
        if method != METHODS[0] and (own or (method != OBSERVER and test.observer is not None)):
            raise ValueError(f"{where}: method={method} takes no observer, no factor and no condition")
        if own:
            return cls(test=test, **how)
        if test.observer is None:
            return cls(method, test.horizon, test.lags, **how)
        options = {"method": test.observer, **observer_keywords(test)}
        return cls(OBSERVER, whole_horizon(horizon, f"horizon of {where}"), None, options, **how)

    def chosen(self, model: LinearSystem) -> LinearSystem:
        """Return the model with no other tests than those that are asked for.

        Raises:
            ValueError: there is no such test.
        """
        if self.test is None:
            return model
        if not isinstance(self.test, str):
            return model.replace(tests=[self.test])
        known = {test.name: test for test in model.tests}
        if self.test in known:
            return model.replace(tests=[known[self.test]])
        there = "it states none; say one by fields, like horizon=30"
        if known:
            there = f"it states {listed(known)}"
        raise ValueError(f"there is no test {quoted(self.test)} in this model: {there}")

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
            if self.lags is not None:
                raise ValueError(f"lags are for windows of the model, not for method={method}")
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
