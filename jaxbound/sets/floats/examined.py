"""The arithmetic of a compiler and a device: measured by one small kernel, against exact rationals.

Few numbers stand before the first proof of a process, thousands where a version of jaxlib is not listed. What
`tests/sets/floats` ask, of loops and of large reductions too, a kind of device and a version have passed
before they are listed. An accelerator is measured with thousands once its user asks for it (`examine`), and
what it keeps to is written down for its very kind, driver and versions.
"""

import json
from fractions import Fraction
from hashlib import sha256
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from jaxbound import __version__
from jaxbound.files.folders import cache_folder
from jaxbound.files.whole import whole
from jaxbound.sets.floats import rounding, unrolled
from jaxbound.sets.floats.kinds import kind_of_device, most_of_a_quotient, plainly_on

EXAMINED = frozenset({"cpu"})
"""Kinds of devices, as `kind_of_device` names them without the driver, on which the tests of `sets/floats`
were run."""
VERSIONS = "0.8.0 0.8.1 0.8.2 0.8.3 0.9.0 0.9.0.1 0.9.1 0.9.2 0.10.0 0.10.1 0.10.2 0.12.0.1".split()
"""Versions of jaxlib that passed the tests of `sets/floats` on a CPU (x86-64). 0.11.1 is not to be installed
at all, see pyproject.toml."""
GIVES_UP = {
    "xla_cpu_enable_fast_math": ("false", "0"),
    "xla_cpu_fast_math_honor_nans": ("", "true", "1"),
    "xla_cpu_fast_math_honor_infs": ("", "true", "1"),
    "xla_cpu_fast_math_honor_division": ("", "true", "1"),
    "xla_cpu_fast_math_honor_functions": ("", "true", "1"),
    "xla_cpu_experimental_onednn_fusion_type": ("",),
    "xla_cpu_experimental_xnn_fusion_type": ("",),
    "xla_cpu_experimental_ynn_fusion_type": ("",),
    "xla_cpu_experimental_xnn_graph_fusion_mode": ("", "XNN_GRAPH_FUSION_MODE_DISABLED"),
    "xla_gpu_enable_fast_min_max": ("false", "0"),
}
"""Flags of XLA after which nothing is known of a rounding, and the values that leave it alone. fusion_type
and graph_fusion_mode hand operations to libraries whose exp, for one, is another."""
SWITCHES = {
    "NVIDIA_TF32_OVERRIDE": ("", "0"),
    "CUBLAS_EMULATE_SINGLE_PRECISION": ("", "0"),
    "CUBLAS_EMULATE_DOUBLE_PRECISION": ("", "0"),
    "CUBLAS_EMULATION_STRATEGY": ("",),
    "CUBLAS_FIXEDPOINT_EMULATION_MANTISSA_BIT_COUNT": ("",),
}
"""Switches of the environment by which libraries of NVIDIA compute otherwise, and the values that leave them
alone. No dot of a library is proved, but whoever sets one of these means to change arithmetic."""
FEW, MANY = 16, 4096
"""Numbers of each kind that are measured: of a listed version, and of another."""


def loose_flags(flags: str) -> list[str]:
    """Return the flags of XLA_FLAGS that give arithmetic up.

    Args:
        flags: what XLA_FLAGS says: the flags themselves, or the name of a file with them.
    """
    if flags.split() and not flags.split()[0].lstrip("'\"").startswith("-"):
        file = Path(flags)
        flags = file.read_text() if file.is_file() else ""
    found = []
    for flag in flags.replace('"', " ").replace("'", " ").split():
        name, given, value = flag.lstrip("-").partition("=")
        harmless = GIVES_UP.get(name)
        if harmless is not None and (value if given else "true") not in harmless:
            found.append(flag)
    return found


def examine(device: jax.Device) -> str:
    """Measure a device with thousands of numbers, float32 and float64, and write down that it keeps to all
    claims; return those that it breaks, "" where it breaks none.

    Raises:
        OSError, RuntimeError: there is no folder to write that in.
    """
    with jax.enable_x64(True):
        words = [broken(device, dtype, MANY) for dtype in (np.float32, np.float64)]
    if found := "; ".join(filter(None, words)):
        return found
    path, kind = _record_of(device)
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole(path) as file:
        file.write(kind)
    return ""


