"""What a certificate is, and who gives one: `certify` is chosen by the type of the relations, registered in
the file of each kind.
"""

import json
from collections.abc import Mapping, Sequence
from functools import singledispatch
from typing import Any

import numpy as np

from jaxbound.certificates.checker.exchange import smt2, vipr
from jaxbound.sets.floats.status import Status

__all__ = ["WindowCertificate", "certify", "evidence", "explain"]


class WindowCertificate:
    """Why one window has its verdict, for people (`str`) and for whoever checks it (`to_json`).

    Fields: status: of the window, as detected. at: the index at which it ends, a tuple.
    """

    status: Status
    at: tuple

    @property
    def proves(self) -> Status:
        """FAULT or CONSISTENT: what is proved here, also where the method of the detection left it
        UNDECIDED.
        """
        raise NotImplementedError

    @property
    def errors(self) -> Mapping[str, float]:
        """{output: the smallest error of that sensor alone that would explain the window}; empty where that
        is not known.
        """
        return {}

    @property
    def candidates(self) -> tuple[str, ...]:
        """The signals that alone could explain a FAULT window; empty where that is not known."""
        return ()

    def _head(self):
        return (
            f"{type(self).__name__} of window {self.at if len(self.at) != 1 else self.at[0]}: "
            f"{self.status.name}"
        )

    def _rows(self):
        return {"why": str(self)}

    def to_dict(self, times: Sequence[str] | None = None, sample: Any = None, errors: bool = True) -> dict:
        """Return what a check needs, ready for JSON: numbers as exact text ("0.1", "1/3"), names apart from
        them.

        Args:
            times: text of the time of each of the s + 1 samples; None leaves them out. sample: what to call
                the last one; None: `at`.
            errors: False leaves out the smallest single-sensor errors of a FAULT, which take most of the
                time.
        """
        raise NotImplementedError

    def to_json(self, times: Sequence[str] | None = None, sample: Any = None, errors: bool = True) -> str:
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


@singledispatch
def certify(
    relations: Any,
    u: Any,
    y: Any,
    method: str = "joint",
    status: Status | None = None,
    at: tuple | None = None,
) -> Any:
    """Prove the verdict of one window.

    Args:
        relations: as for `detect`. u (s+1, m), y (s+1, p): the samples, arrays of floats. method: of the
            detection.
        status: what the detection said; None: what exact numbers say. at: what to call the window, a tuple;
            default (s,).

    Returns:
        A WindowCertificate.

    Raises:
        ValueError: no relation has its data. NotImplementedError: a verdict that one relation or one
            behaviour cannot prove.
    """
    raise NotImplementedError(
        f"certificates are given for relations that detect knows, not {type(relations).__name__}"
    )


def explain(result: Any, at: int | tuple) -> Any:
    """Return the certificate of the window that ends at index `at`. See `Result.explain`."""
    status = Status(int(result.status[at]))
    if status == Status.MISSING:
        raise ValueError(f"window {at} is MISSING: there is nothing to explain")
    at = at if isinstance(at, tuple) else (at,)
    at = tuple(int(i) % n for i, n in zip(at, result.status.shape, strict=True))
    relations, method, u, y = evidence(result.relations, result, at, status)
    return certify(relations, u, y, method, status, at)


@singledispatch
def evidence(
    relations: Any, result: Any, at: tuple, status: Status
) -> tuple[Any, str, np.ndarray, np.ndarray]:
    """Return (relations, method, u, y): the window whose certificate explains the verdict of a Result at an
    index, chosen by its relations.

    Raises:
        NotImplementedError: no window proves it.
    """
    s = relations.horizon
    u, y = (np.asarray(x)[at[:-1]][at[-1] - s : at[-1] + 1] for x in (result.u, result.y))
    return relations, result.method, u, y
