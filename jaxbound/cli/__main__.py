"""`python -m jaxbound.cli` is the command `jaxbound`."""

from jaxbound.cli.main import main

if __name__ == "__main__":
    raise SystemExit(main())
