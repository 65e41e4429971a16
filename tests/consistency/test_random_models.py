"""Hard but ordinary random models: what exact programs decide far from the boundary is decided, and decided
so.
"""

import json
from fractions import Fraction

import check_certificate
import numpy as np
import pytest
from oracles import Plant

import jaxbound as jb
from jaxbound.certificates.exact_window import exact_window
from jaxbound.sets.floats.status import Status

SHAPES = ("random", "rotation", "permutation", "nilpotent", "integrator", "modes")
SEEN = ("random", "unseen state", "identical sensors", "dead sensor", "states")


def shape(rng, kind, n):
    if kind == "rotation":
        A = np.diag(rng.choice([-1.0, 1.0], n))
        for i in range(0, n - 1, 2):
            c, s = [(0.6, 0.8), (0, 1), (0.28, 0.96)][rng.integers(3)]
            A[i : i + 2, i : i + 2] = [[c, -s], [s, c]]
        return A
    if kind == "permutation":
        return np.eye(n)[rng.permutation(n)]
    if kind == "nilpotent":
        return np.triu(np.round(rng.normal(size=(n, n)), 1), 1)
    if kind == "integrator":
        return np.eye(n) + np.eye(n, k=1)
    return (
        np.diag(np.round(rng.uniform(-1.2, 1.2, n), 2))
        if kind == "modes"
        else np.round(0.5 * rng.normal(size=(n, n)), 2)
    )


def random_model(rng, dtype):
    """Return (keywords of a LinearSystem, size of its signals)."""
    n, p, m = rng.integers(1, 5), rng.integers(1, 4), rng.integers(0, 3)
    C, seen = np.round(rng.normal(size=(p, n)), 1), rng.choice(SEEN)
    if seen == "unseen state":
        C[:, rng.integers(n)] = 0
    elif seen == "identical sensors":
        C[:] = C[0]
    elif seen == "dead sensor":
        C[rng.integers(p)] = 0
    elif seen == "states":
        C = np.eye(n)[rng.integers(n, size=p)]
    most = 150 if dtype == np.float64 else 25
    units = 10.0 ** rng.integers(-6, 7, p) if rng.random() < 0.2 else np.ones(p)
    size = 10.0 ** rng.choice([0, 0, 0, 12, -12, most, -most])
    bound = lambda choices: [
        float(f"{a * b * size:.6g}") for a, b in zip(rng.choice(choices, p), units, strict=True)
    ]
    A = shape(rng, rng.choice(SHAPES), n)
    model = dict(
        A=A.tolist(),
        B=np.round(rng.normal(size=(n, m)), 1).tolist() if m else None,
        C=(units[:, None] * C).tolist(),
    )
    model |= dict(noise=bound([0, 0.1, 0.01, 1e-8]), tolerance=rng.choice([0, 0, 0.02, 0.1], p).tolist())
    if rng.random() < 0.3:
        model["noise"] = [0.0] * p
    if rng.random() < 0.3:
        model["resolution"] = bound([0, 0.005])
    if rng.random() < 0.3:
        model["offset"] = {
            "u": np.round(rng.normal(size=m), 1).tolist(),
            "y": bound(np.round(10 * rng.normal(size=9), 2)),
        }
    if rng.random() < 0.3:
        model["disturbance"] = (
            np.round(rng.normal(size=(n, 1)), 1).tolist(),
            [[0, float(f"{0.05 * size:.6g}")]],
        )
    return model, size


def random_window(rng, plant, s, size, dtype):
    """Return u (s + 1, m), y (s + 1, p): unknowns inside or at their bounds, at times a fault, at times a
    missing sample.
    """
    level, share = size * 10 ** rng.uniform(-2, 2), rng.choice([0, 0.3, 1])
    u = (size * rng.uniform(-1, 1, (s + 1, plant.m))).astype(dtype)
    error = lambda: Fraction(
        float(share * (rng.uniform(-1, 1) if rng.random() < 0.5 else rng.choice([-1, 1])))
    )
    known = [[Fraction(float(v)) - o for v, o in zip(row, plant.offset_u, strict=True)] for row in u]
    w = [[(lo + hi + error() * (hi - lo)) / 2 for lo, hi in plant.disturbance] for _ in range(s)]
    t = plant.trajectory(
        [Fraction(float(v)) for v in level * rng.normal(size=plant.n)], known, w=w if plant.g else ()
    )
    y = np.array(
        [
            [
                float(plant.offset_y[i] + x * (1 + plant.tolerance[i] * error()) + plant.noise[i] * error())
                for i, x in enumerate(row)
            ]
            for row in t
        ]
    )
    if rng.random() < 0.4:
        y[-1, rng.integers(plant.p)] += rng.choice([-1, 1]) * 10 ** rng.uniform(-2, 1) * level
    if rng.random() < 0.15:
        y[rng.integers(s + 1), rng.integers(plant.p)] = np.nan
    return u, y.astype(dtype)


@pytest.mark.parametrize(
    "models", [2, pytest.param(25, marks=pytest.mark.long), pytest.param(400, marks=pytest.mark.long)]
)
def test_what_is_far_from_the_boundary_is_decided_and_the_certificate_holds(models, rng):
    """12 windows a model; every verdict's certificate is confirmed by the standard library alone, on the same
    samples.
    """
    counts = np.zeros(4, int)
    for _ in range(models):
        dtype, s = (
            rng.choice([np.float64, np.float64, np.float32]),
            int(rng.choice([0, 1, 1, 2, 2, 3, 4, 6, 9, 12])),
        )
        model, size = random_model(rng, dtype)
        try:
            relations = jb.parity_relations(jb.LinearSystem(**model), s)
        except ValueError:  # more states than samples
            continue
        u, y = (
            np.array(x)
            for x in zip(
                *(random_window(rng, Plant(**model), s, size, dtype) for _ in range(12)), strict=True
            )
        )
        found = jb.detect(relations, u, y)
        for w, status in enumerate(found.status[:, -1]):
            assert status != Status.MISSING or np.isnan(y[w]).any(), (model, s, w)
            if status in (Status.FAULT, Status.CONSISTENT):
                document = json.loads(found.explain((w, s)).to_json())
                check_certificate.confirm(document)
                assert document["certificate"] == Status(status).name, (model, s, w)
            elif status == Status.UNDECIDED:
                margin = 1 - exact_window(relations, u[w], y[w]).solve().t
                assert abs(margin) < (1e-6 if dtype == np.float64 else 0.1), (model, s, w, float(margin))
            counts[status] += 1
    print({s.name: int(counts[s]) for s in Status})
    assert counts[Status.FAULT] > models and counts[Status.CONSISTENT] > models
