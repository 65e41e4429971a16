"""Parity relations of a certain model with imperfect sensors: the unknown state is eliminated exactly.

    external form  p_ext = W (Y - H U)                      numbers
    internal form  p_int = W mu,  mu_i in [y - t_hi, y - t_lo] for each sample    a zonotope
    circuits       every minimal-support combination of the relations: the strips of that zonotope, as long as
    they can be counted

A disturbance w counts as rows of its own: relations and circuits have the coefficients of Y first, then those
of w_k .. w_{k+s-1}. W is a rational left null space, so W O = 0 exactly for the decimals of the model; floats
appear only as nearest values of exact coefficients, whose error `sets.floats.rounding` counts. Source: Adrot,
Maquin, Ragot 2000, (6)-(9), (13)-(15).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property, partial
from typing import ClassVar, Self, TypeVar, cast

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike, DTypeLike

from jaxbound.consistency.exchange import ExchangeTest
from jaxbound.consistency.gains import GainsTest
from jaxbound.consistency.interface import (
    METHODS,
    Budget,
    LinearRelations,
    Starts,
    WindowTest,
    refuse_options,
)
from jaxbound.consistency.reading import Reading
from jaxbound.consistency.strips import StripsTest
from jaxbound.exact import linalg
from jaxbound.exact.circuits import circuits
from jaxbound.exact.frames import ExactFrame, frame
from jaxbound.exact.linalg import Matrix, Rows, Vector
from jaxbound.models import window
from jaxbound.models.arguments import whole_horizon
from jaxbound.models.conversion import ModelLike, as_model
from jaxbound.models.system import LinearSystem
from jaxbound.relations.bounds import Bounds, changed_bounds, model_bounds, reading
from jaxbound.relations.cost import affordable, refuse_many_states
from jaxbound.relations.forms import Formed, Forms, forms, over_samples
from jaxbound.relations.lags import checked_lags, lagged, over_all_rows
from jaxbound.relations.sentence import main_terms, relation_text
from jaxbound.relations.still import without_still
from jaxbound.relations.uncertain import UncertainRelations, uncertain_relations
from jaxbound.sets.floats.kernel import kernel
from jaxbound.sets.strips.separation import Frame, frame_of
from jaxbound.sets.strips.strips import Strips, strips_of
from jaxbound.text.objects import readable
from jaxbound.text.progress import in_part, reporter

ZERO = Fraction(0)
T = TypeVar("T")
SUBSETS, TESTED = 4_000, 400
"""Subsets of rows among which circuits are looked for, and circuits up to which they are tested one by one;
beyond, an exchange search is faster."""
PRIME = 2**61 - 1
"""Ranks that need not be right are taken modulo this prime."""


@readable
@jax.tree_util.register_dataclass
@dataclass(frozen=True, eq=False)
class ParityRelation(Formed, LinearRelations):
    """Independent parity relations over a window of horizon + 1 samples. Build it with `parity_relations`.

    Fields: bounds {"tolerance": (p,), "noise": (p,)}, and "disturbance": (g, 2) if the model has one (floats,
    never tighter than the model's decimals), model, horizon, form, W (count, (s+1)p + gs) and K (count, l): W
    (Y, w) = K U for an exact plant, with exact entries; p_ext = W (Y, 0) - K U. circuits, circuits_known: the
    strips, none where they are too many; frame: then what the exchange search needs
    (`sets.strips.separation`), else None. lags: so many samples before its last a window looks at the
    outputs; None: always.
    """

    untuned: ClassVar[str | None] = None

    bounds: Bounds = field()  # no default, whatever the family of all relations has
    model: LinearSystem = field(metadata={"static": True})
    horizon: int = field(metadata={"static": True})
    form: str = field(metadata={"static": True})
    W: Matrix = field(metadata={"static": True})
    K: Matrix = field(metadata={"static": True})
    circuits: Matrix = field(metadata={"static": True})
    circuits_known: Matrix = field(metadata={"static": True})
    frame: ExactFrame | None = field(default=None, metadata={"static": True})
    lags: tuple[int, ...] | None = field(default=None, metadata={"static": True})

    def _head(self) -> str:
        return f"ParityRelation: {self.count} relations over {self.horizon + 1} samples"

    def _rows(self) -> dict[str, str]:
        return {
            "model": repr(self.model),
            "r1": main_terms(relation_text(self.model, self.horizon, self.W[0], self.K[0])),
        }

    @property
    def count(self) -> int:
        """Number of independent relations."""
        return len(self.W)

    @property
    def made(self) -> tuple[object, ...]:
        """The form and the lags, on which relations depend beside model, horizon and bounds."""
        return self.form, self.lags

    @property
    def methods(self) -> tuple[str, ...]:
        """The methods of `test`: "joint" alone knows bounds of averages."""
        return METHODS[:1] if self.model.averages else METHODS

    @property
    def searched(self) -> bool:
        """Whether a search decides the windows: where circuits are too many to be tested one by one."""
        return self.frame is not None

    @cached_property
    def _moving(self) -> ParityRelation | None:
        return without_still(self, self.of)

    def of(self, model: LinearSystem) -> Self:
        """Return the relations of another model over the same window."""
        return cast(Self, parity_relations(model, form=self.form, **self.span))

    @cached_property
    def _framed(self) -> ParityRelation:
        """The same relations with a frame for a search."""
        if self.frame is not None:
            return self
        return dataclasses.replace(self, frame=_frame(self.model, self.horizon, self.lags))

    @cached_property
    def _joint(self) -> Strips:
        return strips_of(self.circuits, self.circuits_known)

    @cached_property
    def _alone(self) -> Strips:
        return strips_of(self.W, self.K)

    @cached_property
    def _frames(self) -> dict[np.dtype, Frame]:
        return {}

    def _rounded_frame(self, dtype: DTypeLike) -> Frame:
        """Return the frame in floats, rounded once for each type."""
        assert self.frame is not None
        kind = np.dtype(dtype)
        if kind not in self._frames:
            self._frames[kind] = frame_of(self.frame, kind)
        return self._frames[kind]

    def reading(self, dtype: DTypeLike, method: str = "joint") -> Reading:
        """Return the Reading of all circuits ("joint") or of each relation alone ("box") in a float dtype."""
        shape: Strips | Frame
        if method == "box":
            shape = self._alone.astype(dtype)
        elif self.frame is None:
            shape = self._joint.astype(dtype)
        else:
            shape = self._rounded_frame(dtype)
        return reading(shape, self.model, self.horizon, self.bounds, dtype, self.lags)

    def test(self, method: str, dtype: DTypeLike, budget: Budget = None) -> WindowTest:
        """Return the WindowTest by which a method decides windows; see `detect`.

        Raises:
            ValueError: a method or budget that these relations cannot be tested by.
        """
        refuse_options(method, budget)
        # a disturbance without a width would be divided by: windows are those of a model without it
        if self._moving is not None:
            return self._moving.test(method, dtype, budget)
        if self.model.averages and method != "joint":
            raise ValueError(f"averages are tested by method 'joint': {method!r} looks at single samples")
        if self.model.constant_tolerance:
            # a gain that stays ties all samples together: no circuit is tested by itself
            return GainsTest(self._framed, method, dtype)
        if method == "joint" and self.frame is not None:
            return ExchangeTest(self, dtype)
        return StripsTest(self, method, dtype)

    def with_bounds(self, bounds: Mapping[str, ArrayLike]) -> Self:
        """Return the same relations under other bounds.

        Args:
            bounds: {"tolerance": (p,), "noise": (p,), "disturbance": (g,) or (g, 2)}, or some of them;
                arrays, numbers or tracers.

        Raises:
            ValueError: an unknown name, a wrong shape, a negative bound, a tolerance >= 1, lo > hi, NaN or
                infinity.
        """
        return dataclasses.replace(self, bounds=changed_bounds(self.model, self.bounds, bounds))

    def _forms(self, u: object, y: object, starts: Starts) -> Forms:
        return forms(_forms, self, partial(self.reading, method="box"), u, y, starts)

    def text(self, circuits: bool = False) -> str:
        """Return the relations, one a line, as a reader would write them; all circuits instead if asked for.

        Example:
            >>> m = LinearSystem([[0.8, 1], [0, 0.2]], [[0], [1]], [[1, 0], [1, 1]])
            >>> print(parity_relations(m).text())
            r1: y1[k-1] - 5 y2[k-1] + 5 y1[k] = 0
            r2: 4 y2[k-1] - 10 y1[k] + 5 y2[k] - 5 u1[k-1] = 0
        """
        letter, method = ("c", "joint") if circuits else ("r", "box")
        lines = []
        for i, (h, k) in enumerate(zip(*self.strips(method), strict=True), 1):
            lines.append(f"{letter}{i}: {relation_text(self.model, self.horizon, h, k)}")
        return "\n".join(lines)


@kernel
def _forms(reading: Reading, u: jax.Array, y: jax.Array) -> Forms:
    """Return the Forms (T, count) of the relations one by one."""
    s, windows = reading.horizon, reading.windows(u, y)
    mid, rad, _, known, _ = reading.block(*windows)
    samples = (windows[1] - reading.offset_y[None, :, None]).reshape(-1, mid.shape[1])
    samples = jnp.concatenate([samples, jnp.zeros_like(mid[len(samples) :])])  # nobody measures a disturbance

    def one(strip: tuple[jax.Array, ...]) -> Forms:
        rows, h, k = strip

        def total(weights: jax.Array, x: jax.Array) -> jax.Array:
            return jnp.sum(weights[:, None] * x[rows], 0)

        driven = jnp.sum(jnp.where(k[:, None] == 0, 0, k[:, None] * known), 0)  # 0 * NaN is NaN
        return total(h, samples) - driven, total(h, samples - mid), total(abs(h), rad)

    strips = reading.strips
    external, centre, width = jax.lax.map(one, (strips.rows, strips.h, strips.k))
    return over_samples(external, s), over_samples(centre - width, s), over_samples(centre + width, s)


def parity_relations(
    model: ModelLike,
    horizon: int | None = None,
    form: str = "first",
    progress: Callable[[float], object] | None = None,
    lags: Sequence[int] | None = None,
) -> ParityRelation | UncertainRelations:
    """Eliminate the unknown state from a window exactly: chooses the elimination that the model needs.

    Args:
        model: a LinearSystem, or a discrete state-space object of python-control or scipy.signal (perfect
            sensors then).
        horizon: s >= 0, a window has s + 1 samples; None: that of the model, or its lags, for which its
            bounds were found; without them, the smallest at which every output that can be checked is checked
            (and, with uncertainties, all states that can be seen are seen).
        form: "first" (all samples on the first state) or "second" (dynamics stacked). They test the same set;
            the basis of the relations, and with it the box test, differs.
        progress: called with the share of the work done: many states or a long window take minutes.
        lags: samples before its last, 0 among them, at which a window looks at the outputs, in place of
            horizon: (0, 1, 2, 4, 8, 16, 32) remembers as long as 33 samples with the rows of 7. It uses every
            input and disturbance between: an input that is missing anywhere is missing.

    Returns:
        A ParityRelation. "first" gives relations that span as few samples as possible, with coprime integers.
        UncertainRelations if the model has uncertainties.

    Raises:
        ValueError: no relation at this horizon or these lags; a window so long that exact numbers would not
            end (`relations.cost`); lags of a model with uncertainties; uncertainties under which some state
            is seen at some values and not at others.

    Source: Adrot, Maquin, Ragot 2000, (6), (13); Ploix, Adrot 2006, (2)-(3), (5).

    Example:
        >>> m = LinearSystem([[0.8, 1], [0, 0.2]], [[0], [1]], [[1, 0], [1, 1]])
        >>> r = parity_relations(m)
        >>> r.horizon, r.count, len(r.circuits)
        (1, 2, 4)
    """
    model, report = as_model(model, factors=True), reporter(progress, "relations")
    if form not in ("first", "second"):
        raise ValueError(f"form must be 'first' or 'second', not {form!r}")
    # bounds that were found from data hold for the windows that they were found for
    if lags is None and horizon is None:
        lags = model.lags
    if lags is not None:
        lags = checked_lags(model, horizon, form, lags)
        horizon = lags[-1]
    if horizon is None:
        horizon = model.horizon
    horizon = whole_horizon(horizon)
    if horizon is None:
        horizon = _smallest_useful_horizon(model)
    # asked of sizes before any exact number is made: what would not end is not begun
    affordable(model, horizon)
    if model.uncertainties:
        if form != "first":
            raise ValueError("form 'second' is for models without uncertainties")
        return uncertain_relations(model, horizon, report)
    if lags is not None:
        samples, K = lagged(model, horizon, lags)
        W = _with_disturbance(model, horizon, samples)
    elif form == "first":
        W, K = _first(model, horizon, lambda share: report(0.5 * share))
    else:
        samples, K = _second(model, horizon)
        W = _with_disturbance(model, horizon, samples)
    # a bound of a sum is tested by circuits and frames; each relation alone leaves it out
    W = _beside_sums(model, horizon, W)
    if not W:
        raise ValueError(_without_relation(model, horizon, lags))
    report(0.5)
    bounds = model_bounds(model)
    looked_at = window.window_rows(model, horizon, lags).seen
    E, on_inputs = (_numbered(matrix, looked_at) for matrix in window.unknowns(model, horizon))
    most = SUBSETS if model.constant_tolerance else TESTED
    # of the rows that are looked at, those of sums among them, which W has not
    circuits = _few_circuits(E, most)
    report(0.6)
    if not circuits:
        searched = _frame(model, horizon, lags, lambda share: report(0.6 + 0.4 * share))
        report(1.0)
        return ParityRelation(bounds, model, horizon, form, W, K, (), (), searched, lags)
    report(1.0)
    circuits_known = _on_inputs(circuits, on_inputs)
    circuits = tuple(over_all_rows(row, looked_at, model, horizon) for row in circuits)
    return ParityRelation(bounds, model, horizon, form, W, K, circuits, circuits_known, None, lags)


def _frame(
    model: LinearSystem,
    horizon: int,
    lags: Sequence[int] | None,
    report: Callable[[float], object] | None = None,
) -> ExactFrame:
    """Return the frame of the rows that relations look at."""
    looked_at = window.window_rows(model, horizon, lags).seen
    E, on_inputs = (_numbered(matrix, looked_at) for matrix in window.unknowns(model, horizon))
    narrow = frame(E, on_inputs, progress=report)
    inner, outer = _numbered(looked_at, narrow.inner), _numbered(looked_at, narrow.outer)
    return dataclasses.replace(narrow, inner=inner, outer=outer)


def _numbered(entries: Sequence[T], numbers: Sequence[int]) -> tuple[T, ...]:
    """Return some entries by their numbers."""
    return tuple(entries[i] for i in numbers)


def _on_inputs(relations: Matrix, on_inputs: Rows) -> Matrix:
    """Return the coefficients of relations on inputs, from those of their rows; () where there are none."""
    if not relations or not on_inputs[0]:
        return ((),) * len(relations)
    return linalg.matmul(relations, on_inputs)


def _without_relation(model: LinearSystem, horizon: int, lags: Sequence[int] | None) -> str:
    """Return why a window has no relation, and which one has."""
    if lags is not None:
        return (
            f"lags {lags} give no relation: {len(lags) * model.p} samples do not outnumber what is "
            f"unknown; look at more of them"
        )
    first = next((s for s in range(model.n + 1) if linalg.left_null_space(window.unbounded(model, s))), None)
    if first is None:
        return (
            f"no horizon gives a relation: {model.d} unknown inputs can explain whatever {model.p} "
            f"outputs show"
        )
    free = model.n + model.d * window.unknown_lags(model, horizon)
    unknowns = f"{free} states and unknown inputs" if model.d else f"the {free} states"
    return (
        f"horizon {horizon} gives no relation: {(horizon + 1) * model.p} samples do not outnumber "
        f"{unknowns}; the smallest horizon with one is {first}"
    )


def stated_relations(model: LinearSystem, horizon: int, samples: Matrix, K: Matrix) -> ParityRelation:
    """Return given relations samples Y = K U of an exact plant as a ParityRelation, to be tested one by one
    (method "box").
    """
    W = _beside_sums(model, horizon, _with_disturbance(model, horizon, samples))
    return ParityRelation(model_bounds(model), model, horizon, "stated", W, K, (), ())


def _beside_sums(model: LinearSystem, horizon: int, relations: Matrix) -> Matrix:
    """Append to relations the coefficients of bounded sums: none."""
    nothing = (ZERO,) * len(window.window_rows(model, horizon).of_sums)
    return tuple(row + nothing for row in relations)


def _few_circuits(E: Rows, most: int) -> Matrix:
    """Return the circuits of the rows E, or none if they are more than `most`."""
    rank = linalg.rank(E)
    # without unknowns each row is a circuit by itself, and none is looked for
    if rank and math.comb(len(E), rank + 1) > SUBSETS:
        return ()
    every = circuits(E)
    if rank and len(every) > most:
        return ()
    return tuple(map(linalg.presentable, every))


def _with_disturbance(model: LinearSystem, horizon: int, relations: Matrix) -> Matrix:
    """Append to relations h Y = k U the coefficients of the disturbances: Y = .. + V w."""
    if not model.g or not horizon:
        return relations
    # W (Y - V w) = K U: what the plant adds by w is no part of the relation
    through = linalg.matmul(relations, window.disturbance_form(model, horizon))
    return tuple(h + linalg.scale(v, -1) for h, v in zip(relations, through, strict=True))


def _first(model: LinearSystem, horizon: int, report: Callable[[float], object]) -> tuple[Matrix, Matrix]:
    """Return (W, K), of minimal span: beyond n samples every further one brings p relations, the last ones
    once more, later.
    """
    short = min(horizon, model.n)
    unseen = linalg.left_null_space(window.unbounded(model, short), partial(in_part, report, 0.0, 0.4))
    shortest = linalg.minimal_span(unseen, partial(in_part, report, 0.4, 0.6))
    samples = tuple(map(linalg.presentable, shortest))
    H = window.first_form(model, short)[1]
    on_inputs = _on_inputs(samples, H)
    outputs, later = (short + 1) * model.p, horizon - short

    def moved(row: Vector, width: int, shift: int) -> Vector:
        """Return a row over a short window as one over the long one, so many samples later."""
        return (ZERO,) * (shift * width) + row + (ZERO,) * ((later - shift) * width)

    shifted = [(i, 0) for i in range(len(samples))]
    # moved by one sample, another relation still lies among samples whose relations are all there
    newest = [i for i, row in enumerate(samples) if any(row[short * model.p :])]
    for shift in range(1, later + 1):
        shifted += [(i, shift) for i in newest]
    whole = _with_disturbance(model, short, samples)
    W, K = [], []
    for i, shift in shifted:
        on_outputs, on_disturbances = whole[i][:outputs], whole[i][outputs:]
        W.append(moved(on_outputs, model.p, shift) + moved(on_disturbances, model.g, shift))
        K.append(moved(on_inputs[i], model.m, shift))
    return tuple(W), tuple(K)


def _second(model: LinearSystem, horizon: int) -> tuple[Matrix, Matrix]:
    """Return (W~_L, action on U) of the second static form. Source: (13)-(14)."""
    L, M, N, F = window.second_form(model, horizon)
    # the states of all samples are unknowns here, and rows of the dynamics bind each to the next
    stacked = linalg.left_null_space(L + M)
    on_outputs = tuple(row[: len(L)] for row in stacked)
    direct = _on_inputs(on_outputs, F)
    if not F[0] or not M:
        return on_outputs, direct
    through = linalg.matmul([row[len(L) :] for row in stacked], N)
    K = [linalg.add_multiple(x, -1, y) for x, y in zip(direct, through, strict=True)]
    return on_outputs, tuple(K)


def _smallest_useful_horizon(model: LinearSystem) -> int:
    """Return the smallest horizon at which as many outputs are checked as at any, and, with uncertainties, as
    many states are seen.

    A relation checks an output iff the samples of that output raise the rank by less than their number. Ranks
    are taken modulo a prime: a model that fools it gets another horizon, whose relations are exact all the
    same.
    """
    refuse_many_states(model)
    n, p = model.n, model.p
    exact = window.unbounded(model, n)  # a longer window involves no further output (Cayley-Hamilton)
    O = [[x.numerator * pow(x.denominator, -1, PRIME) % PRIME for x in row] for row in exact]
    # numbers modulo a prime do not grow; exact ones would, from sample to sample
    whole = _ranks(O, p, n + 1)
    others = []
    for i in range(p):
        rest = [row for j, row in enumerate(O) if j % p != i]
        others.append(_ranks(rest, p - 1, n + 1))
    states = [0] * (n + 1)
    if model.uncertainties:
        states = _ranks([row[:n] for row in O], p, n + 1)

    def shown(s: int) -> tuple[list[bool], int]:
        """Return which outputs windows of a horizon check, and how many states they see."""
        return [whole[s] - other[s] <= s for other in others], states[s]

    return next(s for s in range(n + 1) if shown(s) == shown(n))


def _ranks(rows: list[list[int]], width: int, count: int) -> list[int]:
    """Return the ranks modulo PRIME of the first width, 2 width, .., count width rows."""
    if not width:
        return [0] * count
    reduced: dict[int, list[int]] = {}
    out: list[int] = []
    for i, row in enumerate(rows, 1):
        for j, head in reduced.items():
            factor = row[j]
            if factor:
                row = [(x - factor * y) % PRIME for x, y in zip(row, head, strict=True)]
        lead = next((j for j, x in enumerate(row) if x), None)
        if lead is not None:
            scale = pow(row[lead], -1, PRIME)
            reduced[lead] = [x * scale % PRIME for x in row]
        # a sample is complete: the rank of the window that ends here
        if i % width == 0:
            out.append(len(reduced))
    return out
