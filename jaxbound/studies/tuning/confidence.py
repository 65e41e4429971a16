"""Healthy data about healthy data that nobody has seen: statements that hold for any number of
samples.

The units are blocks of windows that share no sample. All statements assume that blocks are exchangeable: a
new one is drawn as those seen were, and their order means nothing. Nothing is assumed about distributions.

n blocks that had no part in choosing the direction of the bounds scale them: a new block needs more than all
of them with a probability of at most 1 / (n + 1), on average over such sets of blocks (its rank among n + 1
is uniform, ties help); if blocks are independent, then with confidence 1 - delta at most 1 - delta^(1/n) of
all blocks do (else n of n would have had less than delta). Their factors are distributed as seen, within
sqrt(log(2 / delta) / (2 n)).

Source: Vovk, Gammerman, Shafer 2005 (split conformal prediction); Massart 1990 (Dvoretzky, Kiefer,
Wolfowitz); Campi, Garatti 2008.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

BLOCKS = 100  # that data are cut into, unless a length is asked for


@dataclass(frozen=True)
class Risk:
    """The risk of a false alarm in a new block, for the smallest bounds: a safety factor comes on top and is
    not counted.

    Fields:
        blocks: how many the statement rests on. length: windows in each.
        average: at most this is the probability that a new block holds a window outside; None if nothing can
            be said.
        rate, confidence: with this confidence at most this share of all blocks does; None if nothing can be
            said.
        band: with the same confidence the distribution of `factors` is that of all blocks within this much.
        factors: (blocks,) ascending, the largest factor t of each block: 1 - t is the least margin in it.
        guide: True where the two numbers belong to the exact optimum, which bounds found by gradient only
            come near to.
        text: all of this in sentences.
    """

    blocks: int
    length: int
    average: float | None
    rate: float | None
    confidence: float
    band: float | None
    factors: np.ndarray
    guide: bool
    text: str


def rank_risk(n: int) -> float:
    """Return 1 / (n + 1), the largest probability that a new block needs more than all of n.

    Example:
        >>> rank_risk(19)
        0.05
    """
    return 1 / (n + 1)


def rate_bound(n: int, confidence: float) -> float:
    """Return the share of all blocks that need more than all of n independent ones, at most and with this
    confidence.

    Example:
        >>> round(rate_bound(59, 0.95), 3)
        0.05
    """
    return float(1 - (1 - confidence) ** (1 / n))


def distribution_band(n: int, confidence: float) -> float:
    """Return by how much the distribution of n independent numbers differs from the true one anywhere, at
    most and with this confidence.

    Example:
        >>> round(distribution_band(100, 0.95), 3)
        0.136
    """
    return math.sqrt(math.log(2 / (1 - confidence)) / (2 * n))


def scenario_bound(n: int, bounds: int, confidence: float) -> float:
    """Return the share of all blocks that the optimum of a convex program over n blocks violates, at most and
    with this confidence.

    It is the eps with sum over i < bounds of C(n, i) eps^i (1 - eps)^(n - i) = 1 - confidence.

    Args:
        n: independent blocks. bounds: how many numbers were optimised. confidence: in (0, 1).

    Example:
        >>> round(scenario_bound(59, 1, 0.95), 3), round(scenario_bound(100, 4, 0.95), 3)
        (0.05, 0.076)
    """
    from scipy.special import betaincinv

    if bounds > n:
        return 1.0
    return float(betaincinv(bounds, n - bounds + 1, confidence))


class Blocks(NamedTuple):
    """Blocks of windows that share no sample: there are s windows between two of them.

    Fields: label: (T,) the number of the block of each window, -1 where it is in none. length: windows in
    each. horizon: s.
    """

    label: np.ndarray
    length: int
    horizon: int


def blocks_of(across: np.ndarray, horizon: int, length: int | None = None) -> Blocks:
    """Cut windows into blocks that share no sample.

    Args:
        across: (T,) bool, True where no window ends. horizon: s. length: windows in a block; None: so many
            that there are about 100 blocks, and s + 1 at least.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[True], across, [True]]).astype(np.int8)))
    runs = [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]
    if length is None:
        length = max(horizon + 1, math.ceil(sum(b - a for a, b in runs) / BLOCKS) - horizon, 1)
    label, number = np.full(len(across), -1, np.int64), 0
    for first, stop in runs:
        for begin in range(first, stop - length + 1, length + horizon):
            label[begin : begin + length] = number
            number += 1
    return Blocks(label, length, horizon)


def held_out(blocks: int, share: float) -> np.ndarray:
    """Return (blocks,) bool: the share of blocks that is kept for scaling, spread evenly.

    Example:
        >>> held_out(6, 1 / 3).tolist()
        [False, False, True, False, False, True]
    """
    count = np.floor(np.arange(blocks + 1) * share + 1e-9)
    return np.asarray(np.diff(count) > 0)


def touched(chosen: np.ndarray, horizon: int) -> np.ndarray:
    """Return (T,) bool: windows that share a sample with a chosen one.

    Example:
        >>> touched(np.array([False, False, False, True, False, False]), 1).tolist()
        [False, False, True, True, True, False]
    """
    count = np.cumsum(np.append(0, chosen))
    at = np.arange(len(chosen))
    return count[np.minimum(at + horizon + 1, len(chosen))] > count[np.maximum(at - horizon, 0)]


