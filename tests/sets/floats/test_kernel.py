"""Kernels outside XLA: NumPy evaluates what XLA compiles, primitive by primitive."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from jaxbound.sets.floats.kernel import PRIMITIVES, is_outside_xla, kernel, outside_xla

pytestmark = pytest.mark.compiled

X = np.linspace(-2.5, 3.5, 24).reshape(4, 6)
I = np.array([3, 0, 2, 7, -1], np.int32)
Y, SQUARE = jnp.asarray(X), np.arange(4).reshape(1, 2, 2)


def doubled(n):
    """Double until a number is beyond n: batched, loops that end each at its own time."""
    return lax.while_loop(lambda x: x[0] < n, lambda x: (x[0] * 2, x[1] + jnp.ones(2)), (1, jnp.zeros(2)))


FUNCTIONS = {
    "arithmetic": lambda: (
        X + 2 * X - X / 3,
        -X,
        abs(X),
        X % 1.5,
        jnp.sign(X),
        jnp.floor(X),
        jnp.sqrt(abs(X)),
        X**3,
        X**-2,
    ),
    "integers": lambda: (
        I // 2,
        I % 3,
        -I // 2,
        I << 1,
        I >> 1,
        lax.shift_right_logical(I, 0 * I + 1),
        lax.population_count(I),
    ),
    "functions": lambda: (
        jnp.exp(X),
        jnp.log(abs(X)),
        jnp.sin(X),
        jnp.tanh(X),
        jnp.arctan2(X, X.T.reshape(4, 6)),
        jnp.power(abs(X), 1.7),
    ),
    "logic": lambda: (
        X > 0,
        (X > 0) & (X < 1),
        ~(X > 0),
        X == X,
        jnp.where(X > 1, X, 0),
        lax.select_n(abs(I) % 3, I, 2 * I, 3 * I),
    ),
    "extremes": lambda: (
        jnp.maximum(X, 0),
        jnp.max(X, 0),
        jnp.min(X),
        jnp.argmax(X, 1),
        jnp.argmin(X, 0),
        jnp.clip(X, -1, 1),
    ),
    "missing": lambda: (
        jnp.max(jnp.where(X > 0, jnp.nan, X), 0),
        jnp.minimum(jnp.nan, X),
        jnp.isnan(X),
        jnp.isfinite(X / 0),
    ),
    "sums": lambda: (
        jnp.sum(I),
        jnp.prod(I),
        jnp.cumsum(I),
        lax.cummax(X, 1, reverse=True),
        jnp.any(X > 3),
        jnp.all(X > 3),
    ),
    "shapes": lambda: (
        X.T,
        X.reshape(3, 8),
        X[None],
        X[1:3, ::2],
        X[::-1],
        jnp.concatenate([X, X], 1),
        jnp.stack([X, X]),
        jnp.tile(X, 2),
    ),
    "padding": lambda: (
        jnp.pad(X, ((1, 2), (0, 1))),
        lax.pad(X, 0.0, ((1, -1, 1), (-2, 0, 0))),
        jnp.split(X, 3, 1),
        jnp.repeat(X, 2, 0),
    ),
    "parts": lambda: (
        lax.dynamic_slice(X, (2, 5), (2, 3)),
        lax.dynamic_update_slice(X, X[:2, :2], (3, 4)),
        jnp.roll(X, 2, 1),
    ),
    "gather": lambda: (
        X[I % 4],
        jnp.take(X, I, 1, mode="clip"),
        jnp.take(X, I, 0),
        X[jnp.arange(4), I[:4] % 6],
        jnp.take(X[0], I[0], mode="fill"),
    ),
    "scatter": lambda: (
        Y.at[1].set(0),
        Y.at[I].add(1),
        Y.at[:, 2].max(9),
        Y.at[1:3, 4].mul(2),
        Y.at[I, 0].set(1),
        Y[0].at[I[0]].set(7),
    ),
    "sorts": lambda: (
        jnp.sort(-X, 0),
        jnp.argsort(X % 0.7, 1),
        *lax.sort((I % 2, I), num_keys=2),
        *lax.sort((X % 0.7, X), num_keys=1),
    ),
    "products": lambda: (
        SQUARE[0, 0] @ SQUARE[0, 1],
        jnp.arange(6) @ jnp.arange(12).reshape(6, 2),
        jnp.einsum("bij,bjk->bik", SQUARE, SQUARE),
    ),
    "types": lambda: (
        X.astype(np.float32),
        (1e20 * X).astype(np.int32),
        lax.bitcast_convert_type(X, np.uint64),
        lax.complex(X, X).imag,
    ),
    "loops": lambda: (
        lax.fori_loop(0, 5, lambda i, x: x * i + 1, 2),
        lax.while_loop(lambda x: x[0] < 50, lambda x: (x[0] * 2, x[1] + 1), (1, 0)),
        jax.vmap(doubled)(I),
        lax.scan(lambda c, x: (c + x, c * x), X[0], X),
        lax.scan(lambda c, x: (c - x, c), X[0], X, reverse=True),
    ),
    "branches": lambda: (
        lax.cond(I[0] > 2, lambda x: x + 1, lambda x: x - 1, I),
        lax.switch(I[2], [lambda: 1, lambda: 2, lambda: 3]),
        jax.vmap(lambda i: lax.cond(i > 1, lambda: i, lambda: -i))(I),
    ),
    "calls": lambda: (
        jax.jit(lambda x: jax.jit(lambda y: y + 1)(x) * 2)(I),
        jax.checkpoint(jnp.cumsum)(I),
        jax.nn.relu(X),
        jnp.round(X),
    ),
}
ULPS = {"functions": 1e-14, "arithmetic": 1e-15, "types": 0}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_numpy_says_what_xla_says(name):
    """Everything is an argument's part: nothing is known when the program is written down."""

    def shifted(zero):
        arrays = {key: globals()[key] for key in ("X", "I", "Y", "SQUARE")}
        try:
            for key, x in arrays.items():
                globals()[key] = jnp.asarray(x) + zero.astype(x.dtype)
            return FUNCTIONS[name]()
        finally:
            globals().update(arrays)

    program = kernel(shifted)
    with jax.numpy_rank_promotion("allow"):
        by_xla = program(np.zeros(()))
        with outside_xla():
            by_numpy = program(np.zeros(()))
    for a, b in zip(jax.tree.leaves(by_xla), jax.tree.leaves(by_numpy), strict=True):
        assert isinstance(b, np.ndarray | np.generic) and a.dtype == b.dtype and a.shape == b.shape
        np.testing.assert_allclose(b, np.asarray(a), rtol=ULPS.get(name, 0), atol=0)


