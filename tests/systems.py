"""The models that many tests use."""

import jaxbound as jb

PAPER = dict(
    A=[[0.8, 1], [0, 0.2]],
    B=[[0], [1]],
    C=[[1, 0], [1, 1]],
    dt=0.01,
    tolerance=[0.02, 0.1],
    noise=[0.1, 0.01],
)


def paper(**changes):
    """Return the system of Adrot 2000, section 5."""
    return jb.LinearSystem(**{**PAPER, **changes})
