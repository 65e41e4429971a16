"""Pictures of results. They take results, never the other way round, and touch no global state of matplotlib.

Colours are those of Okabe and Ito, which colour-blind readers can tell apart. Recordings of more than 5000 samples are drawn as the
extremes of 1200 bins; a bin with a single FAULT window is drawn as FAULT.
"""

import io
import warnings

import numpy as np

from jaxbound.relations.uncertain import UncertainRelations
from jaxbound.sets.floats.status import Status

__all__ = ["Timeline", "plot_result", "plot_residuals", "plot_timeline", "to_png"]

COLOURS = {Status.MISSING: "#c9ccd1", Status.CONSISTENT: "#009e73", Status.UNDECIDED: "#e69f00", Status.FAULT: "#d55e00"}
INK, ENVELOPE, GRID, FAULTY = "#16324f", "#56b4e9", "#e3e6ea", COLOURS[Status.FAULT]
SAMPLES, BINS, PANELS = 5000, 1200, 12
BOTTOM = 0.55  # inches below the lowest axes
FACTORS = (0, 0.5, 1, 1.5, 2, 2.5, 3, 4, 5)
STYLE = {
    "font.size": 9.5, "axes.spines.top": False, "axes.spines.right": False, "axes.edgecolor": "#8a9099", "axes.labelcolor": "#30363d",
    "xtick.color": "#30363d", "ytick.color": "#30363d", "axes.titlesize": 10.5, "axes.titlelocation": "left", "axes.titlecolor": "#16324f",
    "legend.frameon": False, "axes.axisbelow": True, "font.family": "DejaVu Sans", "mathtext.fontset": "dejavusans"}  # fmt: skip


def plot_result(res, time=None, alarms=None):
    """Draw a Result of one recording: `pictures.plot` says what, and takes the same arguments."""
    x = time_of(res, time)
    alarms = res.alarms() if alarms is None else alarms
    line = Timeline(len(x))
    line.add(0, x, res.status, res.margin)
    line.mark([a.worst for a in alarms])
    return plot_timeline(line, res, len(alarms))


class Timeline:
    """The extremes of a recording of any length, given piece by piece: what a picture of it can show.

    Fields: samples; bins: where each bin starts, one sample each up to 5000; x: its time; status: the worst of each bin; low, high: the
    extremes of its margin, NaN where there is none; marked: whether the deepest window of an alarm lies in it.
    """

    def __init__(self, samples):
        """Begin a recording of so many samples."""
        self.samples, self.bins = samples, _bins(samples)
        self.x = None
        self.status = np.zeros(len(self.bins), np.int8)
        self.low, self.high = np.full((2, len(self.bins)), np.nan)
        self.marked = np.zeros(len(self.bins), bool)

    def add(self, start, x, status, margin):
        """Take the samples from number `start` on: their time (seconds or datetime64), status and margin."""
        first, stop = np.searchsorted(self.bins, (start, start + len(x)), "left")
        begun = int(first) - (first == len(self.bins) or self.bins[first] > start)  # a bin that begins in an earlier piece
        edges, put = np.maximum(self.bins[begun:stop] - start, 0), slice(begun, stop)
        margin = np.where(np.isneginf(margin), -1e15, margin)
        self.x = np.empty(len(self.bins), x.dtype) if self.x is None else self.x
        self.x[first:stop] = x[self.bins[first:stop] - start]
        self.status[put] = np.maximum(self.status[put], np.maximum.reduceat(status, edges))
        self.low[put] = np.fmin(self.low[put], np.fmin.reduceat(margin, edges))
        self.high[put] = np.fmax(self.high[put], np.fmax.reduceat(margin, edges))

    def mark(self, samples):
        """Mark the bins in which these samples lie."""
        self.marked[np.searchsorted(self.bins, np.asarray(samples, np.int64), "right") - 1] = True


def plot_timeline(line, res, alarms):
    """Draw a complete Timeline as `plot_result` does; `alarms` is how many there are, res has .relations and .method."""
    at, label, dates = time_axis(line.x)
    with style():
        fig, (ax, ribbon) = stacked(2, (11, 4.3), [12, 1])
        shade(ax, at, line.status == Status.FAULT)
        if np.isnan(line.low).all():
            ax.text(0.5, 0.5, _no_margin(res), ha="center", va="center", transform=ax.transAxes, color="#57606a")
            ax.set_yticks([])
        else:
            _margin(ax, at, line.low, line.high, line.samples > SAMPLES)
        if alarms:
            _mark_alarms(ax, at[line.marked], alarms)
        _ribbon(ribbon, at, line.status)
        title = f"Margin of {res.relations.model.name}" + thinning(line.samples, len(at), "extremes")
        ax.set_title(title, pad=16, parse_math=False)
        finish(fig, [ax, ribbon], at, label, dates)
    return fig


