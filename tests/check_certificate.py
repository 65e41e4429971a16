"""Re-check exported certificates in exact rationals, with the standard library alone: python check_certificate.py FILE.json...

Plant x+ = A x + B u + G w + F v, readings y = (1 + theta) (C x + D u + D_v v) + delta, in deviations from the offsets; v any number,
|theta| <= tolerance, w in its bounds, |delta| <= noise + resolution + recorder (largest |y| of the signal + noise) + floor (+ an error of
one sensor).

"averages" bound weighted sums of consecutive deltas of one output, or of one disturbance, in every run of samples that is listed.

"first_state" bounds the state of the first sample, as one who gives it to an observer says; without it, it is any.

A document with "constant" has one theta for all samples of an output: one gain 1 / (1 + theta).

With uncertain parameters v_1, v_2, .., each varying one anew at each sample, A is A + sum v_i dA_i, and so B, C, D; |v_i| <= bound_i. FAULT
is then a tree of boxes of v, each with a combination of relations, polynomials in v, that cannot be 0 in it; CONSISTENT is parameters with
which the first state explains the samples.

YES or NO to a question about sets {center + generators x : every |x_i| <= 1, constraints x = offsets}: an x, or a combination l of the
equations that no x keeps.
"""

import json
import sys
from fractions import Fraction as F
from itertools import product
from math import prod


def confirm(document):
    """Raise an exception unless the certificate proves what it says."""
    if "question" in document:
        return decide(document)
    c, fault = numbers(document["numbers"], seen := []), {"FAULT": True, "CONSISTENT": False}[document["certificate"]]
    insist(sum(seen) == 2 * c["sum"], "the numbers do not add up: one was changed")
    if "uncertainties" in c:
        for i, parameter in enumerate(c["uncertainties"]):
            lags = range(len(c["y"])) if parameter["varying"] else [None]
            insist(all([i, lag] in c["variables"] for lag in lags), "a parameter is not a variable where it may vary")
        return contradict(c) if fault else explain(c, c["witness"], v=c["parameters"])
    if fault or c["relation"]:
        insist((factor(c, c["relation"]) > 1) == fault, "the relation does not prove the verdict")
    if not fault:
        explain(c, c["witness"])
    for e in c["errors"]:
        i = int(e["output"])
        runs = zip(e["relation"].get("a", []), c.get("runs", []), strict=True)
        own = [x for x, run in runs if (a := c["averages"][int(run["average"])])["output"] and a["number"] == i]
        unused = not any([h[i] for h in e["relation"]["h"]] + own)
        if e["smallest"] is None:
            insist(unused and factor(c, e["relation"]) > 1, "an error of this sensor might explain the window")
        else:
            insist(not unused and factor(c, e["relation"], (i, e["smallest"])) == 1, "a smaller error would explain the window")
            insist(e["enough"] >= e["smallest"], "the error that is enough is too small")
            explain(c, e["witness"], (i, e["enough"]))


def factor(c, r, error=None):
    """Check that a relation holds for every trajectory; return the factor on all bounds at which the samples can keep it."""
    follow(c, single(c, r), [])
    if "constant" in c:
        residual, width = with_gains(c, r)
        insist([residual, width, abs(residual) / width] == [r["residual"], r["width"], r["factor"]], "residual, width or factor is wrong")
        return r["factor"]
    residual = width = F(0)
    for h, g, k, u, (readings, w) in zip(r["h"], r["g"], r["k"], c["u"], limits(c, error), strict=True):
        for x, (lo, hi) in [(x, ends) for x, ends in zip(h + g, readings + w, strict=True) if x]:
            residual, width = residual + x * (lo + hi) / 2, width + abs(x) * (hi - lo) / 2
        residual -= sum(x * (v - offset) for x, v, offset in zip(k, u, c["offset_u"], strict=True) if x)
    for x, ends in zip(r.get("a", []), averaged(c, error), strict=True):
        insist(not x or ends is not None, "an average needs a reading that is missing")
        residual, width = (residual + x * sum(ends) / 2, width + abs(x) * (ends[1] - ends[0]) / 2) if x else (residual, width)
    for x, (lo, hi) in zip(r.get("x", []), c.get("first_state", []), strict=True):
        residual, width = residual + x * (lo + hi) / 2, width + abs(x) * (hi - lo) / 2
    insist([residual, width, abs(residual) / width] == [r["residual"], r["width"], r["factor"]], "residual, width or factor is wrong")
    return r["factor"]


