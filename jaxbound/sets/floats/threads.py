"""Settings of a thread: contexts of JAX belong to a thread, and those that it starts know nothing of them."""

from collections.abc import Callable
from typing import ParamSpec, TypeVar

import jax
import numpy as np

from jaxbound.sets.floats.kernel import is_outside_xla, is_sparing, judged_by, noted, outside_xla, sparing
from jaxbound.sets.floats.probe import is_searching, searching

P = ParamSpec("P")
T = TypeVar("T")


def has_x64() -> bool:
    """Return whether JAX computes with 64 bits in this thread, by a context or for all."""
    return bool(jax.dtypes.canonicalize_dtype(np.float64) == np.float64)


def inherited(job: Callable[P, T]) -> Callable[P, T]:
    """Return a function that does the job in any thread with the settings of the thread that asks here.

    Settings are x64, `outside_xla`, `sparing`, `noted` and `searching`; the device is left to the job.

    Example:
        >>> from concurrent.futures import ThreadPoolExecutor
        >>> with jax.enable_x64(False), ThreadPoolExecutor(1) as threads:
        ...     print(threads.submit(inherited(has_x64)).result())
        False
    """
    wide, outside, searched, spares = has_x64(), is_outside_xla(), is_searching(), is_sparing()
    ways = judged_by()

    def run(*args: P.args, **kwargs: P.kwargs) -> T:
        with jax.enable_x64(wide), outside_xla(outside), searching(searched), sparing(spares), noted(ways):
            return job(*args, **kwargs)

    return run
