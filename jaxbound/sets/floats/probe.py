"""May this process prove anything? What `rounding` assumes of processor, device and compiler, asked before
every proof.

**The rounding mode** of the processor is asked at every call: it takes a microsecond, and an import can
change it at any time. **The device** has to be of a kind whose arithmetic was examined: CPU, by its
developers (`EXAMINED`); an accelerator by its user, once, with `jaxbound examine`, after which it is known by
its name, compute capability, driver and version of jaxlib (`examined.record_of`). What no probe can show
(`PREMISES`) is assumed of it. A device that nobody examined may search (`searching_device`): what decides
windows then proves every FAULT on the host, and what else proves something goes to the CPU
(`where_proofs_hold`).
**Flags of XLA, and switches of the environment,** that give arithmetic up are refused by name (`settings`):
what they allow, a compiler need not do to the kernels of a probe. **The probe** (`measure`), one small
kernel, catches what names do not, and asks the premises beside rounding: that a stored quotient is one number
for all its uses, that a callee is kept apart. It runs once a process for each device and setting, with the
flags in force.
**Versions of jaxlib, flags and options of jax** that no table knows are examined in full, once (`examined`).
"""

import contextlib
import os
import threading
from collections.abc import Callable, Iterator
from fractions import Fraction
from functools import lru_cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from jaxbound.sets.floats import rounding, unrolled
from jaxbound.sets.floats.examined import Record, admitted, doubt_of, examine, record_of
from jaxbound.sets.floats.kinds import (
    is_cpu_default,
    kind_of_device,
    most_of_a_quotient,
    named,
    plainly_on,
)
from jaxbound.sets.floats.settings import (
    examined_versions,
    loose_flags,
    odd_options,
    set_switches,
    unknown_flags,
)
from jaxbound.text.progress import reporter

__all__ = [
    "EXAMINED",
    "PREMISES",
    "Examined",
    "Unverified",
    "default_device",
    "examination_of",
    "examined_devices",
    "is_searching",
    "kind_of_device",
    "measure",
    "refuse_other_modes",
    "refuse_unusable",
    "refuse_unverified",
    "searching",
    "searching_device",
    "usable_devices",
    "where_proofs_hold",
]

EXAMINED = frozenset({"cpu"})
"""Kinds of devices, as `kind_of_device` names them without the driver, on which this house's tests were
run; others are known by the record of an examination by their user.
"""

_state = threading.local()

PREMISES = {
    "cpu": (),
    "NVIDIA": (
        "float32: a quotient may be off by 2 ulp, 4 units (PTX ISA, div.full.f32); `outward` widens it by 6",
        "float32: a root may be off by 1 ulp, 2 units (PTX ISA, sqrt.approx.f32), within the 2.84 that are "
        "assumed",
        "float64: + - * / fma and sqrt are rounded correctly (PTX ISA, .rn)",
        "a * b + c may be contracted; subnormals are kept in float64, and in float32 unless xla_gpu_ftz is "
        "set: both are allowed for",
        "dots of libraries may compute in TF32 or emulate float64: what is proved computes none there",
    ),
}
"""What the makers' manuals say of the arithmetic of a kind of device, and no probe can show."""


UNREAD = "no manual of its maker was read: that all devices of this kind compute alike is assumed"


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
    """Raise Unverified if windows can be decided nowhere in this process.

    A device that may prove is asked all of `refuse_unverified`. Of one that may only search nothing is
    asked: what proves is then NumPy on the host, which needs its rounding mode, and a CPU device for arrays
    that no card has held.
    """
    if card := searching_device():
        refuse_other_modes()
        _host_beside(card)
    else:
        refuse_unverified()


@contextlib.contextmanager
def where_proofs_hold() -> Iterator[None]:
    """Do on the CPU what proves, where work would go to a device that may only search; also a decorator.

    Raises:
        Unverified: nothing can be proved on the CPU either.
    """
    card = searching_device()
    if not card or is_searching():
        refuse_unverified()
        yield
        return
    with jax.default_device(_host_beside(card)):
        refuse_unverified()
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
        if _doubt(device) and kind_of_device(device)["platform"] != "cpu":
            return named(kind_of_device(device))
    return ""


def examination_of(device: jax.Device) -> Record | None:
    """Return the Record of the examination by which a device that no table knows may prove; else None."""
    kind = kind_of_device(device)
    if named(kind) in EXAMINED:
        return None
    record = record_of(device, kind)
    return record if admitted(record) else None


