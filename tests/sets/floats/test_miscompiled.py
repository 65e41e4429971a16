"""What XLA computes wrongly here and there stands nowhere in the package, and no proof waits for it."""

import ast

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_layers import FILES

from jaxbound.sets.inclusion import lifted
from jaxbound.sets.intervals.interval import Interval

COPIED_OVER_ITSELF = "x = base.at[1:].set(base[:-1]).reshape((1, *base.shape))"
OUT_OF_RANGE = "x = jax.lax.dynamic_slice(jnp.roll(x, k), [start], [4])"


def copies_over_itself(node):
    """Whether x.at[i].set(..) or the like takes another part of x than x[i]."""
    if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute)):
        return False
    place = node.func.value
    if not (
        isinstance(place, ast.Subscript)
        and isinstance(place.value, ast.Attribute)
        and place.value.attr == "at"
    ):
        return False
    base, own = ast.dump(place.value.value), ast.dump(place.slice)
    parts = [x for given in node.args for x in ast.walk(given) if isinstance(x, ast.Subscript)]
    return any(ast.dump(x.value) == base and ast.dump(x.slice) != own for x in parts)


def rolls(node):
    """Whether jax rolls an array: what slices the result may read another window."""
    if not (isinstance(node, ast.Attribute) and node.attr == "roll"):
        return False
    return ast.unparse(node.value) != "np"


def found(text):
    return [ast.unparse(x) for x in ast.walk(ast.parse(text)) if copies_over_itself(x) or rolls(x)]


@pytest.mark.parametrize("text", [COPIED_OVER_ITSELF, OUT_OF_RANGE])
def test_a_copy_that_xla_gets_wrong_is_found_in_a_text(text):
    assert found(text) and not found("x = x.at[i].set(x[i] + y[1:])\ny = np.roll(x, 1)")


def test_no_file_copies_as_xla_gets_it_wrong():
    wrong = {name: found(path.read_text()) for name, path in FILES.items()}
    assert not {name: lines for name, lines in wrong.items() if lines}


@pytest.mark.parametrize("shape", [(4, 3), (1024, 8), (8, 1024)])
def test_a_sum_of_terms_with_an_unknown_one_is_unknown_however_many_are_added(shape):
    """The least of many numbers overlooks NaN: a sum with one was taken for one of terms that are not
    negative.
    """
    lo, hi = np.ones(shape), np.full(shape, 2.0)
    lo[1, 1] = hi[2, 2] = np.nan
    summed = jax.jit(lambda x: lifted.summed_along(x, (1,)))
    up, down = (
        summed(Interval(jnp.asarray(lo), jnp.asarray(hi))),
        summed(Interval(jnp.asarray(-hi), jnp.asarray(-lo))),
    )
    assert up.lo[1] == -np.inf and down.hi[1] == np.inf
    assert up.hi[2] == np.inf and down.lo[2] == -np.inf
    assert 0 < up.lo[0] <= shape[1] and -shape[1] <= down.hi[0] < 0
