"""The picture of a whole recording for readers without scripts, in SVG: its margin over time, a ribbon of
verdicts, and its alarms.

`plots.timeline` draws the same for notebooks; to import what it draws with takes longer than most recordings.
"""

from collections.abc import Iterator
from html import escape

import numpy as np

from jaxbound.plots.canvas import CALM, COLOURS, ENVELOPE, FAULTY, GRID, INK, thinning
from jaxbound.plots.timeline import Timeline
from jaxbound.sets.floats.status import Status
from jaxbound.text.characters import printable

WIDTH, HEIGHT = 880, 330
LEFT, RIGHT, TOP, BOTTOM = 50, 870, 30, 270
RIBBON = 282, 300
TICKS = 4
"""Powers of ten of the margin that have a tick, at most."""
SPARE = 1.05
"""How much further the axis goes than margins do."""


def overview(line: Timeline, name: str, ends: tuple[str, str], alarms: int, observes: bool) -> bytes:
    """Return a complete Timeline of a model of that name as SVG.

    Args:
        ends: the times of its first and last sample, in words. alarms: how many there are. observes: whether
            UNDECIDED is what healthy samples are.
    """
    assert line.x is not None, "a Timeline is drawn when all its samples were added"
    x, low, high = _time_places(line.x), _scaled(line.low), _scaled(line.high)
    lowest = float(np.fmin.reduce(low, initial=0))
    down = (BOTTOM - TOP) / (SPARE - SPARE * lowest)

    def height(margin: np.ndarray) -> np.ndarray:
        return np.asarray(TOP + down * (SPARE - margin))

    title = f"Margin of {name}" + thinning(line.samples, len(x), "extremes")
    parts = [_text(LEFT, 16, title, "start"), _text(RIGHT, 16, _alarms(alarms), "end", FAULTY)]
    parts += _verdict_strip(x, line.status, observes)
    for margin in _margin_ticks(lowest):
        y = float(height(_scaled(np.array(margin))))
        parts.append(f'<path d="M{LEFT} {y:.1f}H{RIGHT}" stroke="{GRID if margin else INK}"/>')
        parts.append(_text(LEFT - 6, y + 4, f"{margin:g}", "end"))
    if line.samples > len(x):
        parts.append(f'<path d="{_broken_line(x, height(high))}" stroke="{ENVELOPE}"/>')
    parts.append(f'<path d="{_broken_line(x, height(low))}" stroke="{INK}"/>')
    for at in x[line.marked].tolist():
        parts.append(f'<path d="M{at - 4:.1f} 20h8l-4 7z" fill="{FAULTY}"/>')
    parts += [_text(LEFT, 318, ends[0], "start"), _text(RIGHT, 318, ends[1], "end")]
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}"'
    style = 'font-family="sans-serif" font-size="12" fill="none"'
    return "\n".join([f"{head} {style}>", *parts, "</svg>"]).encode()


def _time_places(time: np.ndarray) -> np.ndarray:
    """Return the places of times in the picture."""
    since = np.asarray(time - time[0], float)
    return np.asarray(LEFT + (RIGHT - LEFT) * since / max(since[-1], 1e-300))


def _scaled(margin: np.ndarray) -> np.ndarray:
    """Return margins, those below -1 by their logarithm."""
    return np.where(margin < -1, -1 - np.log10(np.maximum(-margin, 1)), margin)


def _margin_ticks(lowest: float) -> list[float]:
    """Return the margins at which the axis has a tick; lowest: scaled."""
    steps = [-(10.0**n) * k for n in range(int(-lowest) + 1) for k in (1, 2, 5)]
    steps = [x for x in steps if _scaled(np.array(x)) >= lowest]
    return [1.0, 0.5, 0.0, *steps[:: 1 + len(steps) // TICKS]]


def _broken_line(x: np.ndarray, y: np.ndarray) -> str:
    """Return a line through points, in pieces where there are none between."""
    words, pen = [], "M"
    for a, b in zip(x.tolist(), y.tolist(), strict=True):
        if b != b:
            pen = "M"
            continue
        words.append(f"{pen}{a:.1f} {b:.1f}")
        pen = "L"
    return "".join(words)


def _verdict_strip(x: np.ndarray, status: np.ndarray, observes: bool) -> Iterator[str]:
    """Yield the strip of verdicts, and the shades of FAULT behind the margin."""
    edges = np.concatenate([x[:1], (x[1:] + x[:-1]) / 2, [RIGHT]])
    begins = np.flatnonzero(np.diff(status, prepend=-1))
    for first, behind in zip(begins, [*begins[1:], len(status)], strict=True):
        verdict = Status(int(status[first]))
        colour = COLOURS[verdict]
        if observes and verdict == Status.UNDECIDED:  # of a healthy sample: nothing to warn of
            colour = CALM
        a, width = edges[first], max(edges[behind] - edges[first], 1)
        place = f'x="{a:.1f}" width="{width:.1f}" fill="{colour}"'
        yield f'<rect {place} y="{RIBBON[0]}" height="{RIBBON[1] - RIBBON[0]}"/>'
        if verdict == Status.FAULT:
            yield f'<rect {place} y="{TOP}" height="{BOTTOM - TOP}" opacity=".12"/>'


def _alarms(count: int) -> str:
    """Return how many alarms there are, in words; "" for none."""
    if not count:
        return ""
    return f"{count} alarm" + "s" * (count != 1)


def _text(x: float, y: float, words: str, anchor: str, colour: str = INK) -> str:
    """Return a text of the picture."""
    said = escape(printable(words))
    return f'<text x="{x}" y="{y:.1f}" text-anchor="{anchor}" fill="{colour}">{said}</text>'
