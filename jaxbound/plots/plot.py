"""Pictures of whatever can be drawn: results of a recording, banks of relations on a recording, tables of signatures."""

import jax
import numpy as np

from jaxbound.diagnosis.isolation import BankResult
from jaxbound.plots import canvas as plots
from jaxbound.plots.canvas import BINS, COLOURS, ENVELOPE, FAULTY, GRID, INK, canvas, finish, stacked, style, time_axis, time_of
from jaxbound.plots.curves import plot_study
from jaxbound.plots.fit import plot_fit
from jaxbound.plots.tune import plot_tuning
from jaxbound.relations.decoupling import Isolability, Signatures
from jaxbound.sets.floats.status import Status
from jaxbound.sets.zonotopes.constrained import ConstrainedZonotope
from jaxbound.sets.zonotopes.extents import support
from jaxbound.sets.zonotopes.shapes import vertices
from jaxbound.sets.zonotopes.zonotope import Zonotope
from jaxbound.studies.identification.fitting import Fitted
from jaxbound.studies.montecarlo.study_result import StudyResult
from jaxbound.studies.tuning.tuning import TuneResult

__all__ = ["plot"]

PALE, HALF = "#eef1f4", "#8fb8d8"
SERIES = (INK, FAULTY, COLOURS[Status.CONSISTENT], ENVELOPE, COLOURS[Status.UNDECIDED])
SIDES = 360  # of the polygon drawn around a constrained zonotope


def plot(thing, time=None, alarms=None):
    """Draw a result, a table of faults, or sets in the plane.

    Args:
        thing: a Result of one recording: the margin of every window over time with a ribbon of verdicts and the alarms. A BankResult:
            which relations are violated and which single faults remain, over time. Signatures or Isolability: the table as a heat map.
            A TuneResult: the search and the margins.
            A Fitted: the share of its bounds that each window needs. A StudyResult: what is detected against the size of a fault.
            A Zonotope or ConstrainedZonotope in the plane, or a list of them: their outlines.
        time: (T,) seconds or datetime64; None: the index of the DataFrame, or sample numbers times dt.
        alarms: a list of Alarm for a Result; None: its own.

    Returns:
        A matplotlib Figure.

    Raises:
        ValueError: a batch of recordings, or a time axis of another length.

    Example:
        >>> import jaxbound as jb
        >>> m = jb.LinearSystem([[0.5]], [[1]], [[1]], noise=0.1)
        >>> len(plot(jb.detect(jb.parity_relations(m), [[0.0]] * 4, [[1.0], [0.5], [0.9], [0.45]])).axes)
        3
        >>> [len(plot(x).axes) for x in (jb.signatures(jb.redundancy(m)), jb.isolability(m))]
        [1, 1]
    """
    if isinstance(thing, StudyResult):
        return plot_study(thing)
    if isinstance(thing, Zonotope | ConstrainedZonotope | list | tuple):
        return _sets(thing if isinstance(thing, list | tuple) else [thing])
    if isinstance(thing, Signatures):
        level = thing.weak.astype(int) + thing.constant
        title = f"Which relation reacts to which fault: two faults differ in at least {thing.distance}"
        return _heat_map(level, thing.faults, thing.relations, ("no reaction", "to changes", "reacts"), title)
    if isinstance(thing, Isolability):
        seen = thing.detectable.astype(int) + thing.detectable_constant
        level = thing.isolable.astype(int) + thing.isolable_constant
        level[np.arange(len(level)), np.arange(len(level))] = -1
        title = "Does the fault of the row show, whatever that of the column does?"
        legend = ("no", "its changes", "yes")
        return _heat_map(np.column_stack([seen, level]), ("no other", *thing.faults), thing.faults, legend, title)
    if isinstance(thing, BankResult):
        return _bank(thing, time)
    if isinstance(thing, Fitted):
        return plot_fit(thing)
    if isinstance(thing, TuneResult):
        return plot_tuning(thing)
    return plots.plot_result(thing, time, alarms)


