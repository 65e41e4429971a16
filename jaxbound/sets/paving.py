"""Paving: cover the image of a box by boxes, or decide that a point is not in it.

Uniform subdivision of order q cuts every variable into q equal pieces. Adaptive bisection keeps a FIFO list: a box whose image
excludes the target is dropped, any other is cut in two; an empty list proves that the target is not in the image. The
list is worked off level by level for all targets of a batch at once, which gives the same boxes and counts as one at a time.

Source: Adrot, Maquin, Ragot 2000, 4.3, with the errata of `golden`: an excluded box goes on with step (5), and closed containment.
"""

from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.sets.interval import Interval, interval
from jaxbound.sets.status import Status

__all__ = ["Paving", "pave"]

BLOCKS = (2**10, 2**14)  # the only two sizes of a level that are compiled
CUTS = ("alternate", "widest")


@dataclass(frozen=True, eq=False)
class Paving:
    """The outcome of `pave`.

    Fields:
        status: int8, one a target: FAULT (proved: the target is not in the image) or UNDECIDED; None without a target.
        boxes: Interval (N, n), what is left of the box; owner (N,): the target that each belongs to.
        evaluated: boxes evaluated, one count a target.
        witness: None; a proof of membership by existence tests is not implemented yet.
    """

    status: np.ndarray | None
    boxes: Interval
    owner: np.ndarray
    evaluated: np.ndarray
    witness: None = None
    _again: Any = None  # a function that evaluates the images

    @cached_property
    def images(self):
        """Interval (N, m): the enclosures of f over `boxes`, evaluated when first asked for."""
        return self._again()

    def area(self):
        """Return the area of the union of the images in the plane (m = 2), to rounding.

        Raises:
            ValueError: m is not 2.
        """
        lo, hi = np.asarray(self.images.lo), np.asarray(self.images.hi)
        if lo.shape[1] != 2:
            raise ValueError(f"area is for two-dimensional images: these have {lo.shape[1]} dimensions")
        if not len(lo):
            return 0.0
        ticks = [np.unique(np.concatenate([lo[:, j], hi[:, j]])) for j in range(2)]
        covered = np.zeros((len(ticks[0]), len(ticks[1])), np.int32)  # 2-D difference array: +1 at corners, -1 past edges
        first = [np.searchsorted(t, lo[:, j]) for j, t in enumerate(ticks)]
        last = [np.searchsorted(t, hi[:, j]) for j, t in enumerate(ticks)]
        for i, j, sign in ((first[0], first[1], 1), (last[0], first[1], -1), (first[0], last[1], -1), (last[0], last[1], 1)):
            np.add.at(covered, (i, j), sign)
        covered = covered.cumsum(0).cumsum(1)[:-1, :-1] > 0
        return float(np.diff(ticks[0]) @ covered @ np.diff(ticks[1]))


