"""All peers on the same work in one process: python -m benchmarks [--quick] [--only horizon,boxes,strips,...]
[--table].

Writes benchmarks/results.json and benchmarks/figures, prints the table; --table puts it into
docs/benchmarks.md between its markers. Sweeps are limits, horizon, residuals and boxes; every other module of
this folder that measures can be named with --only, and writes its own json. On a GPU margins alone are
measured: verdicts are proved on CPU.
"""

import argparse
import datetime
import json
import runpy
import sys
from pathlib import Path

import jax

HERE = Path(__file__).parent
QUICK = {
    "strips": ["--windows", "500000"],
    "long_windows": ["--windows", "2000", "--programs", "200"],
    "varying": ["--windows", "4096"],
    "inclusion": ["--boxes", "2000"],
    "intervals": ["--count", "100000"],
    "paving": ["--targets", "200", "--windows", "50"],
}


def main(argv=None):
    """Run what was asked for; return the exit code."""
    jax.config.update("jax_enable_x64", True)
    from benchmarks import drawing, peers, timing
    from benchmarks.sweeps import SWEEPS

    modules = sorted(p.stem for p in HERE.glob("*.py") if "timing.save(" in p.read_text())
    parser = argparse.ArgumentParser("python -m benchmarks", description=__doc__.split("\n")[0])
    parser.add_argument(
        "--quick", action="store_true", help="small sizes: does it run, and are the orders right"
    )
    parser.add_argument(
        "--only", default=",".join(SWEEPS), help=f"{', '.join([*SWEEPS, *modules])} (default: the sweeps)"
    )
    parser.add_argument("--table", action="store_true", help="put the table into docs/benchmarks.md")
    args = parser.parse_args(argv)
    wanted = [name.strip() for name in args.only.split(",")]
    unknown = [name for name in wanted if name not in SWEEPS and name not in modules]
    if unknown:
        parser.error(f"--only knows {', '.join([*SWEEPS, *modules])}, not {', '.join(unknown)}")
    gpu = jax.default_backend() == "gpu"
    here, absent = peers.present()
    for name, why in absent.items():
        print(f"{name} is absent: {why}")
    results = {
        "machine": timing.machine(),
        "date": f"{datetime.date.today()}",
        "quick": args.quick,
        "peers": here,
        "absent": absent,
    }
    results |= {
        "sweeps": {name: SWEEPS[name](args.quick, gpu) for name in wanted if name in SWEEPS},
        "modules": {},
    }
    for name in (n for n in wanted if n not in SWEEPS):
        before, sys.argv = sys.argv, [name, *(QUICK.get(name, []) if args.quick else [])]
        try:
            runpy.run_module(f"benchmarks.{name}", run_name="__main__")
        finally:
            sys.argv = before
        results["modules"][name] = json.loads((HERE / f"{name}.json").read_text())
    (HERE / "results.json").write_text(json.dumps(results, indent=1) + "\n")
    figures, lines = drawing.draw(results), drawing.table(results)
    print("\n".join(["", *lines, "", f"benchmarks/results.json, benchmarks/figures: {', '.join(figures)}"]))
    if args.table:
        page = HERE.parent / "docs" / "benchmarks.md"
        page.write_text(drawing.rewritten(page.read_text(), lines))
    return 0


if __name__ == "__main__":
    sys.exit(main())
