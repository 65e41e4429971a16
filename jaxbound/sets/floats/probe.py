"""May this process prove anything? What `rounding` assumes of processor, device and compiler, asked before
every proof, of the compiler where something is compiled.

**The rounding mode** of the processor is asked at every call: it takes a microsecond, and an import can
change it at any time. **The device** has to be of a kind whose arithmetic was examined (`EXAMINED`): so far
CPU, or an accelerator that its user examined (`examined.examine`). A device that nobody examined may search
(`searching_device`): what decides windows then proves every FAULT on the host, and what else proves something
goes to the CPU (`where_proofs_hold`).
**Flags of XLA, and switches of the environment,** that give arithmetic up are refused by name: what they
allow, a compiler need not do to the kernels of a probe. **The probe** (`examined.measure`), one small kernel,
catches what names do not, and asks the premises beside rounding: that a stored quotient is one number for all
its uses, that a callee is kept apart. It runs once a process for each device and setting, with the flags in
force; of a version of jaxlib that is not listed (`examined.VERSIONS`) with thousands of numbers.
"""

import contextlib
import os
import threading
from collections.abc import Iterator
from functools import lru_cache

import jax
import jax.numpy as jnp
import numpy as np

from jaxbound.sets.floats.examined import (
    EXAMINED,
    FEW,
    MANY,
    SWITCHES,
    VERSIONS,
    broken,
    examine,
    is_admitted,
    loose_flags,
)
from jaxbound.sets.floats.kinds import is_cpu_default, kind_of_device, named
from jaxbound.text.warned import warn

_state = threading.local()


class Unverified(RuntimeError):
    """Nothing can be proved in this process, or on this device; the message says why, and what to do."""


def refuse_unverified(*given: object) -> None:
    """Raise Unverified if a proof from these arguments would rest on arithmetic that was not verified.

    Args:
        given: PyTrees; where jax arrays among them lie, the work is done. Without any: on the devices of
            `usable_devices`.

    While windows are searched for on a device that proves nothing (`searching`), the rounding mode alone is
    asked: what comes out is proved by others.
    """
    refuse_other_modes()
    if is_searching():
        return
    devices = {usable_devices()[0]}
    for x in jax.tree.leaves(given):
        if isinstance(x, jax.Array) and not isinstance(x, jax.core.Tracer):
            devices |= x.devices()
    for device in devices:
        if why := _doubt(device):
            raise Unverified(why)


def refuse_unusable() -> None:
    """Raise Unverified if windows can be decided nowhere in this process, as far as names tell.

    The probe is compiled where windows are (`refuse_unverified`): NumPy, which decides few of them, needs its
    rounding mode alone. Of a device that may only search no more is asked, but for a CPU device beside it,
    for arrays that no card has held.
    """
    refuse_other_modes()
    if card := searching_device():
        _host_beside(card)
    elif not is_searching() and (why := _doubt_by_name(usable_devices()[0])):
        raise Unverified(why)


@contextlib.contextmanager
def where_proofs_hold(compiled: bool = True) -> Iterator[None]:
    """Do on the CPU what proves, where work would go to a device that may only search; also a decorator.

    Args:
        compiled: False where whoever compiles asks for the probe itself.

    Raises:
        Unverified: nothing can be proved on the CPU either.
    """
    card, refuse = searching_device(), refuse_unverified if compiled else refuse_unusable
    if not card or is_searching():
        refuse()
        yield
        return
    with jax.default_device(_host_beside(card)):
        refuse()
        yield


def is_searching() -> bool:
    """Return whether this thread takes what a device computes for hints, see `searching`."""
    return getattr(_state, "searching", False)


@contextlib.contextmanager
def searching(active: bool = True) -> Iterator[None]:
    """Let a device search that proves nothing, on this thread until the block ends: whoever asks for that
    proves what comes out on the host. active: False changes nothing.
    """
    before = is_searching()
    _state.searching = active or before
    try:
        yield
    finally:
        _state.searching = before


def searching_device() -> str:
    """Return the kind of device that work goes to, like "NVIDIA 9.0", where it may search and proves nothing;
    "" where it may prove, or is a CPU, which is refused where it may not.
    """
    if default_device() is None and is_cpu_default():  # asked for each sample of a stream
        return ""
    for device in usable_devices():
        if kind_of_device(device)["platform"] != "cpu" and _doubt(device):
            return named(kind_of_device(device))
    return ""


