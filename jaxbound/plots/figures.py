"""The figures of Adrot, Maquin, Ragot 2000, redrawn from computation."""

from collections.abc import Sequence
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from jaxbound.diagnosis.result import Result
from jaxbound.models.faults import Fault
from jaxbound.models.simulate import Trajectory
from jaxbound.models.system import LinearSystem
from jaxbound.plots.canvas import (
    ENVELOPE,
    FAULTY,
    GRID,
    INK,
    canvas,
    finish,
    stacked,
    style,
    time_axis,
    time_of,
)
from jaxbound.sets.floats.status import Status
from jaxbound.sets.intervals.interval import Interval, interval
from jaxbound.sets.paving.paving import pave

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def paper_example(z: Interval) -> list[Interval]:
    """Enclose p(z) = (2 z1^2 + z2, z1 - z2). Source: Adrot, Maquin, Ragot 2000, section 4.3."""
    return [2 * z[0] ** 2 + z[1], z[0] - z[1]]


def figure_1() -> "Figure":
    """Redraw Fig. 1 of Adrot, Maquin, Ragot 2000 from computation: p(z) = (2 z1^2 + z2, z1 - z2) over z in
    [-1, 2] x [1, 3].

    Left: the exact set A(p), its box, and the uniform pavings of order 10 and 20. Right: the boxes that the
    adaptive test of p = (2, -2) evaluates (the paper prints (2, 2), which its own quoted solutions
    contradict).

    Returns:
        A matplotlib Figure.
    """
    box, target = interval([-1.0, 1.0], [2.0, 3.0]), [2.0, -2.0]
    whole = pave(paper_example, box, subdivision="uniform", q=1)
    pavings = [pave(paper_example, box, subdivision="uniform", q=q) for q in (10, 20)]
    final = pave(paper_example, box, target, q=10)
    levels = [pave(paper_example, box, target, q=10, max_depth=d).boxes for d in range(18)]
    with style():
        fig = canvas((11, 4.9), "constrained")
        left, right = fig.subplots(1, 2)
        _boxes(left, whole.images, facecolor="#eef1f4", edgecolor="#8a9099", lw=1.2, label="box of A(p)")
        for paving, q, colour in zip(pavings, (10, 20), ("#a9d8f5", "#56b4e9"), strict=True):
            name = f"paving, q = {q}: area {paving.area():.3f}"
            _boxes(left, paving.images, facecolor=colour, edgecolor="white", lw=0.25, label=name)
        p2 = np.linspace(-4, 1, 2001)
        a, b = np.maximum(-1, 1 + p2), np.minimum(2, 3 + p2)
        vertex = np.clip(-0.25, a, b)  # of the parabola p1 = 2 z1^2 + z1 - p2, as near as z2 lets z1 come
        at_vertex, at_a, at_b = (2 * z**2 + z - p2 for z in (vertex, a, b))
        lo, hi = at_vertex, np.maximum(at_a, at_b)
        left.fill_betweenx(p2, lo, hi, facecolor=INK, lw=0, label="A(p) exactly: area 21.375")
        left.plot(*target, marker="o", color=FAULTY, ms=6, mec="white", ls="", label="tested point (2, -2)")
        left.set(xlabel="p1", ylabel="p2", xlim=(0.5, 11.5), ylim=(-4.3, 3.4), title="Residual space")
        left.legend(loc="upper center", ncols=2, fontsize=8.5)
        for boxes in levels:
            _boxes(right, boxes, facecolor="none", edgecolor="#8a9099", lw=0.5)
        name = f"{len(final.boxes)} boxes kept"
        _boxes(right, final.boxes, facecolor=FAULTY, edgecolor=FAULTY, lw=2.2, label=name)
        name = "solutions (-.5, 1.5) and (0, 2)"
        right.plot([-0.5, 0], [1.5, 2], "o", mfc="none", mec=INK, ms=15, label=name)
        right.set(xlabel="z1", ylabel="z2", xlim=(-1.1, 2.1), ylim=(0.95, 3.45))
        right.set_title(f"Space of the unknowns: {int(final.evaluated)} boxes evaluated")
        right.legend(loc="upper center", ncols=2, fontsize=8.5)
    return fig


def figure_2(trajectory: Trajectory, res: Result, faults: Sequence[Fault] = ()) -> "Figure":
    """Redraw Fig. 2 of the same paper: measurements, true combinations of states, fault intervals in grey,
    and the test result.

    Args:
        trajectory: from `simulate`, one recording. res: its Result. faults: the Faults that were put in.

    Returns:
        A matplotlib Figure.
    """
    model, (x, label, _) = res.relations.model, time_axis(time_of(res, None))
    assert isinstance(model, LinearSystem), "the paper's system has states"
    y, state = np.asarray(trajectory.y), np.asarray(trajectory.x)
    C = np.array([[float(c) for c in row] for row in model.C])
    with style():
        fig, axes = stacked(model.p + 1, (11, 1.6 + 1.8 * model.p), [3] * model.p + [1])
        for i, ax in enumerate(axes[:-1]):
            name = f"{_combination(model.states, model.C[i])} (true)"
            ax.plot(x, state @ C[i], color=ENVELOPE, lw=2.2, label=name)
            ax.plot(x, y[:, i], color=INK, lw=0.9, label=f"{model.outputs[i]} (measured)")
            ax.legend(loc="lower right", ncols=2, fontsize=9, bbox_to_anchor=(1.0, 1.0), borderaxespad=0.1)
            ax.grid(color=GRID, lw=0.7)
        axes[-1].fill_between(x, 0, res.status == Status.FAULT, step="mid", color=FAULTY, lw=0)
        axes[-1].set(yticks=[0, 1], ylim=(0, 1.15), ylabel="fault\nproved")
        for ax in axes:
            for name, f in zip("ABCDEFGH", faults, strict=False):
                ax.axvspan(x[f.start], x[f.start : f.stop][-1], color="#d8dade", zorder=0, lw=0)
                if ax is axes[0]:
                    top = ax.get_xaxis_transform()
                    words = f" {name}: {f.kind} of {f.signal}"
                    ax.text(x[f.start], 1.0, words, transform=top, va="bottom", fontsize=9)
        finish(fig, axes, x, label, False, top=0.55, gap=0.3)
    return fig


def _combination(names: Sequence[str], coefficients: Sequence[Fraction]) -> str:
    """Return "x1 + 0.5 x2" for the row of a matrix."""
    text = ""
    for name, c in zip(names, coefficients, strict=True):
        if not c:
            continue
        sign, size = "+", f"{float(abs(c)):g} "
        if c < 0:
            sign = "-"
        if abs(c) == 1:
            size = ""
        text += f" {sign} {size}{name}"
    return text.removeprefix(" ").removeprefix("+ ") or "0"


def _boxes(ax: "Axes", boxes: Interval, label: str | None = None, **style: Any) -> None:
    from matplotlib.collections import PolyCollection

    lo, hi = np.asarray(boxes.lo), np.asarray(boxes.hi)
    corners = np.stack(
        [lo, np.column_stack([hi[:, 0], lo[:, 1]]), hi, np.column_stack([lo[:, 0], hi[:, 1]])], 1
    )
    ax.add_collection(PolyCollection(list(corners), label=label, **style))
