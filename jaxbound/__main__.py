"""`python -m jaxbound` is the command `jaxbound`, where no folder of programs is on the path."""

from jaxbound.cli.main import main

if __name__ == "__main__":
    raise SystemExit(main())
