"""A certificate as text for independent programs: VIPR 1.0 for checkers of exact proofs, SMT-LIB 2 for
solvers that decide anew.

Source: scipopt/vipr, cert_spec_v1_0.md; smt-lib.org, version 2.6.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from fractions import Fraction as F
from typing import NamedTuple

from jaxbound.certificates.checker.claim import numbers
from jaxbound.certificates.checker.polynomial import Monomial, Polynomial, Value, variables
from jaxbound.certificates.checker.trajectories import behaviour, limits, moved, multipliers, named, sums_of
from jaxbound.certificates.checker.words import Document

PROOF = ("witness", "relation", "errors", "relations", "proof", "parameters", "sum")
NONLINEAR = (
    "VIPR proves linear inequalities only, and here uncertain parameters multiply unknown states: "
    "to_smt2 writes this window for solvers"
)


class Line(NamedTuple):
    """A sum of terms that is equal to its end (E), at least (G) or at most (L)."""

    signal: str
    sense: str
    terms: Mapping[Monomial, F]
    end: F


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
    lines = list(_lines(c, v))
    unknowns = _unknowns(lines) or ["none"]
    place = dict(zip(unknowns, range(len(unknowns)), strict=True))
    text = [*_head(document, "%"), "VER 1.0", f"VAR {len(place)}", " ".join(place), "INT 0", "OBJ min", "0"]
    text.append(f"CON {len(lines)} 0")
    for number, line in enumerate(lines):
        terms = [f"{place[name]} {x}" for (name,), x in line.terms.items()]
        text.append(" ".join([f"c{number}", line.sense, str(line.end), str(len(terms)), *terms]))
    if fault:
        text += ["RTP infeas", "SOL 0", "DER 1", _contradiction(c, proof["relation"], lines)]
    else:
        every = behaviour(c, proof["witness"], v).items()
        values = [f"{place[name]} {x}" for name, x in every if name in place and x]
        text += ["RTP range -inf inf", "SOL 1", f"witness {len(values)} {' '.join(values)}", "DER 0"]
    return "\n".join([*text, ""])


def _contradiction(c: Document, r: Document, lines: Sequence[Line]) -> str:
    """Return the derivation that a combination of lines is 0 >= a positive number."""
    wanted, sign = multipliers(c, r, [])[0], 1
    if r["residual"] < 0:
        sign = -1
    used, left = {}, Polynomial({})
    # gains last: they get minus what readings leave of them
    for number, line in sorted(enumerate(lines), key=lambda one: one[1].signal[0] == "g"):
        x = sign * Polynomial.of(wanted.get(line.signal, 0)).at({})
        if line.signal[0] == "g":
            x = -left.terms.get((line.signal,), F(0))
        # a reading has two lines: the one that this sign of its multiplier needs
        if x and (line.sense == "E" or (line.sense == "G") == (x > 0)):
            used[number] = x
            left = left + Polynomial({**line.terms, (): -line.end}) * x
    combined = " ".join(f"{number} {x}" for number, x in used.items())
    return f"contradiction G {-left.terms[()]} 0 {{ lin {len(used)} {combined} }} -1"


def smt2(document: Document) -> str:
    """Return the rows of a certificate's window as an SMT-LIB 2 script, with the answer that is expected:
    unsat for FAULT, else sat.
    """
    c, _ = _parts(document)
    lines = list(_lines(c))
    logic, expected = "QF_LRA", "sat"
    if any(len(monomial) > 1 for line in lines for monomial in line.terms):
        logic = "QF_NRA"
    if document["certificate"] == "FAULT":
        expected = "unsat"
    text = [
        *_head(document, ";"),
        "(set-info :smt-lib-version 2.6)",
        f"(set-logic {logic})",
        f"(set-info :status {expected})",
    ]
    text += [f"(declare-fun {name} () Real)" for name in _unknowns(lines)]
    senses = {"E": "=", "G": ">=", "L": "<="}
    text += [f"(assert ({senses[line.sense]} {_sum(line)} {_real(line.end)}))" for line in lines]
    return "\n".join([*text, "(check-sat)", "(exit)", ""])


def _lines(c: Document, parameters: Sequence[F] | None = None) -> Iterator[Line]:
    """Yield all that model, bounds and samples say of a window, equations of the states included.

    Args: parameters: values of uncertain parameters that are put in; None: they are unknowns, and lines not
        linear.
    """
    count = len(c.get("variables", []))
    signals = named("p", variables("p", count)) | named("g", variables("g", len(c["noise"])))
    v: Sequence[Value] = variables("p", count)
    if parameters is not None:
        v = parameters
        for k, value in enumerate(v):
            yield from _between(f"p{k}", signals[f"p{k}"], value, value)
    x: list[Value] = variables("x0_", len(c["A"]))
    for j, recorded in enumerate(c["u"]):
        w, free = variables(f"w{j}_", len(c["disturbance"])), variables(f"v{j}_", len(c["D_v"][0]))
        u: list[Value] = variables(f"u{j}_", len(recorded))
        for i, value in enumerate(recorded):
            if value is not None:
                u[i] = value - c["offset_u"][i]
        t, after = moved(c, j, v, x, u, w, free)
        signals |= named(f"x{j}_", x) | named(f"y{j}_", t) | named(f"w{j}_", w)
        # states are unknowns of their own with an equation each: substituted, lines would grow with time
        x = variables(f"x{j + 1}_", len(x))
        if j < len(c["u"]) - 1:
            for i, (new, of) in enumerate(zip(x, after, strict=True)):
                yield from _between(f"step{j}_{i}", new + -1 * of, F(0), F(0))
    signals |= sums_of(c, signals)
    for name, ends in limits(c).items():
        gain: Value = F(1)
        if "constant" in c and name[0] == "y":
            gain = signals["g" + name.split("_")[1]]
        yield from _between(name, signals[name], *(gain * end for end in ends))


def _between(signal: str, terms: Value, lo: Value, hi: Value) -> Iterator[Line]:
    """Yield the lines of lo <= terms <= hi, one where both ends are the same number."""
    senses = [("G", lo), ("L", hi)]
    if lo == hi:
        senses = [("E", lo)]
    for sense, end in senses:
        moved_over = dict(Polynomial.of(terms + -1 * end).terms)
        known = moved_over.pop((), F(0))
        yield Line(signal, sense, moved_over, -known)


def _unknowns(lines: Iterable[Line]) -> list[str]:
    """Return the names of all unknowns, in the order in which lines name them."""
    return list(dict.fromkeys(name for line in lines for monomial in line.terms for name in monomial))


def _parts(document: Document) -> tuple[Document, Document]:
    """Return (claim, proof) of a document that was built here: nothing in it needs a check."""
    claim = numbers(document["numbers"], [])
    return claim, {name: claim.pop(name) for name in PROOF if name in claim}


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


def _sum(line: Line) -> str:
    terms = [_product(monomial, x) for monomial, x in line.terms.items()]
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
