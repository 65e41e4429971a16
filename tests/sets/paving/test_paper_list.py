"""The paper's own paving of the unknowns of a window, by `pave`: counted box by box as a FIFO list."""

from collections import deque

import numpy as np
import pytest
from oracles import MODELS, Plant, draw
from systems import paper

import jaxbound as jb
from benchmarks.paving import internal_form
from jaxbound.sets.floats.status import Status
from jaxbound.sets.intervals.interval import interval
from jaxbound.sets.paving.paving import pave

W, K = np.array([[1.0, -5, 5, 0], [0, 4, -10, 5]]), np.array([0.0, 5])
SIGMA, RHO = np.tile([0.02, 0.1], 2), np.tile([0.1, 0.01], 2)


def windows(count, rng, **how):
    u, _, y = draw(Plant(**MODELS["paper"]), 1, count, rng, **how)
    return u, y


def outside(rng, count=128):
    """Return windows that are FAULT jointly: those inside cost up to 65 535 boxes each."""
    u, y = windows(1000, rng)
    r = jb.parity_relations(paper(), horizon=1)
    found = np.flatnonzero(jb.detect(r, u, y).status[:, -1] == Status.FAULT)[:count]
    return u[found], y[found]


def product(a, b):
    ends = (a[0] * b[0], a[0] * b[1], a[1] * b[0], a[1] * b[1])
    return min(ends), max(ends)


def image(box, y):
    """Enclose W mu over a box of (theta / sigma, delta) by natural interval arithmetic in plain floats."""
    mu = []
    for i in range(4):
        theta, delta = product(box[i], (SIGMA[i], SIGMA[i])), box[4 + i]
        top = [
            a + b for a, b in zip(product(theta, (y[i], y[i])), product(delta, (RHO[i], RHO[i])), strict=True)
        ]
        mu.append(product(top, (1 / (1 + theta[1]), 1 / (1 + theta[0]))))
    rows = [[product((w, w), m) for w, m in zip(row, mu, strict=True)] for row in W]
    return [(sum(t[0] for t in row), sum(t[1] for t in row)) for row in rows]


def paper_algorithm(target, y, threshold):
    """Run the list of Adrot 2000, 4.3 (with golden's erratum) on one window; return (empty, boxes
    evaluated).
    """
    waiting, evaluated, r = deque([(((-1.0, 1.0),) * 8, 0)]), 0, 1
    while waiting:
        box, cuts = waiting.popleft()
        evaluated += 1
        if all(lo <= t <= hi for t, (lo, hi) in zip(target, image(box, y), strict=True)):
            axis, (lo, hi) = cuts % 8, box[cuts % 8]
            for part in ((lo, (lo + hi) / 2), ((lo + hi) / 2, hi)):
                waiting.append((box[:axis] + (part,) + box[axis + 1 :], cuts + 1))
        if waiting and waiting[0][1] == 8 * r:  # first in is the coarsest
            r += 1
        if r > threshold:
            break
    return not waiting, evaluated


@pytest.mark.parametrize("q", [2, pytest.param(3, marks=pytest.mark.long)])
def test_boxes_are_those_of_the_papers_list_one_window_at_a_time(q, rng):
    (u, y), (more_u, more_y) = outside(rng, 22), windows(2, rng)
    u, y = np.concatenate([u, more_u]), np.concatenate([y, more_y])
    flat = np.resize(y, (128, 4))  # the windows again and again: a size that is compiled anyway
    target = flat @ W.T - np.resize(u[:, 0], (128, 1)) * K
    each = lambda a: np.broadcast_to(a, (128, *a.shape))
    edge = np.ones(8)
    args = (flat, each(SIGMA), each(RHO), each(W))
    p = pave(internal_form, interval(-edge, edge), target, q=q, max_boxes=10**7, args=args)
    plain = [paper_algorithm(target[i], flat[i], q - 1) for i in range(len(y))]
    np.testing.assert_array_equal(p.evaluated, np.resize([evaluated for _, evaluated in plain], 128))
    np.testing.assert_array_equal(p.status == Status.FAULT, np.resize([empty for empty, _ in plain], 128))
    print(
        f"evaluated {p.evaluated.min()} .. {p.evaluated.max()}, {sum(empty for empty, _ in plain)} of "
        f"{len(y)} rejected"
    )
    assert p.evaluated.max() > 30 and {empty for empty, _ in plain} == {True, False}
