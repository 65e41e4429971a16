"""The values that say how a model is fitted, and what is tested under its bounds."""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jaxbound.estimation.methods import OBSERVERS, ObserverMethod, observer_method
from jaxbound.models.arguments import listed_argument, whole_lags
from jaxbound.models.faults import Fault
from jaxbound.models.numbers import is_real, is_whole
from jaxbound.text.objects import readable

AUTO, BANK = "auto", "bank"
KINDS = ("least squares", "windows", "filters")
HORIZON = 15
"""Of the windows where neither a horizon nor lags are asked for."""
WORDS = {
    "test": (None, AUTO, BANK),
    "disturbances": (None, AUTO),
    "signals": (None, AUTO),
    "method": (AUTO, *KINDS),
    "direct": (False, True),
}
"""{field: what it may be}."""
NUMBERS = {
    "order": (0, 1001, "a whole number >= 0, or auto"),
    "delay": (1, 1001, "a whole number >= 1, or auto"),
    "follow": (0, np.inf, "a number >= 0, or auto"),
    "safety": (1, np.inf, "a factor >= 1"),
    "held_out": (0, 1.0, "a share from 0 to below 1"),
}
"""{field: (its least number, the first that is too large, of which kind both are, words for a reader)}."""
LONGEST = 10**7
"""The largest horizon: no computer fits more."""
SEEN = ("bias", "drift")
"""Kinds of faults that enter a recording linearly."""
SEE = "[jb.Fault('T1', 'bias', 2.5)]"
"""An example of faults to see."""
APART = (
    ("horizon", "lags", "lags say by themselves how long a window is"),
    ("lags", "observer", "lags is for windows: a fit for an observer looks at every sample"),
    ("average", "observer", "average is for windows: a fit for an observer looks at every sample"),
    *((name, "test", "test = {!r} chooses windows") for name in ("horizon", "lags", "average")),
    ("follow", "disturbances", "follow widens bounds of sensors alone"),
    ("average", "disturbances", "average is for bounds of sensors alone"),
    ("delay", "direct", "direct inputs act at once"),
)
"""Fields that one fit cannot have both, and why; a place in a reason is for the value of the second."""


class WindowChoice(NamedTuple):
    """Windows of horizon + 1 samples, of which a test looks at all or at lags, with bounds on the mean of
    `average` errors in a row; None: without. observer: the name of one in place of windows, which looks at
    all samples. follow: how strongly bounds follow the operating point; 0: not at all.
    """

    horizon: int
    lags: tuple[int, ...] | None = None
    average: int | None = None
    observer: str | None = None
    follow: float = 0.0

    @property
    def constant(self) -> "WindowChoice":
        """The same windows, with bounds that do not follow."""
        return self._replace(follow=0.0)

    @property
    def about(self) -> dict[str, Any]:
        """The windows as an argument of a LinearSystem; none of an observer."""
        if self.observer is not None:
            return {}
        if self.lags is None:
            return {"horizon": self.horizon}
        return {"lags": self.lags}

    @property
    def text(self) -> str:
        """The words for a reader."""
        if self.observer is not None:
            return f"observer {self.observer}"
        text = f"{self.horizon + 1} samples"
        if self.lags is not None:
            text = f"{len(self.lags)} of {text}"
        if self.average is not None:
            text = f"means of {self.average} in {text}"
        if self.follow:
            text = f"{text} (follow {self.follow:g})"
        return text


