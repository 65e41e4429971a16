"""A certificate is checked against the claim that model and samples make: exact fractions, the standard
library alone.

Plant x+ = A x + B u + G w + F v, readings y = (1 + theta) (C x + D u + D_v v) + delta, in deviations from the
offsets; v any number, |theta| <= tolerance, w in its bounds, |delta| <= noise + resolution + recorder
(largest |y| of the signal + noise) + floor (+ an error of one sensor). With "factors" the noise of each
sample is times its own.

"averages" bound weighted sums of consecutive deltas of one output, or of one disturbance, in every run of
samples that is looked at; one over several signals names the others "beside" the first. "first_state" bounds
the state of the first sample, as one who gives it to an observer says; without it, it is any. A document with
"constant" has one theta for all samples of an output: one gain 1 / (1 + theta). With uncertain parameters
v_1, v_2, .., each varying one anew at each sample, A is A + sum v_i dA_i, and so B, C, D; |v_i| <= bound_i.

FAULT: multipliers of a relation that holds for every trajectory and that the samples cannot keep; with
uncertain parameters a tree of boxes (`boxes`). CONSISTENT: a trajectory within all bounds. Everything else
that is shown must be what the claim says.
"""

from collections.abc import Sequence
from fractions import Fraction as F
from typing import Any

from jaxbound.certificates.checker.boxes import contradict
from jaxbound.certificates.checker.claim import (
    BOUNDS,
    DOUBLE,
    PRECISIONS,
    SINGLE,
    STATED,
    claimed,
    compare,
    numbers,
    statement,
)
from jaxbound.certificates.checker.sets import decide
from jaxbound.certificates.checker.trajectories import follow, limits, plant_at, runs_of
from jaxbound.certificates.checker.vectors import add, dots
from jaxbound.certificates.checker.words import Claim, Document, Ends, Relation, SensorError, Witness, insist

__all__ = ["confirm"]

ROUNDED = F(101, 100)
"""The error of a sensor that is shown to be enough is at most so many times the smallest."""
WITNESS = {"state", "disturbances", "unknown_inputs", "inputs", "outputs"}
RELATION = {"h", "g", "k", "residual", "width", "factor"}
SENSOR_ERROR = {"output", "smallest", "relation", "enough", "witness"}
MISSING_READING = "the relation needs a reading that is missing"


def confirm(document: Document, names: dict[str, Any] | None = None, claim: Claim | None = None) -> None:
    """Raise an exception unless a certificate proves what it says.

    Args:
        document: the certificate as JSON gives it. names, claim: names and numbers that are claimed, from the
            model and the samples themselves (`claim.claimed`); None: those that the certificate shows, which
            then may be of another plant or another day.

    Raises:
        ArithmeticError, LookupError, TypeError, ValueError: it does not, ValueError says why in a sentence.
    """
    if "question" in document:
        return decide(document)
    fields = {"certificate", "statement", "names", "numbers"}
    insist(set(document) == fields, "a field of the certificate is missing or unknown")
    verdict = document["certificate"]
    insist(verdict in ("FAULT", "CONSISTENT"), "it proves neither FAULT nor CONSISTENT")

    # 1. It is about this model and these samples, and says so.
    every: list[F] = []
    c = numbers(document["numbers"], every)
    if claim is None:
        claim = _shown(c)
    compare(c, claim)
    if names is not None:
        _compare_names(document["names"], names)
    sentence = statement(verdict, document["names"], claim)
    insist(document["statement"] == sentence, f"the statement must be: {sentence}")
    insist(sum(every) == 2 * c["sum"], "the numbers do not add up: one was changed")  # the sum is one of them

    # 2. The rest of its numbers prove the verdict.
    proof = {name: value for name, value in c.items() if name not in claim and name != "sum"}
    fault = verdict == "FAULT"
    insist((proof["witness"] is None) == fault, "a CONSISTENT shows a witness, a FAULT shows none")
    if "uncertainties" in claim:
        _uncertain(claim, proof, fault)
    else:
        _certain(claim, proof, fault)


