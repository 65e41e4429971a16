"""Certificates of windows: `certify` gives one, chosen by the type of the relations, registered in the file
of each kind.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from fractions import Fraction
from functools import partial, singledispatch
from typing import Any, Protocol, Self, TypeAlias

import numpy as np

from jaxbound.certificates.checker.solver_texts import smt2, vipr
from jaxbound.certificates.diagnosis import Diagnosis
from jaxbound.consistency.extrapolated import extrapolated
from jaxbound.consistency.interface import Relations
from jaxbound.models.named_faults import NamedFault
from jaxbound.sets.floats.status import Status
from jaxbound.text.progress import Progress

Index: TypeAlias = tuple[int, ...]
"""Where a window ends: (.., sample)."""
Sample: TypeAlias = int | list[int] | None
"""What a certificate calls the last sample of its window."""


class Judgement(Protocol):
    """Verdicts of a recording with what they are of, as a Result has them."""

    @property
    def status(self) -> np.ndarray:
        """(..., T)."""

    @property
    def margin(self) -> np.ndarray:
        """(..., T)."""

    @property
    def relations(self) -> Any:
        """The relations, or the observer, that were tested."""

    @property
    def method(self) -> str:
        """The method of the test."""

    @property
    def u(self) -> np.ndarray:
        """(..., T, m)."""

    @property
    def y(self) -> np.ndarray:
        """(..., T, p)."""


class WindowCertificate:
    """A proof of the verdict of one window, for people (`str`) and for whoever checks it (`to_json`).

    Fields: status: of the window, as detected. at: the index at which it ends, a tuple. test: of a monitor
    the name of the test that it is of, else "". beyond: outside of training makes the certificate under the
    wider bounds, by which the window was judged; None: it was by those stated.
    """

    status: Status
    at: Index
    test: str = ""
    beyond: "Callable[[], WindowCertificate] | None" = None

    def of_test(self, name: str) -> Self:
        """Return the same certificate, of a test of a monitor: what it says is of the model of this test."""
        return self._with(test=name)

    def _with(self, **changes: object) -> Self:
        # certificates are frozen values: another name is another certificate
        own = copy(self)
        vars(own).update(changes)
        return own

    @property
    def proves(self) -> Status:
        """FAULT or CONSISTENT: what is proved here, also where the method of the detection left it
        UNDECIDED.
        """
        raise NotImplementedError

    @property
    def errors(self) -> Mapping[str, Fraction | float]:
        """{output: the smallest error of that sensor alone that would explain the window}; empty where that
        is not known.
        """
        return {}

    @property
    def candidates(self) -> tuple[str, ...]:
        """The signals that alone could explain a FAULT window; empty where that is not known."""
        return ()

    @property
    def sensor_candidates(self) -> tuple[str, ...]:
        """The sensors among the candidates, where these are known sooner."""
        return self.candidates

    def work_out(self, progress: Progress | None = None) -> None:
        """Work out now what else is worked out at the first call: .errors and .candidates, an exact program
        for each signal, which take minutes where a window is long.

        Args:
            progress: called with the share of the work done.
        """

    def diagnose(self, faults: Sequence[NamedFault] | None = None) -> Diagnosis:
        """Return the Diagnosis of a FAULT window: which named faults alone explain it, with the smallest and
        the largest size that do, and of which it is proved that they do not. Exact.

        Args:
            faults: a list of NamedFault; None: those of the model, or a bias of every sensor and an offset
                of every actuator where it names none.

        Raises:
            ValueError: the window is no FAULT, or a fault names a signal that the model does
                not have. NotImplementedError: relations of which that is not known.

        Example:
            >>> import jaxbound as jb
            >>> m = jb.LinearSystem([[0.5]], None, [[1]], noise="1/10", outputs=["T1"])
            >>> print(jb.detect(jb.parity_relations(m), None, [[1.0], [0.8]]).explain(1).diagnose())
            bias of T1: +0.15 to +0.9 of T1 explains it
        """
        raise NotImplementedError(
            f"named faults are weighed on windows of models without uncertain parameters, not by a "
            f"{type(self).__name__}: decouple the parameters, or give them as a disturbance"
        )

    def _head(self) -> str:
        end: object = self.at
        if len(self.at) == 1:
            end = self.at[0]
        return f"{type(self).__name__} of window {end}: {self.status.name}"

    def _rows(self) -> dict[str, str]:
        return {"why": str(self)}

    def to_dict(
        self, times: Sequence[str] | None = None, sample: Sample = None, errors: bool = True
    ) -> dict[str, Any]:
        """Return all that a check needs, ready for JSON: numbers as exact text ("0.1", "1/3"), names apart
        from them.

        Args:
            times: text of the time of each of the s + 1 samples; None leaves them out. sample: what to call
                the last one; None: `at`.
            errors: False leaves out the smallest single-sensor errors of a FAULT, which take most of the
                time.
        """
        raise NotImplementedError

    def to_json(self, times: Sequence[str] | None = None, sample: Sample = None, errors: bool = True) -> str:
        """Return `to_dict` as text.

        Example:
            >>> import jaxbound as jb
            >>> m = jb.LinearSystem([[0.5]], None, [[1]], noise="1/10")
            >>> c = jb.detect(jb.parity_relations(m), None, [[1.0], [0.8]]).explain(1)
            >>> json.loads(c.to_json())["numbers"]["relation"]["h"]
            [['1'], ['-2']]
        """
        return json.dumps(self.to_dict(times, sample, errors), indent=1)

    def to_vipr(self) -> str:
        """Return the proof as VIPR 1.0, which independent checkers of exact linear proofs take.

        Every inequality of the window is written out; a FAULT ends in the combination of them that cannot
        hold, a CONSISTENT shows a solution.

        Raises:
            NotImplementedError: a FAULT of a model with uncertain parameters, whose inequalities are not
                linear; a residual.

        Example:
            >>> import jaxbound as jb
            >>> m = jb.LinearSystem([[0.5]], None, [[1]], noise="1/10")
            >>> c = jb.detect(jb.parity_relations(m), None, [[1.0], [0.8]]).explain(1)
            >>> [line for line in c.to_vipr().splitlines() if line.startswith(("VER", "RTP"))]
            ['VER 1.0', 'RTP infeas']
        """
        return vipr(self.to_dict(errors=False))

    def to_smt2(self) -> str:
        """Return the inequalities of the window as an SMT-LIB 2 script, by which solvers decide anew: FAULT
        is unsat, CONSISTENT sat.

        The logic is QF_LRA, with uncertain parameters QF_NRA.

        Raises:
            NotImplementedError: a residual.

        Example:
            >>> import jaxbound as jb
            >>> m = jb.LinearSystem([[0.5]], None, [[1]], noise="1/10")
            >>> c = jb.detect(jb.parity_relations(m), None, [[1.0], [0.8]]).explain(1)
            >>> [line for line in c.to_smt2().splitlines() if line.startswith("(set-")][1:]
            ['(set-logic QF_LRA)', '(set-info :status unsat)']
        """
        return smt2(self.to_dict(errors=False))


def certify(
    relations: Relations,
    u: np.ndarray,
    y: np.ndarray,
    *,
    status: Status | None = None,
    at: Index | None = None,
) -> WindowCertificate:
    """Prove the verdict of one window.

    Args:
        relations: as for `detect`. u (s+1, m), y (s+1, p): the samples, arrays of floats. status: the
            verdict of the detection; None: that of exact numbers. at: the name of the window, a tuple;
            default (s,).

    Returns:
        A WindowCertificate. Outside of training, where bounds are wider, it is of the bounds as stated where
        these prove the verdict: that of a FAULT says how many times as wide they would have to be. What alone
        could explain a FAULT there, and what could not, is told by the wider bounds.

    Raises:
        ValueError: no relation has its data. NotImplementedError: a verdict that one relation or one
            behaviour cannot prove.
    """
    at = at or (len(y) - 1,)
    proof = partial(certificate_of, u=u, y=y, status=status, at=at)
    wide, grade = extrapolated(relations), -1
    if wide is not None:
        grade = int(wide.region.departure(np.asarray(u), np.zeros(len(y), bool)).grade[-1])
    if wide is None or grade < 0:
        return proof(relations)
    beyond = partial(proof, wide.relations(grade))
    try:
        stated = proof(relations)
    except NotImplementedError:  # the wider bounds may have a behaviour that is found
        if status == Status.FAULT:
            raise
        return beyond()
    if stated.proves != Status.FAULT:
        return stated
    if status != Status.FAULT:
        judged = beyond()
        if judged.proves != Status.FAULT:
            return judged
    return stated._with(beyond=beyond)


@singledispatch
def certificate_of(
    relations: object, u: np.ndarray, y: np.ndarray, status: Status | None, at: Index
) -> WindowCertificate:
    """Return the WindowCertificate of `certify`, by the type of relations: what a kind of proof registers.

    Args:
        relations, u, y, status: as for `certify`. at: the name of the window.
    """
    raise NotImplementedError(
        f"certificates are given for relations that detect knows, not {type(relations).__name__}"
    )


def nothing_to_explain(at: Index) -> ValueError:
    """Return the error of a window without usable data."""
    return ValueError(f"window {at[-1]} is MISSING: there is nothing to explain")


def explain(result: Judgement, at: Index) -> WindowCertificate:
    """Return the certificate of the window that ends at an index. See `Result.explain`."""
    status = Status(int(result.status[at]))
    if status == Status.MISSING:
        raise nothing_to_explain(at)
    return window_certificate(result.relations, result, at, status)


@singledispatch
def window_certificate(
    relations: Relations, result: Judgement, at: Index, status: Status
) -> WindowCertificate:
    """Return the certificate that explains the verdict of a Result at an index, chosen by its relations.

    Raises:
        NotImplementedError: no window proves it.
    """
    *recording, end = at
    samples = slice(end - relations.horizon, end + 1)
    u = np.asarray(result.u)[tuple(recording)][samples]
    y = np.asarray(result.y)[tuple(recording)][samples]
    return certify(relations, u, y, status=status, at=at)