def single(c, r):
    """Return a relation with its averages written out as the samples that they combine."""
    out = {"h": [list(row) for row in r["h"]], "g": [list(row) for row in r["g"]], "k": r["k"]}
    out |= {"x": r["x"]} if "x" in r else {}
    for x, run in zip(r.get("a", []), c.get("runs", []), strict=True):
        a = c["averages"][int(run["average"])]
        for j, f in enumerate(a["weights"] if x else []):
            out["h" if a["output"] else "g"][int(run["first"]) + j][int(a["number"])] += x * f
    return out


def averaged(c, error):
    """Return [lo, hi] of each run of an average, in deviations of true values, None where it says nothing."""
    out = []
    for run in c.get("runs", []):
        a, middle, first = c["averages"][int(run["average"])], F(0), run["first"]
        if first is None:
            out.append(None)
            continue
        i, size = int(a["number"]), sum(map(abs, a["weights"]))
        rad = a["bound"] + 10 * (len(a["weights"]) + size) * c["floor"]
        if a["output"]:
            largest = greatest(c, i)
            rad += size * (c["resolution"][i] + c["recorder"] * (largest + c["noise"][i]) + (error[1] if error and error[0] == i else 0))
            samples = c["all_y"][int(first) : int(first) + len(a["weights"])]
            if any(row[i] is None for row in samples):
                out.append(None)
                continue
            middle = sum((f * (row[i] - c["offset_y"][i]) for f, row in zip(a["weights"], samples, strict=True)), F(0))
        out.append((middle - rad, middle + rad))
    return out


def greatest(c, i):
    """Return the largest reading of an output that is looked at, alone or in an average."""
    looked = [row[i] for row in c["y"]]
    for run in c.get("runs", []):
        a, first = c["averages"][int(run["average"])], run["first"]
        if a["output"] and a["number"] == i and first is not None:
            looked += [row[i] for row in c["all_y"][int(first) : int(first) + len(a["weights"])]]
    return max((abs(v) for v in looked if v is not None), default=F(0))


def with_gains(c, r):
    """Return (residual, width) of a relation whose tolerances keep one value: the sum over outputs, each with its gain at either end."""
    low = high = F(0)
    ends = [limits(c, None, [1 / (1 + sign * t) for t in c["tolerance"]]) for sign in (1, -1)]
    terms = lambda at, i: [(h[i], *readings[i]) for h, (readings, _) in zip(r["h"], at, strict=True) if h[i]]
    for i in range(len(c["tolerance"])):
        sums = [[sum((x * v[(x > 0) == up] for x, *v in terms(at, i)), F(0)) for up in (False, True)] for at in ends]
        low, high = low + min(a for a, _ in sums), high + max(b for _, b in sums)
    for g, k, u, (_, w) in zip(r["g"], r["k"], c["u"], ends[0], strict=True):
        low += sum(min(x * a, x * b) for x, (a, b) in zip(g, w, strict=True))
        high += sum(max(x * a, x * b) for x, (a, b) in zip(g, w, strict=True))
        known = sum(x * (v - offset) for x, v, offset in zip(k, u, c["offset_u"], strict=True) if x)
        low, high = low - known, high - known
    return (low + high) / 2, (high - low) / 2


def follow(c, r, v):
    """Check that sum h y + g w - k u = 0 for every trajectory, whatever the parameters v."""
    q = [F(0)] * len(c["A"])  # how the samples later than j depend on the state after j
    for j, (h, g, k) in reversed(list(enumerate(zip(r["h"], r["g"], r["k"], strict=True)))):
        A, B, C, D = (now(c, letter, j, v) for letter in "ABCD")
        insist(not any(add(dots(turned(c["G"]), q), g)), "the relation leaves a disturbance over")
        insist(not any(dots(turned([*c["D_v"], *c["F"]]), h + q)), "the relation leaves an unknown input over")
        insist(dots(turned([*D, *B]), h + q) == k, "the relation does not fit the inputs")
        q = dots(turned([*C, *A]), h + q)
    insist(not any(add(q, r.get("x", [F(0)] * len(q)))), "the relation leaves the unknown state over")


def now(c, letter, j, v):
    """Return a matrix of the model at sample j, at parameters v (numbers or polynomials)."""
    out = c[letter]
    for (who, lag), x in zip(c.get("variables", []), v, strict=True):
        change = c["uncertainties"][int(who)][letter]
        if change is not None and lag in (None, j):
            out = [[a + x * b for a, b in zip(row, by, strict=True)] for row, by in zip(out, change, strict=True)]
    return out


