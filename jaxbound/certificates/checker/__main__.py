"""Check certificates with the standard library alone: python -I DIR CERTIFICATE.json... --model MODEL.toml
--data RUN.csv

DIR is this folder, wherever it lies. Exit codes: 0 every certificate is confirmed, 1 one of them is not, 2
bad usage or files.
"""

import sys
import types
from pathlib import Path

HERE = Path(__file__).resolve().parent


def _alone() -> None:
    """Let the files of this folder import each other by their names without the package they belong to, which
    would import JAX.
    """
    name = ""
    for part in ("jaxbound", "certificates", "checker"):
        name = f"{name}.{part}".strip(".")
        module = types.ModuleType(name)
        module.__path__ = []
        if part == "checker":
            module.__path__ = [str(HERE)]
        sys.modules.setdefault(name, module)


if __name__ == "__main__":
    _alone()
    from jaxbound.certificates.checker.command import main

    sys.exit(main(sys.argv[1:]))
