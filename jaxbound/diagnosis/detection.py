"""From a recording to a proved verdict for every window.

Windows are tested in blocks of one fixed size by one compiled kernel, so that recordings of any length share a compilation, on all devices
at once (`devices`); the recordings of a batch are laid end to end, and the windows that would cross a seam are MISSING like any warm-up.
"""

import math

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.consistency import constant, gridding, whole_numbers
from jaxbound.consistency.drive import in_blocks
from jaxbound.consistency.exchange import exchange_margins, exchange_windows
from jaxbound.consistency.residual_windows import residual_windows
from jaxbound.consistency.uncertain_windows import uncertain_windows
from jaxbound.diagnosis.isolation import BankResult, bank_test, bank_windows, status_of_words
from jaxbound.diagnosis.result import Result
from jaxbound.diagnosis.uncertain_margins import uncertain_margins
from jaxbound.recordings.recording import Recording
from jaxbound.relations.decoupling import signatures
from jaxbound.relations.parity import ParityRelation
from jaxbound.relations.redundancy import Redundancy
from jaxbound.relations.residual import Residual
from jaxbound.relations.uncertain import UncertainRelations
from jaxbound.sets.floats.probe import refuse_unverified, usable_devices
from jaxbound.sets.floats.status import Status
from jaxbound.sets.strips.bank import unpacked, verdict_dtypes
from jaxbound.sets.strips.separation import Frame
from jaxbound.sets.strips.strips import status_of, strip_margin, strip_verdict

__all__ = ["detect", "margins", "verdicts"]

METHODS = ("joint", "box", "paving", "linearised")


def detect(relations, u, y=None, method="joint", budget=None, progress=None, starts=(), compensation=0.0):
    """Decide for every window whether any behaviour inside the bounds explains it.

    Args:
        relations: from `parity_relations` or `residual`; or a bank from `structured_relations` or `redundancy`, whose relations are
            tested one by one: the Result then knows .violated and the .candidates, the single faults that can explain it.
        u: (..., T, m) inputs, y: (..., T, p) outputs; arrays, or tables with the model's columns, see `Recording.of`. NaN marks a missing
            sample. u is None for a model without inputs. Leading axes are recordings of their own. y None: u is a table of both.
        method: "joint" tests the exact set of all relations together: FAULT and CONSISTENT are both proofs. "box" tests each
            relation alone: FAULT is a proof, CONSISTENT only with a single relation, else UNDECIDED. "paving" is the paper's
            adaptive bisection over the unknowns themselves: FAULT is a proof, anything else UNDECIDED (but see uncertain parameters).
            A residual is always decided by bisection of its unknowns: FAULT and CONSISTENT are proofs.
            With uncertain parameters both proofs of "joint" hold too, but what it neither refutes nor explains is UNDECIDED, until "paving"
            bisects the parameters. "linearised" is the paper's test, which proves nothing: UNDECIDED, and .suspect where it is outside.
        budget: for "paving", (q, max_boxes): stop at r > q - 1; default (3, 1_000_000). For a residual, or with uncertain parameters, boxes
            a window; default 1000, or 10 000.
        progress: called with the share of the work done, after each block.
        starts: numbers of the samples that do not follow the one before, after a gap for example: windows across are MISSING. The gaps
            that the index of a table shows are found from it.
        compensation: for "linearised", what each relation may be off by for the terms that it neglects, one number or one a relation.

    Returns:
        A Result: .status (..., T) int8 (`Status`), .margin (..., T); entry k belongs to the window that ends at sample k. The
        first `horizon` entries are MISSING. A window with missing samples is judged by the circuits that do not need them;
        with a missing input these prove FAULT, but not CONSISTENT. Where bounds are as thin as the rounding of floats, as those of a
        sensor without noise are, "joint" and "box" decide in whole numbers: exact, but some 10 to 100 microseconds a window.

    Raises:
        ValueError: shapes or columns that do not fit, another sampling period than the model's, an infinite sample, an unknown method,
            starts that are no sample numbers.
        RuntimeError: where rounding has not been verified: all devices but CPU, so far, fast-math flags, another rounding mode.

    Source: Adrot, Maquin, Ragot 2000, section 4; exactness of "joint": W box(mu) is a zonotope.

    Example:
        >>> import jaxbound as jb
        >>> m = jb.LinearSystem([[0.8, 1], [0, 0.2]], [[0], [1]], [[1, 0], [1, 1]], tolerance=[0.02, 0.1], noise=[0.1, 0.01])
        >>> jb.detect(jb.parity_relations(m), [[0.0], [0.0]], [[0.0, 0.0], [0.5, 0.0]]).status
        array([0, 3], dtype=int8)
    """
    bank = relations if isinstance(relations, Redundancy) else None
    if bank is not None:
        if method not in ("joint", "box"):
            raise ValueError(f"the relations of a bank are tested one by one: method {method!r} does not apply")
        relations, method = bank.relations, "box"
    own, uncertain = isinstance(relations, Residual), isinstance(relations, UncertainRelations)
    if not isinstance(relations, ParityRelation | Residual | UncertainRelations):
        raise TypeError(f"detect needs relations, not {type(relations).__name__}: detect(parity_relations(model), u, y)")
    if method not in METHODS:
        raise ValueError(f"method must be one of {', '.join(METHODS)}, not {method!r}")
    if own and method == "box":
        raise ValueError("method 'box' is for parity relations: a residual is decided as a whole")
    if method == "linearised" and not uncertain:
        raise ValueError("method 'linearised' is for models with uncertain parameters: use 'joint', which is exact here")
    if method != "linearised" and np.any(np.asarray(compensation) != 0):
        raise ValueError(f"compensation belongs to method='linearised'; {method!r} neglects nothing")
    if budget is not None and method != "paving" and not own:
        raise ValueError(f"budget belongs to method='paving'; {method!r} always finishes")
    relations, given = relations.recording(u, y, starts) if own else (relations, Recording.of(relations.model, u, y, starts))
    refuse_unverified()
    u, y, words = np.asarray(given.u), np.asarray(given.y), np.zeros(0, np.uint32)
    if bank is not None:
        test = bank_test(bank, y.dtype)
        dtypes = verdict_dtypes(test.shape, y.dtype)
        words, margin = unpacked(*in_blocks(bank_windows, test, u, y, dtypes, (np.nan, *[0] * (len(dtypes) - 1)), progress))
        status = status_of_words(words, bank.count)
    elif own:
        status, margin = residual_windows(relations, u, y, budget, progress)
    elif uncertain:
        status, margin = uncertain_windows(relations, u, y, method, budget, progress, compensation)
    elif method == "paving":
        status, margin = gridding.pave_windows(relations, u, y, *(budget or (3, 1_000_000)), progress)
    elif relations.model.constant_tolerance:
        status, margin = constant.constant_windows(relations, method, u, y, progress)
    elif method == "joint" and relations.frame is not None:
        status, margin = exchange_windows(relations, u, y, progress)
    else:
        test = relations.test(method, y.dtype)
        status, margin = in_blocks(verdicts, test, u, y, (np.int8, y.dtype), (Status.MISSING, np.nan), progress)
        flat = (x.reshape(math.prod(x.shape[:-1]), x.shape[-1]) for x in (u, y))
        whole_numbers.settle(relations, test, method, *flat, status.reshape(-1), margin.reshape(-1), progress)
        if method == "box" and relations.count > 1:
            status = np.where(status == Status.CONSISTENT, np.int8(Status.UNDECIDED), status)
    if (status == Status.UNDECIDED).any():  # an infinite sample cannot come out as anything else
        given.finite()
    if len(given.starts):
        across = given.across(relations.horizon)
        status, margin = np.where(across, np.int8(Status.MISSING), status), np.where(across, np.nan, margin)
        words = np.where(across, np.uint32(0), words) if bank is not None else words
    about = status, margin, method, relations, u, y, given.index, tuple(given.starts.tolist())
    left_out = given.aside(relations.horizon)
    return Result(*about, aside=left_out) if bank is None else BankResult(*about, signatures(bank), words, aside=left_out)


