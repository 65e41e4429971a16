"""A certificate as text for independent programs: VIPR 1.0 for checkers of exact proofs, SMT-LIB 2 for
solvers that decide anew.

Source: scipopt/vipr, cert_spec_v1_0.md; smt-lib.org, version 2.6.
"""

from collections.abc import Iterator, Sequence
from fractions import Fraction as F
from typing import cast

from jaxbound.certificates.checker.claim import numbers
from jaxbound.certificates.checker.inequalities import Row, multipliers, rows_of, solution, unknowns
from jaxbound.certificates.checker.words import Claim, Document

__all__ = ["smt2", "vipr"]

PROOF = ("witness", "relation", "errors", "relations", "proof", "parameters", "sum")
NONLINEAR = (
    "VIPR proves linear inequalities only, and here uncertain parameters multiply unknown states: "
    "to_smt2 writes this window for solvers"
)


def vipr(document: Document) -> str:
    """Return a certificate as VIPR 1.0: for FAULT the rows and the combination of them that is 0 >= a
    positive number, for CONSISTENT the rows and a solution.

    Raises:
        NotImplementedError: a FAULT of a model with uncertain parameters.
    """
    c, proof = _parts(document)
    fault = document["certificate"] == "FAULT"
    if fault and "uncertainties" in c:
        raise NotImplementedError(NONLINEAR)
    v = proof.get("parameters") or []
    rows = rows_of(c, v)
    place = {name: i for i, name in enumerate(unknowns(rows) or ["none"])}
    lines = [*_head(document, "%"), "VER 1.0", f"VAR {len(place)}", " ".join(place), "INT 0", "OBJ min", "0"]
    constraints, numbered = _constraints(rows, place)
    lines += [f"CON {len(constraints)} 0", *constraints]
    if fault:
        sign = 1
        if proof["relation"]["residual"] < 0:
            sign = -1
        found = multipliers(c, proof["relation"], rows, sign=sign)
        lines += ["RTP infeas", "SOL 0", "DER 1", _contradiction(rows, numbered, found)]
    else:
        every = solution(c, proof["witness"], v).items()
        values = [f"{place[name]} {x}" for name, x in every if name in place and x]
        lines += ["RTP range -inf inf", "SOL 1", f"witness {len(values)} {' '.join(values)}", "DER 0"]
    return "\n".join([*lines, ""])


def _constraints(rows: Sequence[Row], place: dict[str, int]) -> tuple[list[str], list[dict[str, int]]]:
    """Return (a line for each end of a row, {sense: number of the line} of each row)."""
    lines: list[str] = []
    numbered = []
    for row in rows:
        at = {}
        for sense, end in _ends(row, "E", "G", "L"):
            name = row.name
            if sense != "E":
                name += sense
            at[sense] = len(lines)
            lines.append(f"{name} {sense} {end} {_sparse(row, place)}")
        numbered.append(at)
    return lines, numbered


def _contradiction(rows: Sequence[Row], numbered: Sequence[dict[str, int]], found: Sequence[F]) -> str:
    """Return the derivation that a combination of lines is 0 >= a positive number."""
    used, total = [], F(0)
    for row, at, x in zip(rows, numbered, found, strict=True):
        if not x:
            continue
        sense, end = "L", row.hi
        if "E" in at:
            sense, end = "E", row.lo
        elif x > 0:
            sense, end = "G", row.lo
        assert end is not None, "a multiplier uses an end that is there"
        used.append(f"{at[sense]} {x}")
        total += x * end
    return f"contradiction G {total} 0 {{ lin {len(used)} {' '.join(used)} }} -1"


def smt2(document: Document) -> str:
    """Return the rows of a certificate's window as an SMT-LIB 2 script, with the answer that is expected:
    unsat for FAULT, else sat.
    """
    c, _ = _parts(document)
    rows = rows_of(c)
    logic, expected = "QF_LRA", "sat"
    if any(len(monomial) > 1 for row in rows for monomial in row.terms.terms):
        logic = "QF_NRA"
    if document["certificate"] == "FAULT":
        expected = "unsat"
    lines = [
        *_head(document, ";"),
        "(set-info :smt-lib-version 2.6)",
        f"(set-logic {logic})",
        f"(set-info :status {expected})",
    ]
    lines += [f"(declare-fun {name} () Real)" for name in unknowns(rows)]
    for row in rows:
        total = _sum(row)
        for sense, end in _ends(row, "=", ">=", "<="):
            lines.append(f"(assert ({sense} {total} {_real(end)}))")
    return "\n".join([*lines, "(check-sat)", "(exit)", ""])


def _ends(row: Row, equal: str, least: str, most: str) -> Iterator[tuple[str, F]]:
    """Yield (sense, end) of each end of a row, of an equation once."""
    if row.lo is not None and row.lo == row.hi:
        yield equal, row.lo
        return
    if row.lo is not None:
        yield least, row.lo
    if row.hi is not None:
        yield most, row.hi


def _parts(document: Document) -> tuple[Claim, Document]:
    """Return (claim, proof) of a document."""
    claim, proof = numbers(document["numbers"], []), {}
    for name in PROOF:
        if name in claim:
            proof[name] = claim.pop(name)
    return cast(Claim, claim), proof  # a certificate that was built here: nothing in it needs a check


def _head(document: Document, mark: str) -> list[str]:
    """Return comments that name the verdict and the unknowns; whatever names are, they stay within their
    line.
    """
    sentence = " ".join(document["statement"].split())
    unknown = (
        "xJ_I: state I at sample J, wJ_I: disturbance, vJ_I: unknown input, uJ_I: missing input, gI: "
        "gain, pK: parameter"
    )
    return [
        f"{mark} {document['certificate']}: {sentence}",
        f"{mark} {unknown}, in deviations from the offsets",
    ]


def _sparse(row: Row, place: dict[str, int]) -> str:
    """Return the number of terms of a row and each of them."""
    terms = [f"{place[name]} {x}" for (name,), x in row.terms.terms.items()]
    return " ".join([str(len(terms)), *terms])


def _sum(row: Row) -> str:
    terms = [_product(monomial, x) for monomial, x in row.terms.terms.items()]
    if not terms:
        return "0.0"
    if len(terms) == 1:
        return terms[0]
    return f"(+ {' '.join(terms)})"


def _product(monomial: Sequence[str], x: F) -> str:
    if len(monomial) == 1 and x == 1:
        return monomial[0]
    return f"(* {_real(x)} {' '.join(monomial)})"


def _real(x: F) -> str:
    """Return an exact number as a term of sort Real."""
    size = f"{abs(x.numerator)}.0"
    if x.denominator != 1:
        size = f"(/ {size} {x.denominator}.0)"
    if x < 0:
        return f"(- {size})"
    return size
