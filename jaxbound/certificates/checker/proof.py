"""A certificate is checked against the claim that model and samples make: exact fractions, the standard
library alone.

Plant x+ = A x + B u + G w + F v, readings y = (1 + theta) (C x + D u + D_v v) + delta, in deviations from the
offsets; v any number, |theta| <= tolerance, w in its bounds, |delta| <= noise + resolution + recorder
(largest |y| of the signal + noise) + floor (+ an error of one sensor). With "factors" the noise of each
sample is times its own.

"averages" bound weighted sums of consecutive deltas of one output, or of one disturbance, in every run of
samples that is looked at, times the mean of the factors there, by weight; one over several signals names the
others "beside" the first. "first_state" bounds the state of the first sample, as one who gives it to an
observer says; without it, it is any. A document with "constant" has one theta for all samples of an output:
one gain 1 / (1 + theta). With uncertain parameters v_1, v_2, .., each varying one anew at each sample, A is
A + sum v_i dA_i, and so B, C, D; |v_i| <= bound_i.

FAULT: multipliers of a relation that holds for every trajectory and that the samples cannot keep; with
uncertain parameters a tree of boxes (`boxes`). CONSISTENT: a trajectory within all bounds. Everything else
that is shown must be what the claim says.
"""

from collections.abc import Sequence
from fractions import Fraction as F
from typing import Any

from jaxbound.certificates.checker.boxes import contradict, relation_range
from jaxbound.certificates.checker.claim import checksum, compare, numbers, statement
from jaxbound.certificates.checker.trajectories import Error, behaviour, limits, runs_of
from jaxbound.certificates.checker.words import Document, insist

ROUNDED = F(101, 100)
"""The error of a sensor that is shown to be enough is at most so many times the smallest."""
WITNESS = {"state", "disturbances", "unknown_inputs", "inputs", "outputs"}
RELATION = {"h", "g", "k", "residual", "width", "factor"}
SENSOR_ERROR = {"output", "smallest", "relation", "enough", "witness"}


def confirm(document: Document, names: dict[str, Any], claim: Document) -> None:
    """Raise an exception unless a certificate of a window proves what it says.

    Args:
        document: the certificate as JSON gives it. names, claim: names and numbers that are claimed, from the
            model and the samples themselves (`claim.claim_of`).

    Raises:
        ArithmeticError, LookupError, TypeError, ValueError: it does not, ValueError says why in a sentence.
    """
    fields = {"certificate", "statement", "names", "numbers"}
    insist(set(document) == fields, "a field of the certificate is missing or unknown")
    verdict = document["certificate"]
    insist(verdict in ("FAULT", "CONSISTENT"), "it proves neither FAULT nor CONSISTENT")

    # 1. It is about this model and these samples, and says so.
    every: list[F] = []
    c = numbers(document["numbers"], every)
    compare(c, claim)
    compare(document["names"], names, "names")
    sentence = statement(verdict, document["names"], claim)
    insist(document["statement"] == sentence, f"the statement must be: {sentence}")
    adds_up = checksum(every) == checksum([2 * c["sum"]])  # the sum is one of them
    insist(adds_up, "the numbers do not add up: one was changed")

    # 2. The rest of its numbers prove the verdict.
    proof = {name: value for name, value in c.items() if name not in claim and name != "sum"}
    fault = verdict == "FAULT"
    insist((proof["witness"] is None) == fault, "a CONSISTENT shows a witness, a FAULT shows none")
    if "uncertainties" in claim:
        _uncertain(claim, proof, fault)
    else:
        _certain(claim, proof, fault)


def _certain(c: Document, proof: Document, fault: bool) -> None:
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


