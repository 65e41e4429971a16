"""Bounds that follow the operating point: the noise of an output times a factor that is worked out for each
sample from recorded columns.
"""

from collections.abc import Mapping, Sequence

from jaxbound.models.signals import ModelSignals, Sensors, Words, words
from jaxbound.recordings.expressions import expression, is_expression
from jaxbound.recordings.factors import factors_of, read_factor
from jaxbound.recordings.signals import Named
from jaxbound.text.names import listed


def refuse_factors(model: Named) -> None:
    """Raise ValueError for a model with factors on its noise: said wherever they are not known.

    Whoever takes a model refuses them, or has learned to use them: none may pass them over.
    """
    named = [factor.output for factor in factors_of(model)]
    if named:
        raise ValueError(
            f"the noise of {listed(named)} is times a factor, which only windows of samples and observers "
            f"know, detect(parity_relations(model), ..) and detect(observer(model), ..): give a model with "
            f"times=None, and noise that holds throughout"
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
    for output, text in times:
        for name in read_factor(text).columns:
            used = _outputs_behind(name, signals.inputs, signals.outputs, columns)
            _refuse_outputs(output, text, used)
    return tuple((output, read_factor(text).text) for output, text in times)


def inputs_for_factors(
    inputs: Sequence[str], outputs: Sequence[str], columns: Mapping[str, str]
) -> tuple[str, ...]:
    """Return the inputs that a factor may use: those that rest on no output."""
    return tuple(name for name in inputs if not _outputs_behind(name, inputs, outputs, columns))


def _outputs_behind(
    name: str, inputs: Sequence[str], outputs: Sequence[str], columns: Mapping[str, str]
) -> list[str]:
    """Return the outputs on which a column, or an input by its name, rests.

    An output that is computed from several columns has those for its own that are no inputs by themselves:
    the model takes an input as known, whatever else is computed from it.
    """
    sources = {name.strip()}
    if name in inputs:
        sources = _sources(name, columns)
    known = {columns.get(x, x).strip() for x in inputs}
    resting = []
    for output in outputs:
        measured_in = _sources(output, columns)
        own = measured_in - known
        if len(own) < 2:  # its name alone
            own = measured_in
        if sources & own:
            resting.append(output)
    return resting


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