def contradict(c):
    """Check that no v within its bounds, and no errors, explain the samples."""
    count, relations = len(c["variables"]), []
    for r in c["relations"]:
        read = {part: [[Polynomial({tuple(m): x for x, *m in p}) for p in row] for row in r[part]] for part in "hgk"}
        follow(c, read, [Polynomial({(F(i),): F(1)}) for i in range(count)])
        middle, spread = Polynomial({}), []
        for h, g, k, u, (readings, w) in zip(*read.values(), c["u"], limits(c, None), strict=True):
            for x, ends in zip(h + g, readings + w, strict=True):
                lo, hi = ends or (F(0), F(0))
                insist(ends is not None or not x, "a relation needs a reading that is missing")
                middle, spread = middle + x * ((lo + hi) / 2), [*spread, x * ((hi - lo) / 2)]
            for x, value, offset in zip(k, u, c["offset_u"], strict=True):
                middle = middle + x * (offset - value) if x else middle
        relations.append([middle, *spread])
    bounds = [c["uncertainties"][int(who)]["bound"] for who, _ in c["variables"]]
    exclude(c["proof"], relations, [-b for b in bounds], bounds)


def exclude(proof, relations, lo, hi):
    """Check that in the box lo <= v <= hi some combination of the relations cannot be 0."""
    if "at" in proof:
        i = int(proof["variable"])
        insist(lo[i] <= proof["at"] <= hi[i], "a box is cut outside of itself")
        cut = lambda ends: [proof["at"] if j == i else x for j, x in enumerate(ends)]
        exclude(proof["below"], relations, lo, cut(hi))
        return exclude(proof["above"], relations, cut(lo), hi)
    middle, *spread = (sum((a * x for a, x in zip(proof["direction"], part, strict=True)), Polynomial({})) for part in turned(relations))
    if proof["vertices"]:
        insist(all(len(set(m)) == len(m) for p in (middle, *spread) for m in p.terms), "vertices say nothing about powers")
        used, ends = sorted({int(i) for p in (middle, *spread) for m in p.terms for i in m}), []
        for chosen in product(*((lo[i], hi[i]) for i in used)):
            v = dict(zip(used, chosen, strict=True))
            value, reach = middle.at(v), sum((abs(p.at(v)) for p in spread), F(0))
            ends += [value - reach, value + reach]
        low, high = min(ends), max(ends)
    else:
        low, high = middle.span(lo, hi)
        reach = sum((max(map(abs, p.span(lo, hi))) for p in spread), F(0))
        low, high = low - reach, high + reach
    insist([low, high] == [proof["low"], proof["high"]], "the range of a combination is wrong")
    insist(low > 0 or high < 0, "a combination may be 0")


def decide(document):
    """Check an answer about sets: equations M x = d of what was asked, and an x in [-1, 1]^q or a direction l with l d > sum |l M|."""
    c, yes = numbers(document["numbers"], seen := []), {"YES": True, "NO": False}[document["certificate"]]
    insist(sum(seen) == 2 * c["sum"], "the numbers do not add up: one was changed")
    first, *others = c["sets"]
    G, A, b = first["generators"], first["constraints"], first["offsets"]
    insist(all(len(row) == len(G[0]) for row in G + A), "a row of a set is too short")
    if document["question"] == "is_empty":
        M, D, yes = A, [[v] for v in b], not yes
    elif document["question"] == "contains":
        M, D = G + A, [[v] for v in add(c["point"], [-v for v in first["center"]]) + b]
    else:
        (second,) = others
        G2, A2 = second["generators"], second["constraints"]
        shift = add(second["center"], [-v for v in first["center"]])
        if document["question"] == "contains_set":
            insist(not A2, "the inner set must be a zonotope")
            M, D = G + A, [[v, *row] for v, row in zip(shift + b, G2 + [[F(0)] * len(G2[0]) for _ in b], strict=True)]
        else:
            insist(document["question"] == "intersects", "this question is not known")
            M = [row + [-v for v in other] for row, other in zip(G, G2, strict=True)]
            M += [row + [F(0)] * len(G2[0]) for row in A] + [[F(0)] * len(G[0]) + row for row in A2]
            D = [[v] for v in shift + b + second["offsets"]]
    if yes:
        X = c["X"] if "X" in c else [[v] for v in c["x"]]
        insist([dots(turned(X), row) for row in M] == D, "x does not keep the equations")
        insist(all(sum(map(abs, row)) <= 1 for row in X), "x is out of its bounds")
    else:
        along, (d, *spread) = dots(turned(M), c["l"]), dots(turned(D), c["l"])
        insist(d + sum(map(abs, spread)) > sum(map(abs, along)), "the equations might hold")


