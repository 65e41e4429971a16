"""Faults as states: a bias or a drift b that a model carries on, so that an observer encloses it.

    y = (1 + theta) (C x + D u) + b + noise

A sensor's fault is added behind its relative error, which speaks of the true value alone. Outputs of a model
have one relative error for all that they show: where such a fault meets a tolerance, theta becomes a
parameter of the plant, C + theta C and D + theta D, of the same bounds.
"""

from collections.abc import Collection, Mapping, Sequence
from fractions import Fraction
from functools import partial

from jaxbound.exact.linalg import Matrix, Number, beside, columns_of, scale, transpose, zeros
from jaxbound.exact.linalg import identity as unit_matrix
from jaxbound.models.conversion import ModelLike, as_model
from jaxbound.models.faults import refuse_unknown_signal
from jaxbound.models.more_states import more_states
from jaxbound.models.numbers import number
from jaxbound.models.system import LinearSystem
from jaxbound.models.uncertainty import Uncertainty

KINDS = ("bias", "drift")


def with_faults(
    model: ModelLike, *faults: str, rate: Number | Mapping[str, Number] | None = None
) -> LinearSystem:
    """Return the model with one more state for each fault: how much too much a sensor shows, or an actuator
    does.

    An observer of it encloses the faults: one whose interval does not hold 0 is proved, and the interval says
    how large it is. Faults that no output tells apart (a bias of every sensor of a level, say) stay wide:
    bounds of the first state, x0, are then needed.

    They are what a `Fault` of the kind simulates: y = (1 + theta) t + b + noise of a sensor, t the true
    value; u + b of an actuator. The tolerance of a sensor that has a fault becomes an `Uncertainty`,
    "tolerance of T1" (with constant_tolerance those of all sensors do); observers of unknown inputs take none
    on outputs: give it as noise.

    Args:
        model: a LinearSystem, or what `parity_relations` takes.
        faults: texts "signal:kind", signal an output or an input. "T1:bias" is constant, "T2:drift" moves by
            at most `rate` from one sample to the next. The states are called as the texts.
        rate: of drifts, in the unit of the signal; one number, or {"T2": number}.

    Raises:
        ValueError: an unknown signal or kind, a fault named twice, a drift without a rate, a rate that no
            drift has, a negative one; a tolerance that cannot become a parameter: beside averages, or where a
            parameter or an unknown input acts on the same output.

    Example:
        >>> import jaxbound as jb
        >>> m = jb.LinearSystem([[0.9]], [[1]], [[1], [1]], noise=0.1, outputs=["T1", "T2"])
        >>> f = with_faults(m, "T2:bias", "T1:drift", rate=0.01)
        >>> f.states, [float(x) for x in f.C[1]]
        (('x1', 'T2:bias', 'T1:drift'), [1.0, 1.0, 0.0])
    """
    model = as_model(model, factors=True)
    named = [_fault(model, text) for text in faults]
    twice = sorted({x for x in faults if faults.count(x) > 1})
    if not named:
        raise ValueError("name a fault at least: with_faults(model, 'y1:bias')")
    if twice:
        raise ValueError(f"{twice[0]!r} is named twice")
    drifts = [signal for signal, kind in named if kind == "drift"]
    rates = _rates(rate, drifts)
    model = _with_errors_as_parameters(model, [signal for signal, _ in named])
    k = len(named)
    unit = unit_matrix(k)
    changes = more_states(
        model, faults, partial(_acting, model, named, 1), partial(_acting, model, named, 0), unit
    )
    moving = [i for i, (_, kind) in enumerate(named) if kind == "drift"]
    if moving:
        more = beside(zeros(k, model.g), columns_of(unit, moving))
        # a drift is moved by a disturbance of its own, within its rate
        pairs = [*model.disturbance, *((-bound, bound) for bound in rates)]
        changes["disturbance"] = beside(model.G, zeros(model.n, len(moving))) + more, pairs
    return model.replace(**changes)


