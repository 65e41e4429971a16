"""Faults with a name, of a size that nobody knows: what an alarm is explained by.

    (output) a reading shows (1 + theta) t + f g + e, or (1 + f) (1 + theta) t + e
    (input)  the plant receives u + f g, or u (1 + f)
    (states) x+ = A x + B u + f g F
    (A, B, C) x+ = (A + f dA) x + (B + f dB) u,  y = (C + f dC) x + D u

f is the size, constant while the fault lasts; g is 1, or a recorded input; t is the true value, its offset
included for a gain, theta and e are within tolerance and noise, which no fault of a sensor changes. These are
the faults of `simulate`, `with_faults` and studies as well; `certificates.supposed` inverts them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from fractions import Fraction

from jaxbound.exact.linalg import Matrix, MatrixLike, Number, beside, zeros
from jaxbound.models.arguments import listed_argument
from jaxbound.models.numbers import entries_of, number, ordered_pair
from jaxbound.recordings.expressions import missing_column
from jaxbound.text.names import listed
from jaxbound.text.objects import readable

PARAMETER = "parameter"
KINDS = {
    "output": ("bias", "gain"),
    "input": ("offset", "gain"),
    "states": ("leak",),
    PARAMETER: (PARAMETER,),
}
"""The kinds of faults of each place, the usual one first."""
SIGNS = ("+", "-")
LETTERS = ("A", "B", "C")
"""Matrices that a parameter acts on."""


@readable
@dataclass(frozen=True, init=False)
class NamedFault:
    """A fault that an engineer names, of which the size is unknown: a candidate for the cause of an alarm.

    Give one of output, input and states, or the matrices of a parameter: where it acts.

    Args:
        name: in the words of whoever reads an alarm: "heating valve leaks".
        output: the sensor that shows something else than is there. input: the actuator that does something
            else than was recorded. states: what flows in at each sample beyond the model: names, or {name:
            share}, {"tank1": -1, "tank2": 1} for a flow from the one to the other.
        A, B, C: of a parameter of the plant that is another than the model says: what its size
            multiplies in the matrix of that letter, of its shape, as of an `Uncertainty`; A or C is needed,
            and `most`.
        kind: of a sensor "bias" (+ size, the usual one) or "gain" (the value times 1 + size, with the
            noise that it always had); of an actuator "offset"
            (+ size, the usual one) or "gain"; of states "leak" (+ size times the share at each sample);
            of matrices "parameter".
        times: an input whose recorded value multiplies the size: an error that grows with the flow, or an
            entry of B that is another (states={"x1": 1}, times="heat").
        sign: "+" or "-": the size has this sign only. None: either.
        least, most: the magnitude lies between these, in the unit of the size; None: 0, and without end.
        between: (lo, hi), of an actuator: what it does lies between these at each sample, whatever the size:
            a valve is never less than shut.
        unit: of the size, for reports; None: that of the signal.

    Raises:
        ValueError: no place or several, a kind that the place does not have, a sign that is none, numbers
            that are not 0 <= least <= most or lo <= hi, a parameter without `most`.

    Example:
        >>> NamedFault("heating valve leaks", input="heat", sign="+").kind
        'offset'
    """

    name: str
    output: str | None
    input: str | None
    states: tuple[tuple[str, Fraction], ...]
    A: Matrix
    B: Matrix
    C: Matrix
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
        A: MatrixLike | None = None,
        B: MatrixLike | None = None,
        C: MatrixLike | None = None,
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
        matrices = _coefficients(about, {"A": A, "B": B, "C": C})
        places = {"output": output, "input": input, "states": shares, PARAMETER: any(matrices.values())}
        stated = [place for place, value in places.items() if value]
        if len(stated) != 1:
            raise ValueError(
                f"{about} needs one of output, input and states, or the matrices of a parameter: where it "
                f"acts"
            )
        kinds = KINDS[stated[0]]
        if kind is None:
            kind = kinds[0]
        if kind not in kinds:
            raise ValueError(f"kind of {about} must be {' or '.join(kinds)} ({stated[0]}), not {kind!r}")
        if kind == "gain" and times is not None:
            raise ValueError(f"{about}: a gain multiplies its own signal, so it has no times")
        if sign is not None and sign not in SIGNS:
            raise ValueError(f"sign of {about} must be '+' or '-', not {sign!r}")
        smallest, largest = _exact_size(f"least of {about}", least), _exact_size(f"most of {about}", most)
        if smallest is not None and largest is not None and smallest > largest:
            raise ValueError(f"{about} needs least <= most, not {float(smallest):g} and {float(largest):g}")
        if stated[0] == PARAMETER:
            _refuse_open_parameter(about, matrices, times, largest)
        if between is not None and input is None:
            raise ValueError(f"between of {about} is of an actuator: give it with input")
        vars(self).update(
            name=name,
            output=output,
            input=input,
            states=shares,
            **matrices,
            kind=kind,
            times=times,
            sign=sign,
            least=smallest,
            most=largest,
            between=None if between is None else ordered_pair(f"between of {about}", between),
            unit=unit,
        )

    @property
    def usual_kind(self) -> str:
        """The kind of faults of this place where none is stated."""
        if self.states:
            return KINDS["states"][0]
        if self.output is not None:
            return KINDS["output"][0]
        if self.input is not None:
            return KINDS["input"][0]
        return PARAMETER

    @property
    def signal(self) -> str:
        """The name of what it acts on: of an output, an input, states, or entries of matrices."""
        if self.states:
            return ", ".join(name for name, _ in self.states)
        if self.kind == PARAMETER:
            return ", ".join(_changed_entries(self.coefficients))
        return str(self.output or self.input)

    @property
    def coefficients(self) -> dict[str, Matrix]:
        """{letter: what the size of a parameter is multiplied by in that matrix}; empty of other faults."""
        return {letter: rows for letter in LETTERS if (rows := getattr(self, letter))}


def _coefficients(about: str, given: Mapping[str, MatrixLike | None]) -> dict[str, Matrix]:
    """Return the coefficients of a parameter exactly, () for a matrix without one."""
    matrices = {}
    for letter, rows in given.items():
        matrices[letter] = entries_of(f"{letter} of {about}", rows)
        if matrices[letter] and not any(x for row in matrices[letter] for x in row):
            raise ValueError(f"{letter} of {about} is 0: leave it out")
    return matrices


def _refuse_open_parameter(
    about: str, matrices: Mapping[str, Matrix], times: str | None, most: Fraction | None
) -> None:
    """Raise ValueError for a parameter that needs no search, or one whose search has no end."""
    if not matrices["A"] and not matrices["C"]:
        raise ValueError(
            f"{about}: a parameter acts in A or C; of an entry of B alone the size is exact: "
            f'give it as states=["x1"], times="u1"'
        )
    if times is not None:
        raise ValueError(f"{about}: a parameter multiplies what its matrices say, so it has no times")
    if not most:
        raise ValueError(f"{about} needs most > 0: sizes of a parameter are searched up to it")


def _changed_entries(coefficients: Mapping[str, Matrix]) -> list[str]:
    """Return the entries that a parameter changes, like A[0][1]."""
    return [
        f"{letter}[{i}][{j}]"
        for letter, rows in coefficients.items()
        for i, row in enumerate(rows)
        for j, x in enumerate(row)
        if x
    ]


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


def _exact_size(field: str, stated: Number | None) -> Fraction | None:
    """Return a bound of a size exactly, None where there is none."""
    if stated is None:
        return None
    bound = number(field, stated)
    if bound < 0:
        raise ValueError(f"{field} must be >= 0, a magnitude, not {stated!r}")
    return bound


def named_faults(
    given: Iterable[NamedFault], inputs: Sequence[str], outputs: Sequence[str], states: Sequence[str]
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
        _refuse_other_shapes(fault, len(inputs), len(outputs), len(states))
    names = [fault.name for fault in faults]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f"each fault needs its own name: {listed(twice)} is used twice")
    return faults


def _refuse_other_shapes(fault: NamedFault, m: int, p: int, n: int) -> None:
    """Raise ValueError for coefficients of a parameter that do not have the shapes of a model's matrices."""
    shapes = {"A": (n, n), "B": (n, m), "C": (p, n)}
    for letter, rows in fault.coefficients.items():
        shape = len(rows), len(rows[0])
        if shape != shapes[letter]:
            raise ValueError(
                f"{letter} of fault {fault.name!r} must have the shape of the model's {letter}, "
                f"{shapes[letter]}: its shape is {shape}"
            )


def faults_beside_states(faults: Iterable[NamedFault], more: int) -> tuple[NamedFault, ...]:
    """Return the same faults for the model with so many more states behind its own, which no parameter
    moves.
    """
    grown = []
    for fault in faults:
        wider = copy(fault)
        for letter, rows in fault.coefficients.items():
            if letter != "B":
                rows = beside(rows, zeros(len(rows), more))
            if letter != "C":
                rows += zeros(more, len(rows[0]))
            vars(wider)[letter] = rows
        grown.append(wider)
    return tuple(grown)


def default_faults(inputs: Sequence[str], outputs: Sequence[str]) -> tuple[NamedFault, ...]:
    """Return the candidates where nobody named any: a bias of every sensor, an offset of every actuator.

    Example:
        >>> [fault.name for fault in default_faults(["heat"], ["T1"])]
        ['bias of T1', 'offset of heat']
    """
    sensors = [NamedFault(f"bias of {name}", output=name) for name in outputs]
    actuators = [NamedFault(f"offset of {name}", input=name) for name in inputs]
    return (*sensors, *actuators)
