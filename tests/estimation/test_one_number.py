"""In the kernels that prove, as they are compiled, a number that is searched for without a claim is stored
before it is used.
"""

import re

import jax
import numpy as np
import pytest
from observer_case import PLANT

import jaxbound as jb
from jaxbound.estimation import zonotope_steps
from jaxbound.sets.linear_systems import hull


def stored_quotients(text):
    """Return of a compiled text (quotients that end a loop which stands in one place, all others of
    `stored`): lines.
    """
    ends, within, loop = [], [], ""
    for line in text.splitlines():
        if line.endswith("{"):
            loop = line.split()[0]
        if " divide(" in line and "stored/div" in line:
            once = len(re.findall(rf"calls={re.escape(loop)}\b", text)) <= 1
            (ends if line.strip().startswith("ROOT ") and once else within).append(line)
    return ends, within


def test_a_quotient_within_a_loop_is_found():
    f = lambda a: a / (1 + jax.numpy.abs(a)) + 1
    with jax.named_scope("stored"):
        text = jax.jit(f).lower(np.ones(16)).compile().as_text().replace("jit(<lambda>)/", "stored/")
    assert len(stored_quotients(text)[1]) == 1


def compiled(monkeypatch, module, name, call):
    """Return the compiled text of a kernel of a module as a call uses it."""
    kernel, given = getattr(module, name), []
    jitted = kernel if hasattr(kernel, "lower") else jax.jit(kernel, static_argnames="steps")
    monkeypatch.setattr(
        module, name, lambda *args, **more: given.append((args, more)) or kernel(*args, **more)
    )
    call()
    args, more = given[0]
    return jitted.lower(*args, **more).compile().as_text()


def observed(method):
    """Of a size that tests of observers compile."""
    return lambda: jb.observe(PLANT, np.zeros((16, 1)), np.zeros((16, 1)), method=method)


def tightened():
    M = jb.Interval(
        np.full((3, 2, 64), 0.5) + np.arange(6.0).reshape(3, 2, 1),
        np.full((3, 2, 64), 0.6) + np.arange(6.0).reshape(3, 2, 1),
    )
    h, box = (
        jb.Interval(np.ones((3, 64)), np.full((3, 64), 2.0)),
        jb.Interval(-np.ones((2, 64)), np.ones((2, 64))),
    )
    hull.tighten(M, h, box, steps=20)


@pytest.mark.parametrize(
    "module, name, call, least",
    [
        (zonotope_steps, "follow_lanes", observed("zonotope"), 1),
        pytest.param(hull, "tighten", tightened, 5, marks=pytest.mark.long),
    ],
    ids=["zonotope", "hull"],
)
def test_what_is_searched_for_is_stored_once_in_the_compiled_kernel(monkeypatch, module, name, call, least):
    text = compiled(monkeypatch, module, name, call)
    ends, others = stored_quotients(text)
    assert len(ends) >= least and not others