def _rates(rate: Number | Mapping[str, Number] | None, drifts: Sequence[str]) -> list[Fraction]:
    """Return the largest change of each drift from one sample to the next, exactly.

    Raises:
        ValueError: rates of other faults, a drift without one, a negative one.
    """
    rates: dict[str, Number | None] = dict.fromkeys(drifts)
    if isinstance(rate, Mapping):
        rates = dict(rate)
    elif rate is not None:
        rates = dict.fromkeys(drifts, rate)
    spare = sorted(set(rates) - set(drifts))
    if spare:
        raise ValueError(f"rate is for drifts, and {spare[0]} is none")
    if rate is not None and not drifts:
        raise ValueError("rate is for drifts, and none of these faults is none")
    stated = []
    for signal in drifts:
        largest = rates.get(signal)
        if largest is None:
            raise ValueError(
                f"{signal}:drift needs a rate: how much it moves at most from one sample to the next"
            )
        stated.append(largest)
    bounds = [number(f"rate of {signal}", x) for signal, x in zip(drifts, stated, strict=True)]
    if any(bound < 0 for bound in bounds):
        raise ValueError("a rate must be >= 0")
    return bounds


def _with_errors_as_parameters(model: LinearSystem, faulty: Collection[str]) -> LinearSystem:
    """Return the model with the relative errors of faulty outputs as parameters; of all, where they are
    constant.
    """
    chosen = [i for i, name in enumerate(model.outputs) if model.tolerance[i] and name in faulty]
    if not chosen:
        return model
    if model.constant_tolerance:
        # constant for all outputs or for none: the others would lose it
        chosen = [i for i in range(model.p) if model.tolerance[i]]
    parameters = [_relative_error(model, i) for i in chosen]
    return model.replace(
        tolerance=[Fraction(0) if i in chosen else t for i, t in enumerate(model.tolerance)],
        constant_tolerance=False,
        uncertainties=[*model.uncertainties, *(p for p in parameters if p is not None)],
    )


def _relative_error(model: LinearSystem, i: int) -> Uncertainty | None:
    """Return the relative error of output i as an Uncertainty, None where it shows nothing; refuse what has
    none.
    """
    # C + theta C has one parameter: a second factor on the same row would make products of two
    obstacle = ""
    if any(model.D_v[i]):
        obstacle = "an unknown input acts on the same output"
    if any(p.C and any(p.C[i]) or p.D and any(p.D[i]) for p in model.uncertainties):
        obstacle = "a parameter acts on the same output"
    if model.averages:
        obstacle = "the model has averages"
    name = model.outputs[i]
    if obstacle:
        raise ValueError(
            f"a fault of a sensor makes its tolerance a parameter, and {obstacle}: give the tolerance of "
            f"{name!r} as noise instead, the tolerance times the largest |{name}| (less its offset) on top "
            f"of what it has"
        )
    alone = {}
    for letter, rows in (("C", model.C), ("D", model.D)):
        if any(rows[i]):
            others = zeros(len(rows), len(rows[i]))
            alone[letter] = others[:i] + (rows[i],) + others[i + 1 :]
    if not alone:
        return None
    between = -model.tolerance[i], model.tolerance[i]
    return Uncertainty(f"tolerance of {name}", **alone, varying=not model.constant_tolerance, between=between)


def _fault(model: LinearSystem, text: str) -> tuple[str, str]:
    """Return (signal, kind) of a text."""
    signal, _, kind = str(text).rpartition(":")
    if not signal or kind not in KINDS:
        raise ValueError(f"a fault is written 'signal:bias' or 'signal:drift', not {text!r}")
    refuse_unknown_signal(model, signal, kind)
    return signal, kind


def _acting(
    model: LinearSystem, named: Sequence[tuple[str, str]], own: int, part: Mapping[str, Matrix]
) -> tuple[Matrix, Matrix]:
    """Return how faults, (signal, kind) each, act on x+ and on y. own: their effect on outputs that they are
    of. part: the matrices of the model, or of a parameter, by their letters.
    """
    on_states, on_outputs = [], []
    for signal, _ in named:
        if signal in model.outputs:
            i = model.outputs.index(signal)
            on_states.append((Fraction(0),) * model.n)
            on_outputs.append(scale(unit_matrix(model.p)[i], own))
        else:
            i = model.inputs.index(signal)
            on_states.append(tuple(row[i] for row in part["B"]))
            on_outputs.append(tuple(row[i] for row in part["D"]))
    return transpose(on_states), transpose(on_outputs)