def _sensor_error(c: Document, e: Document) -> None:
    """Check the smallest error of one sensor that would explain the window, None where none does.

    A relation with factor 1 at that error has a larger one at any smaller error. It proves that none smaller
    is enough; a witness proves that `enough` is. A violated relation without the sensor has the same factor
    at any error.
    """
    insist(set(e) == SENSOR_ERROR, "a number of a sensor's error is missing or unknown")
    i = int(e["output"])
    used = _uses(c, e["relation"], i)
    if e["smallest"] is None:
        # the relation holds whatever this sensor shows, so no error of it helps
        excluded = not used and _factor(c, e["relation"]) > 1
        insist(excluded, "an error of this sensor might explain the window")
        insist(e["enough"] is None and e["witness"] is None, "an error of this sensor cannot be enough")
        return
    insist(used, "the relation does not use this sensor")
    insist(_factor(c, e["relation"], (i, e["smallest"])) == 1, "a smaller error would explain the window")
    # rounded up so that a witness has short numbers; far more would claim nothing
    close = 0 < e["smallest"] <= e["enough"] <= ROUNDED * e["smallest"]
    insist(close, "the error that is enough is not the smallest, rounded up")
    _explain(c, e["witness"], (i, e["enough"]))


def _uses(c: Document, r: Document, i: int) -> bool:
    """Return whether a relation has samples of output i, alone or in a sum."""
    used = any(row[i] for row in r["h"])
    for x, terms in zip(r.get("a", []), runs_of(c), strict=False):
        used |= bool(x) and any(measured and number == i for measured, _, number, _ in terms)
    return used


def _uncertain(c: Document, proof: Document, fault: bool) -> None:
    """Check the proof of a verdict on a model with uncertain parameters."""
    expected = {"witness", "relations", "proof", "parameters"}
    insist(set(proof) == expected, "a number of the proof is missing or unknown")
    if fault:
        insist(proof["parameters"] is None, "a FAULT shows no parameters")
        contradict(c, proof["relations"], proof["proof"])
        return
    insist(not proof["relations"] and proof["proof"] is None, "a CONSISTENT shows no relations")
    insist(len(proof["parameters"]) == len(c["variables"]), "a parameter is missing or unknown")
    _explain(c, proof["witness"], v=proof["parameters"])


def _factor(c: Document, r: Document, error: Error = None) -> F:
    """Check that a relation holds for every trajectory; return the factor on all bounds at which the samples
    can keep it.

    The samples hold it if 0 lies in [low, high] = residual -+ width, that is if |residual| <= width. A factor
    above 1 is a FAULT: no trajectory keeps the samples.
    """
    optional = {"a": "runs", "x": "first_state"}
    allowed = RELATION | {name for name, field in optional.items() if field in c}
    insist(set(r) <= allowed, "a number of the relation is unknown")
    low, high = relation_range(c, r, error)
    residual, width = (low + high) / 2, (high - low) / 2
    stated = [r["residual"], r["width"], r["factor"]]
    insist([residual, width, abs(residual) / width] == stated, "residual, width or factor is wrong")
    return abs(residual) / width


def _explain(c: Document, witness: Document, error: Error = None, v: Sequence[F] = ()) -> None:
    """Check that the witness is a trajectory with every reading, input and disturbance within its bounds."""
    expected = WITNESS
    if "constant" in c:
        expected = WITNESS | {"gains"}
        insist(bool(witness.get("gains")), "one gain of each output is missing")
    insist(set(witness) == expected, "a number of the witness is missing or unknown")
    insist(len(witness["inputs"]) == len(c["u"]), "the witness has another number of samples")
    values = behaviour(c, witness, v)
    for j, (recorded, inputs, outputs) in enumerate(
        zip(c["u"], witness["inputs"], witness["outputs"], strict=True)
    ):
        for known, value in zip(recorded, inputs, strict=True):
            insist(known is None or known == value, "the inputs are not those recorded")
        true = [values[f"y{j}_{i}"] + offset for i, offset in enumerate(c["offset_y"])]
        insist(true == outputs, "the true outputs do not follow from the first state")
        insist(len(witness["disturbances"][j]) == len(c["disturbance"]), "a disturbance is unknown")
    for name, (lo, hi) in limits(c, error).items():
        gain = F(1)
        if "constant" in c and name[0] == "y":
            gain = values["g" + name.split("_")[1]]
        insist(gain * lo <= values[name] <= gain * hi, f"{name} is out of its bounds")
