"""The note beside everything that is kept: all that its verdicts depend on besides the recording."""

from jaxbound.consistency.interface import Relations
from jaxbound.models.fingerprint import fingerprint
from jaxbound.sets.floats.threads import has_x64


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
    return {
        "version of jaxbound": __version__,
        "model": fingerprint(relations.model, relations.bounds, relations.made),
        "horizon": str(relations.horizon),
        # verdicts of the two types differ: one does not go on with what the other kept
        "precision": "float64" if has_x64() else "float32",
        **{what: _plain(x) for what, x in also.items()},
    }


def _plain(x: object) -> str:
    """Return a text or a whole number as text, of anything else its fingerprint."""
    if isinstance(x, str | int):
        return str(x)
    return fingerprint(x)