def _host_beside(card: str) -> jax.Device:
    """Return the CPU device of a process whose work goes to a card."""
    try:
        return jax.local_devices(backend="cpu")[0]
    except RuntimeError:
        raise Unverified(
            f"what is to be proved is done on the CPU, since {card} was not examined, and this process has "
            f"no CPU device: name it too, as in JAX_PLATFORMS=cuda,cpu"
        ) from None


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


def default_device() -> jax.Device | str | None:
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


def examined_devices() -> dict[str, str]:
    """Examine the devices that work goes to, one of each name; return {device in words: the claims of
    `measure` that it breaks, "" where it may prove}.

    Raises:
        Unverified: a rounding mode, flags of XLA or switches with which nothing can be proved.
        OSError, RuntimeError: there is no folder to write the outcome in.
    """
    refuse_other_modes()
    for why in (_loosened(os.environ.get("XLA_FLAGS", "")), *map(_switched, usable_devices())):
        if why:
            raise Unverified(why)
    devices = {
        f"{device.device_kind} ({named(kind_of_device(device))})": device for device in usable_devices()
    }
    found = {name: examine(device) for name, device in devices.items()}
    _named_doubt.cache_clear()
    _found.cache_clear()
    return found


def _doubt(device: jax.Device) -> str:
    """Return why a device proves nothing, in a sentence; empty where it may."""
    x64 = bool(jax.config.jax_enable_x64)  # type: ignore[attr-defined]  # made at run time
    return _doubt_by_name(device) or _found(device, os.environ.get("XLA_FLAGS", ""), x64)


def _doubt_by_name(device: jax.Device) -> str:
    """Return the same without the probe."""
    return _switched(device) or _named_doubt(device, os.environ.get("XLA_FLAGS", ""))


@lru_cache
def _named_doubt(device: jax.Device, flags: str) -> str:
    kind = kind_of_device(device)
    if named(kind) not in EXAMINED and not is_admitted(device):
        return (
            f"proofs need a device whose rounding was verified, so far only CPU, not {named(kind)}: set "
            f"JAX_PLATFORMS=cpu, examine it once with `jaxbound info --device`, or give NumPy arrays under "
            f'`with jax.default_device("cpu")`; margins gives unproved values anywhere'
        )
    return _loosened(flags)


@lru_cache
def _found(device: jax.Device, flags: str, x64: bool) -> str:
    kind = kind_of_device(device)
    count, versions = FEW, ", ".join(VERSIONS)
    if kind["jaxlib"] not in VERSIONS:
        count = MANY
        warn(f"jaxlib {kind['jaxlib']} is not among the versions that were examined ({versions})")
    if wrong := broken(device, jnp.result_type(float), count):
        settings = f"XLA_FLAGS={flags}" if flags else "what changes the compiler"
        return (
            f"compiled arithmetic in this process is not what proofs rest on ({wrong}), so nothing can be "
            f"proved with jax {jax.__version__} and jaxlib {kind['jaxlib']}: start without {settings}, "
            f"or install a jaxlib that was examined ({versions})"
        )
    return ""


def _switched(device: jax.Device) -> str:
    """Return which switches of the environment change the arithmetic of a card, in a sentence; empty where
    none does, and on a CPU, which minds none.
    """
    if device.platform == "cpu":
        return ""
    given = {name: os.environ.get(name, "") for name in SWITCHES}
    found = [f"{name}={value}" for name, value in given.items() if value not in SWITCHES[name]]
    if not found:
        return ""
    return (
        f"the environment has {' and '.join(found)}, by which libraries of {named(kind_of_device(device))} "
        f"compute otherwise: start without"
    )


def _loosened(flags: str) -> str:
    """Return which flags of XLA give rounding up, in a sentence; empty where none does."""
    loose = loose_flags(flags)
    if not loose:
        return ""
    return (
        f"XLA_FLAGS has {' and '.join(loose)}, with which the compiler keeps to no rounding: start without, "
        f"nothing can be proved so"
    )
