"""A certificate of each kind, of random windows, healthy or not, cut out of recordings in which they lie; and
what a forger would try.
"""

import copy
import functools
import json
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import check_certificate
import numpy as np
from certificate_cases import PLANTS, plant, window
from ploix_experiment import record
from systems import PAPER
from uncertain_systems import TWO, relations

import jaxbound as jb
from jaxbound.certificates.interface import certify
from jaxbound.certificates.long_window import stretch
from jaxbound.sets import constrained_zonotope, contains, intersects, is_empty, zonotope

BEFORE = 2
"""Samples of the recording before the window."""
OTHERS = {
    "lags": (PAPER | dict(lags=(0, 2, 3)), None),
    "averages": (
        PAPER
        | dict(
            tolerance=0,
            noise=[0.3, 0.2],
            averages={"y1": {3: 0.15}, "w1": {2: 0.03}},
            disturbance=([[0], [1]], 0.05),
        ),
        4,
    ),
    "averages at lags": (
        PAPER | dict(tolerance=0, noise=[0.3, 0.2], averages={"y1": {3: 0.15}}, lags=(0, 3)),
        None,
    ),
    "constant tolerance": (PAPER | dict(constant_tolerance=True), 2),
    "single": (PAPER | dict(resolution="1/300"), 1),
    "factors": (PAPER | dict(times={"y1": "1 + u1*u1"}), 2),
    "a test": (PAPER | dict(tests=[{"name": "a", "horizon": 1}]), 1),
    "no state": (dict(A=None, B=None, C=None, D=[[1, 2], [1, 2], [0, 1]], noise=0.2), 0),
    "unsure, no state": (
        dict(
            A=None,
            B=None,
            C=None,
            D=[[1], [1]],
            noise=0.1,
            uncertainties=[jb.Uncertainty("k", D=[[1], [1]], between=(0, "0.2"))],
        ),
        0,
    ),
}
UNSURE = {"unsure": ("n2p1_paper_h3", dict(noise=0.01, tolerance=0.02)), "unsure, joint": (TWO, {})}
LONG = jb.LinearSystem(
    [["0.98", "0.05"], ["-0.02", "0.97"]],
    [[0], ["0.1"]],
    [[1, 0]],
    [["0.2"]],
    noise="0.1",
    tolerance="0.01",
    disturbance=([[1], ["0.5"]], [["-0.002", "0.003"]]),
    offset={"u": 1, "y": 20},
    averages={"w1": {4: "0.0025"}},
    name="drum",
)
OBSERVED = {
    "observer, 7 samples": (7, False),
    "observer": (40, False),
    "observer, first state": (20, True),
    "observer, 513 samples": (513, False),
}
KINDS = (*PLANTS, *OTHERS, *UNSURE, *OBSERVED)
QUESTIONS = tuple(
    (name, meets)
    for name in ("contains", "contains_set", "intersects", "is_empty")
    for meets in (True, False)
)
"""What is asked of sets, and whether the equations of the answer have a solution."""
PROOF = ("witness", "relation", "errors", "relations", "proof", "parameters", "sum")


@dataclass(frozen=True)
class Case:
    """A certificate, its document, and all that `verify` takes beside it."""

    certificate: Any
    document: dict
    given: dict


def case(kind, rng, fault, errors=False):
    """Return a Case of that verdict."""
    while True:
        model, about, u, y, x0 = _window(kind, rng, fault)
        at = len(y) - 1 + (BEFORE if x0 is None else 0)
        try:
            c = certify(about, *_with_factors(model, u, y), at=(at,))
        except (NotImplementedError, ValueError):  # nothing is proved of it
            continue
        if kind == "a test":
            c = c.of_test("a")
        if (c.proves == jb.Status.FAULT) == fault:
            document = json.loads(c.to_json(errors=errors))
            return Case(c, document, {"model": model, **_around(rng, u, y, x0)})


def _with_factors(model, u, y):
    """Return (u, y) as relations take them: factors on noise stand behind the inputs."""
    if not model.factors:
        return u, y
    recording = jb.Recording.of(model, u, y)
    return np.asarray(recording.u), np.asarray(recording.y)


