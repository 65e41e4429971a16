"""The cause of an alarm among named faults: which of them alone explain it, with the sizes that do, and
of which it is proved that they do not.

A fault may begin at any sample of a window and keeps its size from there on; before it there is none. What
explains a window is ranked by its size beside a usual one: `most` of the fault, the range of its actuator in
training, the span of its sensor's readings in the window.

A parameter's size is the smallest that a search found (`parameter_size`): that it explains is proved, that
none does is not. Such a parameter is left open, among those that were not weighed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Any

from jaxbound.certificates.exact_window import ExactWindow
from jaxbound.certificates.fault_size import FaultSize, Scale
from jaxbound.certificates.parameter_size import found_size
from jaxbound.models.named_faults import PARAMETER, NamedFault, default_faults, named_faults
from jaxbound.models.system import LinearSystem
from jaxbound.text.names import listed
from jaxbound.text.objects import readable

Sizes = Mapping[str, Fraction | None]


@readable
@dataclass(frozen=True, eq=False)
class Diagnosis:
    """The named faults that alone explain FAULT windows, and those that do not.

    Fields:
        model. windows: the samples at which the windows end that each candidate has to explain.
        of: so many FAULT windows the alarm has.
        explains: a FaultSize for each fault that alone explains every window, the most plausible first; of
            several windows those that explain each. The size is the smallest, .largest the largest,
            of a parameter the smallest found.
        excluded: a FaultSize for each that does not, a proof. shares: {fault: its size beside a usual one},
            of those whose usual size is known.
        unweighed: {fault: why it neither explains nor is excluded}.
        partly: where none explains every window, {fault: the windows that it alone explains}.
        ends: {fault: its FaultSize in the window that takes the least of it, and in the one that takes the
            most}, of those in `partly`.
        outside: of windows that read inputs outside the region of training the farthest, in words; "": none
            does, or there is no region. Sizes and proofs then rest on a model that is extrapolated.
    """

    model: LinearSystem
    windows: tuple[int, ...]
    of: int
    explains: tuple[FaultSize, ...]
    excluded: tuple[FaultSize, ...]
    shares: Mapping[str, Fraction]
    unweighed: Mapping[str, str]
    partly: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    ends: Mapping[str, tuple[FaultSize, FaultSize]] = field(default_factory=dict)
    outside: str = ""

    @property
    def sizes(self) -> Sizes:
        """{fault: the smallest size of it alone that explains, None where it is excluded}, exact."""
        return {weighed.fault.name: weighed.size for weighed in (*self.explains, *self.excluded)}

    @property
    def first(self) -> str:
        """The most plausible candidate and its size in words; "none of the named faults" where none is."""
        if not self.explains:
            return "none of the named faults"
        return f"{self.explains[0].fault.name}: {size_text(self.model, self.explains[0])}"

    @property
    def lines(self) -> list[tuple[str, str, Fraction | None]]:
        """(fault, its size or why there is none in words, its size beside a usual one), the most plausible
        first; 0 where no usual size is known, None of a fault that does not explain.
        """
        found: list[tuple[str, str, Fraction | None]] = []
        for weighed in self.explains:
            share = self.shares.get(weighed.fault.name, Fraction(0))
            found.append((weighed.fault.name, size_text(self.model, weighed), share))
        for weighed in self.excluded:
            found.append((weighed.fault.name, why_excluded(self.model, weighed), None))
        for name, why in self.unweighed.items():
            found.append((name, f"left open: {why}", None))
        return found

    def __str__(self) -> str:
        """Return the answer in a sentence or two."""
        if not self.explains:
            return f"none of the named faults explains this{self._partly()}{self._left_over()}"
        answer, beyond = f"{self.first} explains it", self.beyond
        others = []
        for weighed in self.explains[1:]:
            if weighed.fault.name not in beyond:
                others.append(f"{weighed.fault.name} ({size_text(self.model, weighed)})")
        if others:
            answer += f"; so would {listed(others, str)}"
        if self.excluded:
            answer += f"; excluded: {listed((weighed.fault.name for weighed in self.excluded), str)}"
        if beyond:
            answer += f"; {len(beyond)} more by sizes beyond the range in training: {listed(beyond, str)}"
        return answer + self._left_over()

    @property
    def beyond(self) -> tuple[str, ...]:
        """The faults that explain, though not the first, only by an actuator farther off than the whole range
        that it had in training.
        """
        others = [weighed.fault for weighed in self.explains[1:] if weighed.fault.kind == "offset"]
        return tuple(fault.name for fault in others if self.shares.get(fault.name, Fraction(0)) > 1)

    def span(self, name: str) -> str:
        """Return the sizes, in words, of a fault that explains some of the windows alone."""
        least, _ = self.ends[name]
        return size_text(self.model, replace(least, largest=self._largest_of_part(name), tried=0))

    def _largest_of_part(self, name: str) -> Fraction | None:
        """Return the largest size of a fault that explains some of the windows alone; None: without end."""
        most = self.ends[name][1]
        if most.tried:  # of a parameter the smallest sizes are known
            return most.size
        return most.largest

    def _partly(self) -> str:
        counts = []
        for name, windows in self.partly.items():
            counts.append(f"{name} {len(windows)} ({self.span(name)})")
        if not counts:
            return ""
        return f" in all {len(self.windows)} windows that were looked at; of these {listed(counts, str)}"

    def _left_over(self) -> str:
        rest = ""
        if self.unweighed:
            whys = [f"{name} ({why})" for name, why in self.unweighed.items()]
            rest = f"; left open: {listed(whys, str)}"
        if self.outside:
            rest += f"; sizes and exclusions rest on extrapolation, {self.outside}"
        return rest

    def _head(self) -> str:
        return f"{type(self).__name__} of {len(self.windows)} of {self.of} windows"

    def _rows(self) -> dict[str, str]:
        return {name: words for name, words, _ in self.lines}

    def to_dict(self) -> dict[str, Any]:
        """Return the diagnosis ready for JSON; sizes as floats, `sizes` has them exactly."""
        explains, excluded = [], []
        for weighed in self.explains:
            name = weighed.fault.name
            entry: dict[str, Any] = {"fault": name, "size": _float(weighed.size)}
            entry |= {"largest": _float(weighed.largest), "words": size_text(self.model, weighed)}
            entry["share"] = _float(self.shares.get(name))
            if weighed.tried:
                entry["tried"] = weighed.tried
            explains.append(entry)
        for weighed in self.excluded:
            excluded.append({"fault": weighed.fault.name, "why": why_excluded(self.model, weighed)})
        sizes = {}
        for name, (least, _) in self.ends.items():
            sizes[name] = [_float(least.size), _float(self._largest_of_part(name))]
        return {
            "answer": str(self),
            "windows": list(self.windows),
            "of": self.of,
            "explains": explains,
            "beyond_range": list(self.beyond),
            "excluded": excluded,
            "not_weighed": dict(self.unweighed),
            "partly": {name: list(windows) for name, windows in self.partly.items()},
            "partly_sizes": sizes,
            "outside": self.outside,
        }

    def and_of(self, other: Diagnosis) -> Diagnosis:
        """Return the Diagnosis of the windows of both: a fault has to explain each of them, of one sign."""
        explains, excluded = [], {weighed.fault.name: weighed for weighed in self.excluded}
        excluded |= {weighed.fault.name: weighed for weighed in other.excluded}
        theirs = {weighed.fault.name: weighed for weighed in other.explains}
        unweighed = {**self.unweighed, **other.unweighed}
        for weighed in self.explains:
            name = weighed.fault.name
            if name not in theirs:
                continue
            one, two = weighed.size or Fraction(0), theirs[name].size or Fraction(0)
            # no one size is of both signs, though each window alone is explained
            if one * two < 0:
                excluded[name] = FaultSize(weighed.fault, None)
            else:
                explains.append(weighed.and_of(theirs[name]))
        shares = {}
        for name in (weighed.fault.name for weighed in explains):
            known = [each.shares[name] for each in (self, other) if name in each.shares]
            # the larger share: a fault is as plausible as in the window that asks most of it
            if known:
                shares[name] = max(known)
        # what is left open in one window is neither excluded nor explained by all
        kept = tuple(w for name, w in excluded.items() if name not in unweighed)
        explains = [weighed for weighed in explains if weighed.fault.name not in unweighed]
        windows = tuple(sorted({*self.windows, *other.windows}))
        ranked = _ranked(explains, shares)
        of, outside = max(self.of, other.of), self.outside or other.outside
        return Diagnosis(self.model, windows, of, ranked, kept, shares, unweighed, outside=outside)


def _float(x: Fraction | None) -> float | None:
    if x is None:
        return None
    return float(x)


def candidates_of(model: LinearSystem) -> tuple[NamedFault, ...]:
    """Return the faults that a model names; a bias of every sensor and an offset of every actuator where it
    names none.
    """
    return model.faults or default_faults(model.inputs, model.outputs)


def diagnose_window(scale: Scale, at: int, faults: Sequence[NamedFault] | None = None) -> Diagnosis:
    """Return the Diagnosis of one FAULT window.

    Args:
        scale: of a window of a certain model. at: the sample at which it ends.
        faults: as of `WindowCertificate.diagnose`.

    Raises:
        ValueError: a fault names a signal that the model does not have.
    """
    window, model = scale.window, scale.window.model
    candidates = candidates_of(model)
    if faults is not None:
        candidates = named_faults(faults, model.inputs, model.outputs, model.states)
    explains, excluded = [], []
    shares, unweighed = {}, {}
    for fault in candidates:
        try:
            weighed = _weighed(scale, fault)
        except NotImplementedError as e:
            unweighed[fault.name] = str(e)
            continue
        if weighed.size is None:
            excluded.append(weighed)
            continue
        explains.append(weighed)
        usual = _usual(fault, window)
        if usual:
            shares[fault.name] = abs(weighed.size) / usual
    ranked = _ranked(explains, shares)
    return Diagnosis(model, (at,), 1, ranked, tuple(excluded), shares, unweighed)


def _weighed(scale: Scale, fault: NamedFault) -> FaultSize:
    """Return the FaultSize of a fault that may begin at any sample of the window.

    Raises:
        NotImplementedError: as `Scale.weigh`, or no size of a parameter was found.
    """
    # from each sample of the window on: one that begins later explains fewer samples
    onsets = range(scale.window.horizon + 1)
    if fault.kind != PARAMETER:
        return scale.weigh(fault, onsets)
    found = found_size(scale.window, fault, onsets)
    if found.size is None:
        raise NotImplementedError(
            f"none of {found.tried} trials of its size, up to {float(fault.most or 0):g}, and of the sample "
            f"since which it holds explains this, which is no proof"
        )
    return found


def _ranked(explains: Sequence[FaultSize], shares: Mapping[str, Fraction]) -> tuple[FaultSize, ...]:
    """Return faults by their shares; those without one before what is larger than usual."""

    def place(weighed: FaultSize) -> Fraction:
        return shares.get(weighed.fault.name, Fraction(1))

    return tuple(sorted(explains, key=place))


def _usual(fault: NamedFault, window: ExactWindow) -> Fraction | None:
    """Return the size that a size of a fault is compared with; None or 0: there is none."""
    model = window.model
    if fault.most is not None:
        return fault.most
    if fault.kind == "gain":
        return Fraction(1)
    span: Fraction | None = None
    if fault.output is not None:
        i = model.outputs.index(fault.output)
        readings = [y for y in window.whole[i :: model.p] if y is not None]
        if readings:
            span = max(readings) - min(readings)
    elif fault.input is not None and fault.input in model.ranges:
        low, high = model.ranges[fault.input]
        span = high - low
    if span and fault.times is not None:
        recorded = window.u[model.inputs.index(fault.times) :: model.m]
        largest = max((abs(x) for x in recorded if x is not None), default=Fraction(0))
        if not largest:
            return None
        span /= largest
    return span


def size_text(model: LinearSystem, weighed: FaultSize) -> str:
    """Return the sizes of a fault that explain a window, with their unit and its signal."""
    fault, size, largest = weighed.fault, weighed.size, weighed.largest
    assert size is not None
    text = amount(model, fault, size)
    if weighed.tried:
        return f"{text} (the smallest found in {weighed.tried} trials)"
    if weighed.varies:
        return f"up to {text}, of no one size"
    if largest is None:
        return f"{text} or more"
    least, most = (amount(model, fault, x).split()[0] for x in (size, largest))
    if least == most:
        return text
    return f"{least} to {amount(model, fault, largest)}"


def amount(model: LinearSystem, fault: NamedFault, size: Fraction) -> str:
    """Return a size of a fault in words, with its unit and its signal."""
    if fault.kind == "gain":
        return f"{100 * float(size):+.3g} % of {fault.signal}"
    unit = fault.unit
    if unit is None:
        unit = model.unit(fault.signal)
    text = f"{float(size):+.3g} {unit}".rstrip()
    if fault.states:
        text += " a sample"
    text += f" of {fault.signal}"
    if fault.times is not None:
        text += f", times {fault.times}"
    return text


def why_excluded(model: LinearSystem, weighed: FaultSize) -> str:
    """Return why a fault does not explain a window, in words."""
    if weighed.beyond is not None:
        needed = amount(model, weighed.fault, weighed.beyond)
        return f"excluded: it would take {needed}, which is beyond what is stated of it"
    return "excluded: no size of it, from no sample on, explains this"