def pave(f, box, target=None, subdivision="adaptive", q=10, cut="alternate", max_boxes=100_000_000, max_depth=None, args=(), progress=None):
    """Cover {f(z) : z in box} by boxes, or decide that `target` is not in it.

    Args:
        f: a function of an Interval (n,) (and of `args` for one target) that returns an Interval (m,) or a list of m, by outward-rounded
            operations. Pass the same function again to reuse its compilation.
        box: Interval (n,), bounded.
        target: None, a point (m,), points (B, m) or Intervals of them (known to lie inside).
        subdivision: "adaptive" or "uniform".
        q: uniform: the number of pieces per variable. Adaptive: the paper's threshold, stop at r > q - 1, that is after n (q - 1) levels.
        cut: "alternate" (variables in turn) or "widest" (widest edge, the first if equal).
        max_boxes: no new level is begun that would evaluate more boxes than this in total. max_depth: levels instead of n (q - 1).
        args: arrays with leading axis B, handed to f one entry a target.
        progress: called with the share of levels (adaptive) or targets (uniform) done.

    Returns:
        A Paving. Encloses: the images of `boxes`, together with what was excluded, cover the image of `box`.

    Raises:
        ValueError: unbounded or empty box, a target that does not fit, q < 1, unknown subdivision or cut, a uniform subdivision into
            more than max_boxes boxes.
        NotImplementedError: cut="smear".

    Example:
        >>> f = lambda z: [2 * z[0] ** 2 + z[1], z[0] - z[1]]
        >>> p = pave(f, interval([-1.0, 1.0], [2.0, 3.0]), [2.0, -2.0])
        >>> int(p.evaluated), len(p.boxes)
        (261, 20)
    """
    if subdivision not in ("adaptive", "uniform"):
        raise ValueError(f"subdivision must be 'adaptive' or 'uniform', not {subdivision!r}")
    if cut == "smear":
        raise NotImplementedError("cut='smear' is not implemented yet; use 'alternate' or 'widest'")
    if cut not in CUTS:
        raise ValueError(f"cut must be one of {', '.join(CUTS)}, not {cut!r}")
    if isinstance(q, bool) or not isinstance(q, (int, np.integer)) or q < 1:
        raise ValueError(f"q must be a whole number >= 1, not {q!r}")
    box = interval(box)
    lo, hi = np.asarray(box.lo), np.asarray(box.hi)
    if lo.ndim != 1 or not (np.isfinite(lo) & np.isfinite(hi)).all() or (lo > hi).any():
        raise ValueError("box must be a bounded, non-empty Interval of shape (n,)")
    goal, single = _goals(target, lo.dtype)
    count = 1 if goal is None else goal.shape[0]
    args = tuple(jnp.asarray(a) for a in args)
    if any(a.shape[:1] != (count,) for a in args):
        raise ValueError(f"every array of args needs one entry for each of the {count} targets: shapes {[a.shape for a in args]}")
    if subdivision == "uniform":
        if max_depth is not None:
            raise ValueError("max_depth belongs to subdivision='adaptive': the depth of a uniform one is q")
        if int(q) ** len(lo) > max_boxes:
            raise ValueError(f"{q} pieces of {len(lo)} variables are {int(q) ** len(lo)} boxes, more than max_boxes = {max_boxes}")
        found = _uniform(f, lo, hi, goal, args, count, int(q), progress)
    else:
        if goal is None:
            raise ValueError("adaptive subdivision needs a target; subdivision='uniform' covers the whole image")
        depth = len(lo) * (int(q) - 1) if max_depth is None else max_depth
        found = _adaptive(f, lo, hi, goal, args, depth, cut, max_boxes, progress)
    left_lo, left_hi, owner, evaluated = found
    status = None
    if goal is not None:
        status = np.where(np.bincount(owner, minlength=count) == 0, np.int8(Status.FAULT), np.int8(Status.UNDECIDED))
    if single:
        status, evaluated = None if status is None else status[0], evaluated[0]
    return Paving(status, Interval(jnp.asarray(left_lo.T), jnp.asarray(left_hi.T)), owner, evaluated,
                  _again=partial(_images, f, left_lo, left_hi, owner, args, goal.shape[1] if goal is not None else 0))  # fmt: skip


def _goals(target, dtype):
    """Return the targets as an Interval (B, m), and whether there is just one."""
    if target is None:
        return None, True
    goal = target if isinstance(target, Interval) else interval(np.asarray(target, dtype))
    single = len(goal.shape) == 1
    if len(goal.shape) not in (1, 2):
        raise ValueError(f"target must have shape (m,) or (B, m): its shape is {goal.shape}")
    return Interval(jnp.atleast_2d(goal.lo), jnp.atleast_2d(goal.hi)), single


def _evaluate(f, lo, hi, args):
    """Enclose f over boxes (n, N) with args (..., N): a list of m Intervals (N,). Stacking them would break the fusion."""
    return jax.vmap(lambda lo, hi, *a: list(f(Interval(lo, hi), *a)), in_axes=-1)(lo, hi, *args)


def _of_owner(args, owner):
    """Return args (B, ...) as (..., N), each column that of the box's target."""
    return tuple(jnp.moveaxis(a, 0, -1)[..., owner] for a in args)


@partial(jax.jit, static_argnums=0)
def _meets(f, lo, hi, owner, goal, args):
    """True for each box (n, N) whose image meets the target of its owner (closed sets)."""
    images = _evaluate(f, lo, hi, _of_owner(args, owner))
    return _touch(images, [(goal.lo[:, j][owner], goal.hi[:, j][owner]) for j in range(goal.shape[1])])


def _touch(images, goals):
    """True where every component shares a point with its goal (lo, hi); a bound that is NaN excludes nothing."""
    if len(images) != len(goals):
        raise ValueError(f"the target has {len(goals)} components, f has {len(images)}")
    apart = False
    for image, (lo, hi) in zip(images, goals, strict=True):
        apart |= (image.lo > hi) | (lo > image.hi)
    return ~apart


@partial(jax.jit, static_argnums=0)
def _image_block(f, lo, hi, owner, args):
    return _evaluate(f, lo, hi, _of_owner(args, owner))


