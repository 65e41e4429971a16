"""The picture of whatever can be drawn: each file beside this one registers how, `@plot.register(Thing)` on a
function of a Thing.
"""

from functools import singledispatch
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@singledispatch
def plot(thing: object, time: object = None, alarms: object = None, ax: object = None) -> "Figure | Axes":
    """Draw a result, a table of faults, or sets in the plane.

    Args:
        thing: a Result of one recording: the margin of every window over time with a ribbon of verdicts and
            the alarms. A BankResult: which relations are violated and which single faults remain, over time.
            Signatures or Isolability: the table as a heat map. A TuneResult: the search and the margins.
            A Diagnosis: the smallest size of each named fault that alone explains an alarm.
            An Assessment: faulty against healthy windows in alarm, over factors on the bounds.
            A Fitted: the share of its bounds that each window needs. A Look: each column.
            A StudyResult: what is detected against the size of a fault.
            A Digest: as a Result. A Validation: the band of the true value of each output, and its faulty
                samples.
            An Observation: the band of each output before its sample is looked at, and of each state.
            A ParameterSet: its boxes, for each pair of parameters.
            A Zonotope or ConstrainedZonotope in the plane, or a list of them: their outlines.
        time: (T,) seconds or datetime64, of a Result, BankResult, Validation or Observation; None: the index
            of the DataFrame, or sample numbers times dt.
        alarms: a list of Alarm for a Result; None: its own.
        y: (T, p), of a Validation or Observation: what the sensors showed, if it is to be drawn too.
        ax: matplotlib Axes of one's own to draw into: of what is one chart (sets, Signatures, Isolability, a
            Diagnosis), and of a Result or Digest the margin with its alarms. What has several charts makes a
            figure of its own and takes none.

    Returns:
        A matplotlib Figure, not one of pyplot: fig.savefig("margin.png"). At the end of a notebook cell it
        shows itself. With ax, that Axes.

    Raises:
        ValueError: a batch of recordings, or a time axis of another length. TypeError: what cannot be drawn,
            and options that a thing does not have.

    Example:
        >>> import jaxbound as jb
        >>> m = jb.LinearSystem([[0.5]], [[1]], [[1]], noise=0.1)
        >>> len(plot(jb.detect(jb.parity_relations(m), [[0.0]] * 4, [[1.0], [0.5], [0.9], [0.45]])).axes)
        3
        >>> [len(plot(x).axes) for x in (jb.signatures(jb.redundancy(m)), jb.isolability(m))]
        [1, 1]
    """
    kinds = sorted(kind.__name__ for kind in plot.registry if kind is not object)
    raise TypeError(f"plot draws {', '.join(kinds)}, not {type(thing).__name__}")