def _sets(sets):
    for S in sets:
        if not isinstance(S, Zonotope | ConstrainedZonotope) or np.shape(S.center) != (2,):
            raise ValueError(f"sets of two coordinates can be drawn, not {type(S).__name__} {np.shape(getattr(S, 'center', ()))}: "
                             "choose two with linear_map")  # fmt: skip
    with style():
        fig = canvas((5.2, 4.6))
        ax = fig.subplots()
        for number, S in enumerate(sets):
            outline, colour = _outline(S), SERIES[number % len(SERIES)]
            ax.fill(*outline.T, facecolor=colour, alpha=0.18)
            ax.plot(*np.concatenate([outline, outline[:1]]).T, color=colour, lw=1.6)
        ax.set_xlabel("first coordinate")
        ax.set_ylabel("second coordinate")
        ax.set_aspect("equal", "datalim")
        fig.subplots_adjust(left=0.14, right=0.97, top=0.97, bottom=0.13)
    return fig


def _outline(S):
    """Return the corners of a zonotope, or of a polygon that touches a constrained one on every side."""
    if isinstance(S, Zonotope):
        return vertices(S)
    angle = 2 * np.pi * np.arange(SIDES) / SIDES
    normal = np.column_stack([np.cos(angle), np.sin(angle)])
    far = np.asarray(jax.vmap(support, (None, 0))(S, normal.astype(S.center.dtype)))
    after = np.roll(far, -1)  # two neighbouring sides meet where both are touched
    along = (after - far * np.cos(angle[1])) / np.sin(angle[1])
    return far[:, None] * normal + along[:, None] * np.column_stack([-normal[:, 1], normal[:, 0]])


def _heat_map(level, columns, rows, legend, title):
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch

    with style():
        fig = canvas((2.2 + 0.62 * len(columns), 1.5 + 0.34 * len(rows)))
        ax = fig.subplots()
        ax.pcolormesh(np.arange(len(columns) + 1), np.arange(len(rows) + 1), level, cmap=ListedColormap(["white", PALE, HALF, INK]),
                      vmin=-1.5, vmax=2.5, edgecolor="white", lw=2)  # fmt: skip
        ax.set_xticks(np.arange(len(columns)) + 0.5, columns)
        ax.set_yticks(np.arange(len(rows)) + 0.5, rows)
        ax.invert_yaxis()
        ax.xaxis.tick_top()
        ax.tick_params(length=0)
        ax.spines[:].set_visible(False)
        fig.suptitle(title, x=0.02, ha="left", fontsize=10.5, color=INK)
        patches = [Patch(color=c, label=label) for c, label in zip((PALE, HALF, INK), legend, strict=True)]
        fig.legend(handles=patches, loc="lower left", ncols=3, bbox_to_anchor=(0.01, 0.0), fontsize=9)
        height = fig.get_figheight()
        fig.subplots_adjust(left=0.9 / fig.get_figwidth(), right=0.98, top=1 - 0.75 / height, bottom=0.45 / height)
    return fig


def _bank(res, time):
    """Draw the relations violated and the candidates of one recording, each as a raster over time."""
    from matplotlib.colors import ListedColormap

    x = np.arange(len(res.status)) if time is None and res.relations is None else time_of(res, time)
    at, label, dates = (x, "sample", False) if time is None and res.relations is None else time_axis(x)
    bins = np.unique(np.linspace(0, len(x), min(len(x), BINS), endpoint=False).astype(int))
    gather = lambda on: np.maximum.reduceat(on, bins, axis=0).T
    edges = np.append(at[bins], at[-1:])
    with style():
        count = len(res.signatures.relations)
        fig, (top, bottom) = stacked(2, (11, 1.6 + 0.2 * (count + len(res.faults))), [count, len(res.faults)])
        panels = ((top, gather(res.violated), res.signatures.relations, FAULTY, "Relations violated, each a proof"),
                  (bottom, gather(res.candidates), res.faults, COLOURS[Status.UNDECIDED], "Single faults that explain them"))  # fmt: skip
        for ax, on, names, colour, title in panels:
            ax.pcolormesh(edges, np.arange(len(names) + 1), on, cmap=ListedColormap([PALE, colour]), vmin=0, vmax=1, shading="flat")
            ax.set_yticks(np.arange(len(names)) + 0.5, names, fontsize=8)
            ax.set_title(title)
            ax.hlines(np.arange(1, len(names)), edges[0], edges[-1], color=GRID, lw=0.6)
            ax.invert_yaxis()
            ax.tick_params(axis="y", length=0)
        finish(fig, [top, bottom], at, label, dates, gap=0.5)
    return fig
