"""The checker as tests of certificates call it: on the model and the samples that the certificate itself
shows, which may then be of another plant or another day.
"""

from jaxbound.certificates.checker.claim import (
    BOUNDS,
    DOUBLE,
    PRECISIONS,
    SINGLE,
    STATED,
    claim_of,
    numbers,
)
from jaxbound.certificates.checker.proof import confirm as confirm_claim
from jaxbound.certificates.checker.sets import decide

__all__ = ["confirm", "numbers"]


def confirm(document):
    """Raise an exception unless a certificate proves what it says of what it shows."""
    if "question" in document:
        return decide(document)
    return confirm_claim(document, document["names"], _shown(numbers(document["numbers"], [])))


def _shown(c):
    """Return the claim that the shown model and samples make."""
    model = {name: c[name] for name in (*STATED, *BOUNDS)}
    model |= {"averages": c.get("averages", []), "uncertainties": c.get("uncertainties", [])}
    precision = SINGLE if c["floor"] == PRECISIONS[SINGLE][1] else DOUBLE
    model["constant"], every_y = "constant" in c, c.get("all_y", c["y"])
    return claim_of(model, c["u"], every_y, precision, c.get("lags"), c.get("first_state"), c.get("factors"))