class Search(NamedTuple):
    """The part that data had in a search for bounds.

    Fields: kept: (blocks,) bool, blocks that had no part in choosing the direction. tuned: how many bounds
    moved. convex: whether the program is. fixed: whether data had no part in the direction at all.
    """

    kept: np.ndarray
    tuned: int
    convex: bool
    fixed: bool


def risk_of(factors: np.ndarray, blocks: Blocks, search: Search, confidence: float, safety: float) -> Risk:
    """Return the Risk of bounds that were scaled until all windows were inside.

    Args:
        factors: (T,) t of every window at the smallest bounds, NaN where missing. blocks: of these windows.
            search: that found the bounds. confidence: of .rate. safety: the factor on top.
    """
    label, length, horizon = blocks
    kept, tuned, convex, fixed = search
    worst = np.full(int(label.max(initial=-1)) + 1, -np.inf)
    inside = (label >= 0) & ~np.isnan(factors)
    np.maximum.at(worst, label[inside], factors[inside])
    has_data = worst > -np.inf  # a block without any data says nothing
    kept = has_data if fixed else kept & has_data
    n, count = int(kept.sum()), int(has_data.sum())
    extra = ""
    if safety != 1:
        extra = f" The safety factor {safety:g} comes on top and is not counted."
    if n:
        average, rate, band = rank_risk(n), rate_bound(n, confidence), distribution_band(n, confidence)
        text = _calibrated_text(n, length, average, rate, band, confidence, fixed) + extra
        return Risk(n, length, average, rate, confidence, band, np.sort(worst[kept]), False, text)
    factors_of_blocks = np.sort(worst[has_data])
    if count > tuned and convex:
        average, rate = tuned / (count + 1), scenario_bound(count, tuned, confidence)
        text = _guiding_text(count, length, average, rate, confidence, tuned) + extra
        return Risk(count, length, average, rate, confidence, None, factors_of_blocks, True, text)
    text = (
        f"Nothing can be said about other healthy data: {count} block{'s' * (count != 1)} of {length} "
        f"windows of {horizon + 1} samples, none of them kept out of the search. More data, or calibrate= > "
        f"0, give a statement.{extra}"
    )
    return Risk(0, length, None, None, confidence, None, factors_of_blocks, False, text)


def risk_of_recordings(factors: np.ndarray, confidence: float, safety: float) -> Risk:
    """Return the Risk of bounds that one number scaled until all recordings were inside.

    Args:
        factors: (n,) t of each recording at the smallest bounds. confidence, safety: as for `risk_of`.
    """
    n = len(factors)
    average, rate, band = rank_risk(n), rate_bound(n, confidence), distribution_band(n, confidence)
    text = (
        f"{n} recording{'s' * (n > 1)} rescaled the given bounds, which must not come from the same data. If "
        f"recordings of healthy operation are exchangeable (a new one is drawn as these were, in any order), "
        f"a new one needs more than the smallest bounds with a probability of at most 1/{n + 1} = "
        f"{_percent(average)}; if they are independent, then with {100 * confidence:g} % confidence at most "
        f"{_percent(rate)} of all do. What was left out and the safety factor {safety:g} come on top and are "
        f"not counted."
    )
    return Risk(n, 1, average, rate, confidence, band, np.sort(factors), False, text)


ASSUMED = "If blocks of healthy operation are exchangeable (a new one is drawn as these were, in any order)"


def _calibrated_text(
    n: int, length: int, average: float, rate: float, band: float, confidence: float, fixed: bool
) -> str:
    """Return the statement that rests on blocks which only scaled the bounds."""
    role = "had no part in the search and only rescaled what it found"
    if fixed:
        role = "rescaled the given bounds, which must not come from the same data"
    return (
        f"{n} block{'s' * (n > 1)} of {length} windows, which share no sample, {role}. {ASSUMED}, a new "
        f"block holds a window outside the smallest bounds with a probability of at most 1/{n + 1} = "
        f"{_percent(average)}, on average over such data; if they are independent, then with "
        f"{100 * confidence:g} % confidence in at most {_percent(rate)} of all blocks, and the least margins "
        f"of blocks are distributed as seen here within {_percent(band)}."
    )


def _guiding_text(
    blocks: int, length: int, average: float, rate: float, confidence: float, tuned: int
) -> str:
    """Return the guide that there is where all blocks took part in the search."""
    return (
        f"No block was kept out of the search. {ASSUMED} and independent, the exact optimum of {tuned} "
        f"bounds over {blocks} blocks of {length} windows leaves a new block outside with a probability of "
        f"at most {_percent(average)} on average, and with {100 * confidence:g} % confidence at most "
        f"{_percent(rate)} of all blocks. Bounds found by gradient come near to that optimum, so this is a "
        f"guide and no guarantee; a share of blocks kept out (calibrate=) gives one."
    )


def _percent(share: float) -> str:
    return f"{100 * min(share, 1.0):.3g} %"
