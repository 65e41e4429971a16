"""The sheet that pictures are drawn on: colours, sizes, a time axis that reads well, bins of long recordings,
PNG bytes.

Pictures take results, never the other way round, and touch no global state of matplotlib. Colours are near
those of Okabe and Ito, which colour-blind readers can tell apart; FAULT and CONSISTENT differ in lightness
too, so that they do on a grey print. Recordings of more than 5000 samples are drawn as the extremes of 1200
bins; a bin with a single FAULT window is drawn as FAULT.
"""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Literal

import numpy as np

from jaxbound.diagnosis.result import Result
from jaxbound.sets.floats.status import Status

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.typing import RcKeyType

COLOURS = {
    Status.MISSING: "#c9ccd1",
    Status.CONSISTENT: "#6fcfb0",
    Status.UNDECIDED: "#e69f00",
    Status.FAULT: "#b33c00",
}
INK, ENVELOPE, GRID, FAULTY = "#16324f", "#56b4e9", "#e3e6ea", COLOURS[Status.FAULT]
PALE = "#eef1f4"
LINES = INK, ENVELOPE, "#e69f00", "#6fcfb0", "#cc79a7", "#f0e442", "#0072b2", "#999999"
"""Of several lines or sets in one chart."""
CALM = "#d3e9f8"
"""In place of UNDECIDED where that is what a healthy sample is: as pages have it."""
SAMPLES, BINS, PANELS = 5000, 1200, 12
BOTTOM = 0.55  # inches below the lowest axes
STYLE: "dict[RcKeyType, object]" = {
    "font.size": 9.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#8a9099",
    "axes.labelcolor": "#30363d",
    "xtick.color": "#30363d",
    "ytick.color": "#30363d",
    "axes.titlesize": 10.5,
    "axes.titlelocation": "left",
    "axes.titlecolor": "#16324f",
    "legend.frameon": False,
    "axes.axisbelow": True,
    "font.family": "DejaVu Sans",
    "text.parse_math": False,  # a name with dollar signs stands as it is
}


def to_png(fig: "Figure", dpi: int = 130) -> bytes:
    """Return a Figure as the bytes of a PNG picture."""
    from jaxbound.plots.picture import png

    return png(fig, dpi)


def style() -> AbstractContextManager[None]:
    """Return a context in which figures look like ours."""
    import matplotlib

    return matplotlib.rc_context(STYLE)


