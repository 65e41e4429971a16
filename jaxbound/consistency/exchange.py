"""Verdicts for relations whose circuits are too many to enumerate: the exchange search of
`sets.strips.separation` over blocks of windows.

Windows are gathered into blocks of one fixed size. Those that a first, short search leaves open are gathered
again and searched on; those that lack a sample on which the search is built get an exact frame without it,
shared by all windows that it fits.
"""

import dataclasses
from collections.abc import Callable
from functools import cached_property, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.consistency import whole_numbers
from jaxbound.consistency.interface import Judged, LinearRelations, WindowTest
from jaxbound.consistency.reading import gather
from jaxbound.consistency.strips_on_host import contradicted_by
from jaxbound.consistency.twice import Twice
from jaxbound.consistency.unproved import unproved_margins
from jaxbound.exact.frames import ExactFrame, reframe
from jaxbound.recordings.recording import Recording
from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.floats.sizes import power
from jaxbound.sets.floats.status import Status
from jaxbound.sets.strips import separation

__all__ = [
    "PATIENCE",
    "ExchangeTest",
    "candidates",
    "exchange_margins",
    "imaged",
    "rounded_frame",
    "verdicts",
]

CONSISTENT, UNDECIDED, FAULT = map(np.int8, (Status.CONSISTENT, Status.UNDECIDED, Status.FAULT))
PATIENCE = 10
"""Exchanges per inner row after which a search is given up; it takes 2 to 4."""
LARGE = 2048
"""Numbers of a window that an exchange changes, above which fewer stand side by side."""
FINER = (1.0, 3e-4, 1e-5, 0.03, 0.0, 0.3, 1e-4, 3e-6, 3e-3)
"""Searches after which a window stays undecided, see `separation_search`: one in some thousands needs more
than the first.
"""