def plot_residuals(res, time=None):
    """Draw every residual with the interval that healthy sensors inside their bounds allow, FAULT windows shaded.

    Windows can be FAULT with every residual inside: the joint test sees more than each residual alone.

    Args:
        res, time: as for `pictures.plot`. Of long recordings, the worst window of each bin is drawn, and how much of its envelope each
            residual uses (above 1: outside).

    Returns:
        A matplotlib Figure with one panel a residual, at most 12.

    Raises:
        ValueError: as `pictures.plot`.
    """
    x, label, dates = time_axis(time_of(res, time))
    relations = res.relations
    picked = _worst(res) if len(x) > SAMPLES else np.arange(len(x))
    thinned = len(picked) < len(x)
    missing = (res.status[picked] == Status.MISSING)[:, None]  # a window across a gap has a residual, but it says nothing
    external, lo, hi = (np.where(missing, np.nan, x) for x in _forms(res, picked))
    fault = np.maximum.reduceat(res.status, _bins(len(x))) == Status.FAULT
    distinct = distinct_relations(relations)
    shown, at, lines = distinct[:PANELS], x[picked], relations.text().splitlines()
    panel, gap, top = 1.5, 0.55, 1.0  # inches
    with style():
        fig, axes = stacked(len(shown), (11, top + BOTTOM + panel * len(shown) + gap * (len(shown) - 1)), [1] * len(shown))
        for j, ax in zip(shown, axes, strict=True):
            text = lines[j]
            value, low, high = (np.asarray(z[:, j]) for z in (external, lo, hi))
            if thinned:  # neighbours have nothing to do with each other: the share of the envelope says more than a thicket of lines
                value, low, high = abs(value - (low + high) / 2) / ((high - low) / 2), np.zeros(len(at)), np.ones(len(at))
            shade(ax, at, fault)
            ax.fill_between(at, low, high, color=ENVELOPE, alpha=0.35, lw=0, label="allowed by the bounds")
            for edge in (low, high):
                ax.plot(at, edge, color="#0072b2", lw=0.6, alpha=0.8)
            ax.plot(at, value, color=INK, lw=1.0, label="share of the envelope that the residual uses" if thinned else "residual")
            beyond = _robust_limits(ax, value, low, high)
            ax.set_title(text if len(text) <= 125 else text[:122] + " ...", fontsize=9.5, parse_math=False)
            ax.grid(color=GRID, lw=0.7)
            if beyond:
                ax.text(0.995, 0.99, f"{beyond} beyond the axis", ha="right", va="top", transform=ax.transAxes, fontsize=8.5, color=FAULTY)
        copies = f", {len(distinct)} of {relations.count}: the others are these, some samples earlier" * (len(distinct) < relations.count)
        more = f"; the first {PANELS} are shown" if len(distinct) > PANELS else ""
        title = f"Residuals of {relations.model.name}{copies}{more}{thinning(len(x), len(picked), 'the worst window')}"
        fig.text(0.012, 1 - 0.3 / fig.get_figheight(), title, fontsize=10.5, color=INK, parse_math=False)
        handles, labels = axes[0].get_legend_handles_labels()
        fig.legend(handles, labels, loc="upper right", ncols=3, bbox_to_anchor=(0.93, 1 - 0.34 / fig.get_figheight()))
        finish(fig, axes, at, label, dates, top=top, gap=gap / panel)
    return fig