def _in_blocks(kernel, lo, hi, owner):
    """Yield the results of a kernel over blocks of two fixed sizes, and how many columns of each count."""
    total = lo.shape[1]
    size = BLOCKS[0] if total <= BLOCKS[0] else BLOCKS[1]
    running = []
    for start in range(0, total, size):
        part = slice(start, start + size)
        count = min(size, total - start)
        fill = [(0, size - count)]
        block = (lo[:, part], hi[:, part], owner[part])
        if count < size:
            block = (np.pad(block[0], [(0, 0), *fill]), np.pad(block[1], [(0, 0), *fill]), np.pad(block[2], fill))
        running.append((kernel(*block), count))
    return running


def _images(f, lo, hi, owner, args, width):
    parts = _in_blocks(lambda *b: _image_block(f, *b, args), lo, hi, owner)
    if not parts:
        return Interval(jnp.zeros((0, width), lo.dtype), jnp.zeros((0, width), lo.dtype))
    join = lambda end: jnp.asarray(np.concatenate([np.stack([getattr(x, end) for x in image], 1)[:count] for image, count in parts]))
    return Interval(join("lo"), join("hi"))


def _adaptive(f, lo, hi, goal, args, depth, cut, max_boxes, progress):
    count = goal.shape[0]
    lo, hi = (np.repeat(x[:, None], count, 1) for x in (lo, hi))
    owner = np.arange(count, dtype=np.int32)
    evaluated = np.zeros(count, np.int64)
    for level in range(depth):
        if not len(owner) or evaluated.sum() + len(owner) > max_boxes:
            break
        evaluated += np.bincount(owner, minlength=count)
        parts = _in_blocks(lambda *b: _meets(f, *b, goal, args), lo, hi, owner)
        kept = np.flatnonzero(np.concatenate([np.asarray(x)[:n] for x, n in parts]))
        lo, hi, owner = _cut(lo[:, kept], hi[:, kept], owner[kept], level % len(lo) if cut == "alternate" else None)
        if progress is not None:
            progress((level + 1) / depth)
    return lo, hi, owner, evaluated


def _cut(lo, hi, owner, axis):
    """Cut boxes (n, N) in two along one axis, or along the widest edge of each; children follow each other."""
    axis = np.argmax(hi - lo, 0) if axis is None else np.full(lo.shape[1], axis)
    columns = np.arange(lo.shape[1])
    middle = lo[axis, columns] * 0.5 + hi[axis, columns] * 0.5
    lo, hi = np.repeat(lo, 2, 1), np.repeat(hi, 2, 1)
    hi[axis, 2 * columns] = middle
    lo[axis, 2 * columns + 1] = middle
    return lo, hi, np.repeat(owner, 2)


def _uniform(f, lo, hi, goal, args, count, q, progress):
    n = len(lo)
    share = np.arange(q + 1, dtype=lo.dtype) / q
    edges = np.clip(lo[:, None] * (1 - share) + hi[:, None] * share, lo[:, None], hi[:, None])  # hi - lo could overflow
    edges[:, -1] = hi
    digits = np.indices((q,) * n).reshape(n, -1)
    cell_lo, cell_hi = (np.stack([edges[i][digits[i] + k] for i in range(n)]) for k in (0, 1))
    total = digits.shape[1]
    if goal is None:
        return cell_lo, cell_hi, np.zeros(total, np.int32), np.array([total])
    kept = []
    share = max(1, 2**27 // total)  # targets at once: the answers are one byte a box
    for start in range(0, count, share):
        part = slice(start, start + share)
        block = Interval(goal.lo[part], goal.hi[part])
        meet = np.asarray(_meets_uniform(f, cell_lo, cell_hi, block, tuple(a[part] for a in args)))
        which, cell = np.nonzero(meet)
        kept.append((which + start, cell))
        if progress is not None:
            progress(min(start + share, count) / count)
    owner, cell = (np.concatenate(x) for x in zip(*kept, strict=True))
    return cell_lo[:, cell], cell_hi[:, cell], owner.astype(np.int32), np.full(count, total)


@partial(jax.jit, static_argnums=0)
def _meets_uniform(f, lo, hi, goal, args):
    def one(now):
        (goal_lo, goal_hi), a = now
        return _touch(_evaluate(lambda z: f(z, *a), lo, hi, ()), list(zip(goal_lo, goal_hi, strict=True)))

    return jax.lax.map(one, ((goal.lo, goal.hi), args))
