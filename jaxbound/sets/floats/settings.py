"""Compilers and their settings, known by name: which versions were examined, which flags, options and
switches change what.

What is in none of these tables is unknown: nothing is proved with it before `examined` has tried it.
"""

import os
import platform
from pathlib import Path

import jax

__all__ = [
    "GIVES_UP",
    "HARMLESS",
    "OPTIONS",
    "SWITCHES",
    "VERSIONS",
    "examined_versions",
    "loose_flags",
    "odd_options",
    "processor",
    "set_switches",
    "unknown_flags",
]

VERSIONS = frozenset(
    {"0.8.0", "0.8.1", "0.8.2", "0.8.3", "0.9.0", "0.9.0.1", "0.9.1", "0.9.2", "0.10.0", "0.10.1", "0.10.2"}
)
"""Versions of jaxlib that passed the whole examination on a CPU (x86-64). A new one is listed once it did,
with the tests of `sets/floats`. 0.11.1 is not to be installed at all, see pyproject.toml."""
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
HARMLESS = (
    "xla_dump_",  # writes down what was compiled
    "xla_force_host_platform_device_count",  # how many devices a CPU is shown as: tests compare their bits
    "xla_cpu_multi_thread_eigen",  # threads of library dots, which no proof uses
    "xla_cpu_parallel_codegen_split_count",  # functions are shared out among compilers
    "xla_embed_ir_in_executable",
    "xla_hlo_profile",
    "xla_allow_excess_precision",  # on by default; off, less is allowed
)
"""Beginnings of the names of flags that change no arithmetic, whatever their value."""
ELSEWHERE = {"cpu": ("xla_gpu_", "xla_tpu_")}
"""Beginnings of the names of flags that a platform does not read."""
OPTIONS: dict[str, tuple[object, ...]] = {
    "jax_allow_f16_reductions": (True,),
    "jax_backend_target": ("",),
    "jax_disable_most_optimizations": (False,),
    "jax_enable_pgle": (False,),
    "jax_exec_time_optimization_effort": (0.0,),
    "jax_experimental_unsafe_xla_runtime_errors": (False,),
    "jax_memory_fitting_effort": (0.0,),
    "jax_memory_fitting_level": ("O2", "UNKNOWN"),
    "jax_no_execution": (False,),
    "jax_optimization_level": ("UNKNOWN",),
    "jax_pjrt_client_create_options": (None, ""),
    "jax_xla_profile_version": (0,),
}
"""Options of jax that reach the compiler, and the values that leave it as it was examined. The others say
how jax traces, logs, stores and moves: on CPU jax_default_matmul_precision, too, changes no product
(measured), and what is proved by one asks for the highest precision."""
SWITCHES = {
    "NVIDIA_TF32_OVERRIDE": ("", "0"),
    "CUBLAS_EMULATE_SINGLE_PRECISION": ("", "0"),
    "CUBLAS_EMULATE_DOUBLE_PRECISION": ("", "0"),
    "CUBLAS_EMULATION_STRATEGY": ("",),
    "CUBLAS_FIXEDPOINT_EMULATION_MANTISSA_BIT_COUNT": ("",),
}
"""Switches of the environment by which libraries of NVIDIA compute otherwise, and the values that leave them
alone. No dot of a library is proved, but whoever sets one of these means to change arithmetic."""


def examined_versions() -> str:
    """Return the versions of jaxlib that were examined, the oldest first, in words."""
    numbers = lambda name: tuple(map(int, name.split(".")))
    return ", ".join(sorted(VERSIONS, key=numbers))


def processor() -> tuple[str, str]:
    """Return (its maker's name, the instructions that a compiler may use) of the processor; where a system
    does not say, less of it.
    """
    told = Path("/proc/cpuinfo")
    lines = told.read_text().splitlines() if told.exists() else []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")][:1]
    uses = [line.split(":", 1)[1].strip() for line in lines if line.startswith(("flags", "Features"))][:1]
    return " ".join([platform.machine(), *names]), " ".join(uses)


def set_switches() -> tuple[str, ...]:
    """Return the switches that are set, as "NAME=value"."""
    now = {name: os.environ.get(name, "") for name in SWITCHES}
    return tuple(f"{name}={value}" for name, value in now.items() if value not in SWITCHES[name])


def odd_options() -> tuple[str, ...]:
    """Return the options of jax that reach the compiler and are not as they were examined, as
    "name=value".
    """
    found, now = [], jax.config.values
    for name, values in OPTIONS.items():
        if now.get(name, values[0]) not in values:  # another version of jax may not have it
            found.append(f"{name}={now[name]}")
    return tuple(found)


def loose_flags(flags: str) -> list[str]:
    """Return the flags of XLA_FLAGS that give arithmetic up.

    Args:
        flags: what XLA_FLAGS says: the flags themselves, or the name of a file with them.
    """
    found = []
    for flag in _each(flags):
        name, given, value = flag.lstrip("-").partition("=")
        harmless = GIVES_UP.get(name)
        if harmless is not None and (value if given else "true") not in harmless:
            found.append(flag)
    return found


def unknown_flags(flags: str, platform: str) -> list[str]:
    """Return the flags of XLA_FLAGS of which no table says whether they leave arithmetic alone.

    Args:
        flags: as for `loose_flags`. platform: as `probe.kind_of_device` names it.
    """
    known = HARMLESS + ELSEWHERE.get(platform, ())
    found = []
    for flag in _each(flags):
        name = flag.lstrip("-").partition("=")[0]
        if name not in GIVES_UP and not name.startswith(known):
            found.append(flag)
    return found


def _each(flags: str) -> list[str]:
    if flags and flags.split() and not flags.split()[0].lstrip("'\"").startswith("-"):
        file = Path(flags)
        flags = file.read_text() if file.is_file() else ""
    return flags.replace('"', " ").replace("'", " ").split()
