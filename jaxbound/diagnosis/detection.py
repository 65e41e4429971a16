"""From a recording to a proved verdict for every window."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.consistency.claims import CLAIMED, refuse_outside
from jaxbound.consistency.drive import drive
from jaxbound.consistency.interface import (
    AUTO,
    Budget,
    Relations,
    Starts,
    relations_of,
    window_count,
    with_margins,
)
from jaxbound.diagnosis import isolation, monitored, observed  # noqa: F401 (the Results of their kinds)
from jaxbound.diagnosis.monitoring import Watchable, monitor
from jaxbound.diagnosis.result import Result, found_by
from jaxbound.recordings.table import Data
from jaxbound.sets.floats.kernel import noted, sparing
from jaxbound.sets.floats.probe import refuse_unusable
from jaxbound.sets.floats.status import Status
from jaxbound.text.progress import reporter


def detect(
    relations: Watchable,
    u: Data,
    y: Data = None,
    method: str = "joint",
    budget: Budget = None,
    progress: Callable[[float], object] | None = None,
    starts: Starts = (),
    margins: str = AUTO,
    outside: str = CLAIMED,
) -> Result:
    """Decide for every window whether any behaviour inside the bounds explains it.

    Args:
        relations: a plant, or the path of its model file, watched by its own `jb.monitor`; or what one test
            says: from `parity_relations` or `residual`; a bank from `structured_relations` or `redundancy`,
            tested one by one: the Result knows .violated and .candidates; a `jb.monitor`: it has .tests, .by.
        u, y: (..., T, m) inputs and (..., T, p) outputs: arrays, leading axes are recordings of their own; or
            tables, see `Recording.of`. NaN: a missing sample. y None: u has both, or is the path of a
            recording, see `jb.read`; u None: no inputs.
        method: "joint": the exact set of all relations together, FAULT and CONSISTENT are proofs; with
            uncertain parameters some windows stay UNDECIDED. "box": each relation alone; CONSISTENT only of a
            single one.
        budget: boxes a window into which unknowns are cut: of a residual, default 1000; of uncertain
            parameters, those of windows that would stay UNDECIDED, default 1.
        progress: called with the share of the work done.
        starts: numbers of the samples that do not follow the one before: windows across are MISSING. Gaps
            that the times of a table show are found.
        margins: "exact", or "bounds": a tenth of the work where a search decides; "auto": bounds from 131 072
            windows on. Alarms, .worst and .explain have exact ones.
        outside: of windows outside the region of training, the model's `ranges`, where bounds are as wide as
            its `extrapolation` says: "fault", or "undecided".

    Returns:
        A Result: .status (..., T) int8 (`Status`), .margin (..., T); entry k belongs to the window that ends
        at sample k, the first `horizon` entries are MISSING. With a missing input FAULT is proved, but not
        CONSISTENT. On a device that nobody examined CONSISTENT is UNDECIDED.

    Raises:
        OSError: no such file. ValueError: shapes, columns, a sampling period or words that do not fit; an
            infinite sample.
        TypeError: no relations; inside jit, vmap or grad. RuntimeError: rounding is not verified.

    Source: Adrot, Maquin, Ragot 2000, section 4; exactness of "joint": W box(mu) is a zonotope.

    Example:
        >>> import jaxbound as jb
        >>> A, B, C = [[0.8, 1], [0, 0.2]], [[0], [1]], [[1, 0], [1, 1]]
        >>> m = jb.LinearSystem(A, B, C, tolerance=[0.02, 0.1], noise=[0.1, 0.01])
        >>> jb.detect(jb.parity_relations(m), [[0.0], [0.0]], [[0.0, 0.0], [0.5, 0.0]]).status
        array([0, 3], dtype=int8)
    """
    relations = relations_of(relations, "detect", "detect(parity_relations(model), u, y)", watched=monitor)
    if isinstance(u, jax.core.Tracer) or isinstance(y, jax.core.Tracer):
        raise TypeError(
            "detect drives compiled kernels from the host and cannot run inside jit, vmap or grad: give it "
            "arrays, a batch of "
            "recordings at once; inside, use margins, which is differentiable and proves nothing"
        )
    refuse_outside(outside)
    report = reporter(progress, "detect")
    named, recording = relations.recording(u, y, starts)
    refuse_unusable()
    recording = replace(recording, u=np.asarray(recording.u), y=np.asarray(recording.y))
    test = named.test(method, recording.y.dtype, budget)
    test = with_margins(test, margins, window_count(recording.y.shape[:-1], test.horizon))
    with sparing(), noted() as ways:
        judged = drive(test, recording, report)
    if (judged.status == Status.UNDECIDED).any():  # an infinite sample cannot come out as anything else
        recording.finite()
    result = found_by(test, recording, judged, outside, relations)
    return replace(result, evaluated=" and ".join(sorted(ways)))


def margins(relations: Relations, u: Data, y: Data = None, starts: Starts = ()) -> jax.Array:
    """Return the signed margin of every window, 1 - t: t is the factor on all half-widths at which the window
    just becomes consistent.

    The fast path: not rounded, no proof claimed, bounds as stated everywhere. Differentiable in
    `relations.bounds`, y and u, under jit, vmap and grad.

    Args:
        relations, u, y, starts: as for `detect`; no plant and no monitor.

    Returns:
        (..., T): > 0 inside, < 0 outside, NaN where the window has no usable data (the first `horizon`
        entries). With uncertain parameters t is that of the joint test, not above the true factor: > 0 says
        only that the test does not refute the window.

    Raises:
        ValueError: as `detect`.

    Example:
        >>> import jax, jaxbound as jb
        >>> m = jb.LinearSystem([[0.5]], None, [[1]], noise=0.1)
        >>> r = jb.parity_relations(m)
        >>> loss = lambda bounds: jb.margins(r.with_bounds(bounds), None, [[1.0], [0.8]])[1]
        >>> jax.grad(loss)(r.bounds)["noise"].round(2)
        Array([20.], dtype=float...)
    """
    relations_of(relations, "margins", "margins(parity_relations(model), u, y)", monitors=False)
    relations, recording = relations.recording(u, y, starts)
    if recording.y.shape[-2] <= relations.horizon:
        return jnp.full(recording.y.shape[:-1], jnp.nan, recording.y.dtype)
    return relations.test("joint", recording.y.dtype).margins(recording)