def _window(kind, rng, fault):
    bias = 10 ** rng.uniform(0, 1.5) if fault else 0.0
    if kind in OBSERVED:
        return _observed(*OBSERVED[kind], rng)
    if kind in UNSURE:
        name, changes = UNSURE[kind]
        about = relations(name, **changes)
        u, y = record(rng, name, 1, "uniform", **changes)
        part = slice(20, 21 + about.horizon)
        return (
            about.model,
            about,
            u[0, part],
            y[0, part] + (bias * rng.uniform(-1, 1, y[0, part].shape) if fault else 0),
            None,
        )
    about, gaps = _relations(kind)
    if about.model.uncertainties:
        u = rng.uniform(1, 2, (about.horizon + 1, about.model.m))
        y = (
            u[:, :1] * (1 + rng.uniform(0, 0.2))
            + rng.uniform(-0.1, 0.1, (len(u), about.model.p))
            + bias * rng.uniform(-1, 1, (1, 2))
        )
    else:
        u, y = window(about, gaps, rng, bias)
    u, y = (x.astype(np.float32) for x in (u, y)) if kind == "single" else (u, y)
    return about.model, about, u, y, None


@functools.cache
def _relations(kind):
    if kind in PLANTS:
        return plant(kind)
    numbers, horizon = OTHERS[kind]
    return jb.parity_relations(
        jb.LinearSystem(**numbers), horizon
    ), 0.05 if kind == "averages at lags" else 0.0


