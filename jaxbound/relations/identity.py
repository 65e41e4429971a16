"""What verdicts depend on besides the recording: the note beside everything that is kept, by which it is known again."""

import jax
import numpy as np

from jaxbound.models.fingerprint import fingerprint

__all__ = ["differences", "identity", "refuse_other"]


def identity(relations, **also):
    """Return {what: text} of all that the verdicts of relations depend on besides the recording, fit for JSON.

    Args:
        relations: from `parity_relations`. also: {what: value} more, as `fingerprint` takes it; texts and
            whole numbers are kept as they are.
    """
    from jaxbound import __version__

    made = relations.form, getattr(relations, "order", None)  # the rest of them follows from the model and the horizon
    plain = lambda x: str(x) if isinstance(x, str | int) else fingerprint(x)
    return {
        "version of jaxbound": __version__,
        "model": fingerprint(relations.model, relations.bounds, made),
        "horizon": str(relations.horizon),
        "precision": str(jax.dtypes.canonicalize_dtype(np.float64)),
        **{what: plain(x) for what, x in also.items()},
    }


def differences(before, now):
    """Return what two identities differ in, as text; empty where they are the same. A note that holds no identity differs in all."""
    before = before if isinstance(before, dict) else {}
    return " and ".join(what for what in now if before.get(what) != now[what])


def refuse_other(path, before, now):
    """Raise ValueError if what is kept in a file is of another identity than what is to go on there."""
    if changed := differences(before, now):
        raise ValueError(f"{path} is of another {changed}: choose another folder, or delete it to begin anew")
