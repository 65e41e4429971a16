"""Certificates of all kinds before checkers that others wrote, and forged ones before ours."""

import ast
import shutil
import subprocess
import sys
from fractions import Fraction
from pathlib import Path

import check_certificate
import numpy as np
import pytest
from certificate_kinds import (
    KINDS,
    OBSERVED,
    QUESTIONS,
    UNSURE,
    case,
    forged,
    forged_question,
    question,
    summed,
)
from outside_checkers import adds_up, built, cvc5_says, vipr_confirms, z3_says

import jaxbound as jb
import jaxbound.certificates.checker
from jaxbound.certificates.checker.command import REFUSED
from jaxbound.certificates.interface import certify
from jaxbound.certificates.residual_certificate import ResidualCertificate
from jaxbound.certificates.verification import verify
from jaxbound.cli.main import main

FOLDER = Path(jaxbound.certificates.checker.__file__).parent
VERDICTS = [(kind, fault) for kind in KINDS for fault in ((True,) if kind in OBSERVED else (True, False))]
HUGE = "observer, 513 samples"
SHORT = [pytest.param(*x, marks=pytest.mark.long) if x[0] == HUGE else x for x in VERDICTS]
SEARCHED = ("long", "six states", "disturbance", "leak", "unknown inputs", *UNSURE, *OBSERVED)
MANY = {HUGE: 1} | dict.fromkeys(SEARCHED, 20)
OFTEN = 100
"""So many certificates of each kind and verdict."""
TAMPERED = 1000
"""So many forged ones of each kind, of the two verdicts together."""


@pytest.fixture(scope="session")
def vipr(shared, tmp_path_factory):
    """Return a function that says whether the VIPR checker verifies a text."""
    folder = tmp_path_factory.mktemp("vipr")
    program = built(shared, folder)
    return lambda text: vipr_confirms(program, text, folder)


def refused(document, given):
    """Return why `verify` refuses a document, or None."""
    try:
        verify(document, **given)
    except REFUSED as e:
        return str(e) or type(e).__name__
    return None


def twice_confirmed(found, vipr, fault):
    """Return whether our checker and another one confirm a case."""
    verify(found.document, **found.given)
    if not fault or "uncertainties" not in found.document["numbers"]:
        assert adds_up(found.certificate.to_vipr())
    if fault and "uncertainties" in found.document["numbers"]:
        return z3_says(found.certificate.to_smt2()) == "unsat"
    return vipr(found.certificate.to_vipr())


@pytest.mark.parametrize("kind, fault", SHORT)
def test_a_certificate_is_confirmed_by_two_checkers_and_refused_when_it_is_forged(kind, fault, vipr, rng):
    found = case(kind, rng, fault, errors=kind == "two residuals")
    assert twice_confirmed(found, vipr, fault)
    for _ in range(2):
        what, wrong = forged(found.document, rng)
        assert refused(wrong, found.given), what