@readable
@dataclass(frozen=True)
class Recipe:
    """The way from healthy recordings to a model and its bounds, as `fit` takes it.

    Fields:
        order: so many samples back determine the next one (of "filters": so many filters an output). order *
            p states. 0: a static model, y = D u and a constant, of windows of one sample unless horizon asks
            for more. "auto": whichever of 1 to 4 sees the smallest errors at the bounds that recordings which
            are left out ask for.
        delay: so many samples pass before inputs act (dead time), 1 of a plant that answers at the next one;
            (delay - 1) * m more states. "auto": of 1 to 6 and 8, chosen as the order is.
        direct: whether inputs act on the outputs of the same sample (D).
        horizon: s, the bounds are found for windows of s + 1 samples; None: as `test` says. Long windows see
            small faults; the model says for which it is made.
        lags: of windows that look at the outputs at some samples only, in place of horizon; see
            `parity_relations` and `suggest_lags`.
        average: of so many errors in a row, at most horizon + 1, the mean gets a bound too: an average of the
            model. Lasting errors show smaller where errors do average out. None: none.
        test: "auto": windows are chosen, too, in place of horizon, lags and average: whichever of 8, 16, 31,
            61 samples, means of 8 and 16, and lags of 61 sees the smallest errors, each at the bounds that
            recordings which are left out ask of it; `.check.tests` has them all. "bank": as many of them as
            see clearly smaller jumps, lasting errors or ramps than the others: the model states them as its
            `tests`, each with coefficients and bounds of its own, and `jb.monitor` is all of them; `observer`
            or `disturbances` has a set observer ("joint" if none is named) tried beside them. None: as
            horizon, lags and average say, or the observer; where these are left out, "bank", or windows of
            16 samples where nothing can be left out to choose by.
        observer: the method of a set observer ("zonotope", "joint", ..), see `jb.observer`: the bounds are
            those at which it follows every recording, instead of those of windows; horizon is then that of
            the windows which `method` looks at. Not with lags or average.
        disturbances: "auto": process noise and offsets that drift get bounds beside the noise of the sensors,
            those of a trajectory that explains each recording from start to end, so that they hold for
            windows and observers alike; which of them, by the smallest fault that is then seen in the longest
            recording. Not with average or test="auto", nor with follow but for a bank, whose windows follow
            then. None: none.
        see: a bias or a drift of a signal, or several, of the size that is wanted: disturbances are chosen
            for these, and bounds are as much wider than `safety` as these still allow. Biases of two outputs
            or more: bounds of these sensors are in the ratio of these sizes, not of the residuals, without
            disturbances too. (): biases of each output.
        follow: how strongly bounds grow with the distance of the inputs from their training: a weight, which
            writes `times`, an expression of the inputs, to the bounds of all outputs; "auto": .1, .3 or 0,
            whichever sees the smallest errors at the bounds that recordings which are left out ask for. 0:
            bounds are constant. Where tests are chosen each follows by its own weight or not at all. Bounds
            of means follow, too. Not with every.
        signals: "auto": inputs are chosen, too: one is dropped, or a square or a product of two joins them,
            wherever clearly smaller errors are then seen at the bounds that recordings which are left out ask
            for; `.check.signals` has all that were tried. A product is an input whose column is an
            expression, like "= `fan` * `lift`", so recordings must be tables. None: inputs are as given.
        method: "least squares" (ARX, one step ahead), "windows" (the same, refined over whole windows),
            "filters" (inputs through given filters that fade within a window, so that no state can follow a
            lasting error) or "auto": whichever sees the smallest jump and lasting error with bounds as wide
            as recordings that are left out ask for.
        safety: factor >= 1 on top: how much more than in the recordings healthy operation may deviate.
        held_out: the share of a single recording that is a block: its blocks are left out in turn, which says
            less of another day than recordings do. 0: nothing is left out, of several recordings either.

    Example:
        >>> Recipe(order=1, horizon=30).window.text
        '31 samples'
    """

    order: int | str = 2
    delay: int | str = 1
    direct: bool = False
    horizon: int | None = None
    lags: Sequence[int] | None = None
    average: int | None = None
    test: str | None = None
    observer: str | ObserverMethod | None = None
    disturbances: str | None = None
    see: Fault | Sequence[Fault] = ()
    follow: float | str = 0
    signals: str | None = None
    method: str = AUTO
    safety: float = 1.25
    held_out: float = 0.3

    @property
    def observing(self) -> ObserverMethod | None:
        """The set observer that bounds are for; None: windows."""
        if self.observer is None:
            return None
        return observer_method(self.observer)

    @property
    def window(self) -> WindowChoice:
        """The windows that regressions look at, and the test."""
        observer = None
        if self.observing is not None:
            observer = self.observing.name
        if self.lags is not None:
            return WindowChoice(self.lags[-1], tuple(self.lags), self.average, observer)
        usual = 0 if self.order == 0 else HORIZON
        horizon = usual if self.horizon is None else self.horizon
        return WindowChoice(horizon, None, self.average, observer)

    @property
    def is_open(self) -> bool:
        """Whether nothing says what is tested."""
        chosen = self.test, self.horizon, self.lags, self.average, self.observer
        return chosen == (None,) * len(chosen) and self.order != 0

    @property
    def faults(self) -> tuple[Fault, ...]:
        """The faults that are wanted."""
        if isinstance(self.see, Fault):
            return (self.see,)
        return tuple(self.see)

    def of(self, window: WindowChoice, method: str) -> "Recipe":
        """Return the recipe of a test of windows, and of one of KINDS."""
        about: dict[str, Any] = {"horizon": None, "lags": None} | window.about
        about |= {"average": window.average, "follow": window.follow}
        return dataclasses.replace(self, test=None, method=method, **about)


