"""A monitor as scikit-learn's outlier detectors are used: fit, predict, decision_function. Needs
scikit-learn: `jaxbound[sklearn]`.

Rows are samples in the order of time, and a row is judged with the samples before it: unlike other
detectors', verdicts depend on that order, and -1 is a proof as long as the bounds are true.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxbound.diagnosis.detection import detect
from jaxbound.diagnosis.monitoring import monitor
from jaxbound.diagnosis.result import Result
from jaxbound.models.system import LinearSystem
from jaxbound.relations.parity import parity_relations
from jaxbound.sets.floats.status import Status
from jaxbound.studies.identification.fitting import fit as fit_model

try:
    from sklearn.base import BaseEstimator, OutlierMixin
    from sklearn.utils.validation import check_is_fitted, validate_data
except ImportError as why:
    raise ImportError(
        "jaxbound.sklearn needs scikit-learn 1.6 or newer: pip install 'jaxbound[sklearn]'"
    ) from why


class Detector(OutlierMixin, BaseEstimator):  # type: ignore[misc]  # scikit-learn states no types
    """Proved fault detection with the methods of scikit-learn's outlier detectors.

    Args:
        model: a LinearSystem with bounds that an engineer knows: `fit` then learns nothing, it looks whether
            the columns fit. If it states tests, all of them watch, as of `jaxbound.monitor`, unless a horizon
            is given. None: `fit` finds a nominal model and bounds from X, which must be healthy, by
            `jaxbound.fit`.
        inputs, outputs: numbers of the columns of X, or their names in a DataFrame. outputs None: all columns
            that are no inputs; with a model, first its inputs and then its outputs, or by name in a
            DataFrame.
        method: of `detect`. order, horizon, safety, held_out, test, fitting: of `jaxbound.fit` (its
            `method`), horizon also of a model.

    Fields after `fit`: model_: the LinearSystem. relations_: its relations, or the monitor of its tests.
    offset_: 0.0, what decision_function subtracts.

    Rows follow each other in time; a gap in the times of a table begins anew. The first rows, as many as the
    horizon, and rows with missing samples (NaN) have no verdict: they count as inliers, of score 0.

    Encloses: a row of -1 is proved: no behaviour within the bounds explains its window. A healthy plant never
    gives one while the bounds hold, however many rows there are; bounds that were fitted from data are no
    more than an estimate of what is healthy.

    Example:
        >>> import jaxbound as jb
        >>> model = jb.LinearSystem([[0.5]], None, [[1]], noise=0.1)
        >>> Detector(model).fit_predict([[1.0], [0.5], [0.8], [0.4]]).tolist()
        [1, 1, -1, 1]
    """

    def __init__(
        self,
        model: LinearSystem | None = None,
        *,
        inputs: Sequence[int | str] = (),
        outputs: Sequence[int | str] | None = None,
        method: str = "joint",
        order: int = 2,
        horizon: int | None = None,
        safety: float = 1.25,
        held_out: float = 0.3,
        test: str | None = None,
        fitting: str = "auto",
    ) -> None:
        self.model = model
        self.inputs = inputs
        self.outputs = outputs
        self.method = method
        self.order = order
        self.horizon = horizon
        self.safety = safety
        self.held_out = held_out
        self.test = test
        self.fitting = fitting

    def __sklearn_tags__(self) -> Any:
        """Return the tags: NaN is a missing sample."""
        tags = super().__sklearn_tags__()
        tags.input_tags.allow_nan = True
        return tags

    def fit(self, X: object, y: object = None) -> "Detector":
        """Find a model and bounds of healthy rows X (T, columns), or check that a given model fits them. y is
        ignored.

        Raises:
            ValueError: columns that are not there, infinite numbers, too few rows, an output that stands
                still; see `jaxbound.fit`.
        """
        if not isinstance(self.model, LinearSystem | None):
            raise TypeError(
                f"model must be a LinearSystem, all of whose tests watch, not {type(self.model).__name__}"
            )
        rows = self._rows(X, reset=True)
        self._places = self._columns(rows.shape[1])
        if self.model is not None:
            self.model_ = self.model
        else:
            names = [
                str(name)
                for name in getattr(self, "feature_names_in_", [f"x{i}" for i in range(rows.shape[1])])
            ]
            inputs, outputs = ([names[i] for i in places] for places in self._places)
            given = (
                X if hasattr(self, "feature_names_in_") else tuple(rows[:, places] for places in self._places)
            )
            self.model_ = fit_model(
                given,
                order=self.order,
                horizon=self.horizon,
                inputs=inputs,
                outputs=outputs,
                safety=self.safety,
                held_out=self.held_out,
                method=self.fitting,
                test=self.test,
            )
        several = bool(self.model_.tests) and self.horizon is None
        self.relations_ = monitor(self.model_) if several else parity_relations(self.model_, self.horizon)
        self.offset_ = 0.0
        return self

    def detect(self, X: object, margins: str = "auto") -> Result:
        """Return the Result of `jaxbound.detect` for rows X (T, columns), with certificates and alarms.

        Args:
            margins: see `jaxbound.detect`; scores are always exact.
        """
        check_is_fitted(self)
        rows = self._rows(X, reset=False)
        if hasattr(self, "feature_names_in_") and hasattr(X, "columns"):
            return detect(self.relations_, X, method=self.method, margins=margins)
        u, y = (rows[:, places] for places in self._places)
        return detect(self.relations_, u, y, method=self.method, margins=margins)

    def decision_function(self, X: object) -> np.ndarray:
        """Return (T,) scores: below 0 exactly where a fault is proved, then the margin; else the margin, 0
        where there is none.
        """
        res = self.detect(X, margins="exact")
        fault, margin = res.status == Status.FAULT, np.nan_to_num(np.asarray(res.margin, np.float64), nan=0.0)
        # a proved fault ranks below all else, though its margin may be rounded to 0
        return np.where(fault, np.minimum(margin, -np.finfo(np.float64).tiny), np.maximum(margin, 0.0))

    def score_samples(self, X: object) -> np.ndarray:
        """Return (T,) scores, the lower the less normal: those of decision_function."""
        return self.decision_function(X) + self.offset_

    def predict(self, X: object) -> np.ndarray:
        """Return (T,) int: -1 where a fault is proved, else 1."""
        return np.where(self.detect(X).status == Status.FAULT, -1, 1)

    def _rows(self, X: object, reset: bool) -> np.ndarray:
        """Return the rows as an array of floats, checked as scikit-learn does."""
        least = 2 if reset else 1
        rows: np.ndarray = validate_data(
            self,
            X,
            reset=reset,
            dtype=np.float64,
            ensure_all_finite="allow-nan",
            ensure_min_samples=least,
        )
        return rows

    def _columns(self, count: int) -> tuple[list[int], list[int]]:
        """Return (numbers of the columns of the inputs, of the outputs)."""
        names = list(getattr(self, "feature_names_in_", ()))
        if self.model is not None and self.outputs is None and not len(self.inputs):
            m, p = self.model.m, self.model.p
            if names or count == m + p:
                return list(range(m)), list(range(m, m + p))
            raise ValueError(
                f"X has {count} columns, the model {m} inputs and {p} outputs: say which they are by inputs= "
                f"and outputs="
            )
        inputs = [self._place(column, names, count) for column in self.inputs]
        others = [i for i in range(count) if i not in inputs]
        outputs = others
        if self.outputs is not None:
            outputs = [self._place(column, names, count) for column in self.outputs]
        if self.model is not None and (len(inputs), len(outputs)) != (self.model.m, self.model.p):
            raise ValueError(
                f"the model has {self.model.m} inputs and {self.model.p} outputs, {len(inputs)} and "
                f"{len(outputs)} columns are given"
            )
        return inputs, outputs

    @staticmethod
    def _place(column: int | str, names: list[str], count: int) -> int:
        if isinstance(column, str):
            if not names:
                raise ValueError(f"X has no column {column!r} by name: give numbers")
            if column not in names:
                raise ValueError(f"X has no column {column!r}: it has {', '.join(map(str, names))}")
            return names.index(column)
        if not 0 <= column < count:
            raise ValueError(f"X has the columns 0 to {count - 1}, not {column}")
        return int(column)
