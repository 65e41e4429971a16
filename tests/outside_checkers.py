"""Programs by others that decide or check what a certificate says: the VIPR checker, z3 and cvc5."""

import shutil
import subprocess
from pathlib import Path

import pytest

SECONDS = 20
SOURCES = ("viprchk.cpp", "CMakeConfig.hpp")


def built(find, folder):
    """Return the VIPR checker, built in a folder; skip the test where it cannot be. find: a function that
    finds a shared file.
    """
    compiler, program = shutil.which("g++"), folder / "viprchk"
    if compiler is None:
        pytest.skip("there is no g++ to build the VIPR checker with")
    for name in SOURCES:
        shutil.copy(find(f"external/vipr/{name}"), folder)
    headers = subprocess.run(
        [compiler, "-E", "-x", "c++", "-"], input="#include <gmpxx.h>", capture_output=True, text=True
    )
    if headers.returncode:
        pytest.skip(
            "the headers of GMP in C++ are not here (Debian: libgmp-dev): the VIPR checker cannot be built"
        )
    build = [
        compiler,
        "-O1",
        "-DNDEBUG",
        "-std=c++14",
        f"-I{folder}",
        str(folder / SOURCES[0]),
        "-o",
        str(program),
        "-lgmpxx",
        "-lgmp",
    ]
    subprocess.run(build, check=True, capture_output=True)
    return program


def vipr_confirms(program: Path, text: str, folder: Path) -> bool:
    """Return whether the VIPR checker verifies a text."""
    file = folder / "certificate.vipr"
    file.write_text(text)
    ran = subprocess.run([program, file], capture_output=True, text=True)
    return (
        ran.returncode == 0
        and "Successfully verified" in ran.stdout
        and "Successfully" in ran.stdout.rsplit("Processing", 1)[-1]
    )


def z3_says(text: str) -> str:
    """Return "sat", "unsat" or "unknown": what z3 says of an SMT-LIB script."""
    z3 = pytest.importorskip("z3", reason="z3-solver is not installed")
    solver = z3.Solver()
    solver.set("timeout", 1000 * SECONDS)
    solver.from_string(text)
    return str(solver.check())


def cvc5_says(text: str) -> str:
    """Return "sat", "unsat" or "unknown": what cvc5 says of an SMT-LIB script."""
    cvc5 = pytest.importorskip("cvc5", reason="cvc5 is not installed")
    solver = cvc5.Solver(cvc5.TermManager())
    solver.setOption("tlimit-per", str(1000 * SECONDS))
    parser = cvc5.InputParser(solver)
    parser.setStringInput(cvc5.InputLanguage.SMT_LIB_2_6, text, "certificate")
    said = ""
    while not (command := parser.nextCommand()).isNull() and command.getCommandName() != "exit":
        said += command.invoke(solver, parser.getSymbolManager())
    return said.strip()