def recipe_of(recipe: object, fields: Mapping[str, Any]) -> Recipe:
    """Return a recipe, or that of a model file, with some of its fields changed, checked.

    Raises:
        OSError: no such file.
        ValueError: no Recipe, unknown fields, values out of range, fields that do not go together.
    """
    if isinstance(recipe, str | PathLike):
        fields = _written(Path(recipe)) | dict(fields)
        recipe = None
    if recipe is None:
        recipe = Recipe()
    if not isinstance(recipe, Recipe):
        raise ValueError(f"recipe must be a Recipe, like jb.Recipe(order=1), not {recipe!r}")
    for name in fields:
        if name not in Recipe.__dataclass_fields__:
            raise ValueError(f"fit has no {name}: a recipe has {', '.join(Recipe.__dataclass_fields__)}")
    recipe = dataclasses.replace(recipe, **fields)
    for name, words in WORDS.items():
        value = getattr(recipe, name)
        if not isinstance(value, str | bool | np.bool_ | None) or value not in words:
            raise ValueError(f"{name} must be {' or '.join(map(str, words))}, not {value!r}")
    try:
        observer = recipe.observing
    except ValueError as e:
        raise ValueError(f"observer: {e}") from None
    see = recipe.faults if isinstance(recipe.see, Fault) else listed_argument("see", recipe.see, SEE)
    lags = None if recipe.lags is None else whole_lags(recipe.lags)
    direct = bool(recipe.direct) or recipe.order == 0
    recipe = dataclasses.replace(recipe, observer=observer, see=see, lags=lags, direct=direct)
    _refuse_together(recipe)
    numbers = _numeric_fields(recipe)
    _refuse_faults(recipe)
    return dataclasses.replace(recipe, **numbers)


def _written(path: Path) -> dict[str, Any]:
    """Return the fields of the recipe in a model file."""
    import tomllib

    try:
        table: dict[str, Any] = tomllib.loads(path.read_text(encoding="utf-8-sig"))["fit"]
        faults = [Fault(*fault) for fault in table.pop("see", [])]
        if "observer" in table:
            name, *settings = table["observer"]
            table["observer"] = OBSERVERS[name](*settings)
    except (ValueError, KeyError, TypeError, AttributeError):
        raise ValueError(
            f"{path}: no table [fit] as `fit` writes it, so there is no recipe to repeat"
        ) from None
    return table | {"see": faults}


