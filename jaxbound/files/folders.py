"""The folder of files that may be thrown away."""

import os
from pathlib import Path


def cache_folder() -> Path:
    """Return the folder of what can be computed again: `jaxbound` in `$XDG_CACHE_HOME`, by default
    `~/.cache`.

    Raises:
        RuntimeError: there is no home folder.
    """
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jaxbound"
