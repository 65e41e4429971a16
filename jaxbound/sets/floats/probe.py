"""May this process prove anything? What `rounding` assumes of processor, device and compiler, asked before
every proof.

**The rounding mode** of the processor is asked at every call: it takes a microsecond, and an import can
change it at any time. **The device** has to be of a kind whose arithmetic was examined: CPU, so far. An
accelerator of NVIDIA is known by its compute capability, its driver and the version of jaxlib
(`kind_of_device`); none is in `EXAMINED` before `examination` has run on one, with every test of this house,
and before what no probe can show (`PREMISES`) holds for what is computed there. **Flags of XLA, and switches
of the environment,** that give arithmetic up are refused by name (`settings`): what they allow, a compiler
need not do to the kernels of a probe. **The probe** (`measure`), one small kernel, catches what names do not,
and asks the premises beside
rounding: that a stored quotient is one number for all its uses, that a callee is kept apart. It runs once a
process for each device and setting, with the flags in force.
**Versions of jaxlib, flags and options of jax** that no table knows are examined in full, once (`examined`).
"""

import os
from fractions import Fraction
from functools import lru_cache
from importlib.metadata import version
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from jaxbound.sets.floats import rounding, unrolled
from jaxbound.sets.floats.examined import doubt_of
from jaxbound.sets.floats.settings import (
    examined_versions,
    loose_flags,
    odd_options,
    set_switches,
    unknown_flags,
)

__all__ = [
    "EXAMINED",
    "PREMISES",
    "Unverified",
    "default_device",
    "kind_of_device",
    "measure",
    "refuse_other_modes",
    "refuse_unverified",
    "usable_devices",
    "verified",
]

EXAMINED = frozenset({"cpu"})
"""Kinds of devices, as `kind_of_device` names them without the driver, on which this house's tests were
run.
"""

PREMISES = {
    "cpu": (),
    "NVIDIA": (
        "float32: a quotient may be off by 2 ulp, 4 units (PTX ISA, div.full.f32); `outward` must widen it "
        "by 6 units, and widens by 4",
        "float32: a root may be off by 1 ulp, 2 units (PTX ISA, sqrt.approx.f32), within the 2.84 that are "
        "assumed",
        "float64: + - * / fma and sqrt are rounded correctly (PTX ISA, .rn)",
        "a * b + c may be contracted; subnormals are kept in float64, and in float32 unless xla_gpu_ftz is "
        "set: both are allowed for",
        "dots of libraries may compute in TF32 or emulate float64: what is proved computes none there",
    ),
}
"""What the makers' manuals say of the arithmetic of a kind of device, and no probe can show."""


class Unverified(RuntimeError):
    """Nothing can be proved in this process, or on this device; the message says why, and what to do."""


def refuse_unverified(*given: object) -> None:
    """Raise Unverified if a proof from these arguments would rest on arithmetic that was not verified.

    Args:
        given: PyTrees; where jax arrays among them lie, the work is done. Without any: on the devices of
            `usable_devices`.
    """
    refuse_other_modes()
    devices = {usable_devices()[0]}
    for x in jax.tree.leaves(given):
        if isinstance(x, jax.Array) and not isinstance(x, jax.core.Tracer):
            devices |= x.devices()
    for device in devices:
        if why := _doubt(device):
            raise Unverified(why)


def refuse_other_modes() -> None:
    """Raise Unverified if this process does not round to the nearest float, or flushes small ones: all bounds
    in `rounding` rest on that.

    Importing some libraries for intervals (codac, for one) sets the processor to round upward from then on,
    in threads to come too.
    """
    one, half = float(np.ones(())), float(np.finfo(np.float64).eps) / 4
    if one + half != one or one - half != one:
        raise Unverified(
            "this process does not round to nearest: some library that was imported (codac does it) has "
            "changed the rounding mode of the "
            "processor, so nothing can be proved here; run it in another process, or set the mode back to "
            "nearest (fesetround)"
        )
    if not one * float(np.finfo(np.float64).tiny) / 2 > 0:
        raise Unverified(
            "this thread reads numbers below the smallest normal one as 0, or makes them 0: some library has "
            "set the processor to flush "
            "them, so nothing can be proved here; ask in another thread or process, or switch that off"
        )