def _shown(c: Document) -> Claim:
    """Return the claim that the shown model and samples make."""
    model = {name: c[name] for name in (*STATED, *BOUNDS)}
    model["averages"] = c.get("averages", [])
    model["constant"] = "constant" in c
    model["uncertainties"] = c.get("uncertainties", [])
    precision = DOUBLE
    if c["floor"] == PRECISIONS[SINGLE][1]:
        precision = SINGLE
    every_y = c["y"]
    if "all_y" in c:
        every_y = c["all_y"]
    first, factors = c.get("first_state"), c.get("factors")
    return claimed(model, c["u"], every_y, precision, c.get("lags"), first, factors)


def _compare_names(shown: dict[str, Any], names: dict[str, Any]) -> None:
    insist(set(shown) == set(names), "a name of the certificate is missing or unknown")
    for name, value in names.items():
        same = type(shown[name]) is type(value) and shown[name] == value
        insist(
            same,
            f"the certificate is about something else: names.{name} is {shown[name]}, model and data say "
            f"{value}",
        )


def _certain(c: Claim, proof: Document, fault: bool) -> None:
    """Check the proof of a verdict on a model without uncertain parameters."""
    insist(set(proof) == {"witness", "relation", "errors"}, "a number of the proof is missing or unknown")
    insist(not (fault and proof["relation"] is None), "a FAULT needs a relation")
    if proof["relation"] is not None:
        insist((_factor(c, proof["relation"]) > 1) == fault, "the relation does not prove the verdict")
    if not fault:
        insist(not proof["errors"], "a CONSISTENT says nothing of errors of sensors")
        _explain(c, proof["witness"])
    outputs = [e["output"] for e in proof["errors"]]
    each_once = outputs == sorted(set(outputs)) and set(outputs) <= set(range(len(c["noise"])))
    insist(each_once, "an output is named twice or unknown")
    for e in proof["errors"]:
        _sensor_error(c, e)


def _sensor_error(c: Claim, e: SensorError) -> None:
    """Check the smallest error of one sensor that would explain the window, None where none does.

    A relation with factor 1 at that error has a larger one at any smaller error. It proves that none smaller
    is enough; a witness proves that `enough` is. A violated relation without the sensor has the same factor
    at any error.
    """
    insist(set(e) == SENSOR_ERROR, "a number of a sensor's error is missing or unknown")
    i = int(e["output"])
    used = _uses(c, e["relation"], i)
    if e["smallest"] is None:
        excluded = not used and _factor(c, e["relation"]) > 1
        insist(excluded, "an error of this sensor might explain the window")
        insist(e["enough"] is None and e["witness"] is None, "an error of this sensor cannot be enough")
        return
    insist(used, "the relation does not use this sensor")
    insist(_factor(c, e["relation"], (i, e["smallest"])) == 1, "a smaller error would explain the window")
    if e["enough"] is None or e["witness"] is None:
        raise ValueError("the error that is enough, or what it explains, is missing")
    close = 0 < e["smallest"] <= e["enough"] <= ROUNDED * e["smallest"]
    insist(close, "the error that is enough is not the smallest, rounded up")
    _explain(c, e["witness"], (i, e["enough"]))


def _uses(c: Claim, r: Relation, i: int) -> bool:
    """Return whether a relation has samples of output i, alone or in a sum."""
    if any(row[i] for row in r["h"]):
        return True
    for run in runs_of(c, r.get("a")):
        if run.multiplier and any(measured and number == i for measured, _, number, _ in run.terms):
            return True
    return False


def _uncertain(c: Claim, proof: Document, fault: bool) -> None:
    """Check the proof of a verdict on a model with uncertain parameters."""
    expected = {"witness", "relations", "proof", "parameters"}
    insist(set(proof) == expected, "a number of the proof is missing or unknown")
    if fault:
        insist(proof["parameters"] is None, "a FAULT shows no parameters")
        contradict(c, proof["relations"], proof["proof"])
        return
    insist(not proof["relations"] and proof["proof"] is None, "a CONSISTENT shows no relations")
    _parameters_kept(c, proof["parameters"])
    _explain(c, proof["witness"], v=proof["parameters"])


