"""From a recording to a proved verdict for every window."""

from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.consistency.claims import CLAIMED, UNCLAIMED, refuse_outside, unclaimed
from jaxbound.consistency.drive import drive
from jaxbound.consistency.interface import (
    AUTO,
    Budget,
    Compensation,
    Relations,
    Starts,
    relations_of,
    window_count,
    with_margins,
)
from jaxbound.consistency.searched import judging_device
from jaxbound.diagnosis import isolation, monitored, observed  # noqa: F401 (the Results of their kinds)
from jaxbound.diagnosis.result import Result, result_of
from jaxbound.models.region import Region
from jaxbound.recordings.table import Data
from jaxbound.sets.floats.probe import refuse_unusable
from jaxbound.sets.floats.status import Status
from jaxbound.text.progress import reporter

__all__ = ["detect", "margins"]


def detect(
    relations: Relations,
    u: Data,
    y: Data = None,
    method: str = "joint",
    budget: Budget = None,
    progress: Callable[[float], object] | None = None,
    starts: Starts = (),
    compensation: Compensation = 0.0,
    margins: str = AUTO,
    outside: str = CLAIMED,
) -> Result:
    """Decide for every window whether any behaviour inside the bounds explains it.

    Args:
        relations: from `parity_relations` or `residual`; or a bank from `structured_relations` or
            `redundancy`, whose relations are tested one by one: the Result then knows .violated and the
            .candidates, the single faults that can explain it; or a `jb.monitor` of several tests, whose
            Result has .tests and .by, which of them speaks.
        u: (..., T, m) inputs, y: (..., T, p) outputs; arrays, or tables with the model's columns, see
            `Recording.of`. NaN marks a missing sample. u is None for a model without inputs. Leading axes are
            recordings of their own. y None: u is a table of both.
        method: "joint" tests the exact set of all relations together: FAULT and CONSISTENT are both proofs.
            "box" tests each relation alone: FAULT is a proof, CONSISTENT only with a single relation, else
            UNDECIDED. "paving" is the paper's adaptive bisection over the unknowns themselves: FAULT is a
            proof, anything else UNDECIDED (but see uncertain parameters). A residual is always decided by
            bisection of its unknowns: FAULT and CONSISTENT are proofs. With uncertain parameters both proofs
            of "joint" hold too, but what it neither refutes nor explains is UNDECIDED, until "paving" bisects
            the parameters. "linearized" is the paper's test, which proves nothing: UNDECIDED, and .suspect
            where it is outside.
        budget: for "paving", (q, boxes a window): stop at r > q - 1; default (3, 100_000). For a residual, or
            with uncertain parameters, boxes a window; default 1000, or 10 000.
        progress: called with the share of the work done, after each block.
        starts: numbers of the samples that do not follow the one before, after a gap for example: windows
            across are MISSING. The gaps that the times of a table show are found, and rows that are in
            disorder or of another period refused, as of a file.
        compensation: for "linearized", what each relation may be off by for the terms that it neglects, one
            number or one a relation.
        margins: "exact": where windows are decided by a search, each is searched for its margin; "bounds":
            one that a projection settles keeps the bound on its margin that this proves, at a tenth of the
            work, but with more to compile; "auto": bounds of 131 072 windows and more. .margins says which a
            Result has; .alarms(), .worst, .explain and reports have exact ones of what they show.
        outside: "fault": of a window that reads inputs outside the region of training, the model's `ranges`,
            FAULT is FAULT, and .outside says how far; "undecided": it is not claimed there, and UNDECIDED.

    Returns:
        A Result: .status (..., T) int8 (`Status`), .margin (..., T); entry k belongs to the window that ends
        at sample k. The first `horizon` entries are MISSING. A window with missing samples is judged by the
        circuits that do not need them; with a missing input these prove FAULT, but not CONSISTENT. Where
        bounds are as thin as the rounding of floats, as those of a sensor without noise are, "joint" and
        "box" decide in whole numbers: exact, but some 10 to 100 microseconds a window.

    Raises:
        TypeError: no relations; samples inside jit, vmap or grad.
        ValueError: shapes or columns that do not fit, another sampling period than the model's, an infinite
            sample, an unknown method, unknown margins, another word for outside, starts that are no sample
            numbers.
        RuntimeError: where rounding has not been verified: fast-math flags, another rounding mode.

    A device that nobody examined (`jaxbound examine`) searches: each FAULT is proved on the host, CONSISTENT
    is UNDECIDED, and the hints say so. An observer follows on the CPU there.

    Source: Adrot, Maquin, Ragot 2000, section 4; exactness of "joint": W box(mu) is a zonotope.

    Example:
        >>> import jaxbound as jb
        >>> A, B, C = [[0.8, 1], [0, 0.2]], [[0], [1]], [[1, 0], [1, 1]]
        >>> m = jb.LinearSystem(A, B, C, tolerance=[0.02, 0.1], noise=[0.1, 0.01])
        >>> jb.detect(jb.parity_relations(m), [[0.0], [0.0]], [[0.0, 0.0], [0.5, 0.0]]).status
        array([0, 3], dtype=int8)
    """
    relations_of(relations, "detect", "detect(parity_relations(model), u, y)")
    if isinstance(u, jax.core.Tracer) or isinstance(y, jax.core.Tracer):
        raise TypeError(
            "detect drives compiled kernels from the host and cannot run inside jit, vmap or grad: give it "
            "arrays, a batch of "
            "recordings at once; inside, use margins, which is differentiable and proves nothing"
        )
    refuse_outside(outside)
    report = reporter(progress)
    named, recording = relations.recording(u, y, starts)
    refuse_unusable()
    recording = replace(recording, u=np.asarray(recording.u), y=np.asarray(recording.y))
    test = named.test(method, recording.y.dtype, budget, compensation)
    test = with_margins(test, margins, window_count(recording.y.shape[:-1], test.horizon))
    judged = drive(test, recording, report)
    if (judged.status == Status.UNDECIDED).any():  # an infinite sample cannot come out as anything else
        recording.finite()
    region = Region.of(named)
    if region is not None and outside == UNCLAIMED:
        missing = judged.status == Status.MISSING
        judged = unclaimed(judged, region.departure(recording.u, missing))
    starts, recorded = tuple(recording.starts.tolist()), None
    if recording.source:
        recorded = recording.hints
    about = test.method, test.relations, recording.u, recording.y, recording.index, starts
    aside, device = recording.aside(test.horizon), judging_device(named.remembers)
    return result_of(
        relations,
        judged,
        *about,
        aside=aside,
        recorded=recorded,
        device=device,
        margins=test.margins_are,
        outside_is=outside,
    )


def margins(relations: Relations, u: Data, y: Data = None, starts: Starts = ()) -> jax.Array:
    """Return the signed margin of every window, 1 - t: t is the factor on all half-widths at which the window
    just becomes consistent.

    The fast path: not rounded, no proof claimed. Differentiable in `relations.bounds`, y and u, under jit,
    vmap and grad.

    Args:
        relations, u, y, starts: as for `detect`.

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
