"""Whether a certificate proves what model and samples make it claim: exact fractions, the standard library
alone.

Plant x+ = A x + B u + G w + F v, readings y = (1 + theta) (C x + D u + D_v v) + delta, in deviations from the
offsets; v any number, |theta| <= tolerance, w in its bounds, |delta| <= noise + resolution + recorder
(largest |y| of the signal + noise) + floor (+ an error of one sensor).

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
    DOUBLE,
    PRECISIONS,
    SINGLE,
    claimed,
    compare,
    numbers,
    statement,
)
from jaxbound.certificates.checker.sets import decide
from jaxbound.certificates.checker.trajectories import add, dots, follow, insist, limits, now, runs_of

__all__ = ["confirm"]

ROUNDED = F(101, 100)
"""The error of a sensor that is shown to be enough is at most so many times the smallest."""
WITNESS = {"state", "disturbances", "unknown_inputs", "inputs", "outputs"}
RELATION = {"h", "g", "k", "residual", "width", "factor"}
SENSOR_ERROR = {"output", "smallest", "relation", "enough", "witness"}


def confirm(
    document: dict[str, Any], names: dict[str, Any] | None = None, claim: dict[str, Any] | None = None
) -> None:
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
    insist(
        set(document) == {"certificate", "statement", "names", "numbers"},
        "a field of the certificate is missing or unknown",
    )
    verdict = document["certificate"]
    insist(verdict in ("FAULT", "CONSISTENT"), "it proves neither FAULT nor CONSISTENT")
    seen: list[F] = []
    c = numbers(document["numbers"], seen)
    claim = _shown(c) if claim is None else claim
    compare(c, claim)
    if names is not None:
        _compare_names(document["names"], names)
    said = statement(verdict, document["names"], claim)
    insist(document["statement"] == said, f"the statement must be: {said}")
    insist(sum(seen) == 2 * c["sum"], "the numbers do not add up: one was changed")
    proof = {name: value for name, value in c.items() if name not in claim and name != "sum"}
    fault = verdict == "FAULT"
    insist((proof["witness"] is None) == fault, "a CONSISTENT shows a witness, a FAULT shows none")
    if "uncertainties" in claim:
        _uncertain(claim, proof, fault)
    else:
        _certain(claim, proof, fault)


def _shown(c):
    """Return the claim that the shown model and samples make."""
    names = (
        "A",
        "B",
        "C",
        "D",
        "G",
        "F",
        "D_v",
        "offset_u",
        "offset_y",
        "tolerance",
        "noise",
        "resolution",
        "disturbance",
    )
    model = {name: c[name] for name in names}
    model |= {
        "averages": c.get("averages", []),
        "constant": "constant" in c,
        "uncertainties": c.get("uncertainties", []),
    }
    precision = SINGLE if c["floor"] == PRECISIONS[SINGLE][1] else DOUBLE
    return claimed(model, c["u"], c.get("all_y", c["y"]), precision, c.get("lags"), c.get("first_state"))


def _compare_names(shown, names):
    insist(set(shown) == set(names), "a name of the certificate is missing or unknown")
    for name, value in names.items():
        same = type(shown[name]) is type(value) and shown[name] == value
        insist(
            same,
            f"the certificate is about something else: names.{name} is {shown[name]}, model and data say "
            f"{value}",
        )


def _certain(c, proof, fault):
    insist(set(proof) == {"witness", "relation", "errors"}, "a number of the proof is missing or unknown")
    insist(not (fault and proof["relation"] is None), "a FAULT needs a relation")
    if proof["relation"] is not None:
        insist((_factor(c, proof["relation"]) > 1) == fault, "the relation does not prove the verdict")
    if not fault:
        insist(not proof["errors"], "a CONSISTENT says nothing of errors of sensors")
        _explain(c, proof["witness"])
    outputs = [e["output"] for e in proof["errors"]]
    insist(
        outputs == sorted(set(outputs)) and set(outputs) <= set(range(len(c["noise"]))),
        "an output is named twice or unknown",
    )
    for e in proof["errors"]:
        _sensor_error(c, e)


def _sensor_error(c, e):
    """Check the smallest error of one sensor that would explain the window, None where none does."""
    insist(set(e) == SENSOR_ERROR, "a number of a sensor's error is missing or unknown")
    i = int(e["output"])
    multipliers = [row[i] for row in e["relation"]["h"]]
    for run in runs_of(c, e["relation"].get("a")):
        if any(measured and number == i for measured, _, number, _ in run.terms):
            multipliers.append(run.multiplier)
    if e["smallest"] is None:
        insist(
            not any(multipliers) and _factor(c, e["relation"]) > 1,
            "an error of this sensor might explain the window",
        )
        insist(e["enough"] is None and e["witness"] is None, "an error of this sensor cannot be enough")
        return
    insist(any(multipliers), "the relation does not use this sensor")
    insist(_factor(c, e["relation"], (i, e["smallest"])) == 1, "a smaller error would explain the window")
    insist(
        0 < e["smallest"] <= e["enough"] <= ROUNDED * e["smallest"],
        "the error that is enough is not the smallest, rounded up",
    )
    _explain(c, e["witness"], (i, e["enough"]))


def _uncertain(c, proof, fault):
    expected = {"witness", "relations", "proof", "parameters"}
    insist(set(proof) == expected, "a number of the proof is missing or unknown")
    if fault:
        insist(proof["parameters"] is None, "a FAULT shows no parameters")
        contradict(c, proof["relations"], proof["proof"])
    else:
        insist(not proof["relations"] and proof["proof"] is None, "a CONSISTENT shows no relations")
        _explain(c, proof["witness"], v=proof["parameters"])


def _factor(c, r, error=None):
    """Check that a relation holds for every trajectory; return the factor on all bounds at which the samples
    can keep it.
    """
    allowed = RELATION | {name for name, there in (("a", "runs"), ("x", "first_state")) if there in c}
    insist(set(r) <= allowed, "a number of the relation is unknown")
    follow(c, _single(c, r), [])
    low, high = _readings_range(c, r, error)
    parts: list[tuple] = []
    samples = limits(c, error)
    for g, k, u, (_, w) in zip(r["g"], r["k"], c["u"], samples, strict=True):
        parts += zip(g, w, strict=True)
        for x, value, offset in zip(k, u, c["offset_u"], strict=True):
            insist(not x or value is not None, "the relation needs an input that is missing")
            if x:
                low, high = low - x * (value - offset), high - x * (value - offset)
    for x, _, ends in runs_of(c, r.get("a"), error):
        insist(not x or ends is not None, "an average needs a reading that is missing, or is not looked at")
        parts.append((x, ends))
    parts += zip(r.get("x", []), c.get("first_state", []), strict=True)
    for x, ends in parts:
        if x:
            low, high = low + min(x * end for end in ends), high + max(x * end for end in ends)
    residual, width = (low + high) / 2, (high - low) / 2
    insist(
        [residual, width, abs(residual) / width] == [r["residual"], r["width"], r["factor"]],
        "residual, width or factor is wrong",
    )
    return r["factor"]


def _readings_range(c, r, error):
    """Return (lowest, highest) sum of a relation's multipliers times true outputs that the readings allow."""
    low, high = F(0), F(0)
    if "constant" not in c:
        for h, (readings, _) in zip(r["h"], limits(c, error), strict=True):
            for x, ends in zip(h, readings, strict=True):
                insist(not x or ends is not None, "the relation needs a reading that is missing")
                if x:
                    low, high = low + min(x * end for end in ends), high + max(x * end for end in ends)
        return low, high
    for i in range(len(c["tolerance"])):
        own = [
            _own_range(c, r, i, 1 + sign * c["tolerance"][i], error) for sign in (1, -1)
        ]  # extreme at the ends of the gain
        low, high = low + min(a for a, _ in own), high + max(b for _, b in own)
    return low, high