class ExchangeTest(WindowTest):
    """Searches for the combination of relations that speaks most against a window, or the behaviour that
    explains it.

    Both verdicts are proofs. Windows that a first, short search leaves open are searched on; those that lack
    a sample on which the search is built get an exact frame without it, shared by all windows that it fits.

    Args:
        reading: how kernels read a window, with the frame of this search; None: that of the relations. steps,
            finer: of `separation.separation_search`.
    """

    relations: LinearRelations

    threads = twice = True
    short = 16  # the work grows with the block

    def __init__(
        self, relations: Any, dtype: Any, reading: Any = None, steps: int | None = None, finer: float = 1.0
    ) -> None:
        super().__init__(relations, "joint", dtype)
        self.finer = finer
        if reading is not None:
            self.reading = reading
        self.steps = 2 * len(relations.frame.inner) + 6 if steps is None else steps

    @property
    def constants(self) -> Any:
        """The reading, and how long and how finely to search."""
        return self.reading, self.steps, self.finer

    @property
    def block(self) -> int:
        """How many windows are judged at once: their inverses should stay in the cache."""
        return _block_of(self.reading.shape)

    @property
    def outputs(self) -> tuple:
        """The margins, whose sign is the verdict."""
        return ((self.dtype, np.nan),)

    def judge(self, run: Callable, blocks: list) -> list:
        """Return (margin, open): proofs, in a second kernel, of what a first one finds; between them are real
        arrays, as proofs need.
        """
        ones = [np.ones(y.shape[-1], self.dtype) for _, y in blocks]
        searched = run(candidates, [(one, *block) for one, block in zip(ones, blocks, strict=True)])
        judged = run(verdicts, [(one, *found) for one, found in zip(ones, searched, strict=True)])
        decided = (
            self._twice.decided(
                margin, partial(self._by_hints, block, found), partial(self._contradicted, block, found)
            )
            for block, found, (margin, _) in zip(blocks, searched, judged, strict=True)
        )
        return [(margin, ~np.asarray(settled)) for margin, (_, settled) in zip(decided, judged, strict=True)]

    @cached_property
    def _twice(self):
        return Twice(self.block)

    def _by_hints(self, block, found, at):
        """Return the margins of some windows of a block, in NumPy from their samples, by what the search
        found for them.
        """
        one, (u, y), (h, d, done) = (
            np.ones(len(at), self.dtype),
            (x[..., at] for x in block),
            (np.asarray(x)[..., at] for x in found[:3]),
        )
        return verdicts(self.constants, one, h, d, done, *imaged(self.constants, one, u, y))[0]

    def _contradicted(self, block, found, at):
        """Return which windows of a block the combinations that the search found contradict; see
        `contradicted_by`.
        """
        if self.reading.window.sums:
            return np.zeros(len(at), bool)
        u, y = (x[..., at] for x in block)
        return contradicted_by(self.reading, self.reading.shape, u, y, np.asarray(found[0])[:, at])

    def write(self, outs: list, at: np.ndarray, found: tuple) -> None:
        """Write margins; a proof stays one."""
        (margin,), (values,) = outs, found
        if np.count_nonzero(nothing := values == 0):
            values = np.where(nothing & (abs(margin[at]) > 0), margin[at], values)
        margin[at] = values

    def settle(
        self, u: np.ndarray, y: np.ndarray, outs: list, left: np.ndarray, again: Callable, progress: Callable
    ) -> None:
        """Decide what rounding leaves open far from the boundary, then search on with frames that fit the
        samples that are there.
        """
        (margin,), s = outs, self.horizon
        self._whole_numbers(u, y, margin)
        assert self.relations.frame is not None
        k = len(self.relations.frame.inner)
        for frame, chosen in self._frames(u, y, left):
            starts = left[chosen]
            own = frame is self.relations.frame
            reading = (
                self.reading
                if own
                else dataclasses.replace(self.reading, shape=rounded_frame(self.relations, frame, self.dtype))
            )
            for finer in FINER:
                starts = again(
                    ExchangeTest(self.relations, self.dtype, reading, PATIENCE * (k + 10), finer), starts
                )
                starts = starts[margin[starts + s] == 0]  # what is proved needs no other search
                if not len(starts):
                    break

    def judged(self, outs: list) -> Judged:
        """Return the verdicts that the margins say."""
        (margin,) = outs
        return Judged(
            CONSISTENT * (margin > 0) + UNDECIDED * (margin == 0) + FAULT * (margin < 0), margin
        )  # NaN: MISSING, which is 0

    def margins(self, given: Recording) -> jax.Array:
        """Return the unproved margins (..., T); see `WindowTest.margins`."""
        return unproved_margins(self, exchange_margins, _given_margins, given, search=_best)

    def _whole_numbers(self, u, y, margin):
        if not np.count_nonzero(nothing := margin == 0):
            return
        starts = np.flatnonzero(nothing) - self.horizon
        starts = starts[whole_numbers.thin(self.reading, *self._gather(u, y, starts))]
        for frame, chosen in self._frames(u, y, starts):
            windows = gather(u, y, starts[chosen], self.lags, self.horizon)
            margin[starts[chosen] + self.horizon] = whole_numbers.exact_search(
                self.relations, self.reading, frame, *windows
            )

    def _gather(self, u, y, starts):
        u, y = gather(u, y, starts, self.lags, self.horizon)
        return u, self.reading.seen(y)

    def _frames(self, u, y, starts):
        """Return [(exact frame, numbers of windows)]: for every window a frame whose inner rows and inputs it
        has.
        """
        if not len(starts):
            return []
        gathered = gather(u, y, starts, self.lags, self.horizon)
        missing, absent = (
            np.isnan(gathered[0]).reshape(-1, len(starts)).T,
            self.reading.window.absent(gathered[1]).T,
        )
        patterns, which = np.unique(np.concatenate([absent, missing], 1), axis=0, return_inverse=True)
        rows = absent.shape[1]
        frames, numbers = [self.relations.frame], []
        by_inputs: dict[tuple[int, ...], list[int]] = {(): [0]}
        for pattern in patterns:
            gone, inputs = (
                set(np.flatnonzero(pattern[:rows]).tolist()),
                tuple(np.flatnonzero(pattern[rows:]).tolist()),
            )
            number = next((i for i in by_inputs.get(inputs, ()) if _fits(frames[i], gone, inputs)), None)
            if number is None:
                number = len(frames)
                assert self.relations.frame is not None
                frames.append(reframe(self.relations.frame, gone, inputs))
                by_inputs.setdefault(inputs, []).append(number)
            numbers.append(number)
        chosen = np.array(numbers)[which.ravel()]
        return [(frames[i], np.flatnonzero(chosen == i)) for i in np.unique(chosen).tolist()]


