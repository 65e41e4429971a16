"""Faults as states: a bias or a drift b that a model carries on, so that an observer encloses it.

    y = (1 + theta) (C x + D u) + b + noise

A sensor's fault is added behind its relative error, which speaks of the true value alone. Outputs of a model
have one relative error for all that they show: where such a fault meets a tolerance, theta becomes a
parameter of the plant, C + theta C and D + theta D, of the same bounds.
"""

from collections.abc import Mapping
from fractions import Fraction
from typing import Any

from jaxbound.exact.linalg import Number
from jaxbound.models.faults import refuse_unknown_signal
from jaxbound.models.plant import number
from jaxbound.models.system import LinearSystem
from jaxbound.models.uncertainty import Uncertainty, centred

__all__ = ["with_faults"]

KINDS = ("bias", "drift")


def with_faults(
    model: LinearSystem, *faults: str, rate: Number | Mapping[str, Number] | None = None
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
        model: a LinearSystem.
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
    named = [_fault(model, text) for text in faults]
    twice = sorted({x for x in faults if faults.count(x) > 1})
    if not named or twice:
        raise ValueError(
            f"{twice[0]!r} is named twice"
            if twice
            else "name a fault at least: with_faults(model, 'y1:bias')"
        )
    drifts = [signal for signal, kind in named if kind == "drift"]
    rates: dict[str, Any] = dict(rate) if isinstance(rate, Mapping) else dict.fromkeys(drifts, rate)
    if spare := sorted(set(rates) - set(drifts)) or (rate is not None and not drifts):
        raise ValueError(
            f"rate is for drifts, and {spare[0] if isinstance(spare, list) else 'none of these faults'} is "
            f"none"
        )
    if lacking := [x for x in drifts if rates.get(x) is None]:
        raise ValueError(
            f"{lacking[0]}:drift needs a rate: how much it moves at most from one sample to the next"
        )

    model = _with_errors_as_parameters(model, [signal for signal, _ in named])
    k, n = len(named), model.n
    given = {letter: getattr(model, letter) for letter in "ABCD"}
    zero = lambda *shape: [[Fraction(0)] * shape[1] for _ in range(shape[0])]

    def grown(part, own):
        """Return A, B, C, D with the columns of the faults; own: 1 for the model itself, 0 for what a
        parameter adds to it.
        """
        A, B, C, D = (
            list(map(list, part[x])) if part[x] else zero(len(given[x]), len(given[x][0]) if given[x] else 0)
            for x in "ABCD"
        )
        columns = [_columns(model, signal, B, D, own) for signal, _ in named]
        A = [row + [c[0][i] for c in columns] for i, row in enumerate(A)]
        A += [[Fraction(0)] * n + [Fraction(own * (i == j)) for j in range(k)] for i in range(k)]
        C = [row + [c[1][i] for c in columns] for i, row in enumerate(C)]
        return {"A": A, "B": B + zero(k, model.m), "C": C, "D": D}

    matrices = grown({x: centred(given[x], model.uncertainties, x, sign=-1) for x in "ABCD"}, 1)
    acts = lambda rows: any(x for row in rows for x in row)
    parameters = []
    for p in model.uncertainties:
        parts = {x: rows for x, rows in grown({x: getattr(p, x) for x in "ABCD"}, 0).items() if acts(rows)}
        parameters.append(Uncertainty(p.name, **parts, varying=p.varying, between=p.between))
    moving = [i for i, (_, kind) in enumerate(named) if kind == "drift"]
    bounds = [number(f"rate of {named[i][0]}", rates[named[i][0]]) for i in moving]
    if any(b < 0 for b in bounds):
        raise ValueError("a rate must be >= 0")
    G = [list(row) + [Fraction(0)] * len(moving) for row in (model.G if model.g else [()] * n)]
    G += [[Fraction(0)] * model.g + [Fraction(i == j) for j in moving] for i in range(k)]
    pairs = [*model.disturbance, *((-b, b) for b in bounds)]
    F = (zero(n + k, model.d), model.D_v) if model.d else None
    if F is not None:
        F[0][:n] = list(map(list, model.F))
    changes: dict[str, Any] = dict(
        matrices,
        uncertainties=parameters,
        states=(*model.states, *faults),
        disturbance=(G, pairs) if pairs else None,
        unknown_inputs=F,
    )
    return model.replace(**changes)


def _with_errors_as_parameters(model, faulty):
    """Return the model with the relative errors of faulty outputs as parameters; of all, where they are
    constant.
    """
    chosen = [i for i, name in enumerate(model.outputs) if model.tolerance[i] and name in faulty]
    if not chosen:
        return model
    if model.constant_tolerance:
        chosen = [i for i in range(model.p) if model.tolerance[i]]
    parameters = [_relative_error(model, i) for i in chosen]
    return model.replace(
        tolerance=[Fraction(0) if i in chosen else t for i, t in enumerate(model.tolerance)],
        constant_tolerance=False,
        uncertainties=[*model.uncertainties, *(p for p in parameters if p is not None)],
    )


def _relative_error(model, i):
    """Return the relative error of output i as an Uncertainty, None where it shows nothing; refuse what has
    none.
    """
    beside = ""
    if any(model.D_v[i]):
        beside = "an unknown input acts on the same output"
    if any(p.C and any(p.C[i]) or p.D and any(p.D[i]) for p in model.uncertainties):
        beside = "a parameter acts on the same output"
    if model.averages:
        beside = "the model has averages"
    name = model.outputs[i]
    if beside:
        raise ValueError(
            f"a fault of a sensor makes its tolerance a parameter, and {beside}: give the tolerance of "
            f"{name!r} as noise instead, the tolerance times the largest |{name}| (less its offset) on top "
            f"of what it has"
        )
    alone = {
        letter: _row_alone(getattr(model, letter), i) for letter in "CD" if any(getattr(model, letter)[i])
    }
    if not alone:
        return None
    between = -model.tolerance[i], model.tolerance[i]
    return Uncertainty(f"tolerance of {name}", **alone, varying=not model.constant_tolerance, between=between)


def _row_alone(rows, i):
    """Return a matrix with zeros in all rows but one."""
    return [row if j == i else [Fraction(0)] * len(row) for j, row in enumerate(rows)]


def _fault(model, text):
    """Return (signal, kind) of a text."""
    signal, _, kind = str(text).rpartition(":")
    if not signal or kind not in KINDS:
        raise ValueError(f"a fault is written 'signal:bias' or 'signal:drift', not {text!r}")
    refuse_unknown_signal(model, signal, kind)
    return signal, kind


def _columns(model, signal, B, D, own):
    """Return (how a fault acts on x+, on y)."""
    if signal in model.outputs:
        i = model.outputs.index(signal)
        return [Fraction(0)] * model.n, [Fraction(own * (i == j)) for j in range(model.p)]
    i = model.inputs.index(signal)
    return [row[i] for row in B], [row[i] for row in D]