def test_static_arguments_trees_and_names_are_those_of_jit():
    @kernel(static_argnums=0, static_argnames="power")
    def program(f, numbers, *more, power=2):
        return {"a": f(numbers["x"]) ** power, "b": sum(more)}

    given = {"x": np.arange(3.0)}
    one = program(jnp.cos, given, 1.0, 2.0, power=3)
    with outside_xla():
        two = program(jnp.cos, given, 1.0, 2.0, power=3)
    np.testing.assert_allclose(two["a"], one["a"], rtol=1e-15)
    assert two["b"] == one["b"] == 3 and program.__name__ == "program" and program._cache_size() == 1


def test_inside_a_trace_a_kernel_is_a_part_of_the_program():
    double = kernel(lambda x: 2 * x)
    with outside_xla():
        assert jax.eval_shape(double, np.zeros(3)).shape == (3,)
        assert not isinstance(jax.grad(lambda x: double(x).sum())(np.ones(3)), np.ndarray)
        assert is_outside_xla()
    assert not is_outside_xla() and isinstance(double(np.ones(3)), jax.Array)


def test_what_numpy_does_not_know_is_named():
    with outside_xla(), pytest.raises(NotImplementedError, match="erf"):
        kernel(jax.scipy.special.erf)(np.ones(3))


def test_nothing_goes_to_xla(rng):
    """With transfers to devices forbidden, programs with loops and calls run."""
    program = kernel(lambda x: lax.fori_loop(0, 3, lambda i, y: jnp.sort(y) + i, x))
    with outside_xla(), jax.transfer_guard("disallow"):
        assert program(rng.normal(size=5)).shape == (5,)


def test_what_stays_as_it_is_is_worked_out_once(monkeypatch):
    """Of loops their constants, too, which an outer loop may change; what nobody needs, never."""
    seen = []
    monkeypatch.setitem(PRIMITIVES, "sin", lambda params: lambda x: [np.sin(x), seen.append(float(x))][0])

    @kernel
    def program(x):
        def inner(y):
            jnp.sin(y + 10)
            return lax.fori_loop(0, 3, lambda k, z: z + jnp.sin(y) * jnp.sin(y), y)

        return lax.scan(lambda y, k: (inner(y) + jnp.sin(x), y), x, np.arange(2.0))

    by_xla = program(2.0)
    with outside_xla():
        by_numpy = program(2.0)
    assert seen == [2.0, 2.0, float(by_xla[1][1])]
    jax.tree.map(np.testing.assert_allclose, by_numpy, by_xla)


def test_zeros_of_both_signs_are_two_numbers():
    with outside_xla():
        quotients = kernel(lambda x: (x / 0.0, x / -0.0, x / np.zeros(())))(1.0)
    assert [float(x) for x in quotients] == [np.inf, -np.inf, np.inf]


def test_a_kernel_of_a_gradient_is_that_gradient():
    square = kernel(lambda x: x * x)
    assert float(kernel(jax.grad(square))(3.0)) == 6.0
