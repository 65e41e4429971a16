"""`python -m jaxbound.cli` is the command `jaxbound`, as `python -m jaxbound` is."""

from jaxbound.cli.main import main

if __name__ == "__main__":
    raise SystemExit(main())