@jax.jit
def exchange_margins(test: Any, u: jax.Array, y: jax.Array) -> jax.Array:
    """Return the unproved margins (T - s,) of one recording u (T, m), y (T, p): NaN where data are
    missing.
    """
    return _given_margins(test, u, y)


def _given_margins(test: Any, u: jax.Array, y: jax.Array, best: jax.Array | None = None) -> jax.Array:
    """Return the same, differentiable; best: from `_best`, else it is searched for."""
    if best is None:
        found = _over_blocks(lambda *rows: separation.separation_margin(test.shape, *rows), test, u, y)
    else:
        found = _over_blocks(
            lambda mid, rad, known, best: separation.margin_of(best, mid, rad, known), test, u, y, best
        )
    return found.reshape(-1)[: y.shape[0] - test.horizon]


def _best(test: Any, u: jax.Array, y: jax.Array) -> jax.Array:
    """Return the combinations (blocks, rows + l, N) that speak most against each window: margins and their
    derivatives follow from them.
    """
    return _over_blocks(lambda *rows: separation.separation_best(test.shape, *rows), test, u, y)


def _over_blocks(kernel, test, u, y, *more):
    """Return what kernel(mid, rad, known, *one of each of more) gives of all windows of a recording, block
    after block.
    """
    count, size = y.shape[0] - test.horizon, _block_of(test.shape)
    blocks = -(-count // size)
    fill = lambda x: jnp.pad(x, ((0, blocks * size - count), (0, 0)), mode="edge")
    u, y = fill(u), fill(y)

    def one_block(given):
        first, *rest = given
        take = lambda x, lags: jnp.moveaxis(
            x[first + jnp.arange(lags)[:, None] + jnp.arange(size)[None]], 1, 2
        )
        mid, rad, _, known, _ = test.block(take(u, test.lags), take(y, test.horizon + 1))
        return kernel(mid, rad, known, *rest)

    return jax.lax.map(one_block, (size * jnp.arange(blocks), *more))


@kernel
def candidates(given: Any, one: jax.Array, u: jax.Array, y: jax.Array) -> tuple[jax.Array, ...]:
    """Return the combinations (h, d, done) that speak most against each window of a block, and their `Image`;
    nothing is proved yet.
    """
    test, steps, finer = given
    image = _imaged(given, one, u, y)
    return *separation.separation_search(test.shape, image, one, steps, finer), *image


def _imaged(given, one, u, y):
    """Return the `Image` of the windows of a block."""
    test, *_ = given
    mid, rad, scale, known, known_scale = (x / one[None] for x in test.block(u, y))
    return separation.separation_image(test.shape, mid, rad, scale, known, known_scale, test.lift, one)


imaged = kernel(_imaged)


@kernel
def verdicts(
    given: Any, one: jax.Array, h: jax.Array, d: jax.Array, done: jax.Array, *image: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Return (margin, settled) of the windows of a block, proved from what `candidates` found."""
    test, *_ = given
    return separation.separation_verdict(test.shape, separation.Image(*image), one, h, d, done)


def _block_of(frame):
    """Return how many windows stand side by side: what their exchanges change should stay in the cache."""
    c, k = frame.R.shape
    if k <= 8:
        return 1024
    return 64 if min(c, k) * k <= LARGE else 16


def rounded_frame(relations: Any, frame: ExactFrame, dtype: Any) -> separation.Frame:
    """Return a frame in floats, of one of few widths, so that few are compiled."""
    k, more = len(relations.frame.inner), len(frame.inner) - len(relations.frame.inner)
    return separation.frame_of(frame, dtype, k + (power(more) if more > 0 else 0))


def _fits(frame, gone, inputs):
    """Say whether a frame serves windows without the rows `gone` and the inputs `inputs`, which it was made
    without.
    """
    relations = zip(frame.used, frame.outer, frame.K, strict=True)
    return gone.isdisjoint(frame.inner) and not any(
        row[b] for used, j, row in relations if used and j not in gone for b in inputs
    )
