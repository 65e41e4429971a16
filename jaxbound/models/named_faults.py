"""Faults with a name, of a size that nobody knows: what an alarm is explained by.

    (output) a reading shows y + f g, or y (1 + f)
    (input)  the plant receives u + f g, or u (1 + f)
    (states) x+ = A x + B u + f g F

f is the size, constant while the fault lasts; g is 1, or a recorded input.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

from jaxbound.exact.linalg import Number
from jaxbound.models.arguments import listed_argument
from jaxbound.models.numbers import number
from jaxbound.recordings.expressions import missing_column
from jaxbound.text.names import listed
from jaxbound.text.objects import readable

__all__ = ["NamedFault", "default_faults", "named_faults"]

KINDS = {"output": ("bias", "gain"), "input": ("offset", "gain"), "states": ("leak",)}
"""The kinds of faults of each place, the usual one first."""
SIGNS = ("+", "-")


@readable
@dataclass(frozen=True, init=False)
class NamedFault:
    """A fault that an engineer names, of which the size is unknown: a candidate for the cause of an alarm.

    Give one of output, input and states: where it acts.

    Args:
        name: in the words of whoever reads an alarm: "heating valve leaks".
        output: the sensor that shows something else than is there. input: the actuator that does something
            else than was recorded. states: what flows in at each sample beyond the model: names, or {name:
            share}, {"tank1": -1, "tank2": 1} for a flow from the one to the other.
        kind: of a sensor "bias" (+ size, the usual one) or "gain" (times 1 + size); of an actuator "offset"
            (+ size, the usual one) or "gain"; of states "leak" (+ size times the share at each sample).
        times: an input whose recorded value multiplies the size: an error that grows with the flow, or an
            entry of B that is another (states={"x1": 1}, times="heat").
        sign: "+" or "-": the size has this sign only. None: either.
        least, most: the magnitude lies between these, in the unit of the size; None: 0, and without end.
        between: (lo, hi), of an actuator: what it does lies between these at each sample, whatever the size:
            a valve is never less than shut.
        unit: of the size, for reports; None: that of the signal.

    Raises:
        ValueError: no place or several, a kind that the place does not have, a sign that is none, numbers
            that are not 0 <= least <= most or lo <= hi.

    Example:
        >>> NamedFault("heating valve leaks", input="heat", sign="+").kind
        'offset'
    """

    name: str
    output: str | None
    input: str | None
    states: tuple[tuple[str, Fraction], ...]
    kind: str
    times: str | None
    sign: str | None
    least: Fraction | None
    most: Fraction | None
    between: tuple[Fraction, Fraction] | None
    unit: str | None

    def __init__(
        self,
        name: str,
        *,
        output: str | None = None,
        input: str | None = None,
        states: Mapping[str, Number] | Sequence[str] = (),
        kind: str | None = None,
        times: str | None = None,
        sign: str | None = None,
        least: Number | None = None,
        most: Number | None = None,
        between: Sequence[Number] | None = None,
        unit: str | None = None,
    ) -> None:
        if not isinstance(name, str) or not name.strip():
            raise ValueError(f"a fault needs a name in words, not {name!r}")
        about = f"fault {name!r}"
        shares = _shares(about, states)
        places = {"output": output, "input": input, "states": shares}
        stated = [place for place, value in places.items() if value]
        if len(stated) != 1:
            raise ValueError(f"{about} needs one of output, input and states: where it acts")
        kinds = KINDS[stated[0]]
        if kind is None:
            kind = kinds[0]
        if kind not in kinds:
            raise ValueError(f"kind of {about} must be {' or '.join(kinds)} ({stated[0]}), not {kind!r}")
        if kind == "gain" and times is not None:
            raise ValueError(f"{about}: a gain multiplies its own signal, so it has no times")
        if sign is not None and sign not in SIGNS:
            raise ValueError(f"sign of {about} must be '+' or '-', not {sign!r}")
        smallest, largest = _magnitude(f"least of {about}", least), _magnitude(f"most of {about}", most)
        if smallest is not None and largest is not None and smallest > largest:
            raise ValueError(f"{about} needs least <= most, not {float(smallest):g} and {float(largest):g}")
        if between is not None and input is None:
            raise ValueError(f"between of {about} is of an actuator: give it with input")
        vars(self).update(
            name=name,
            output=output,
            input=input,
            states=shares,
            kind=kind,
            times=times,
            sign=sign,
            least=smallest,
            most=largest,
            between=_ends(f"between of {about}", between),
            unit=unit,
        )

    @property
    def usual_kind(self) -> str:
        """The kind of faults of this place where none is stated."""
        if self.states:
            return KINDS["states"][0]
        if self.output is not None:
            return KINDS["output"][0]
        return KINDS["input"][0]

    @property
    def signal(self) -> str:
        """The name of what it acts on: of an output, an input, or states."""
        if self.states:
            return ", ".join(name for name, _ in self.states)
        return str(self.output or self.input)


def _shares(about: str, states: Mapping[str, Number] | Sequence[str]) -> tuple[tuple[str, Fraction], ...]:
    """Return the states that a fault acts on with their shares, exactly."""
    if isinstance(states, str):
        states = (states,)
    if not isinstance(states, Mapping):
        states = dict.fromkeys(states, 1)
    shares = [(str(name), number(f"states of {about}", share)) for name, share in states.items()]
    for name, share in shares:
        if not share:
            raise ValueError(f"states of {about}: the share of {name!r} is 0, leave it out")
    return tuple(shares)


def _magnitude(field: str, stated: Number | None) -> Fraction | None:
    """Return a bound of a size exactly, None where there is none."""
    if stated is None:
        return None
    bound = number(field, stated)
    if bound < 0:
        raise ValueError(f"{field} must be >= 0, a magnitude, not {stated!r}")
    return bound


def _ends(field: str, stated: Sequence[Number] | None) -> tuple[Fraction, Fraction] | None:
    """Return the ends of what an actuator does exactly, None where nothing is stated."""
    if stated is None:
        return None
    if isinstance(stated, str) or len(stated) != 2:
        raise ValueError(f"{field} needs two numbers, lo <= hi, not {stated!r}")
    lo, hi = number(field, stated[0]), number(field, stated[1])
    if lo > hi:
        raise ValueError(f"{field} needs lo <= hi, not {float(lo):g} and {float(hi):g}")
    return lo, hi


def named_faults(
    given: Iterable[NamedFault],
    inputs: Sequence[str],
    outputs: Sequence[str],
    states: Sequence[str],
) -> tuple[NamedFault, ...]:
    """Return the named faults of a model, checked against the names of its signals and states.

    Raises:
        TypeError: something else than a NamedFault. ValueError: a name used twice, or one that the model does
            not have.
    """
    faults = listed_argument("faults", given, "[NamedFault(..)]")
    for fault in faults:
        if not isinstance(fault, NamedFault):
            raise TypeError(f"faults of a model must be NamedFault, not {type(fault).__name__}")
        about = f"fault {fault.name!r}"
        for name, known, what in (
            (fault.output, outputs, "output"),
            (fault.input, inputs, "input"),
            (fault.times, inputs, "input"),
        ):
            if name is not None and name not in known:
                raise ValueError(missing_column(name, list(known), about, what))
        for name, _ in fault.states:
            if name not in states:
                raise ValueError(missing_column(name, list(states), about, "state"))
    names = [fault.name for fault in faults]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f"each fault needs its own name: {listed(twice)} is used twice")
    return faults


def default_faults(inputs: Sequence[str], outputs: Sequence[str]) -> tuple[NamedFault, ...]:
    """Return the candidates where nobody named any: a bias of every sensor, an offset of every actuator.

    Example:
        >>> [fault.name for fault in default_faults(["heat"], ["T1"])]
        ['bias of T1', 'offset of heat']
    """
    sensors = [NamedFault(f"bias of {name}", output=name) for name in outputs]
    actuators = [NamedFault(f"offset of {name}", input=name) for name in inputs]
    return (*sensors, *actuators)