def _factor(c: Claim, r: Relation, error: tuple[int, F] | None = None) -> F:
    """Check that a relation holds for every trajectory; return the factor on all bounds at which the samples
    can keep it.

    For every trajectory h t + g w + a S + x x_0 = k u. What samples and bounds allow of t, w, the sums S and
    x_0 puts the left side less k u into [low, high] = residual -+ width, where 0 is if and only if
    |residual| <= width. A factor above 1 is a FAULT: no trajectory keeps the samples.
    """
    optional = {"a": "runs", "x": "first_state"}
    allowed = RELATION | {name for name, field in optional.items() if field in c}
    insist(set(r) <= allowed, "a number of the relation is unknown")
    follow(c, _written_out(c, r), [])

    parts = [_readings_range(c, r, error)]  # h t
    samples = limits(c, error)
    for g, k, u, (_, w) in zip(r["g"], r["k"], c["u"], samples, strict=True):
        parts.append(_range(g, w, "the relation needs a disturbance without bounds"))  # g w
        known = _known_inputs(c, k, u)  # k u
        parts.append((-known, -known))
    for run in runs_of(c, r.get("a"), error):
        missing = "an average needs a reading that is missing, or is not looked at"
        parts.append(_range([run.multiplier], [run.ends], missing))  # a S
    first = [(lo, hi) for lo, hi in c.get("first_state", [])]
    parts.append(_range(r.get("x", []), first, "the first state has no bounds"))  # x x_0

    low, high = add(*parts)
    residual, width = (low + high) / 2, (high - low) / 2
    stated = [r["residual"], r["width"], r["factor"]]
    insist([residual, width, abs(residual) / width] == stated, "residual, width or factor is wrong")
    return r["factor"]


def _range(multipliers: Sequence[F], ends: Sequence[Ends | None], missing: str) -> Ends:
    """Return (lowest, highest) of sum_i x_i t_i over lo_i <= t_i <= hi_i: both ends by themselves in each.

    Raises: ValueError: `missing`, where something is multiplied that has no ends.
    """
    low = high = F(0)
    for x, pair in zip(multipliers, ends, strict=True):
        if not x:
            continue
        if pair is None:
            raise ValueError(missing)
        lo, hi = pair
        low, high = low + min(x * lo, x * hi), high + max(x * lo, x * hi)
    return low, high


def _known_inputs(c: Claim, k: Sequence[F], u: Sequence[F | None]) -> F:
    """Return k u of one sample, u in deviations from its offsets."""
    total = F(0)
    for x, value, offset in zip(k, u, c["offset_u"], strict=True):
        if not x:
            continue
        if value is None:
            raise ValueError("the relation needs an input that is missing")
        total += x * (value - offset)
    return total


def _readings_range(c: Claim, r: Relation, error: tuple[int, F] | None) -> Ends:
    """Return (lowest, highest) sum of a relation's multipliers times true outputs that the readings allow.

    With one gain over the window, readings of an output go to their ends together: the sum is linear in the
    gain, so it is extreme at one of its ends.
    """
    low = high = F(0)
    if "constant" not in c:
        for h, (readings, _) in zip(r["h"], limits(c, error), strict=True):
            lo, hi = _range(h, readings, MISSING_READING)
            low, high = low + lo, high + hi
        return low, high
    for i, tolerance in enumerate(c["tolerance"]):
        least = _range_of_output(c, r, i, 1 / (1 + tolerance), error)
        most = _range_of_output(c, r, i, 1 / (1 - tolerance), error)
        low, high = low + min(least[0], most[0]), high + max(least[1], most[1])
    return low, high