def _observed(samples, begins, rng):
    """Return the window of an observer: slow drift of the sensor."""
    u = 1 + rng.normal(size=(samples, 1))
    x, y = np.zeros(2), np.empty((samples, 1))
    A, B, G = np.array([[0.98, 0.05], [-0.02, 0.97]]), np.array([0, 0.1]), np.array([1, 0.5])
    for k in range(samples):
        y[k] = 20 + (1 + rng.uniform(-0.01, 0.01)) * (x[0] + 0.2 * (u[k, 0] - 1)) + rng.uniform(-0.1, 0.1)
        x = A @ x + B * (u[k, 0] - 1) + G * rng.uniform(-0.002, 0.003)
    y[samples // 2 :, 0] += (
        rng.uniform(1, 4) * rng.choice([-1, 1]) * np.linspace(0, 1, samples - samples // 2)
    )
    y[3] = np.nan
    x0 = jb.interval([-3.0, -0.5], [3.0, 0.5]) if begins else None
    return (
        LONG,
        stretch(
            LONG, samples - 1, list(zip(x0.lo.tolist(), x0.hi.tolist(), strict=True)) if begins else None
        ),
        u,
        y,
        x0,
    )


def _around(rng, u, y, x0):
    """Return the recording that a window is part of, and bounds of its first state."""
    before = BEFORE if x0 is None else 0
    drawn = lambda n, x: rng.normal(size=(n, x.shape[1])).astype(x.dtype)
    longer = lambda x: np.concatenate([drawn(before, x), x, drawn(2, x)])
    return {"u": longer(u), "y": longer(y), "x0": x0}


def summed(document):
    """Return the document with the sum of its numbers made right again."""
    document["numbers"].pop("sum", None)
    check_certificate.numbers(document["numbers"], seen := [])
    document["numbers"]["sum"] = str(sum(seen))
    return document


def forged(document, rng):
    """Return (what was done, the document with one thing in it that is false), the sum of its numbers right
    again.

    Everything here breaks what is said: a claim about other numbers, names or samples, a relation that does
    not hold, a witness that does not explain. Proofs that are only written otherwise, like a relation times
    two, are none of it.
    """
    out = copy.deepcopy(document)
    while True:
        what = FORGERIES[rng.integers(len(FORGERIES))]
        said = what(out, rng)
        if said is not None:
            return f"{what.__name__}: {said}", summed(out)


def _places(tree, wanted, path=()):
    """Return the paths to all leaves of a tree that are wanted."""
    if isinstance(tree, (dict, list)):
        branches = tree.items() if isinstance(tree, dict) else enumerate(tree)
        return [place for key, branch in branches for place in _places(branch, wanted, (*path, key))]
    return [path] if wanted(path, tree) else []


def _at(tree, path):
    return functools.reduce(lambda branch, key: branch[key], path, tree)


def _changed(tree, path, value):
    _at(tree, path[:-1])[path[-1]] = value
    return f"{path} is {value}"


def _other(text, rng):
    """Return another number than a text says."""
    x = Fraction(0) if text is None else Fraction(text)
    tried = [x + 1, x - Fraction(1, 3), -x, x * (1 + Fraction(1, 10**9)), x + Fraction(1, 10**300), None]
    others = [v for v in tried if v is None or v != x]
    return (lambda v: None if v is None else str(v))(others[rng.integers(len(others))])


def _pick(rng, places):
    return places[rng.integers(len(places))] if places else None


def number(document, rng):
    """Another number of the model, its bounds or the samples."""
    path = _pick(rng, _places(document["numbers"], lambda path, leaf: path[0] not in PROOF))
    old = _at(document["numbers"], path)
    new = _other(old, rng)
    return None if new == old else _changed(document["numbers"], path, new)


def multiplier(document, rng):
    """Another multiplier of a relation, all that is shown to follow from it as it was."""
    parts = ("relation", "relations", "proof")
    free = {"h", "g", "k", "a", "x", "direction"}
    wanted = lambda path, leaf: (
        path[0] in parts and free & set(path) and leaf is not None and path[-1] != "vertices"
    )
    path = _pick(
        rng,
        _places(
            document["numbers"], lambda p, leaf: wanted(p, leaf) and not (p[0] == "relations" and p[-1] > 0)
        ),
    )
    if path is None:
        return None
    x = Fraction(_at(document["numbers"], path))
    new = [
        x + 1,
        -x if x else Fraction(1),
        x * (1 + Fraction(1, 10**6)) if x else Fraction(1, 7),
        x + Fraction(1, 10**40),
    ][rng.integers(4)]
    return _changed(document["numbers"], path, str(new))


def result(document, rng):
    """Another value of what a relation comes to."""
    shown = {"residual", "width", "factor", "low", "high"}
    path = _pick(
        rng,
        _places(
            document["numbers"],
            lambda path, leaf: path[0] in ("relation", "proof", "errors") and path[-1] in shown,
        ),
    )
    return (
        None
        if path is None
        else _changed(
            document["numbers"], path, str(Fraction(_at(document["numbers"], path)) * Fraction(3, 2) + 1)
        )
    )


def witness(document, rng):
    """A witness that is no trajectory of the plant, or one out of its bounds."""
    shown = document["numbers"]["witness"]
    if shown is None:
        return None
    near = [
        ("witness", *path)
        for path in _places({k: shown[k] for k in ("state", "outputs")}, lambda path, leaf: True)
    ]
    far = [
        ("witness", "disturbances", *path)
        for path in _places(shown["disturbances"][:-1], lambda path, leaf: True)
    ]
    far += [("witness", "gains", i) for i in range(len(shown.get("gains", [])))]
    far += [("parameters", i) for i in range(len(document["numbers"].get("parameters") or []))]
    recorded = lambda path, leaf: document["numbers"]["u"][path[0]][path[1]] is not None
    near += [("witness", "inputs", *path) for path in _places(shown["inputs"], recorded)]
    path = _pick(rng, near + far)
    x = Fraction(_at(document["numbers"], path))
    new = (
        x + 10
        if path in far
        else x + [Fraction(1), Fraction(-1, 10**30), Fraction(1, 10**6)][rng.integers(3)]
    )
    return _changed(document["numbers"], path, str(new))


def word(document, rng):
    """Another statement, verdict, name, sample or time."""
    names = document["names"]
    k = names["sample"][-1]
    tried = [
        (("statement",), document["statement"] + " at once"),
        (("statement",), ""),
        (("names", "model"), "another"),
        (("certificate",), "CONSISTENT" if document["certificate"] == "FAULT" else "FAULT"),
        (("names", "sample"), [k + 1]),
        (("names", "sample"), [k - 1]),
        (("names", "sample"), [0, k]),
        (("names", "sample"), k + 10),
        (("names", "times"), ["12:00"] * len(document["numbers"]["y"])),
        (("names", "outputs", 0), "y9"),
        (("names", "units"), {names["outputs"][0]: "bar"}),
        (("names", "outputs"), names["outputs"] * 2),
    ]
    return _changed(document, *tried[rng.integers(len(tried))])


def shape(document, rng):
    """A row twice, in another place, or left out; a field more or less."""
    numbers = document["numbers"]
    lists = [
        name for name in numbers if name not in PROOF and isinstance(numbers[name], list) and numbers[name]
    ]
    name, how = _pick(rng, lists), rng.integers(5)
    rows = numbers[name]
    if how == 0:
        rows.insert(int(rng.integers(len(rows))), rows[-1])
    elif how == 1:
        rows.pop(int(rng.integers(len(rows))))
    elif how == 2:
        if rows == rows[::-1]:
            return None
        rows.reverse()
    elif how == 3:
        del numbers[name]
    else:
        numbers["trust"] = "1"
    return f"{name}, {('twice', 'less', 'turned', 'gone', 'more')[how]}"


def samples(document, rng):
    """Other samples and all that is shown of them, like the recording of another day."""
    numbers = document["numbers"]
    j = int(rng.integers(len(numbers["y"])))
    i = int(rng.integers(len(numbers["y"][0])))
    if numbers["y"][j][i] is None:
        return None
    new = str(Fraction(numbers["y"][j][i]) + Fraction(1, 1000))
    for name in ("y", "all_y"):
        if name in numbers:
            numbers[name][j][i] = new
    return f"y of {j}, {i} is {new}"


def rows(document, rng):
    """Rows of a relation or of a witness in another order, or one of them left out."""
    numbers = document["numbers"]
    part, fields = _pick(
        rng, [(name, ("h", "outputs")) for name in ("relation", "witness") if numbers.get(name)]
    ) or (None, ())
    if part is None:
        return None
    shown = numbers[part][next(name for name in fields if name in numbers[part])]
    i, j = rng.integers(len(shown), size=2)
    if shown[i] == shown[j]:
        shown.pop(int(i))
        return f"{part} without row {i}"
    shown[i], shown[j] = shown[j], shown[i]
    return f"rows {i} and {j} of {part} change places"


def error(document, rng):
    """Another output, size or witness of the smallest error of a sensor."""
    shown = document["numbers"].get("errors")
    if not shown:
        return None
    one = shown[rng.integers(len(shown))]
    field = ("output", "smallest", "enough", "relation", "witness")[rng.integers(5)]
    values = {"output": "7", "relation": None, "witness": None}
    values |= {
        "smallest": str(Fraction(one["smallest"] or 1) * 2),
        "enough": str(Fraction(one["enough"] or 1) * 2),
    }
    if one[field] == values[field]:
        one[field] = "1"
    else:
        one[field] = values[field]
    return f"{field} is {one[field]}"


def question(name, meets, rng):
    """Return the certificate of an answer about sets, drawn until it is that one."""
    while True:
        decided = _decided(name, rng)
        answer = int(np.ravel(np.asarray(decided.answer))[0])
        if answer == (1 if meets != (name == "is_empty") else -1):
            try:
                return json.loads(json.dumps(decided.certificate((0,) * np.ndim(decided.answer))))
            except NotImplementedError:  # proved by facets, of which there is no short certificate
                continue


def _decided(name, rng):
    """Return the Decision of random sets of two dimensions."""
    drawn = lambda most, *shape: rng.integers(-most, most + 1, shape) / 4
    G, point, inner = drawn(9, 2, 4), drawn(18, 2), zonotope(drawn(9, 2), drawn(4, 2, 3))
    bound = constrained_zonotope(np.zeros(2), G, drawn(9, 1, 4), drawn(30, 1))
    match name:
        case "contains":
            return contains(bound, point[None])
        case "contains_set":
            return contains(zonotope(np.zeros(2), G), inner)
        case "intersects":
            return intersects(bound, inner)
    return is_empty(bound)


def forged_question(document, rng):
    """Return (what was done, the certificate of an answer about sets with one thing in it that is false)."""
    out = copy.deepcopy(document)
    c, how = out["numbers"], rng.integers(5)
    other = {"YES": "NO", "NO": "YES"}
    if how == 0:
        out["certificate"] = other[out["certificate"]]
    elif how == 1:
        out["statement"] = _pick(rng, ["", "the set is what it is", out["statement"] + " at once"])
    elif how == 2:
        out["question"] = _pick(
            rng, [name for name in ("contains", "intersects", "is_empty", "none") if name != out["question"]]
        )
    elif "l" in c:  # a combination that separates nothing; of a set within another -l may separate, too
        times = 0 if how == 3 or out["question"] == "contains_set" else -1
        c["l"] = [str(Fraction(x) * times) for x in c["l"]]
    else:
        shown = c["X"] if "X" in c else [c["x"]]
        path = _pick(rng, _places(shown, lambda path, leaf: True))
        new = Fraction(_at(shown, path)) + _pick(rng, [3, -3])  # beyond every bound
        _changed(shown, path, str(new))
    return f"{how}", summed(out)


FORGERIES = (rows, error, number, number, multiplier, multiplier, result, witness, word, shape, samples)
