"""What verdicts depend on besides the recording: the note beside everything that is kept, by which it is
known again.
"""

import jax
import numpy as np

from jaxbound.consistency.interface import Relations
from jaxbound.models.fingerprint import fingerprint

__all__ = ["identity"]


def identity(relations: Relations, **also: object) -> dict[str, str]:
    """Return {what: text} of all that the verdicts of relations depend on besides the recording, fit for
    JSON.

    Args:
        relations: of a model, or an observer, which say by .made how they came from it. also: {what: value}
            more, as `fingerprint` takes it; texts and whole numbers are kept as they are.

    Raises:
        TypeError: a user's own residual, or observer.
    """
    from jaxbound import __version__

    if relations.made is None:
        raise TypeError(
            f"nothing tells one {type(relations).__name__} from another: what is found with it cannot be "
            f"kept and taken up"
        )
    plain = lambda x: str(x) if isinstance(x, str | int) else fingerprint(x)
    return {
        "version of jaxbound": __version__,
        "model": fingerprint(relations.model, relations.bounds, relations.made),
        "horizon": str(relations.horizon),
        "precision": str(jax.dtypes.canonicalize_dtype(np.float64)),
        **{what: plain(x) for what, x in also.items()},
    }
