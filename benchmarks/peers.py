"""Who takes part: the peers that are installed, with their versions, and how to get the others."""

import importlib
import importlib.metadata

from benchmarks import timing

__all__ = ["PEERS", "load", "present"]

PEERS = {  # name: (module, distribution)
    "NumPy": ("numpy", "numpy"),
    "HiGHS": ("highspy", "highspy"),
    "zonoopt": ("zonoopt", "zonoopt"),
    "codac": ("codac", "codac"),
    "intvalpy": ("intvalpy", "intvalpy"),
    "python-flint": ("flint", "python-flint"),
    "immrax": ("immrax", "immrax"),
}


def load(name):
    """Return the module of a peer, or None."""
    try:
        return _import(PEERS[name][0])
    except Exception:  # a peer whose own dependencies do not fit is as good as absent; `present` says why
        return None


@timing.own_rounding()
def _import(name):
    return importlib.import_module(name)


def present():
    """Return ({peer: version}, {peer: why it is absent and the line that installs it})."""
    here, absent = {}, {}
    for name, (module, distribution) in PEERS.items():
        try:
            _import(module)
            here[name] = importlib.metadata.version(distribution)
        except Exception as e:
            absent[name] = f'{type(e).__name__}: {e}; pip install "jaxbound[bench]" brings it'
    return here, absent