def _range_of_output(c: Claim, r: Relation, i: int, gain: F, error: tuple[int, F] | None) -> Ends:
    """Return (lowest, highest) sum over the samples of output i at one gain 1 / (1 + theta)."""
    samples = limits(c, error, [gain] * len(c["tolerance"]))
    multipliers = [h[i] for h in r["h"]]
    ends = [readings[i] for readings, _ in samples]
    return _range(multipliers, ends, MISSING_READING)


def _written_out(c: Claim, r: Relation) -> Relation:
    """Return a relation with its averages written out as the samples that they combine."""
    h, g = [list(row) for row in r["h"]], [list(row) for row in r["g"]]
    for x, terms, _ in runs_of(c, r.get("a")):
        if not x:
            continue
        insist(bool(terms), "an average is not looked at")
        for measured, j, number, weight in terms:
            if measured:
                h[j][number] += x * weight
            else:
                g[j][number] += x * weight
    out: Relation = {"h": h, "g": g, "k": r["k"]}
    if "x" in r:
        out["x"] = r["x"]
    return out


def _explain(c: Claim, witness: Witness, error: tuple[int, F] | None = None, v: Sequence[F] = ()) -> None:
    """Check that the witness is a trajectory with every reading, input and disturbance within its bounds."""
    expected, gains = WITNESS, None
    if "constant" in c:
        expected, gains = WITNESS | {"gains"}, witness.get("gains")
        insist(bool(gains), "one gain of each output is missing")
    insist(set(witness) == expected, "a number of the witness is missing or unknown")
    _first_state_kept(c, witness["state"])
    if gains is not None:
        _gains_kept(c, gains)
    samples = zip(
        c["u"],
        limits(c, error, gains),
        witness["inputs"],
        witness["disturbances"],
        witness["unknown_inputs"],
        witness["outputs"],
        strict=True,
    )
    x = witness["state"]
    for j, (recorded, (readings, bounds), inputs, w, free, outputs) in enumerate(samples):
        for known, value in zip(recorded, inputs, strict=True):
            insist(known is None or known == value, "the inputs are not those recorded")
        A, B, C, D = plant_at(c, j, v)
        u = [value - offset for value, offset in zip(inputs, c["offset_u"], strict=True)]
        t = add(dots(C, x), dots(D, u), dots(c["D_v"], free))  # t = C x + D u + D_v v
        insist(add(t, c["offset_y"]) == outputs, "the true outputs do not follow from the first state")
        for value, ends in zip([*t, *w], [*readings, *bounds], strict=True):
            kept = ends is None or ends[0] <= value <= ends[1]
            insist(kept, "a reading or a disturbance is out of its bounds")
        x = add(dots(A, x), dots(B, u), dots(c["G"], w), dots(c["F"], free))  # x+ = A x + B u + G w + F v
    _averages_kept(c, witness, error)


def _parameters_kept(c: Claim, v: Sequence[F]) -> None:
    for x, (number, _) in zip(v, c["variables"], strict=True):
        insist(abs(x) <= c["uncertainties"][int(number)]["bound"], "a parameter is out of its bounds")


def _first_state_kept(c: Claim, state: Sequence[F]) -> None:
    if "first_state" not in c:
        return  # it may be any
    for value, (lo, hi) in zip(state, c["first_state"], strict=True):
        insist(lo <= value <= hi, "the first state is out of its bounds")


def _gains_kept(c: Claim, gains: Sequence[F]) -> None:
    for gain, tolerance in zip(gains, c["tolerance"], strict=True):
        insist(1 / (1 + tolerance) <= gain <= 1 / (1 - tolerance), "a gain is out of its bounds")


def _averages_kept(c: Claim, witness: Witness, error: tuple[int, F] | None) -> None:
    for _, terms, ends in runs_of(c, None, error):
        if ends is None:
            continue
        total = F(0)
        for measured, j, i, weight in terms:
            if measured:
                total += weight * (witness["outputs"][j][i] - c["offset_y"][i])
            else:
                total += weight * witness["disturbances"][j][i]
        insist(ends[0] <= total <= ends[1], "an average is out of its bound")
