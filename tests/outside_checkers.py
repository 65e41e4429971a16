"""Programs by others that decide or check what a certificate says: the VIPR checker, z3 and cvc5."""

import shutil
import subprocess
from fractions import Fraction
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


def adds_up(text: str) -> bool:
    """Return whether a VIPR text holds by sums of fractions alone: its lines, times the multipliers of its
    derivation, are 0 >= a positive number, or its solution keeps each of them.
    """
    lines = [line.split() for line in text.splitlines() if not line.startswith("%")]
    start = next(i for i, words in enumerate(lines) if words[0] == "CON")
    rows = []
    for _, sense, end, count, *terms in lines[start + 1 : start + 1 + int(lines[start][1])]:
        assert len(terms) == 2 * int(count)
        rows.append((sense, Fraction(end), dict(zip(terms[::2], map(Fraction, terms[1::2]), strict=True))))
    for words in lines[start:]:
        if words[0] == "contradiction":
            assert words[1:5] == ["G", words[2], "0", "{"] and len(words[7:-2]) == 2 * int(words[6])
            total, left = Fraction(0), {}
            for number, x in zip(words[7:-2:2], map(Fraction, words[8:-2:2]), strict=True):
                sense, end, terms = rows[int(number)]
                if (sense == "G" and x < 0) or (sense == "L" and x > 0):
                    return False
                total += x * end
                for unknown, coefficient in terms.items():
                    left[unknown] = left.get(unknown, 0) + x * coefficient
            return total == Fraction(words[2]) > 0 and not any(left.values())
        if words[0] == "witness":
            values = dict(zip(words[2::2], map(Fraction, words[3::2]), strict=True))
            for sense, end, terms in rows:
                gap = sum(x * values.get(unknown, 0) for unknown, x in terms.items()) - end
                if (gap < 0 and sense != "L") or (gap > 0 and sense != "G"):
                    return False
            return True
    return False


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