class Polynomial:
    """Numbers by monomial: (1, 1, 4) is v_1^2 v_4."""

    def __init__(self, terms):
        self.terms = {m: x for m, x in terms.items() if x}

    def __add__(self, other):
        out = dict(self.terms)
        for m, x in polynomial(other).terms.items():
            out[m] = out.get(m, F(0)) + x
        return Polynomial(out)

    def __mul__(self, other):
        out = {}
        for m, x in self.terms.items():
            for n, y in polynomial(other).terms.items():
                both = tuple(sorted(m + n))
                out[both] = out.get(both, F(0)) + x * y
        return Polynomial(out)

    __radd__, __rmul__ = __add__, __mul__

    def __eq__(self, other):
        return self.terms == polynomial(other).terms

    def __bool__(self):
        return bool(self.terms)

    def at(self, v):
        return sum((prod([x, *(v[int(i)] for i in m)]) for m, x in self.terms.items()), F(0))

    def span(self, lo, hi):
        """Return (low, high), which holds all values over a box: each monomial around the middle by itself."""
        v = [Polynomial({(): (a + b) / 2, (F(i),): (b - a) / 2}) for i, (a, b) in enumerate(zip(lo, hi, strict=True))]
        whole = sum((prod([x, *(v[int(i)] for i in m)]) for m, x in self.terms.items()), Polynomial({}))
        low = high = whole.terms.pop((), F(0))
        for m, x in whole.terms.items():
            even = all(m.count(i) % 2 == 0 for i in m)
            low, high = low + (min(x, 0) if even else -abs(x)), high + (max(x, 0) if even else abs(x))
        return low, high


def polynomial(x):
    return x if isinstance(x, Polynomial) else Polynomial({(): x})


def explain(c, witness, error=None, v=()):
    """Check that the witness is a trajectory with every reading, input and disturbance within its bounds."""
    inside = zip(v, c.get("variables", []), strict=True)
    insist(all(abs(x) <= c["uncertainties"][int(who)]["bound"] for x, (who, _) in inside), "a parameter is out of its bounds")
    names, x = ("inputs", "disturbances", "unknown_inputs", "outputs"), witness["state"]
    gains = witness["gains"] if "constant" in c else None
    if gains is not None:
        inside = all(1 / (1 + t) <= g <= 1 / (1 - t) for g, t in zip(gains, c["tolerance"], strict=True))
        insist(inside, "a gain is out of its bounds")
    samples = zip(c["u"], limits(c, error, gains), *(witness[name] for name in names), strict=True)
    for j, (recorded, (readings, bounds), u, w, free, y) in enumerate(samples):
        A, B, C, D = (now(c, letter, j, v) for letter in "ABCD")
        insist(all(a is None or a == b for a, b in zip(recorded, u, strict=True)), "the inputs are not those recorded")
        u = [a - offset for a, offset in zip(u, c["offset_u"], strict=True)]
        t = add(add(dots(C, x), dots(D, u)), dots(c["D_v"], free))
        insist(add(t, c["offset_y"]) == y, "the true outputs do not follow from the first state")
        inside = all(b is None or b[0] <= a <= b[1] for a, b in zip(t + w, readings + bounds, strict=True))
        insist(inside, "a reading or a disturbance is out of its bounds")
        x = add(add(dots(A, x), dots(B, u)), add(dots(c["G"], w), dots(c["F"], free)))
    for run, ends in zip(c.get("runs", []), averaged(c, error), strict=True):
        if ends is None:
            continue
        a = c["averages"][int(run["average"])]
        i, rows = int(a["number"]), witness["outputs" if a["output"] else "disturbances"]
        offset = c["offset_y"][i] if a["output"] else F(0)
        rows = rows[int(run["first"]) : int(run["first"]) + len(a["weights"])]
        total = sum((f * (row[i] - offset) for f, row in zip(a["weights"], rows, strict=True)), F(0))
        insist(ends[0] <= total <= ends[1], "an average is out of its bound")


def limits(c, error, gains=None):
    """Return for each time ([lo, hi] of the true value behind each reading, None where it is missing; [lo, hi] of each disturbance)."""
    out = []
    for row in c["y"]:
        readings = []
        for i, (y, noise) in enumerate(zip(row, c["noise"], strict=True)):
            largest = greatest(c, i)
            delta = (
                noise + c["resolution"][i] + c["recorder"] * (largest + noise) + c["floor"] + (error[1] if error and error[0] == i else 0)
            )
            ends = lambda d, i=i: [d / (1 - c["tolerance"][i]), d / (1 + c["tolerance"][i])] if gains is None else [gains[i] * d]
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
    if len(sys.argv) < 2:
        print("usage: python check_certificate.py FILE.json...", file=sys.stderr)
        sys.exit(2)
    for name in sys.argv[1:]:
        with open(name, encoding="utf-8") as file:
            document = json.load(file)
        try:
            confirm(document)
        except (ArithmeticError, LookupError, TypeError, ValueError) as e:
            sys.exit(f"{name}: NOT confirmed: {e}")
        print(f"{name}: confirmed: {document['certificate']}. {document['statement']}")
