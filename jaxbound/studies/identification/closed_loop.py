"""Inputs that a controller makes of past outputs: in a closed loop a fault moves the input, and may leave the
output where it was.

Each input is predicted by its own past, and by that and the past of one output, by least squares. What nobody
feeds back is predicted no better by outputs; what a controller computes, much better.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from jaxbound.studies.identification.records import Records
from jaxbound.studies.identification.regression import CompleteWindows, scales_of, windows_of

PAST, MOST = 2, 20_000
"""Samples of the past that predict, and windows that are looked at, at most."""
ROOM = 20
"""The least number of windows for each coefficient."""
LOOP, LIVELY = 0.5, 1e-3
"""Below this share of the error that its own past leaves, an input is fed back; an error below this share of
its spread says nothing.
"""


def closed_loops(records: Records, inputs: Sequence[str], outputs: Sequence[str]) -> Iterator[str]:
    """Yield a sentence for each input that past outputs predict far better than its own past does."""
    windows = windows_of(records, scales_of(records), PAST, MOST)
    if len(windows.u) < ROOM * (2 * PAST + 1):
        return
    for i, name in enumerate(inputs):
        alone = _error(windows, i, [])
        if alone < LIVELY:
            continue
        shares = [_error(windows, i, [j]) / alone for j in range(len(outputs))]
        best = int(np.argmin(shares))
        if shares[best] < LOOP:
            output = outputs[best]
            yield (
                f"{name} follows {output}: the past of {output} leaves {shares[best]:.2g} of the error with "
                f"which {name} is predicted by its own. In a closed loop a fault moves {name} and hardly "
                f"{output}: record steps of {name} that nobody feeds back, or fit again with "
                f"{name} in --outputs, outputs={[*outputs, name]!r}"
            )


def _error(windows: CompleteWindows, i: int, outputs: Sequence[int]) -> float:
    """Return the root mean square error of the prediction of input i by its past and that of some outputs."""
    past = [windows.u[:, :PAST, i], *(windows.y[:, :PAST, j] for j in outputs)]
    regressors = np.concatenate([*past, np.ones((len(windows.u), 1))], 1)
    now = windows.u[:, PAST, i]
    weights, *_ = np.linalg.lstsq(regressors, now, rcond=1e-9)
    return float(np.sqrt(np.mean(np.square(now - regressors @ weights))))