def recipe_text(recipe: Recipe) -> dict[str, str]:
    """Return {field: TOML} of what is not as usual in a recipe, for the table [fit] of a model file."""
    from tomlkit import item

    changed = {name: x for name, x in vars(recipe).items() if x != getattr(Recipe(), name)}
    if recipe.faults:
        fields = [dataclasses.astuple(fault) for fault in recipe.faults]
        changed["see"] = [[x for x in fault if x is not None] for fault in fields]  # TOML has no None: stop
    if recipe.observing is not None:
        changed["observer"] = [recipe.observing.name, *vars(recipe.observing).values()]
    return {name: item(x).as_string() for name, x in changed.items()}


def _refuse_together(recipe: Recipe) -> None:
    """Raise ValueError for fields that do not go together."""
    usual = Recipe()
    names = Recipe.__dataclass_fields__
    given = {name for name in names if getattr(recipe, name) != getattr(usual, name)}
    if recipe.is_open or recipe.test == BANK:  # its windows may follow beside an observer with disturbances
        given.discard("follow")
    for one, other, why in APART:
        if {one, other} <= given:
            raise ValueError(f"{why.format(getattr(recipe, other))}: leave {one} out, or {other}")
    if recipe.test == AUTO and recipe.observer is not None:
        raise ValueError("test = 'auto' chooses windows: leave observer out, or test")
    if recipe.test == AUTO and recipe.disturbances is not None:
        raise ValueError("test = 'auto' compares windows whose sensors alone err: leave disturbances out")
    if recipe.order == 0 and recipe.test is not None:
        raise ValueError("a static model, order 0, is tested sample by sample: leave test out")
    if recipe.order == 0 and recipe.method not in (AUTO, KINDS[0]):
        raise ValueError(f"a static model, order 0, is fitted by {KINDS[0]}: leave method out")


def _numeric_fields(recipe: Recipe) -> dict[str, Any]:
    """Return the fields that are numbers, as those of Python; raise ValueError for one out of range."""
    numbers: dict[str, Any] = {}
    for name, (least, end, words) in NUMBERS.items():
        value = getattr(recipe, name)
        if value == AUTO and words.endswith(AUTO):
            continue
        is_one = is_whole(value) if isinstance(end, int) else is_real(value)
        if not (is_one and least <= value < end):
            raise ValueError(f"{name} must be {words}, not {value!r}")
        numbers[name] = type(end)(value)
    order, horizon, average = numbers.get("order", 1), recipe.window.horizon, recipe.average
    if not is_whole(horizon) or not (order + 1 if order else 0) <= horizon <= LONGEST:
        raise ValueError(f"horizon must be a whole number above the order ({order}), not {horizon!r}")
    if average is not None and not (is_whole(average) and 2 <= average <= horizon + 1):
        raise ValueError(
            f"average must be a whole number from 2 to the {horizon + 1} samples of a window, not {average!r}"
        )
    for name in ("horizon", "average"):
        if getattr(recipe, name) is not None:
            numbers[name] = int(getattr(recipe, name))
    return numbers


def _refuse_faults(recipe: Recipe) -> None:
    """Raise ValueError for faults that bounds cannot be chosen for."""
    if not all(isinstance(fault, Fault) for fault in recipe.faults):
        raise ValueError(f"see must be a fault, or a list of them, like {SEE}, not {recipe.see!r}")
    if recipe.disturbances is not None:
        for fault in recipe.faults:
            if fault.kind not in SEEN or not fault.size:
                raise ValueError(
                    f"see: bounds are chosen for a bias or a drift of some size, not for "
                    f"{fault.signal}:{fault.kind} of size {fault.size:g}"
                )
    elif recipe.faults and len(wanted_biases(recipe.faults)) < 2:
        raise ValueError(
            "see says which disturbances are chosen: give disturbances='auto' with it; without, biases "
            "of two outputs or more say in which ratio their bounds are"
        )


def wanted_biases(faults: Sequence[Fault]) -> dict[str, float]:
    """Return {signal: the least size of a bias of it that is wanted}."""
    sizes: dict[str, float] = {}
    for fault in faults:
        if fault.kind == "bias" and fault.size:
            sizes[fault.signal] = min(abs(fault.size), sizes.get(fault.signal, np.inf))
    return sizes