def canvas(size: tuple[float, float], layout: "Literal['constrained'] | None" = None) -> "Figure":
    """Return an empty Figure of a size in inches, with its own canvas; notebooks show it. layout: finds room
    for labels.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    from jaxbound.plots.picture import Picture

    # no pyplot: it would keep every figure, and choose a display of its own
    fig = Picture(figsize=size, layout=layout)
    FigureCanvasAgg(fig)
    return fig


def chart(
    draw: "Callable[[Axes], object]", size: tuple[float, float], title: str, ax: "Axes | None"
) -> "Figure | Axes":
    """Draw one chart into an Axes, or into a figure of its own, of a size in inches."""
    if ax is not None:
        draw(ax)
        ax.set_title(title, parse_math=False)  # of a figure that another style has made
        return ax
    with style():
        fig = canvas(size, "constrained")
        draw(fig.subplots())
        fig.suptitle(title, x=0.02, ha="left", fontsize=10.5, color=INK)
    return fig


def stacked(
    rows: int, size: tuple[float, float], heights: Sequence[float], shared: bool = True
) -> "tuple[Figure, list[Axes]]":
    """Return (figure, axes): axes above each other, of relative heights, that share the time axis if not said
    otherwise.
    """
    fig = canvas(size)
    axes = fig.subplots(rows, 1, sharex=shared, gridspec_kw={"height_ratios": heights}, squeeze=False)
    return fig, list(axes[:, 0])


def time_of(res: Result, time: np.ndarray | None) -> np.ndarray:
    """Return the time axis of a Result: as given, of its DataFrame, or sample numbers times dt."""
    if res.status.ndim != 1:
        raise ValueError(
            f"a plot shows one recording, this result has the shape {res.status.shape}: detect and plot one "
            f"of them"
        )
    if time is not None:
        x = np.asarray(time)
    elif np.issubdtype(getattr(res.index, "dtype", int), np.datetime64):
        x = np.asarray(res.index)
    else:
        x = np.arange(len(res.status)) * res.relations.model.dt
    if x.shape != res.status.shape:
        raise ValueError(
            f"time needs one entry for each of the {len(res.status)} samples: its shape is {x.shape}"
        )
    return x


def time_axis(x: np.ndarray) -> tuple[np.ndarray, str, bool]:
    """Return (x, label, dates): a time axis in units that read well."""
    if np.issubdtype(x.dtype, np.datetime64):
        return x, "", True
    span = 0.0
    if len(x) > 1:
        span = float(x[-1] - x[0])
    units = (("days", 86400, 172800), ("h", 3600, 10800), ("min", 60, 300), ("s", 1, 0))
    unit, size = next((unit, size) for unit, size, limit in units if span >= limit)
    return x / size, f"time ({unit})", False


def bins(count: int) -> np.ndarray:
    """Return the first sample of each bin: of one sample, or of 1200 bins."""
    if count <= SAMPLES:
        return np.arange(count)
    return np.linspace(0, count, BINS, endpoint=False).astype(int)


def inside(edges: np.ndarray, start: int, count: int) -> tuple[int, int, np.ndarray]:
    """Return (the first bin, the one behind the last, the first sample of each) of the samples start .. start
    + count - 1, counted from `start`.

    Args:
        edges: where each bin starts, of `bins`. start, count: a piece of the recording, in whose first bin
            may be samples before it.
    """
    first, stop = np.searchsorted(edges, (start, start + count), "left")
    # the bin that holds the first sample of the piece began before it, unless it begins there
    begun = int(first) - int(first == len(edges) or edges[first] > start)
    return begun, int(stop), np.maximum(edges[begun:stop] - start, 0)


def thinning(count: int, drawn: int, what: str) -> str:
    """Return the part of a title on points that stand for many samples, empty where they do not."""
    if drawn >= count:
        return ""
    return f"   (each of {drawn} points: {what} of about {count // drawn} samples)"


def shade(ax: "Axes", x: np.ndarray, on: np.ndarray) -> None:
    """Shade the samples that are on, each at least a pixel wide."""
    if not on.any() or len(x) < 2:
        return
    half = (x[-1] - x[0]) / max(len(x) - 1, 1) / 2
    starts = np.flatnonzero(np.diff(np.concatenate([[0], on.astype(int)])) == 1)
    ends = np.flatnonzero(np.diff(np.concatenate([on.astype(int), [0]])) == -1)
    # one outline for all stretches: thousands of patches would take seconds to draw
    edges = np.column_stack([x[starts] - half, x[starts] - half, x[ends] + half, x[ends] + half]).ravel()
    level = np.tile([0, 1, 1, 0], len(starts))
    ax.fill_between(
        edges, 0, level, transform=ax.get_xaxis_transform(), color="#fbe3d6", lw=0.4, zorder=0, label="FAULT"
    )


def finish(
    fig: "Figure",
    axes: "Sequence[Axes]",
    x: np.ndarray,
    label: str,
    dates: bool,
    top: float = 0.62,
    gap: float = 0.09,
) -> None:
    """Label the time axis of the lowest axes and place all of them: margins in inches, gap relative to an
    axes' height.
    """
    for ax in axes[:-1]:
        ax.tick_params(labelbottom=False)
    label_time(axes[-1], x, label, dates)
    height = fig.get_figheight()
    fig.subplots_adjust(left=0.075, right=0.925, bottom=BOTTOM / height, top=1 - top / height, hspace=gap)


def label_time(ax: "Axes", x: np.ndarray, label: str, dates: bool) -> None:
    """Label the time axis of an Axes."""
    ax.set_xlabel(label)
    if len(x) > 1:
        ax.set_xlim(x[0], x[-1])
    if dates:
        from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

        locator = AutoDateLocator()  # type: ignore[no-untyped-call]  # matplotlib
        ax.xaxis.set_major_locator(locator)
        ax.xaxis.set_major_formatter(ConciseDateFormatter(locator))  # type: ignore[no-untyped-call]


def note(ax: "Axes", words: str, colour: str = "#57606a") -> None:
    """Write words into the middle of an Axes in which nothing is drawn."""
    ax.text(0.5, 0.5, words, ha="center", va="center", transform=ax.transAxes, color=colour)
