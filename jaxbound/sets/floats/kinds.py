"""Kinds of devices: the facts that distinguish them, and how far a quotient may be off on each."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache

import jax
import numpy as np
from jax.typing import DTypeLike

FINE, COARSE = 2.84, 4.84
"""Units that a quotient may be off by: anywhere, and in float32 on a card of NVIDIA (4, PTX ISA)."""
EXTRA = 2.0
"""Units by which bounds are widened further for a coarse quotient: 6 in place of 4."""


def kind_of_device(device: jax.Device) -> dict[str, str]:
    """Return the four facts that distinguish kinds of devices: {"platform", "capability", "driver",
    "jaxlib"}.

    Args:
        device: of jax. capability: of an NVIDIA device its compute capability, like "9.0", else ""; driver:
            what its plug-in says.

    Example:
        >>> import jax
        >>> kind_of_device(jax.devices("cpu")[0])["platform"]
        'cpu'
    """
    capability = str(getattr(device, "compute_capability", "") or "")
    nvidia = capability and "nvidia" in str(getattr(device, "device_kind", "")).lower()
    driver = ""
    if device.platform != "cpu":
        told = str(getattr(getattr(device, "client", None), "platform_version", ""))
        driver = " ".join(told.split())
    return {
        "platform": "NVIDIA" if nvidia else device.platform,
        "capability": capability,
        "driver": driver,
        "jaxlib": jax.lib.__version__,
    }


def named(kind: dict[str, str]) -> str:
    """Return a kind of device in words, like "NVIDIA 9.0"."""
    return " ".join(x for x in (kind["platform"], kind["capability"]) if x)


def most_of_a_quotient(device: jax.Device, dtype: DTypeLike) -> float:
    """Return the units u that a quotient of a device may be off by, as `rounding.outward` allows for."""
    if _is_single(dtype) and kind_of_device(device)["platform"] == "NVIDIA":
        return COARSE
    return FINE


@contextmanager
def plainly_on(device: jax.Device) -> Iterator[None]:
    """Compute on a device, compiled, whatever JAX is to look for in the results."""
    with (
        jax.ensure_compile_time_eval(),
        jax.default_device(device),
        jax.debug_nans(False),
        jax.debug_infs(False),
        jax.disable_jit(False),
    ):
        yield


def extra_units(dtype: DTypeLike) -> float:
    """Return the units that `rounding.outward` widens by beside those it is asked for: 0, and 2 in float32
    where a card of NVIDIA is in this process.

    One number for the whole process: programs are written down once for all its devices.
    """
    if _is_single(dtype) and has_coarse_quotients():
        return EXTRA
    return 0.0


@cache
def has_coarse_quotients() -> bool:
    """Return whether a device of this process divides float32 coarsely."""
    devices = [*jax.local_devices()]
    with suppress(RuntimeError):  # beside a CPU that is the default
        devices += jax.local_devices(backend="gpu")
    return any(kind_of_device(device)["platform"] == "NVIDIA" for device in devices)


@cache
def is_cpu_default() -> bool:
    """Return whether work goes to CPUs where nobody chooses a device."""
    return all(device.platform == "cpu" for device in jax.local_devices())


def _is_single(dtype: DTypeLike) -> bool:
    return np.dtype(dtype) == np.float32