@pytest.mark.long(by_day="test_a_certificate_is_confirmed_by_two_checkers_and_refused_when_it_is_forged")
@pytest.mark.parametrize("kind, fault", VERDICTS)
def test_certificates_are_confirmed_and_a_thousand_forged_ones_of_each_kind_refused(kind, fault, vipr, rng):
    count, verdicts = MANY.get(kind, OFTEN), VERDICTS.count((kind, True)) + VERDICTS.count((kind, False))
    for i in range(count):
        found = case(kind, rng, fault, errors=i % 4 == 0 and kind not in SEARCHED)
        assert twice_confirmed(found, vipr, fault), found.document
        for _ in range(TAMPERED // verdicts // count):
            what, wrong = forged(found.document, rng)
            assert refused(wrong, found.given), what


@pytest.mark.parametrize("name, meets", QUESTIONS)
@pytest.mark.parametrize("count, each", [(1, 40), pytest.param(20, 25, marks=pytest.mark.long)])
def test_answers_about_sets_are_confirmed_and_forged_ones_refused(name, meets, count, each, rng):
    """As many forged ones of each kind by night, of both answers together."""
    for _ in range(count):
        document = question(name, meets, rng)
        check_certificate.confirm(document)
        assert holds(document, meets)
        for _ in range(each):
            what, wrong = forged_question(document, rng)
            with pytest.raises(REFUSED):
                pytest.fail(f"{what}: {wrong}") if check_certificate.confirm(wrong) is None else None


def holds(document, meets):
    """Return whether fractions agree with the proof of an answer, each question in words of its own."""
    c = {name: np.array(x, object) for name, x in _fractions(document["numbers"]).items() if name != "sets"}
    first, *others = _fractions(document["numbers"])["sets"]
    G, center = np.array(first["generators"], object), np.array(first["center"], object)
    A, b = np.array(first["constraints"], object).reshape(-1, G.shape[1]), np.array(first["offsets"], object)
    q = G.shape[1]
    inner = [(np.array(x["generators"], object), np.array(x["center"], object)) for x in others]
    if document["question"] == "contains_set":
        ((H, at),) = inner
        if meets:
            X = c["X"]
            same = (G @ X[:, 1:] == H).all() and (center + G @ X[:, 0] == at).all()
            return same and all(sum(map(abs, row)) <= 1 for row in X)
        along = lambda M: sum(map(abs, c["l"] @ M))
        return c["l"] @ (at - center) + along(H) > along(G)
    if meets:
        x = c["x"]
        true = (A @ x[:q] == b).all() and max(map(abs, x)) <= 1
        if document["question"] == "contains":
            return true and (center + G @ x == c["point"]).all()
        return true and all((center + G @ x[:q] == at + H @ x[q:]).all() for H, at in inner)
    # every x of the box: l (what the equations ask for) - l (what they give) > 0
    l, n = c["l"], len(center)
    if document["question"] == "is_empty":
        return l @ b > sum(map(abs, l @ A))
    across, right = l[:n] @ G + l[n : n + len(b)] @ A, l[n : n + len(b)] @ b
    if document["question"] == "contains":
        return l[:n] @ (c["point"] - center) + right > sum(map(abs, across))
    ((H, at),) = inner
    return l[:n] @ (at - center) + right > sum(map(abs, across)) + sum(map(abs, l[:n] @ H))


def _fractions(tree):
    return check_certificate.numbers(tree, [])


def test_the_smallest_error_of_a_sensor_is_where_wider_bounds_begin_to_explain(vipr, rng):
    """Outside checkers know no errors of sensors: more noise of the sensor says the same."""
    relations = {}
    found = case("no state", rng, True, errors=True)
    model, u, y = (found.given[name] for name in ("model", "u", "y"))
    at = found.document["names"]["sample"][0]
    for e in found.document["numbers"]["errors"]:
        if e["smallest"] is None:
            continue
        i = int(e["output"])
        for size, status in (
            (Fraction(e["smallest"]) * Fraction("0.999999"), "FAULT"),
            (Fraction(e["enough"]), "CONSISTENT"),
        ):
            noise = [x + size * (k == i) for k, x in enumerate(model.noise)]
            wider = certify(
                jb.parity_relations(model.replace(noise=noise), 0), u[at : at + 1], y[at : at + 1]
            )
            assert wider.proves.name == status and adds_up(wider.to_vipr())
            relations[i] = status
    assert relations


@pytest.mark.parametrize(
    "kind", ["averages at lags", "constant tolerance", "unsure, no state", "unknown inputs"]
)
def test_solvers_that_know_no_certificate_come_to_the_same_verdict(kind, rng):
    for fault in (True, False):
        text = case(kind, rng, fault).certificate.to_smt2()
        expected = "unsat" if fault else "sat"
        assert f"(set-info :status {expected})" in text
        assert z3_says(text) == cvc5_says(text) == expected


def test_another_multiplier_or_another_solution_is_refused_by_the_checker_of_others(vipr, rng):
    for fault in (True, False):
        text = case("leak", rng, fault).certificate.to_vipr()
        assert vipr(text)
        head, mark, tail = text.rpartition(" }" if fault else "\nDER")
        assert not vipr(f"{head}1{mark}{tail}")  # a digit more in the last multiplier or value


def test_a_relation_times_a_number_proves_the_same(rng):
    found = case("two residuals", rng, True)
    c = found.document["numbers"]
    r = c["relation"]
    for name in ("h", "g", "k"):
        r[name] = [[str(3 * Fraction(x)) for x in row] for row in r[name]]
    for name in ("residual", "width"):
        r[name] = str(3 * Fraction(r[name]))
    assert refused(summed(found.document), found.given) is None


def test_what_is_not_linear_has_no_text_for_a_checker_of_linear_proofs(rng):
    with pytest.raises(NotImplementedError, match="uncertain parameters multiply unknown states"):
        case("unsure, no state", rng, True).certificate.to_vipr()
    own = jb.residual(lambda z, u, y: y[1] - z * y[0], jb.interval([0.5], [0.6]), horizon=1)
    c = ResidualCertificate(jb.Status.FAULT, (1,), own, np.zeros((2, 0)), np.array([[1.0], [2.0]]), None, 1)
    for text in (c.to_vipr, c.to_smt2):
        with pytest.raises(NotImplementedError, match="a residual is a program of its user"):
            text()
    with pytest.raises(ValueError, match="a certificate of a residual, which is a program of its user"):
        verify(c.to_dict(), None, None)


def test_a_name_cannot_leave_its_comment(vipr):
    m = jb.LinearSystem([[0.5]], None, [[1]], noise="1/10", name="tank\n(assert false)\nVER")
    c = jb.detect(jb.parity_relations(m), None, [[1.0], [0.52]]).explain(1)
    assert vipr(c.to_vipr()) and z3_says(c.to_smt2()) == "sat"


def test_a_window_across_a_gap_or_of_a_later_first_state_is_refused(rng):
    found = case("two residuals", rng, True)
    verify(found.document, **found.given)
    model, u, y = (found.given[name] for name in ("model", "u", "y"))
    parted = jb.Recording.of(model, u, y, starts=[3])
    assert "there is a gap among them" in refused(found.document, {"model": model, "u": parted})
    begun = case("observer, first state", rng, True)
    assert "must be given: x0" in refused(begun.document, begun.given | {"x0": None})
    assert refused(begun.document, begun.given | {"x0": jb.interval([-9.0, -9.0], [9.0, 9.0])})
    later = begun.given | {
        name: np.concatenate([begun.given[name][:1]] * 2 + [begun.given[name][1:]]) for name in ("u", "y")
    }
    shifted = begun.document | {
        "names": begun.document["names"] | {"sample": [begun.document["names"]["sample"][0] + 1]}
    }
    assert refused(shifted, later)


def test_the_checker_imports_nothing_but_the_standard_library():
    for path in FOLDER.glob("*.py"):
        nodes = [
            node
            for node in ast.walk(ast.parse(path.read_text()))
            if isinstance(node, (ast.Import, ast.ImportFrom))
        ]
        modules = {
            name
            for node in nodes
            for name in ([node.module] if isinstance(node, ast.ImportFrom) else [a.name for a in node.names])
        }
        outside = {
            name.split(".")[0] for name in modules if not name.startswith("jaxbound.certificates.checker")
        }
        assert outside <= sys.stdlib_module_names, path.name


def test_the_script_runs_alone_and_agrees_with_the_command(tmp_path, kernels):
    """Readers of their own, the same answer; a folder copied elsewhere, without the package."""
    assert main(["example", "heater", "--out", str(tmp_path / "run")]) == 0
    model, data, report = tmp_path / "run" / "truth.toml", tmp_path / "run" / "jump.csv", tmp_path / "report"
    assert main(["detect", str(model), str(data), "--out", str(report), "-q"]) == 1
    script = shutil.copytree(FOLDER, tmp_path / "elsewhere")
    other = tmp_path / "other.toml"
    other.write_text(model.read_text().replace("noise = 0.1", "noise = 0.11"))
    cases = [
        (model, data, 0, ""),
        (other, data, 1, "numbers.noise[0] is 0.1"),
        (model, tmp_path / "run" / "healthy_1.csv", 1, "numbers.u[0]"),
    ]
    for at, verdict in (("60", "FAULT"), ("30", "CONSISTENT")):
        assert main(["explain", str(report), "--at", at]) == 0
        path = report / f"certificate-{at}.json"
        for m, d, code, why in cases:
            assert main(["verify", str(path), "--model", str(m), "--data", str(d)]) == code
            command = [sys.executable, "-I", script, path, "--model", m, "--data", d]
            ran = subprocess.run(command, capture_output=True, text=True)
            assert ran.returncode == code and why in ran.stderr
            assert code or f"confirmed: {verdict}. " in ran.stdout
        text = path.read_text()
        path.write_text(text.replace('"certificate"', '"certificate": "FAULT", "certificate"', 1))
        assert main(["verify", str(path), "--model", str(model), "--data", str(data)]) == 1
    assert main(["verify", str(tmp_path / "none.json"), "--model", str(model), "--data", str(data)]) == 2
