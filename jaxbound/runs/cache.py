"""Compiled kernels on a disk, for the next process."""

import tempfile
from pathlib import Path

import jax

from jaxbound.files.folders import cache_folder


def use_cache(folder: str | Path | None = None) -> Path:
    """Keep compiled kernels in a folder, so that the next process need not compile them again.

    Compiling is nearly all of the time of a first call. The command line calls this; the library itself
    changes no configuration.

    Args:
        folder: as long as it is there, what is in it serves every process with the same versions on the same
            machine. Whoever can write to it can run code in these processes. None: the one that jax was told
            of (`JAX_COMPILATION_CACHE_DIR`), left as it is, or that of the command line: `jaxbound` in
            `$XDG_CACHE_HOME`, by default `~/.cache`.

    Returns:
        The folder in use.

    Raises:
        ValueError: the folder cannot be made or written.

    Example:
        >>> import jaxbound as jb
        >>> jb.use_cache()  # doctest: +SKIP
        PosixPath('/home/me/.cache/jaxbound')
    """
    # jax makes an attribute of each option at run time
    before = jax.config.jax_compilation_cache_dir  # type: ignore[attr-defined]
    if folder is None and before is not None:
        return Path(before)
    where = f"in {folder}"
    try:
        if folder is None:
            where = "in the home folder"
            folder = cache_folder()
        chosen = Path(folder)
        chosen.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=chosen):
            pass
    except (OSError, RuntimeError) as e:
        why = getattr(e, "strerror", None) or str(e)
        raise ValueError(
            f"compiled kernels cannot be kept {where}: {why}; give use_cache a folder that can be written"
        ) from None
    if before is not None:
        from jax.experimental.compilation_cache import compilation_cache

        compilation_cache.reset_cache()  # else the folder before stays in use
    options = {
        "jax_compilation_cache_dir": str(chosen),
        "jax_persistent_cache_min_compile_time_secs": 0,
        "jax_persistent_cache_min_entry_size_bytes": -1,
    }
    for option, value in options.items():
        jax.config.update(option, value)  # type: ignore[no-untyped-call]  # jax gives it no types
    return chosen