class Examined(NamedTuple):
    """The outcome for a kind of device. Fields: record: see `examined.Record`; kept: the file that holds it,
    "" where none does; premises: sentences that nothing but the maker's manual shows.
    """

    record: Record
    kept: str
    premises: tuple[str, ...]

    @property
    def may_prove(self) -> bool:
        """Whether CONSISTENT counts on such devices."""
        return admitted(self.record)


def examined_devices(progress: Callable[[float], object] | None = None) -> list[Examined]:
    """Examine the devices that work goes to, one of each kind, and keep what came out for processes to come.

    Args:
        progress: called with the share of the work done.

    Raises:
        Unverified: flags, switches or a rounding mode with which nothing can be proved.
    """
    refuse_other_modes()
    report = reporter(progress)
    kinds = {}
    for device in usable_devices():
        name = str(getattr(device, "device_kind", ""))
        kinds[name, named(kind_of_device(device))] = device
    found: list[Examined] = []
    for device in kinds.values():
        kind = kind_of_device(device)
        if why := _loosened(kind, os.environ.get("XLA_FLAGS", ""), _switches_of(device)):
            raise Unverified(why)
        record, path = examine(device, kind, partial(_report_part, report, len(found), len(kinds)))
        about = PREMISES.get(kind["platform"], (UNREAD,))
        found.append(Examined(record, "" if path is None else str(path), about))
    _found.cache_clear()  # it may prove from now on
    return found


def _report_part(report: Callable[[float], object], done: int, parts: int, share: float) -> None:
    """Report a share of the part of the work behind those that are done."""
    report((done + share) / parts)


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


def _switches_of(device: jax.Device) -> tuple[str, ...]:
    """Return the switches of the environment that a device minds."""
    return set_switches() if device.platform != "cpu" else ()


def _doubt(device: jax.Device) -> str:
    """Return why a device proves nothing, in a sentence; empty where it may."""
    x64 = bool(jax.config.jax_enable_x64)  # type: ignore[attr-defined]  # made at run time
    switches = _switches_of(device)
    return _found(device, os.environ.get("XLA_FLAGS", ""), x64, switches, odd_options())


@lru_cache
def _found(
    device: jax.Device, flags: str, x64: bool, switches: tuple[str, ...] = (), options: tuple[str, ...] = ()
) -> str:
    kind = kind_of_device(device)
    words = named(kind)
    if switches:
        return _loosened(kind, "", switches)
    if words not in EXAMINED and not admitted(record := record_of(device, kind)):
        return _why_unexamined(words, record)
    if loosened := _loosened(kind, flags, ()):
        return loosened
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


def _loosened(kind: dict[str, str], flags: str, switches: tuple[str, ...]) -> str:
    """Return which switches or flags give arithmetic up, in a sentence; empty where none does."""
    if switches:
        return (
            f"the environment has {' and '.join(switches)}, by which libraries of {named(kind)} compute "
            f"otherwise: start without"
        )
    if loose := loose_flags(flags):
        return (
            f"XLA_FLAGS has {' and '.join(loose)}, with which the compiler keeps to no rounding: start "
            f"without, nothing can be proved so"
        )
    return ""


def _why_unexamined(words: str, record: Record | None) -> str:
    """Return why a kind of device proves nothing that nobody has examined, or that failed."""
    failed = ""
    if record is not None:
        failed = f"; examined on {record['date']}, it broke what proofs assume ({record['outcome']})"
    return (
        f"proofs need a device whose rounding was verified, so far only CPU, not {words}: set "
        f"JAX_PLATFORMS=cpu, examine it with `jaxbound examine`, or give "
        f'NumPy arrays under `with jax.default_device("cpu")`; margins gives unproved values anywhere{failed}'
    )


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
    with plainly_on(device):
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
    by, coarse = Fraction(float(divisor[0])), most_of_a_quotient(device, dtype)
    underflow = max(abs(f - x / by) for f, x in zip(flushed, least, strict=True)) / smallest
    return {
        "error of a sum": (error(total, [x + y for x, y in pairs]), 2.84),
        "error of a quotient": (error(quotient, [x / y for x, y in pairs]), coarse),
        "error of a quotient by one number": (error(share, [x / by for x in A]), coarse),
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
