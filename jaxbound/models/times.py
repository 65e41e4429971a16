"""Bounds that follow the operating point: the noise of an output times a factor that is worked out for each
sample from recorded columns.
"""

from collections.abc import Mapping

from jaxbound.models.signals import ModelSignals, Sensors, Words, words
from jaxbound.recordings.expressions import expression, is_expression
from jaxbound.recordings.factors import factors_of, read_factor
from jaxbound.recordings.signals import Named
from jaxbound.text.names import listed

__all__ = ["refuse_factors", "times_of"]


def refuse_factors(model: Named) -> None:
    """Raise ValueError for a model with factors on its noise: said wherever they are not known.

    Whoever takes a model refuses them, or has learned to use them: none may pass them over.
    """
    named = [factor.output for factor in factors_of(model)]
    if named:
        raise ValueError(
            f"the noise of {listed(named)} is times a factor, which only windows of samples know, "
            f"detect(parity_relations(model), ..): give a model with times=None, and noise that holds "
            f"throughout"
        )


def times_of(
    given: Mapping[str, str] | None, signals: ModelSignals, measured: Sensors, uncertain: bool
) -> Words:
    """Return the factors of a model as pairs (output, expression), checked.

    Args:
        given: as the argument `times` of a LinearSystem. signals, measured: of the model. uncertain: whether
            it has uncertainties.

    Raises:
        ValueError: an unknown output, an expression that cannot be read or that rests on an output; together
            with uncertainties or with constant_tolerance.
    """
    times = words("times", given, signals.outputs)
    if not times:
        return ()
    if uncertain or measured.constant_tolerance:
        what = "uncertainties" if uncertain else "constant_tolerance"
        raise ValueError(
            f"times and {what} do not go together: factors on noise are for exact models and tolerances "
            f"drawn anew"
        )
    columns = dict(signals.columns)
    measured_in: dict[str, str] = {}  # column: the output that is recorded there
    for output in signals.outputs:
        measured_in |= dict.fromkeys(_sources(output, columns), output)
    for output, text in times:
        for name in read_factor(text).columns:
            sources = {name.strip()}
            if name in signals.inputs:
                sources = _sources(name, columns)
            _refuse_outputs(output, text, sorted(measured_in[x] for x in sources if x in measured_in))
    return tuple((output, read_factor(text).text) for output, text in times)


def _sources(signal: str, columns: Mapping[str, str]) -> set[str]:
    """Return the names of the columns that a signal may be read from."""
    stated = columns.get(signal, signal)
    named = {stated}
    if is_expression(stated):
        named = set(expression(stated).columns)
    return {name.strip() for name in (*named, signal)}


def _refuse_outputs(output: str, text: str, used: list[str]) -> None:
    """Raise ValueError where a factor rests on outputs: their faults would widen a bound."""
    if used:
        raise ValueError(
            f"the noise of {output!r} is times {text!r}, which rests on the output {listed(used, str)}: a "
            f"fault would widen its own bound; use inputs, or columns in which no output of the model is "
            f"recorded"
        )