def is_admitted(device: jax.Device) -> bool:
    """Return whether a device may prove, as `examine` found with this driver and these versions."""
    try:
        path, kind = _record_of(device)
        return path.read_bytes() == kind
    except (OSError, RuntimeError):
        return False


def _record_of(device: jax.Device) -> tuple[Path, bytes]:
    """Return the file that says of a device that it may prove, and what stands there."""
    card = str(getattr(device, "device_kind", ""))
    kind = {"card": card, **kind_of_device(device), "jax": jax.__version__, "jaxbound": __version__}
    text = json.dumps(kind, sort_keys=True).encode()
    return cache_folder() / "examined" / f"{sha256(text).hexdigest()[:32]}.json", text


def broken(device: jax.Device, dtype: DTypeLike, count: int = FEW) -> str:
    """Return the claims of `measure` that a device breaks, in words; empty where it keeps to all of them."""
    words = []
    for claim, (value, most) in measure(device, dtype, count).items():
        if not value <= most:
            words.append(f"{claim}: {value:.3g}, at most {most:g} assumed")
    return "; ".join(words)


def measure(device: jax.Device, dtype: DTypeLike, count: int = FEW) -> dict[str, tuple[float, float]]:
    """Return {what `rounding` assumes: (what a compiled kernel did on a device, the most that is assumed)},
    errors in units u.

    A kernel that compiles fast: it stands before every first verdict. count: numbers of each kind.

    A product p = a b that is rounded once leaves p - fl(a b) = 0. If the compiler sees through what should
    store it, or works it out anew where it is used, then it contracts the difference, and the error of the
    product is left.
    """
    k, info = np.arange(1, count + 1), np.finfo(dtype)
    even = k % 2 == 1
    numbers = lambda step, low, high: np.exp2(low + (high - low) * (k * step % 1)).astype(dtype)
    a, b = numbers(0.618, -8, 8) * np.where(k % 3, 1, -1).astype(dtype), numbers(0.414, -8, 8)
    small, top = numbers(0.732, info.minexp + 1, info.minexp + 3.9), np.full(count, info.max, dtype)
    odd, divisor = np.where(k % 4 == 0, np.nan, np.inf).astype(dtype), np.full(1, -17.3, dtype)
    given = a, b, divisor, small, top, odd, np.where(even, a * b, a * a), even
    most = most_of_a_quotient(device, dtype)
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
        float(abs(f - w) / abs(f) / u) if f else (np.inf if w else 0.0)
        for f, w in zip(found, want, strict=True)
    )
    lost = sum(s + e != x + y for s, e, (x, y) in zip(total, rest, pairs, strict=True))
    by = Fraction(float(divisor[0]))
    underflow = max(abs(f - x / by) for f, x in zip(flushed, least, strict=True)) / smallest
    return {
        "error of a sum": (error(total, [x + y for x, y in pairs]), 2.84),
        "error of a quotient": (error(quotient, [x / y for x, y in pairs]), most),
        "error of a quotient by one number": (error(share, [x / by for x in A]), most),
        "error of the square of a root": (error([x * x for x in root], B), 5.7),
        "sums that two_sum loses digits of": (lost, 0),
        "error of an underflow, in smallest numbers": (float(underflow), 1),
        "underflows that lose their sign": (int((~np.signbit(errors[5])).sum()), 0),
        "overflows that are finite": (int((errors[6][even] != np.inf).sum()), 0),
        "NaN that are lost": (int((~np.isnan(errors[6][~even])).sum()), 0),
        "quotients that are not one number for all uses": (int((errors[7][even] != 0).sum()), 0),
        "calls that are not kept apart": (int((errors[7][~even] != 0).sum()), 0),
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
    """Return (8, N) results: more of them would be spread over several loops, and take four times as long
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
