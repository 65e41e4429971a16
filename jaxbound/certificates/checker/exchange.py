"""A certificate as text for independent programs: VIPR 1.0 for checkers of exact proofs, SMT-LIB 2 for
solvers that decide anew.

Source: scipopt/vipr, cert_spec_v1_0.md; smt-lib.org, version 2.6.
"""

from collections.abc import Sequence
from fractions import Fraction as F
from typing import Any

from jaxbound.certificates.checker.claim import numbers
from jaxbound.certificates.checker.inequalities import Row, combination, rows_of, solution, unknowns

__all__ = ["smt2", "vipr"]

PROOF = ("witness", "relation", "errors", "relations", "proof", "parameters", "sum")
NONLINEAR = (
    "VIPR proves linear inequalities only, and here uncertain parameters multiply unknown states: "
    "to_smt2 writes this window for solvers"
)


def vipr(document: dict[str, Any]) -> str:
    """Return a certificate as VIPR 1.0: for FAULT the rows and the combination of them that is 0 >= a
    positive number, for CONSISTENT the rows and a solution.

    Raises:
        NotImplementedError: a FAULT of a model with uncertain parameters.
    """
    c, proof = _read(document)
    fault = document["certificate"] == "FAULT"
    if fault and "uncertainties" in c:
        raise NotImplementedError(NONLINEAR)
    v = proof.get("parameters") or []
    rows = rows_of(c, v)
    place = {name: i for i, name in enumerate(unknowns(rows) or ["none"])}
    lines = [*_head(document, "%"), "VER 1.0", f"VAR {len(place)}", " ".join(place), "INT 0", "OBJ min", "0"]
    constraints, ends = list[str](), []  # one for each end of a row, and their numbers
    for row in rows:
        sides = [("E", row.lo)] if row.lo == row.hi else [("G", row.lo), ("L", row.hi)]
        at = {}
        for sense, end in sides:
            if end is not None:
                at[sense] = len(constraints)
                constraints.append(
                    f"{row.name}{'' if sense == 'E' else sense} {sense} {end} {_sparse(row, place)}"
                )
        ends.append(at)
    lines += [f"CON {len(constraints)} 0", *constraints]
    if not fault:
        values = [f"{place[name]} {x}" for name, x in solution(c, proof["witness"], v) if name in place and x]
        return "\n".join(
            [*lines, "RTP range -inf inf", "SOL 1", f"witness {len(values)} {' '.join(values)}", "DER 0", ""]
        )
    used, total = [], F(0)
    for row, at, x in zip(rows, ends, combination(c, proof["relation"], rows), strict=True):
        if x:
            sense = "E" if "E" in at else "G" if x > 0 else "L"
            end = row.hi if sense == "L" else row.lo
            assert end is not None
            used.append(f"{at[sense]} {x}")
            total += x * end
    derived = f"contradiction G {total} 0 {{ lin {len(used)} {' '.join(used)} }} -1"
    return "\n".join([*lines, "RTP infeas", "SOL 0", "DER 1", derived, ""])


def smt2(document: dict[str, Any]) -> str:
    """Return the rows of a certificate's window as an SMT-LIB 2 script, with the answer that is expected:
    unsat for FAULT, else sat.
    """
    c, _ = _read(document)
    rows = rows_of(c)
    products = any(len(monomial) > 1 for row in rows for monomial in row.terms)
    lines = [
        *_head(document, ";"),
        "(set-info :smt-lib-version 2.6)",
        f"(set-logic {'QF_NRA' if products else 'QF_LRA'})",
    ]
    lines.append(f"(set-info :status {'unsat' if document['certificate'] == 'FAULT' else 'sat'})")
    lines += [f"(declare-fun {name} () Real)" for name in unknowns(rows)]
    for row in rows:
        total = _sum(row)
        sides = [("=", row.lo)] if row.lo == row.hi else [(">=", row.lo), ("<=", row.hi)]
        lines += [f"(assert ({sense} {total} {_real(end)}))" for sense, end in sides if end is not None]
    return "\n".join([*lines, "(check-sat)", "(exit)", ""])


def _read(document):
    """Return (claim, proof) of a document."""
    c = numbers(document["numbers"], [])
    return {name: x for name, x in c.items() if name not in PROOF}, {
        name: x for name, x in c.items() if name in PROOF
    }


def _head(document, mark):
    """Return comments that say what the text is about; whatever names are, they stay within their line."""
    said = " ".join(document["statement"].split())
    unknown = (
        "xJ_I: state I at sample J, wJ_I: disturbance, vJ_I: unknown input, uJ_I: missing input, gI: "
        "gain, pK: parameter"
    )
    return [f"{mark} {document['certificate']}: {said}", f"{mark} {unknown}, in deviations from the offsets"]


def _sparse(row: Row, place: dict[str, int]) -> str:
    """Return the number of terms of a row and each of them."""
    terms = [f"{place[name]} {x}" for (name,), x in row.terms.items()]
    return " ".join([str(len(terms)), *terms])


def _sum(row):
    terms = [_product(monomial, x) for monomial, x in row.terms.items()]
    if not terms:
        return "0.0"
    return terms[0] if len(terms) == 1 else f"(+ {' '.join(terms)})"


def _product(monomial: Sequence[str], x: F) -> str:
    return monomial[0] if len(monomial) == 1 and x == 1 else f"(* {_real(x)} {' '.join(monomial)})"


def _real(x):
    """Return an exact number as a term of sort Real."""
    size = f"{abs(x.numerator)}.0" if x.denominator == 1 else f"(/ {abs(x.numerator)}.0 {x.denominator}.0)"
    return f"(- {size})" if x < 0 else size
