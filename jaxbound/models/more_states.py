"""A model with more states behind its own: what acts on it without being a state becomes one."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

from jaxbound.exact.linalg import Matrix, beside, zeros
from jaxbound.models.named_faults import faults_beside_states
from jaxbound.models.system import LinearSystem, matrices_at_zero
from jaxbound.models.uncertainty import Uncertainty, coefficient

Acting: TypeAlias = Callable[[Mapping[str, Matrix]], tuple[Matrix, Matrix]]
"""Of matrices by their letters: the columns (n, k), (p, k) by which more states act on x+ and y."""


def more_states(
    model: LinearSystem, names: Sequence[str], acting: Acting, of_parameter: Acting, own: Matrix
) -> dict[str, Any]:
    """Return the changes of `LinearSystem.replace` that give a model k more states.

    Args:
        names: of the states. acting: of the matrices of the model; of_parameter: of those of a parameter. own
            (k, k): what the states do to themselves.
    """
    n, m, p, k = model.n, model.m, model.p, len(names)

    def grown(part: Mapping[str, Matrix | None], acting: Acting, own: Matrix) -> dict[str, Matrix]:
        whole = {
            "A": part["A"] or zeros(n, n),
            "B": part["B"] or zeros(n, m),
            "C": part["C"] or zeros(p, n),
            "D": part["D"] or zeros(p, m),
        }
        on_states, on_outputs = acting(whole)
        return {
            "A": beside(whole["A"], on_states) + beside(zeros(k, n), own),
            "B": whole["B"] + zeros(k, m),
            "C": beside(whole["C"], on_outputs),
            "D": whole["D"],
        }

    parameters = []
    for u in model.uncertainties:
        parts = grown({letter: coefficient(u, letter) for letter in "ABCD"}, of_parameter, zeros(k, k))
        # a coefficient of zeros would be refused as one that acts on nothing
        parts = {letter: rows for letter, rows in parts.items() if any(map(any, rows))}
        parameters.append(Uncertainty(u.name, **parts, varying=u.varying, between=u.between))
    return {
        **grown(matrices_at_zero(model), acting, own),
        "uncertainties": parameters,
        "states": (*model.states, *names),
        "faults": faults_beside_states(model.faults, k),
        "disturbance": (model.G + zeros(k, model.g), model.disturbance) if model.g else None,
        "unknown_inputs": (model.F + zeros(k, model.d), model.D_v) if model.d else None,
    }
