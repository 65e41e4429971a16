"""Interval linear systems M x = h: every x that solves M' x = h' for some M' in M and h' in h, enclosed."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.floats.probe import refuse_unverified
from jaxbound.sets.floats.unrolled import apart
from jaxbound.sets.intervals.interval import Interval, Operand, interval
from jaxbound.sets.linear_systems.hull import orthant_hull
from jaxbound.sets.linear_systems.kernels import Factored, contract, enclosed_solutions, factored
from jaxbound.sets.linear_systems.products import preconditioner, times
from jaxbound.text.objects import readable

METHODS = ("gauss", "gauss_seidel", "krawczyk", "hbr", "intersection", "hull")
PRECONDITIONS = ("midpoint", "diagonal", "none")
BLOCK = 64  # systems: a 9 x 9 one takes 1.3 KB, several times, and has to stay in the fastest caches


class Solvability(IntEnum):
    """The verdict on an interval linear system.

    `NOT_REGULAR`: no bounded enclosure was proved (a matrix in M may be singular); the box is the start box,
    or everything. `SOLVED`: the box encloses every solution. `INFEASIBLE`: proved that there is none (none in
    x0); the box is empty.

    Example:
        >>> Solvability.SOLVED.name
        'SOLVED'
    """

    NOT_REGULAR = 0
    SOLVED = 1
    INFEASIBLE = 2


@readable
@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class Solution:
    """Enclosures of the solutions of interval linear systems: x, an Interval (..., n), and status (...,)
    int8, see `Solvability`.
    """

    x: Interval
    status: jax.Array


def solve_interval(
    M: Operand,
    h: Operand,
    method: str = "intersection",
    x0: Operand | None = None,
    precondition: str = "midpoint",
) -> Solution:
    """Enclose every solution of an interval linear system M x = h, or of a batch of them.

    Args:
        M: Interval (or numbers) (..., r, n), r >= n. r > n: all rows hold at once.
        h: Interval (or numbers) (..., r). Leading axes of M and h broadcast; a matrix without them is
            prepared once for all h.
        method: "gauss" elimination, "hbr" (Hansen-Bliek-Rohn), "intersection" of both, narrowed by sweeps
            over the rows ("gauss_seidel" and "krawczyk" name the same: neither is narrower), or "hull": the
            exact hull but for rounding, orthant by orthant (n <= 8).
        x0: Interval (..., n): only solutions in this box are asked for.
        precondition: "midpoint" inverse of the middle of M, or "none" ("diagonal", which scales rows, changes
            no enclosure and names the same). More rows than unknowns need "midpoint" (a pseudo-inverse).

    Returns:
        A Solution: x Interval (..., n), status (...,).

    Encloses: where status is SOLVED, x holds every solution (in x0 if given), rounding included; INFEASIBLE
    is a proof; where no bound was proved the status is NOT_REGULAR and x is x0 or everything: never a wrong
    box.

    Raises:
        ValueError: shapes that do not fit, fewer rows than unknowns, an unknown method, "hull" of more than 8
            unknowns.

    Source: Neumaier 1990; Oettli, Prager 1964 (hull); Alhaj-Dibo, Maquin, Ragot 2004.

    Example:
        >>> M = interval([[2.0, -1.0], [-1.0, 2.0]], [[4.0, 1.0], [1.0, 4.0]])
        >>> s = solve_interval(M, interval([-2.0, -1.0], [2.0, 1.0]), method="hbr")
        >>> print(s.x.hi.round(4), Solvability(int(s.status)).name)
        [1.6667 1.3333] SOLVED
    """
    refuse_unverified(M, h, x0)
    M, h = interval(M), interval(h)
    x0 = None if x0 is None else interval(x0)
    _check(M.shape, h.shape, None if x0 is None else x0.shape, method, precondition)
    r, n = M.shape[-2:]
    batch = np.broadcast_shapes(M.shape[:-2], h.shape[:-1], () if x0 is None else x0.shape[:-1])
    dtype = jnp.result_type(M.dtype, h.dtype)
    M, h = (_flat(v, tail, batch, dtype) for v, tail in ((M, (r, n)), (h, (r,))))
    start = (
        interval(jnp.full((1, n), -jnp.inf, dtype), jnp.full((1, n), jnp.inf, dtype))
        if x0 is None
        else _flat(x0, (n,), batch, dtype)
    )
    x, status = _solve(M, h, start, method, precondition)
    full = lambda v, tail: jnp.broadcast_to(v, (max(1, int(np.prod(batch))), *tail)).reshape(*batch, *tail)
    return Solution(jax.tree.map(lambda v: full(v, (n,)), x), full(status, ()))


def _flat(v: Interval, tail: tuple[int, ...], batch: tuple[int, ...], dtype: DTypeLike) -> Interval:
    """Make the batch axes one; an array that all systems share keeps length 1 there."""
    shared = v.shape[: -len(tail)] == (1,) * (len(v.shape) - len(tail))
    return jax.tree.map(
        lambda a: (a if shared else jnp.broadcast_to(a, batch + tail)).astype(dtype).reshape(-1, *tail), v
    )


def _check(
    M: tuple[int, ...], h: tuple[int, ...], x0: tuple[int, ...] | None, method: str, precondition: str
) -> None:
    if method not in METHODS:
        raise ValueError(f"method must be one of {', '.join(METHODS)}, not {method!r}")
    if precondition not in PRECONDITIONS:
        raise ValueError(f"precondition must be one of {', '.join(PRECONDITIONS)}, not {precondition!r}")
    if len(M) < 2 or not len(h) or M[-2] != h[-1]:
        raise ValueError(f"solve_interval needs M (..., r, n) and h (..., r): the shapes are {M} and {h}")
    r, n = M[-2:]
    if r < n or not n:
        raise ValueError(f"M needs at least as many rows as unknowns (and one unknown): it is {r} x {n}")
    if r > n and precondition != "midpoint":
        raise ValueError(
            f"a system of {r} rows and {n} unknowns needs precondition='midpoint', not {precondition!r}"
        )
    if x0 is not None and (not len(x0) or x0[-1] != n):
        raise ValueError(f"x0 needs one interval for each of {n} unknowns: its shape is {x0}")
    if method == "hull" and n > 8:
        raise ValueError(
            f"the hull visits 2^n orthants and takes at most 8 unknowns, not {n}: use method='intersection'"
        )


@kernel(static_argnames=("method", "precondition"))
def _solve(
    M: Interval, h: Interval, start: Interval, method: str, precondition: str
) -> tuple[Interval, jax.Array]:
    """Enclose N systems, BLOCK at a time: they stay in the processor's cache. Shapes (N or 1, r, n), (N or 1,
    r), (N or 1, n).
    """
    prepared = _prepared(_last(M), precondition) if len(M) == 1 else None
    system, count = (M, h, start), max(len(M), len(h), len(start))

    def block(*parts):
        m, right, box = (_last(part) for part in parts)
        C, F = prepared or _prepared(m, precondition)
        return _enclosed_block(m, right, C, F, method, box)

    if count <= BLOCK:
        return block(*system)

    def step(i, out):  # the last block overlaps with the one before it: slices end where the arrays end
        part = [
            jax.tree.map(lambda a: jax.lax.dynamic_slice_in_dim(a, i * BLOCK, BLOCK), v) if len(v) > 1 else v
            for v in system
        ]
        return jax.tree.map(
            lambda a, b: jax.lax.dynamic_update_slice_in_dim(a, b, i * BLOCK, 0), out, block(*part)
        )

    boxes = Interval(*[jnp.zeros((count, M.shape[2]), M.dtype)] * 2)
    return jax.lax.fori_loop(0, -(-count // BLOCK), step, (boxes, jnp.zeros(count, jnp.int8)))


_last = apart(lambda x: jax.tree.map(lambda a: jnp.moveaxis(a, 0, -1), x))


def _prepared(M: Interval, precondition: str) -> tuple[jax.Array | None, Factored]:
    if precondition != "midpoint":
        return None, factored(M)
    C = preconditioner(M)
    return C, factored(times(C, M))


def _enclosed_block(
    M: Interval, h: Interval, C: jax.Array | None, F: Factored, method: str, start: Interval
) -> tuple[Interval, jax.Array]:
    """Enclose one block; shapes (r, n, N or 1), (r, N or 1), ..., (n, N or 1)."""
    box = enclosed_solutions(F, h if C is None else times(C, h), "hbr" if method == "hull" else method, start)
    if method == "hull":
        box = orthant_hull(M, h, box)
    elif M.shape[0] > M.shape[1]:
        box = contract(M, h, box)
    return _judged(box)


@apart
def _judged(box: Interval) -> tuple[Interval, jax.Array]:
    proved = jnp.all(jnp.isfinite(box.lo) & jnp.isfinite(box.hi), 0)
    empty = jnp.any(box.is_empty, 0)
    box = Interval(jnp.where(empty[None], jnp.inf, box.lo).T, jnp.where(empty[None], -jnp.inf, box.hi).T)
    status = jnp.where(
        empty, Solvability.INFEASIBLE, jnp.where(proved, Solvability.SOLVED, Solvability.NOT_REGULAR)
    )
    return box, status.astype(jnp.int8)