def default_device() -> Any:
    """Return the device that `jax.default_device` chose, perhaps by its name, or None."""
    return jax.config.jax_default_device  # type: ignore[attr-defined]  # made at run time


def usable_devices() -> tuple[jax.Device, ...]:
    """Return the devices that work goes to: all of this process, or the one of `jax.default_device` where
    that is set.
    """
    chosen = default_device()
    if chosen is None:
        return tuple(jax.local_devices())
    return tuple(jax.local_devices(backend=chosen)[:1]) if isinstance(chosen, str) else (chosen,)


def verified(device: jax.Device) -> bool:
    """Return whether results of a device may carry a proof; the first call takes a tenth of a second."""
    return not _doubt(device)


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
    driver = (
        ""
        if device.platform == "cpu"
        else str(getattr(getattr(device, "client", None), "platform_version", ""))
    )
    return {
        "platform": "NVIDIA" if nvidia else device.platform,
        "capability": capability,
        "driver": driver,
        "jaxlib": version("jaxlib"),
    }


def _doubt(device: jax.Device) -> str:
    """Return why a device proves nothing, in a sentence; empty where it may."""
    x64 = bool(jax.config.jax_enable_x64)  # type: ignore[attr-defined]  # made at run time
    switches = set_switches() if device.platform != "cpu" else ()
    return _found(device, os.environ.get("XLA_FLAGS", ""), x64, switches, odd_options())


@lru_cache
def _found(
    device: jax.Device, flags: str, x64: bool, switches: tuple[str, ...] = (), options: tuple[str, ...] = ()
) -> str:
    kind = kind_of_device(device)
    named = " ".join(x for x in (kind["platform"], kind["capability"]) if x)
    if switches:
        return (
            f"the environment has {' and '.join(switches)}, by which libraries of {named} compute "
            f"otherwise: start without"
        )
    if named not in EXAMINED:
        return (
            f"proofs need a device whose rounding was verified, so far only CPU, not {named}: set "
            f"JAX_PLATFORMS=cpu, or give "
            'NumPy arrays under `with jax.default_device("cpu")`; margins gives unproved values anywhere'
        )
    if loose := loose_flags(flags):
        return (
            f"XLA_FLAGS has {' and '.join(loose)}, with which the compiler keeps to no rounding: start "
            f"without, nothing can be proved so"
        )
    if kind["platform"] == "NVIDIA" and not x64:
        return (
            f"on {named} a quotient in float32 may be off by 4 units, more than proofs allow for: switch "
            f"on jax_enable_x64"
        )
    measured = measure(device, jnp.result_type(float))
    if broken := [
        f"{name}: {value:.3g}, at most {most:g} assumed"
        for name, (value, most) in measured.items()
        if not value <= most
    ]:
        settings = f"XLA_FLAGS={flags}" if flags else "what changes the compiler"
        return (
            f"compiled arithmetic in this process is not what proofs rest on ({'; '.join(broken)}), so "
            f"nothing can be proved with "
            f"jax {jax.__version__} and jaxlib {kind['jaxlib']}: start without {settings}, "
            f"or install a jaxlib that was examined ({examined_versions()})"
        )
    odd = []
    if unknown := unknown_flags(flags, kind["platform"]):
        odd.append(f"XLA_FLAGS has {' and '.join(unknown)}, under which nothing was examined")
    if options:
        odd.append(f"jax has {' and '.join(options)}, under which nothing was examined")
    return doubt_of(device, kind, odd)


COUNT = 16
EVEN = np.arange(COUNT) % 2 == 0


