"""Paving: cover the image of a box by boxes, or prove that a point is, or is not, in it.

Uniform subdivision of order q cuts every variable into q equal pieces. Adaptive bisection keeps a list of
boxes, worked off level by level for all targets of a batch at once (`frontier`): one whose image misses the
target is dropped; one that is proved to hold a solution (`existence`) is settled; any other is cut in two. An
empty list without a solution proves that the target is not in the image.

Source: Adrot, Maquin, Ragot 2000, 4.3, with the errata of `golden`: an excluded box goes on with step (5),
and closed containment.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import pairwise
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from numpy.typing import ArrayLike

from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.floats.probe import refuse_unverified
from jaxbound.sets.inclusion.functions import forgets, frozen
from jaxbound.sets.intervals.interval import Interval, Operand, interval
from jaxbound.sets.paving.existence import components, imaged, is_interval_function, search
from jaxbound.sets.paving.frontier import BLOCK, Boxes, Cover, Kernel, Verdicts, explore, judged_in_blocks
from jaxbound.text.objects import readable
from jaxbound.text.progress import reporter

CUTS = ("alternate", "widest", "smear")
SOLUTIONS = ("none", "one", "all")
EXCLUDED = 2**12
"""Boxes at once where boxes are only excluded: that is little work a box, beside what it costs to start a
kernel.
"""


@readable
@dataclass(frozen=True, eq=False)
class Paving:
    """The outcome of `pave`.

    Fields:
        status: int8, one a target: FAULT (proved: the target is not in the image), CONSISTENT (proved: it is)
            or UNDECIDED (the budget, `evaluated` and `levels`, did not settle it); None without a target.
        boxes: Interval (N, n), what is left of the box, neither excluded nor settled; owner (N,): the target
            that each belongs to.
        evaluated: boxes evaluated, one count a target.
        witness: Interval (K, n), boxes that each hold a solution, proved, or None; witness_owner (K,): their
            targets.
        levels: how often the first box was cut.
    """

    status: np.ndarray | None
    boxes: Interval
    owner: np.ndarray
    evaluated: np.ndarray
    witness: Interval | None = None
    witness_owner: np.ndarray | None = None
    levels: int = 0
    _again: Callable[[], Interval] | None = None  # a function that evaluates the images

    @cached_property
    def images(self) -> Interval:
        """Interval (N, m): the enclosures of f over `boxes`, evaluated when first asked for."""
        assert self._again is not None
        return self._again()

    def area(self) -> float:
        """Return the area of the union of the images in the plane (m = 2), to rounding.

        Raises:
            ValueError: m is not 2.
        """
        lo, hi = np.asarray(self.images.lo), np.asarray(self.images.hi)
        if lo.shape[1] != 2:
            raise ValueError(f"area is for two-dimensional images: these have {lo.shape[1]} dimensions")
        order = np.argsort(lo[:, 1])
        lo, hi, total = lo[order], hi[order], 0.0
        for left, right in pairwise(np.unique(np.concatenate([lo[:, 0], hi[:, 0]]))):
            here = (lo[:, 0] <= left) & (right <= hi[:, 0])
            top = np.maximum.accumulate(hi[here, 1])
            new = top - np.maximum(lo[here, 1], np.append(-np.inf, top)[: len(top)])
            total += float(right - left) * float(np.maximum(new, 0).sum())
        return total


def pave(
    f: Callable[..., Any],
    box: Operand,
    target: Operand | None = None,
    subdivision: str = "adaptive",
    q: int | None = None,
    cut: str | None = None,
    max_boxes: int | None = None,
    max_depth: int | None = None,
    args: Sequence[ArrayLike] = (),
    progress: Callable[[float], object] | None = None,
    solutions: str | None = None,
) -> Paving:
    """Cover {f(z) : z in box} by boxes, or decide whether `target` is in it, with a proof.

    Args:
        f: any JAX function of z (n,) (and of `args` for one target) that returns (m,) or a list of m numbers;
            or a function of an Interval (n,) that returns an Interval (m,) or a list of m, by outward-rounded
            operations. The same function written once more is found again, as by `inclusion`.
        box: Interval (n,), bounded.
        target: None, a point (m,), points (B, m), or an Interval of either: is there a z with f(z) in it?
        subdivision: "adaptive" or "uniform".
        q: uniform: the number of pieces per variable, default 10. Adaptive: the paper's algorithm and its
            threshold, stop at r > q - 1, that is after n (q - 1) levels.
        cut: "alternate" (variables in turn), "widest" (widest edge, the first if equal) or "smear" (the edge
            that moves f most); default "alternate" where only excluding, else "smear".
        max_boxes: a target is left before a level that would evaluate more boxes than this for it; default
            10^8, searching for solutions 10^7. All targets together never take more than 10^8, or max_boxes.
        max_depth: levels; default n (q - 1), else so many that every edge can be halved 20 times (float32:
            9).
        args: arrays with leading axis B, handed to f one entry a target.
        progress: called with the share of levels (adaptive) or targets (uniform) done.
        solutions: "none": only exclude, as the paper does; "one": a target is settled by its first solution;
            "all": go on until no box is left, so that `witness` and `boxes` hold all solutions, each box of
            `witness` exactly one (points, m = n), or nothing else (a target with an interior). Default:
            "none" with q or an f of Intervals, "all" for points and m = n, else "one".

    Returns:
        A Paving. Encloses: the images of `boxes`, together with what was excluded or settled, cover the image
        of `box`. FAULT: there is no z in `box` with f(z) in the target. CONSISTENT: there is one, for f in
        exact arithmetic, its constants the floats they are.

    Raises:
        ValueError: unbounded or empty box, a target that does not fit, a budget or q < 1, an unknown option,
            a uniform subdivision into more than max_boxes boxes.

    Example:
        >>> from jaxbound.sets.floats.status import Status
        >>> f = lambda z: [2 * z[0] ** 2 + z[1], z[0] - z[1]]
        >>> p = pave(f, interval([-1.0, 1.0], [2.0, 3.0]), [2.0, -2.0])
        >>> Status(p.status).name, len(p.witness), p.witness.mid[0].round(6).tolist()
        ('CONSISTENT', 2, [-0.5, 1.5])
        >>> p = pave(f, interval([-1.0, 1.0], [2.0, 3.0]), [2.0, -2.0], q=10)
        >>> Status(p.status).name, int(p.evaluated), len(p.boxes)
        ('UNDECIDED', 261, 20)
    """
    refuse_unverified(box, target, args)
    f, report = frozen(f), reporter(progress, "pave")
    box = interval(box)
    lo, hi = np.asarray(box.lo), np.asarray(box.hi)
    if lo.ndim != 1 or not len(lo) or not (np.isfinite(lo) & np.isfinite(hi)).all() or (lo > hi).any():
        raise ValueError("box must be a bounded, non-empty Interval of shape (n,)")
    goal, single = _goals(target, lo.dtype)
    count = goal.shape[0]
    arguments: tuple[Any, ...] = tuple(x if isinstance(x, jax.Array) else np.asarray(x) for x in args)
    if any(a.shape[:1] != (count,) for a in arguments):
        raise ValueError(
            f"every array of args needs one entry for each of the {count} targets: shapes "
            f"{[a.shape for a in arguments]}"
        )
    plain = is_interval_function(f, lo, tuple(jax.ShapeDtypeStruct(a.shape[1:], a.dtype) for a in arguments))
    region = isinstance(target, Interval)
    thick = region and bool((np.asarray(goal.lo) < np.asarray(goal.hi)).any())
    if solutions is None:
        solutions = "one"
        if q is not None or plain or subdivision == "uniform":
            solutions = "none"
        elif goal.shape[1] == len(lo) and not thick:
            solutions = "all"
    if q is None and (solutions == "none" or subdivision == "uniform"):
        q = 10
    if cut is None:
        cut = "alternate" if solutions == "none" else "smear"
    _check_options(subdivision, q, cut, max_boxes, max_depth, solutions, plain)
    most = (10**7 if solutions != "none" else 10**8) if max_boxes is None else max_boxes
    of_targets = partial(_of_targets, goal, arguments)
    again = partial(_images, of_targets(partial(_evaluate, f)), goal.shape[1])
    if subdivision == "uniform":
        if max_depth is not None:
            raise ValueError("max_depth belongs to subdivision='adaptive': the depth of a uniform one is q")
        assert q is not None
        cells = int(q) ** len(lo)
        if cells > most:
            raise ValueError(
                f"{q} pieces of {len(lo)} variables are {cells} boxes, more than max_boxes = {most}"
            )
        whole, meets = _cells(lo, hi, int(q)), of_targets(partial(_image_meets, f))
        none = Boxes(lo[:, None], hi[:, None], np.zeros(1, np.int32)).chosen(np.zeros(1, bool))
        kept, many = [], max(1, 2**20 // cells)  # targets at once
        for k in range(0, count, many):
            some = np.arange(k, min(k + many, count), dtype=np.int32)
            low, high = (np.tile(x, len(some)) for x in whole)
            own = Boxes(low, high, np.repeat(some, cells))
            if target is not None:
                own = own.chosen(judged_in_blocks(meets, *own, EXCLUDED)[0])
            kept.append(own)
            report((k + len(some)) / count)
        cover = Cover(none.beside(*kept), none, np.full(count, cells), 0)
    else:
        if target is None:
            raise ValueError(
                "adaptive subdivision needs a target; subdivision='uniform' covers the whole image"
            )
        depth = max_depth
        if depth is None:
            depth = len(lo) * (int(q) - 1 if q is not None else np.finfo(lo.dtype).nmant * 2 // 5)
        inner = solutions == "all" and thick
        one = partial(search, f, box, solutions == "all", region)
        if solutions == "none":
            one = partial(_image_meets, f)
        elif inner:
            one = partial(_inner, f)
        # to exclude is one evaluation, to prove needs derivatives as well: fewer at once
        kernel, size = of_targets(one), EXCLUDED if solutions == "none" else BLOCK

        def judge(lo: np.ndarray, hi: np.ndarray, owner: np.ndarray) -> Verdicts[np.ndarray]:
            return Verdicts(*judged_in_blocks(kernel, lo, hi, owner, size))

        axis = "kernel" if cut == "smear" else cut
        for cover in explore(judge, Boxes.repeated(lo, hi, count), depth, most, axis, solutions == "one"):
            if cover.levels:
                report(cover.levels / depth)
        if solutions != "none" and not inner and len(cover.proofs.owner):
            cover = cover._replace(proofs=_distinct(cover.proofs, solutions, kernel))
    (boxes, proofs, evaluated, levels), status = cover, None
    if target is not None:
        status = cover.status
    if single:
        status, evaluated = None if status is None else status[0], evaluated[0]
    turned = lambda lo, hi: Interval(jnp.asarray(lo.T), jnp.asarray(hi.T))
    witness, witness_owner = (turned(*proofs[:2]), proofs.owner) if len(proofs.owner) else (None, None)
    again = partial(again, boxes)
    return Paving(status, turned(*boxes[:2]), boxes.owner, evaluated, witness, witness_owner, levels, again)


def _check_options(
    subdivision: str,
    q: int | None,
    cut: str,
    max_boxes: int | None,
    max_depth: int | None,
    solutions: str,
    plain: bool,
) -> None:
    if subdivision not in ("adaptive", "uniform"):
        raise ValueError(f"subdivision must be 'adaptive' or 'uniform', not {subdivision!r}")
    if cut not in CUTS:
        raise ValueError(f"cut must be one of {', '.join(CUTS)}, not {cut!r}")
    if solutions not in SOLUTIONS:
        raise ValueError(f"solutions must be one of {', '.join(SOLUTIONS)}, not {solutions!r}")
    if plain and (solutions != "none" or cut == "smear"):
        raise ValueError(
            "proving solutions and cut='smear' need derivatives: give f as a function of numbers, not of "
            "Intervals"
        )
    for name, value, least in (("q", q, 1), ("max_boxes", max_boxes, 1), ("max_depth", max_depth, 0)):
        whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
        if value is not None and (not whole or value < least):
            raise ValueError(f"{name} must be a whole number >= {least}, not {value!r}")


def _goals(target: Operand | None, dtype: DTypeLike) -> tuple[Interval, bool]:
    """Return the targets as an Interval (B, m), m = 0 where there is none, and whether there is just one."""
    if target is None:
        target = np.zeros(0)
    goal = target if isinstance(target, Interval) else interval(np.asarray(target, dtype))
    single = len(goal.shape) == 1
    if len(goal.shape) not in (1, 2):
        raise ValueError(f"target must have shape (m,) or (B, m): its shape is {goal.shape}")
    return Interval(*(jnp.asarray(np.atleast_2d(end)) for end in (goal.lo, goal.hi))), single


@forgets
@kernel(static_argnums=0)
def _evaluate(
    f: Callable[..., Any], X: Interval, T: Interval, args: tuple[jax.Array, ...]
) -> tuple[Interval, ...]:
    """Enclose f over boxes X (n, N) with args (..., N), whatever the target: m Intervals (N,). Stacking them
    would break the fusion.
    """
    return tuple(jax.vmap(lambda X, *a: components(f, X, a), in_axes=-1)(X, *args))


def _of_targets(goal: Interval, args: tuple[Any, ...], kernel: Callable[..., Any]) -> Kernel:
    """Return kernel(boxes, targets (m, N), args (..., N)) as one of (lo, hi, owner).

    The host looks up what belongs to the target of each box: then nothing that compiles depends on the number
    of targets.
    """
    given = [np.ascontiguousarray(np.moveaxis(np.asarray(x), 0, -1)) for x in (goal.lo, goal.hi, *args)]

    def of(lo: np.ndarray, hi: np.ndarray, owner: np.ndarray) -> Any:
        low, high, *own = (x.take(owner, -1) for x in given)
        return kernel(Interval(lo, hi), Interval(low, high), tuple(own))

    return of


@forgets
@kernel(static_argnums=0)
def _image_meets(f: Callable[..., Any], X: Interval, T: Interval, args: tuple[jax.Array, ...]) -> jax.Array:
    """True for each box (n, N) whose image meets its target (closed sets)."""
    return _touch(_evaluate(f, X, T, args), T)


@forgets
@kernel(static_argnums=0)
def _inner(
    f: Callable[..., Any], X: Interval, T: Interval, args: tuple[jax.Array, ...]
) -> Verdicts[jax.Array]:
    """Return the Verdicts on boxes (n, N): settled are those that map into the target altogether."""
    images, (_, inside) = _evaluate(f, X, T, args), imaged(f, X, args)
    meets = _touch(images, T)
    for own, low, high in zip(images, T.lo, T.hi, strict=True):
        inside &= (low <= own.lo) & (own.lo <= own.hi) & (own.hi <= high)
    return Verdicts(meets & ~inside, inside, (X.lo, X.hi))


def _touch(images: Sequence[Interval], T: Interval) -> jax.Array:
    """Return whether every component shares a point with its target; a bound that is NaN excludes nothing."""
    if len(images) != len(T.lo):
        raise ValueError(f"the target has {len(T.lo)} components, f has {len(images)}")
    apart: jax.Array | bool = False
    for image, lo, hi in zip(images, T.lo, T.hi, strict=True):
        apart |= (image.lo > hi) | (lo > image.hi)
    return jnp.logical_not(apart)


def _distinct(proofs: Boxes, solutions: str, kernel: Kernel) -> Boxes:
    """Return one box for each solution that was proved, ordered by target, and as small as three more steps
    make it.
    """
    proofs = proofs.chosen(np.argsort(proofs.owner, kind="stable"))
    if solutions == "one":
        proofs = proofs.chosen(np.flatnonzero(np.diff(proofs.owner, prepend=-1)))
    lo, hi, owner = proofs
    for _ in range(3):
        said = Verdicts(*judged_in_blocks(kernel, lo, hi, owner))
        assert said.proved is not None and said.proof is not None
        # a box that Newton moved may be proved again, and narrower
        smaller = said.proved & ((said.proof[1] - said.proof[0]).max(0) < (hi - lo).max(0))
        lo, hi = (np.where(smaller, new, old) for new, old in zip(said.proof, (lo, hi), strict=True))
    if solutions == "one":
        return Boxes(lo, hi, owner)
    again = np.zeros(len(owner), bool)
    for shift in range(
        1, int(np.bincount(owner).max())
    ):  # two boxes that meet and whose hull has one solution: the same one
        i = np.flatnonzero(
            (owner[:-shift] == owner[shift:])
            & (lo[:, :-shift] <= hi[:, shift:]).all(0)
            & (lo[:, shift:] <= hi[:, :-shift]).all(0)
        )
        if len(i):
            whole = np.minimum(lo[:, i], lo[:, i + shift]), np.maximum(hi[:, i], hi[:, i + shift])
            again[i + shift] |= Verdicts(*judged_in_blocks(kernel, *whole, owner[i])).proved
    return Boxes(lo, hi, owner).chosen(~again)


def _images(kernel: Kernel, m: int, boxes: Boxes) -> Interval:
    """Return the images (N, m) of boxes."""
    # nothing is left, and no kernel takes no box
    if not len(boxes.owner):
        none = jnp.zeros((0, m), boxes.lo.dtype)
        return Interval(none, none)
    ends = judged_in_blocks(kernel, *boxes)
    return Interval(*(jnp.asarray(np.stack(x, 1)) for x in zip(*((x.lo, x.hi) for x in ends), strict=True)))


def _cells(lo: np.ndarray, hi: np.ndarray, q: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the ends (n, q^n) of the cells into which q pieces a variable cut a box."""
    share = np.arange(q + 1, dtype=lo.dtype) / q
    edges = lo[:, None] * (1 - share) + hi[:, None] * share  # hi - lo could overflow
    edges = np.clip(edges, lo[:, None], hi[:, None])
    edges[:, -1] = hi
    digits = np.indices((q,) * len(lo)).reshape(len(lo), -1)
    low, high = (np.take_along_axis(edges, digits + k, 1) for k in (0, 1))
    return low, high