def distinct_relations(relations):
    """Return the indices of the relations that are not merely an earlier copy of another one."""
    if isinstance(relations, UncertainRelations):
        return list(range(relations.count))
    model, last = relations.model, {}
    count = (relations.horizon + 1) * model.p
    for j, (h, k) in enumerate(zip(relations.W, relations.K, strict=True)):
        parts = ((h[:count], model.p), (h[count:], model.g), (k, model.m))  # outputs, disturbances, inputs
        first = min(i // width for row, width in parts for i, x in enumerate(row) if x)
        last[tuple(tuple((i - first * width, x) for i, x in enumerate(row) if x) for row, width in parts)] = j
    return sorted(last.values())


def to_png(fig, dpi=130):
    """Return a Figure as the bytes of a PNG picture."""
    out = io.BytesIO()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from")  # a name in letters that the font does not have
        _plain_where_no_formula(fig)
        fig.savefig(out, format="png", dpi=dpi, facecolor="white")
    return out.getvalue()


def _plain_where_no_formula(fig):
    """Show a name with dollar signs as it is, unless what is between them can be set as a formula."""
    from matplotlib.mathtext import MathTextParser
    from matplotlib.text import Text

    for text in fig.findobj(Text):
        if "$" in text.get_text():
            try:
                MathTextParser("path").parse(text.get_text())
            except ValueError:
                text.set_parse_math(False)


def style():
    """Return a context in which figures look like ours."""
    import matplotlib

    return matplotlib.rc_context(STYLE)


def canvas(size):
    """Return an empty Figure of a size in inches, with its own canvas."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    fig = Figure(figsize=size)
    FigureCanvasAgg(fig)
    return fig


def stacked(rows, size, heights, shared=True):
    """Return (figure, axes): axes above each other, of relative heights, that share the time axis if not said otherwise."""
    fig = canvas(size)
    axes = fig.subplots(rows, 1, sharex=shared, gridspec_kw={"height_ratios": heights}, squeeze=False)
    return fig, list(axes[:, 0])


def time_of(res, time):
    """Return the time axis of a Result: as given, of its DataFrame, or sample numbers times dt."""
    if res.status.ndim != 1:
        raise ValueError(f"a plot shows one recording, this result has the shape {res.status.shape}: detect and plot one of them")
    if time is None and np.issubdtype(getattr(res.index, "dtype", int), np.datetime64):
        time = res.index
    x = np.arange(len(res.status)) * res.relations.model.dt if time is None else np.asarray(time)
    if x.shape != res.status.shape:
        raise ValueError(f"time needs one entry for each of the {len(res.status)} samples: its shape is {x.shape}")
    return x


def time_axis(x):
    """Return (x, label, dates): a time axis in units that read well."""
    if np.issubdtype(x.dtype, np.datetime64):
        return x, "", True
    span = float(x[-1] - x[0]) if len(x) > 1 else 0.0
    units = (("days", 86400, 172800), ("h", 3600, 10800), ("min", 60, 300), ("s", 1, 0))
    unit, size = next((unit, size) for unit, size, limit in units if span >= limit)
    return x / size, f"time ({unit})", False


def _bins(count):
    """Return where each bin starts: one sample each, or 1200 bins."""
    return np.arange(count) if count <= SAMPLES else np.linspace(0, count, BINS, endpoint=False).astype(int)


def thinning(count, drawn, what):
    """Return what a title says of points that stand for many samples, or nothing."""
    return f"   (each of {drawn} points: {what} of about {count // drawn} samples)" if drawn < count else ""


def _worst(res):
    """Return the index of the worst window of each bin: FAULT first, then the smallest margin."""
    key = np.where(np.isnan(res.margin), np.inf, res.margin) - np.where(res.status == Status.FAULT, 1e18, 0)
    edges = np.append(_bins(len(key)), len(key))
    return np.array([a + int(np.argmin(key[a:b])) for a, b in zip(edges[:-1], edges[1:], strict=True)])


def _forms(res, picked):
    """Return residuals and envelopes (M, count) of the windows that end at the picked samples, in one padded stretch of fixed length."""
    s, dtype = res.relations.horizon, res.y.dtype
    whole = len(picked) == len(res.y)
    rows = picked if whole else (np.maximum(picked, s)[:, None] + np.arange(-s, 1)).ravel()
    pad = lambda x: np.concatenate([x[rows], np.full((max(SAMPLES - len(rows), 0), x.shape[1]), np.nan, dtype)])
    u, y = pad(res.u), pad(res.y)
    keep = slice(0, len(rows)) if whole else slice(s, len(rows), s + 1)
    envelope = res.relations.internal(u, y)
    return [np.asarray(x)[keep] for x in (res.relations.external(u, y), envelope.lo, envelope.hi)]


def shade(ax, x, on):
    """Shade the samples that are on, each at least a pixel wide."""
    if not on.any() or len(x) < 2:
        return
    half = (x[-1] - x[0]) / max(len(x) - 1, 1) / 2
    starts = np.flatnonzero(np.diff(np.concatenate([[0], on.astype(int)])) == 1)
    ends = np.flatnonzero(np.diff(np.concatenate([on.astype(int), [0]])) == -1)
    edges = np.column_stack([x[starts] - half, x[starts] - half, x[ends] + half, x[ends] + half]).ravel()
    level = np.tile([0, 1, 1, 0], len(starts))
    ax.fill_between(edges, 0, level, transform=ax.get_xaxis_transform(), color="#fbe3d6", lw=0.4, zorder=0, label="FAULT")


def _margin(ax, x, low, high, thinned):
    lowest = float(np.nanmin(low))
    if thinned:
        ax.fill_between(x, low, high, color=ENVELOPE, alpha=0.5, lw=0)
    ax.plot(x, low, color=INK, lw=0.9)
    with np.errstate(invalid="ignore"):
        out = low < 0
    ax.plot(x[out], low[out], ls="", marker="o", ms=2.6, color=FAULTY, zorder=3)
    ax.axhline(0, color="#30363d", lw=1.1, zorder=2)
    steep = lowest < -4
    scale = {"linthresh": 1, "linscale": max(0.6, 0.35 * np.log10(-lowest))} if steep else {}
    right = ax.twinx()
    ax.set_yscale("symlog" if steep else "linear", **scale)
    right.set_yscale("symlog" if steep else "linear", **scale)
    pad = 0.06 * (1 - min(lowest, 0))
    ax.set_ylim(*((lowest * 1.6, 1.25) if steep else (min(lowest, 0) - pad, 1 + pad)))
    right.set_ylim(ax.get_ylim())
    if steep:
        powers = range(0, int(np.ceil(np.log10(-lowest))) + 1)
        powers = powers[:: max(1, len(powers) // 4)]
        ax.set_yticks([1, 0.5, 0, *(-(10.0**n) for n in powers)], ["1", "0.5", "0", *(f"$-10^{{{n}}}$" if n else "-1" for n in powers)])
        factors = [(1, "×1"), (2, "×2"), *((10**n, f"×10$^{{{n}}}$" if n > 1 else "×10") for n in powers if n)]
    else:
        factors = [(f, f"×{f:g}") for f in FACTORS if 1 - f >= ax.get_ylim()[0]]
    right.set_yticks([1 - f for f, _ in factors], [text for _, text in factors])
    for side, text in ((ax, "margin   (< 0: outside the bounds)"), (right, "bounds needed to explain it")):
        side.minorticks_off()
        side.set_ylabel(text)
    ax.grid(color=GRID, lw=0.7, axis="y")


def _mark_alarms(ax, x, count):
    ax.plot(x, np.full(len(x), 1.02), ls="", marker="v", ms=4, color=FAULTY, transform=ax.get_xaxis_transform(), clip_on=False)
    text = f"{count} alarm" + "s" * (count != 1)
    ax.text(1.0, 1.055, text, ha="right", transform=ax.transAxes, fontsize=9.5, color=FAULTY)


def _ribbon(ax, x, status):
    """Draw a strip in the colour of the worst verdict of each bin, with a legend of the verdicts that occur."""
    from matplotlib.colors import ListedColormap
    from matplotlib.patches import Patch

    edges = np.concatenate([x[:1], x[1:] - (x[1:] - x[:-1]) / 2, x[-1:]])
    ax.pcolormesh(edges, [0, 1], status[None, :], cmap=ListedColormap([COLOURS[s] for s in Status]), vmin=-0.5, vmax=3.5)
    ax.set_yticks([])
    ax.set_ylabel("verdict", rotation=0, ha="right", va="center")
    present = [s for s in Status if (status == s).any()]
    handles = [Patch(color=COLOURS[s], label=s.name) for s in present]
    ax.figure.legend(handles=handles, loc="lower left", ncols=4, fontsize=9, bbox_to_anchor=(0.066, 0.0))


def _no_margin(res):
    return "paving proves FAULT but measures no margin" if res.method == "paving" else "no window has usable data"


def _robust_limits(ax, external, lo, hi):
    """Set limits that one huge residual does not spoil; return how many windows lie beyond them."""
    seen = np.isfinite(external) & np.isfinite(lo) & np.isfinite(hi)
    if not seen.any():
        return 0
    bottom, top = float(np.quantile(lo[seen], 0.002)), float(np.quantile(hi[seen], 0.998))
    width = max(top - bottom, 1e-300)
    least, most = float(external[seen].min()), float(external[seen].max())
    bottom, top = max(min(bottom, least), bottom - width), min(max(top, most), top + width)
    pad = 0.06 * (top - bottom)
    ax.set_ylim(bottom - pad, top + pad)
    return int(((external[seen] < bottom) | (external[seen] > top)).sum())


def finish(fig, axes, x, label, dates, top=0.62, gap=0.09):
    """Label the time axis of the lowest axes and place all of them: margins in inches, gap relative to an axes' height."""
    axes[-1].set_xlabel(label)
    for ax in axes[:-1]:
        ax.tick_params(labelbottom=False)
    if len(x) > 1:
        axes[-1].set_xlim(x[0], x[-1])
    if dates:
        from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

        locator = AutoDateLocator()
        axes[-1].xaxis.set_major_locator(locator)
        axes[-1].xaxis.set_major_formatter(ConciseDateFormatter(locator))
    height = fig.get_figheight()
    fig.subplots_adjust(left=0.075, right=0.925, bottom=BOTTOM / height, top=1 - top / height, hspace=gap)