def margins(relations, u, y=None, starts=()):
    """Return the signed margin of every window, 1 - t: t is the factor on all half-widths at which the window just becomes consistent.

    The fast path: not rounded, no proof claimed. Differentiable in `relations.bounds`, y and u, under jit, vmap and grad.

    Args:
        relations, u, y, starts: as for `detect`.

    Returns:
        (..., T): > 0 inside, < 0 outside, NaN where the window has no usable data (the first `horizon` entries). With uncertain
        parameters t is that of the joint test, not above the true factor: > 0 says only that the test does not refute the window.

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
    if not isinstance(relations, ParityRelation | UncertainRelations):
        raise TypeError(f"margins needs relations from parity_relations, not {type(relations).__name__}; detect(...).margin has them")
    if relations.model.constant_tolerance:
        raise NotImplementedError("margins has no fast path for constant_tolerance yet; detect(...).margin has them")
    given = Recording.of(relations.model, u, y, starts)
    u, y = given.u, given.y
    traced = any(isinstance(x, jax.core.Tracer) for x in (u, y, *relations.bounds.values()))
    if y.shape[-2] <= relations.horizon:
        return jnp.full(y.shape[:-1], jnp.nan, y.dtype)
    across = given.across(relations.horizon) | (np.arange(y.shape[-2]) < relations.horizon)
    if isinstance(relations, UncertainRelations):
        return uncertain_margins(relations, u, y).at[..., np.flatnonzero(across)].set(jnp.nan)
    test = relations.test("joint", y.dtype)
    devices = usable_devices()
    if traced or (devices[0].platform != "cpu" and len(devices) == 1):
        shape = y.shape[:-1]
        u, y = (jnp.asarray(x).reshape(math.prod(shape), x.shape[-1]) for x in (u, y))
        margin = jnp.pad(_margins(test, u, y), (test.horizon, 0), constant_values=jnp.nan).reshape(shape)
        return margin.at[..., np.flatnonzero(across)].set(jnp.nan)
    (margin,) = in_blocks(_margins, test, np.asarray(u), np.asarray(y), (y.dtype,), (np.nan,), None)
    margin[..., across] = np.nan
    return jax.device_put(margin)


@jax.jit
def verdicts(test, u, y):
    """Return (status, margin) of the windows of one stretch of samples, tested circuit by circuit."""
    mid, rad, scale, known, known_scale = test.stretch(u, y)
    margin = strip_verdict(test.shape, mid, rad, scale, known, known_scale, test.lift)
    margin = jax.lax.optimization_barrier(margin)  # else the compiler works out everything once for each of the two results
    status = status_of(margin)
    unsure = test.silenced(known) & (status == Status.CONSISTENT)
    return jnp.where(unsure, Status.UNDECIDED, status).astype(jnp.int8), margin


@jax.jit
def _margins(test, u, y):
    if isinstance(test.shape, Frame):
        return exchange_margins(test, u, y)
    mid, rad, _, known, _ = test.stretch(u, y)
    return strip_margin(test.shape, mid, rad, known)