def _own_range(c, r, i, theta, error):
    """Return (lowest, highest) sum over the readings of output i at one gain 1 / theta."""
    low, high = F(0), F(0)
    gains = [1 / theta] * len(c["tolerance"])
    for h, (readings, _) in zip(r["h"], limits(c, error, gains), strict=True):
        insist(not h[i] or readings[i] is not None, "the relation needs a reading that is missing")
        if h[i]:
            low, high = (
                low + min(h[i] * end for end in readings[i]),
                high + max(h[i] * end for end in readings[i]),
            )
    return low, high


def _single(c, r):
    """Return a relation with its averages written out as the samples that they combine."""
    out = {"h": [list(row) for row in r["h"]], "g": [list(row) for row in r["g"]], "k": r["k"]}
    if "x" in r:
        out["x"] = r["x"]
    for x, terms, _ in runs_of(c, r.get("a")):
        if not x:
            continue
        insist(bool(terms), "an average is not looked at")
        for measured, j, number, weight in terms:
            out["h" if measured else "g"][j][number] += x * weight
    return out


def _explain(c: dict, witness: dict, error: tuple | None = None, v: Sequence[F] = ()) -> None:
    """Check that the witness is a trajectory with every reading, input and disturbance within its bounds."""
    insist(
        set(witness) == (WITNESS | {"gains"} if "constant" in c else WITNESS),
        "a number of the witness is missing or unknown",
    )
    for x, (who, _) in zip(v, c.get("variables", []), strict=True):
        insist(abs(x) <= c["uncertainties"][int(who)]["bound"], "a parameter is out of its bounds")
    state = witness["state"]
    for value, (lo, hi) in zip(state, c.get("first_state", [(at, at) for at in state]), strict=True):
        insist(lo <= value <= hi, "the first state is out of its bounds")
    gains = witness.get("gains")
    for gain, tolerance in zip(gains or [], c["tolerance"] if gains else [], strict=True):
        insist(1 / (1 + tolerance) <= gain <= 1 / (1 - tolerance), "a gain is out of its bounds")
    samples = zip(
        c["u"],
        limits(c, error, gains),
        *(witness[n] for n in ("inputs", "disturbances", "unknown_inputs", "outputs")),
        strict=True,
    )
    for j, (recorded, (readings, bounds), u, w, free, y) in enumerate(samples):
        A, B, C, D = (now(c, letter, j, v) for letter in "ABCD")
        for a, b in zip(recorded, u, strict=True):
            insist(a is None or a == b, "the inputs are not those recorded")
        u = [a - offset for a, offset in zip(u, c["offset_u"], strict=True)]
        t = add(add(dots(C, state), dots(D, u)), dots(c["D_v"], free))
        insist(add(t, c["offset_y"]) == y, "the true outputs do not follow from the first state")
        for a, ends in zip(t + w, readings + bounds, strict=True):
            insist(ends is None or ends[0] <= a <= ends[1], "a reading or a disturbance is out of its bounds")
        state = add(add(dots(A, state), dots(B, u)), add(dots(c["G"], w), dots(c["F"], free)))
    _averages_kept(c, witness, error)


def _averages_kept(c, witness, error):
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
