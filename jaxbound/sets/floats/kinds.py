"""Kinds of devices: the facts that distinguish them."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from importlib.metadata import version

import jax

__all__ = [
    "is_cpu_default",
    "kind_of_device",
    "named",
    "plainly_on",
]


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
        "jaxlib": _jaxlib(),
    }


def named(kind: dict[str, str]) -> str:
    """Return a kind of device in words, like "NVIDIA 9.0"."""
    return " ".join(x for x in (kind["platform"], kind["capability"]) if x)


@cache
def _jaxlib() -> str:
    """Return the version of jaxlib: looking it up takes a millisecond."""
    return version("jaxlib")


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


@cache
def is_cpu_default() -> bool:
    """Return whether work goes to CPUs where nobody chooses a device."""
    return all(device.platform == "cpu" for device in jax.local_devices())
