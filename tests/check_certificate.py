"""Re-check exported certificates in exact rationals, with the standard library alone: python check_certificate.py FILE.json...

Plant x+ = A x + B u + G w + F v, readings y = (1 + theta) (C x + D u + D_v v) + delta, in deviations from the offsets; v any number,
|theta| <= tolerance, w in its bounds, |delta| <= noise + resolution + recorder (largest |y| of the signal + noise) + floor (+ an error of
one sensor).
"""

import json
import sys
from fractions import Fraction as F


def confirm(document):
    """Raise an exception unless the certificate proves what it says."""
    c, fault = numbers(document["numbers"], seen := []), {"FAULT": True, "CONSISTENT": False}[document["certificate"]]
    insist(sum(seen) == 2 * c["sum"], "the numbers do not add up: one was changed")
    if fault or c["relation"]:
        insist((factor(c, c["relation"]) > 1) == fault, "the relation does not prove the verdict")
    if not fault:
        explain(c, c["witness"])
    for e in c["errors"]:
        i, unused = int(e["output"]), not any(h[int(e["output"])] for h in e["relation"]["h"])
        if e["smallest"] is None:
            insist(unused and factor(c, e["relation"]) > 1, "an error of this sensor might explain the window")
        else:
            insist(not unused and factor(c, e["relation"], (i, e["smallest"])) == 1, "a smaller error would explain the window")
            insist(e["enough"] >= e["smallest"], "the error that is enough is too small")
            explain(c, e["witness"], (i, e["enough"]))


def factor(c, r, error=None):
    """Check that sum h y + g w - k u = 0 for every trajectory; return the factor on all bounds at which it can hold."""
    q = [F(0)] * len(c["A"])  # how the samples later than j depend on the state after j
    for h, g, k in reversed(list(zip(r["h"], r["g"], r["k"], strict=True))):
        insist(not any(add(dots(turned(c["G"]), q), g)), "the relation leaves a disturbance over")
        insist(not any(add(dots(turned(c["D_v"]), h), dots(turned(c["F"]), q))), "the relation leaves an unknown input over")
        insist(add(dots(turned(c["D"]), h), dots(turned(c["B"]), q)) == k, "the relation does not fit the inputs")
        q = add(dots(turned(c["C"]), h), dots(turned(c["A"]), q))
    insist(not any(q), "the relation leaves the unknown state over")
    residual = width = F(0)
    for h, g, k, u, (readings, w) in zip(r["h"], r["g"], r["k"], c["u"], limits(c, error), strict=True):
        for x, (lo, hi) in [(x, ends) for x, ends in zip(h + g, readings + w, strict=True) if x]:
            residual, width = residual + x * (lo + hi) / 2, width + abs(x) * (hi - lo) / 2
        residual -= sum(x * (v - offset) for x, v, offset in zip(k, u, c["offset_u"], strict=True) if x)
    insist([residual, width, abs(residual) / width] == [r["residual"], r["width"], r["factor"]], "residual, width or factor is wrong")
    return r["factor"]


def explain(c, witness, error=None):
    """Check that the witness is a trajectory with every reading, input and disturbance within its bounds."""
    names, x = ("inputs", "disturbances", "unknown_inputs", "outputs"), witness["state"]
    for recorded, (readings, bounds), u, w, v, y in zip(c["u"], limits(c, error), *(witness[name] for name in names), strict=True):
        insist(all(a is None or a == b for a, b in zip(recorded, u, strict=True)), "the inputs are not those recorded")
        u = [a - offset for a, offset in zip(u, c["offset_u"], strict=True)]
        t = add(add(dots(c["C"], x), dots(c["D"], u)), dots(c["D_v"], v))
        insist(add(t, c["offset_y"]) == y, "the true outputs do not follow from the first state")
        inside = all(b is None or b[0] <= a <= b[1] for a, b in zip(t + w, readings + bounds, strict=True))
        insist(inside, "a reading or a disturbance is out of its bounds")
        x = add(add(dots(c["A"], x), dots(c["B"], u)), add(dots(c["G"], w), dots(c["F"], v)))


def limits(c, error):
    """Return for each time ([lo, hi] of the true value behind each reading, None where it is missing; [lo, hi] of each disturbance)."""
    out = []
    for row in c["y"]:
        readings = []
        for i, (y, noise) in enumerate(zip(row, c["noise"], strict=True)):
            largest = max([abs(other[i]) for other in c["y"] if other[i] is not None], default=F(0))
            delta = (
                noise + c["resolution"][i] + c["recorder"] * (largest + noise) + c["floor"] + (error[1] if error and error[0] == i else 0)
            )
            ends = lambda d, i=i: [d / (1 - c["tolerance"][i]), d / (1 + c["tolerance"][i])]
            d = None if y is None else y - c["offset_y"][i]
            readings.append(None if y is None else (min(ends(d - delta)), max(ends(d + delta))))
        out.append((readings, [(lo - c["floor"], hi + c["floor"]) for lo, hi in c["disturbance"]]))
    return out


def dots(rows, vector):
    return [sum((a * b for a, b in zip(row, vector, strict=True)), F(0)) for row in rows]


def turned(matrix):
    return zip(*matrix, strict=True)


def add(a, b):
    return [x + y for x, y in zip(a, b, strict=True)]


def numbers(tree, seen):
    if isinstance(tree, (dict, list)):
        branches = [(k, numbers(v, seen)) for k, v in (tree.items() if isinstance(tree, dict) else enumerate(tree))]
        return dict(branches) if isinstance(tree, dict) else [v for _, v in branches]
    seen += [F(tree)] if tree is not None else []
    return None if tree is None else seen[-1]


def insist(true, reason):
    if not true:
        raise ValueError(reason)


if __name__ == "__main__":
    for name in sys.argv[1:]:
        with open(name, encoding="utf-8") as file:
            document = json.load(file)
        try:
            confirm(document)
        except (ArithmeticError, LookupError, TypeError, ValueError) as e:
            sys.exit(f"{name}: NOT confirmed: {e}")
        print(f"{name}: confirmed: {document['certificate']}. {document['statement']}")