def measure(device: jax.Device, dtype: DTypeLike) -> dict[str, tuple[float, float]]:
    """Return {what `rounding` assumes: (what a compiled kernel did on a device, the most that is assumed)},
    errors in units u.

    Few numbers, and a kernel that compiles fast: it stands before every first verdict.
    `tests/sets/test_probe.py` asks more, of thousands.

    A product p = a b that is rounded once leaves p - fl(a b) = 0. If the compiler sees through what should
    store it, or works it out anew where it is used, then it contracts the difference, and the error of the
    product is left.
    """
    k, info = np.arange(1, COUNT + 1), np.finfo(dtype)
    numbers = lambda step, low, high: np.exp2(low + (high - low) * (k * step % 1)).astype(dtype)
    a, b = numbers(0.618, -8, 8) * np.where(k % 3, 1, -1).astype(dtype), numbers(0.414, -8, 8)
    small, top = numbers(0.732, info.minexp + 1, info.minexp + 3.9), np.full(COUNT, info.max, dtype)
    odd, divisor = np.where(k % 4 == 0, np.nan, np.inf).astype(dtype), np.full(1, -17.3, dtype)
    given = a, b, divisor, small, top, odd, np.where(EVEN, a * b, a * a), EVEN
    with (
        jax.ensure_compile_time_eval(),
        jax.default_device(device),
        jax.debug_nans(False),
        jax.debug_infs(False),
        jax.disable_jit(False),
    ):
        errors = np.asarray(_kernel(*(jax.device_put(x, device) for x in given)))
    *exact, A, B, least = (list(map(Fraction, x.astype(float).tolist())) for x in (*errors[:6], a, b, small))
    total, rest, quotient, share, root, flushed = exact
    u, smallest, pairs = (
        Fraction(float(info.eps)) / 2,
        Fraction(float(info.tiny)),
        list(zip(A, B, strict=True)),
    )
    error = lambda found, want: max(
        float(abs(f - w) / abs(f) / u) if f else np.inf for f, w in zip(found, want, strict=True)
    )
    lost = sum(s + e != x + y for s, e, (x, y) in zip(total, rest, pairs, strict=True))
    by = Fraction(float(divisor[0]))
    underflow = max(abs(f - x / by) for f, x in zip(flushed, least, strict=True)) / smallest
    return {
        "error of a sum": (error(total, [x + y for x, y in pairs]), 2.84),
        "error of a quotient": (error(quotient, [x / y for x, y in pairs]), 2.84),
        "error of a quotient by one number": (error(share, [x / by for x in A]), 2.84),
        "error of the square of a root": (error([x * x for x in root], B), 5.7),
        "sums that two_sum loses digits of": (lost, 0),
        "error of an underflow, in smallest numbers": (float(underflow), 1),
        "underflows that lose their sign": (int((~np.signbit(errors[5])).sum()), 0),
        "overflows that are finite": (int((errors[6][EVEN] != np.inf).sum()), 0),
        "NaN that are lost": (int((~np.isnan(errors[6][~EVEN])).sum()), 0),
        "quotients that are not one number for all uses": (int((errors[7][EVEN] != 0).sum()), 0),
        "calls that are not kept apart": (int((errors[7][~EVEN] != 0).sum()), 0),
    }


@jax.jit
def _kernel(
    a: jax.Array,
    b: jax.Array,
    divisor: jax.Array,
    small: jax.Array,
    top: jax.Array,
    odd: jax.Array,
    product: jax.Array,
    even: jax.Array,
) -> jax.Array:
    """Return (8, COUNT) results: more of them would be spread over several loops, and take four times as long
    to compile.
    """
    lost = jnp.maximum(odd - odd, b)  # odd: NaN and infinite
    held = (
        unrolled.stored(a * b) - product,
        product - _squared(a),
    )  # differences of one form, or of one product, would become one
    ends = jax.lax.select(even, top + top, lost), jax.lax.select(even, *held)
    return jnp.stack([*rounding.two_sum(a, b), a / b, a / divisor, jnp.sqrt(b), small / divisor, *ends])


_squared = unrolled.apart(lambda a: a * a)
