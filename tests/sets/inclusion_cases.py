"""Functions of known range: each as a user writes it in JAX, and once more for 200-bit balls (python-flint),
with where its extremes are.

`least` and `greatest` list, for each output, a point of the box in exact numbers at which the extreme is
attained.
"""

from dataclasses import dataclass
from typing import Any

import flint
import jax
import jax.numpy as jnp
import numpy as np

arb = flint.arb
PI = "pi"


@dataclass(frozen=True)
class Case:
    name: str
    f: Any
    ball: Any  # of a list of arb, returns a list of arb
    lo: tuple
    hi: tuple
    least: Any
    greatest: Any

    def __str__(self):
        return self.name


def ball(x):
    return arb.pi() / 4 if x == PI else (arb(-1)).exp() if x == "1/e" else arb(x)


def both(*point):
    return [point]


def const(x):
    """Return a constant as JAX computes with it: the nearest float of the working dtype."""
    return arb(float(np.asarray(x, np.float64)))


W1 = np.array([[0.5, 1.25], [2.0, 0.375], [0.75, 0.125]])
B1 = np.array([0.25, -1.0, 0.5])
W2 = np.array([[1.5, 0.5, 0.25], [0.125, 2.0, 1.0]])


def network(z):
    return jnp.asarray(W2, z.dtype) @ jnp.tanh(jnp.asarray(W1, z.dtype) @ z + jnp.asarray(B1, z.dtype))


def network_ball(z):
    hidden = [
        (sum((const(w) * x for w, x in zip(row, z, strict=True)), arb(0)) + const(b)).tanh()
        for row, b in zip(W1, B1, strict=True)
    ]
    return [sum((const(w) * h for w, h in zip(row, hidden, strict=True)), arb(0)) for row in W2]


def tanks(x):
    """Step of two double tanks: outflow by the square root of the level."""
    q = 0.25 * jnp.sqrt(x)
    inflow = jnp.stack([jnp.full((), 0.125, x.dtype), q[0], jnp.full((), 0.0625, x.dtype), q[2]])
    return x + 0.5 * (inflow - q)


def tanks_ball(x):
    q = [v.sqrt() / 4 for v in x]
    return [
        x[0] + (arb(1) / 8 - q[0]) / 2,
        x[1] + (q[0] - q[1]) / 2,
        x[2] + (arb(1) / 16 - q[2]) / 2,
        x[3] + (q[2] - q[3]) / 2,
    ]


def van_der_pol(z):
    x, v = z
    return jnp.stack([x + 0.125 * v, v + 0.125 * ((1 - x**2) * v - x)])


def van_der_pol_ball(z):
    x, v = z
    return [x + v / 8, v + ((1 - x * x) * v - x) / 8]


def scanned(z):
    step = lambda c, _: (c + 0.03125 * (z[1] - c**3), c)
    return jax.lax.scan(step, z[0], None, length=50)[0]


def scanned_ball(z):
    c = z[0]
    for _ in range(50):
        c = c + (z[1] - c * c * c) / 32
    return [c]


def horner(z):
    return jax.lax.fori_loop(
        0, 4, lambda i, c: c * z[0] + jnp.asarray([1.0, -2.0, 0.5, 3.0], z.dtype)[i], jnp.zeros((), z.dtype)
    )


def horner_ball(z):
    c = arb(0)
    for a in (1, -2, arb(1) / 2, 3):
        c = c * z[0] + a
    return [c]


def until_large(z):
    return jax.lax.while_loop(
        lambda s: s[0] < z[0],
        lambda s: (2 * s[0], s[1] + 1.0),
        (jnp.ones((), z.dtype), jnp.zeros((), z.dtype)),
    )[1]


def until_large_ball(z):
    s, n = arb(1), arb(0)
    while s < z[0]:
        s, n = 2 * s, n + 1
    return [n]


A = np.array([[2.0, 1.0], [1.0, 2.0]])
ONE = ((1,), (0,))
CASES = [
    Case("square", lambda z: z[0] ** 2, lambda z: [z[0] ** 2], (-1,), (2,), both(0), both(2)),
    Case(
        "parabola",
        lambda z: z[0] * z[0] - z[0],
        lambda z: [z[0] * (z[0] - 1)],
        (0,),
        (1,),
        both(0.5),
        both(1),
    ),
    Case(
        "logistic map",
        lambda z: z[0] * (1 - z[0]),
        lambda z: [z[0] * (1 - z[0])],
        (0,),
        (1,),
        both(0),
        both(0.5),
    ),
    Case(
        "cubic",
        lambda z: z[0] ** 3 - 3 * z[0],
        lambda z: [z[0] ** 3 - 3 * z[0]],
        (-2,),
        (2,),
        both(1),
        both(-1),
    ),
    Case("reciprocal", lambda z: 1 / z[0], lambda z: [1 / z[0]], (2,), (4,), both(4), both(2)),
    Case(
        "rational",
        lambda z: z[0] / (1 + z[0] ** 2),
        lambda z: [z[0] / (1 + z[0] * z[0])],
        (-2,),
        (2,),
        both(-1),
        both(1),
    ),
    Case("root", lambda z: jnp.sqrt(z[0]), lambda z: [z[0].sqrt()], (0,), (4,), both(0), both(4)),
    Case(
        "bell",
        lambda z: jnp.exp(-(z[0] ** 2)),
        lambda z: [(-z[0] * z[0]).exp()],
        (-1,),
        (2,),
        both(2),
        both(0),
    ),
    Case("sine", lambda z: jnp.sin(z[0]), lambda z: [z[0].sin()], (0,), (1.5,), both(0), both(1.5)),
    Case(
        "sine cosine",
        lambda z: jnp.sin(z[0]) * jnp.cos(z[0]),
        lambda z: [z[0].sin() * z[0].cos()],
        (0,),
        (1,),
        both(0),
        both(PI),
    ),
    Case(
        "entropy",
        lambda z: z[0] * jnp.log(z[0]),
        lambda z: [z[0] * z[0].log()],
        (0.125,),
        (1,),
        both("1/e"),
        both(1),
    ),
    Case(
        "saturation",
        lambda z: jnp.tanh(z[0]) - z[0] / 2,
        lambda z: [z[0].tanh() - z[0] / 2],
        (0,),
        (0.5,),
        both(0),
        both(0.5),
    ),
    Case(
        "angle",
        lambda z: jnp.arctan2(z[0], z[1]),
        lambda z: [arb.atan2(z[0], z[1])],
        (1, 1),
        (2, 2),
        both(1, 2),
        both(2, 1),
    ),
    Case(
        "rectifier", lambda z: abs(z[0]) - z[0], lambda z: [abs(z[0]) - z[0]], (-1,), (2,), both(1), both(-1)
    ),
    Case(
        "spread",
        lambda z: jnp.max(z) - jnp.min(z),
        lambda z: [max(z) - min(z)],
        (0, 2),
        (1, 3),
        both(1, 2),
        both(0, 3),
    ),
    Case(
        "where",
        lambda z: jnp.where(z[0] > 0, z[0], 2 * z[0]),
        lambda z: [z[0] if z[0] > 0 else 2 * z[0]],
        (-1,),
        (1,),
        both(-1),
        both(1),
    ),
    Case(
        "product", lambda z: z[0] * z[1], lambda z: [z[0] * z[1]], (-1, -3), (2, 1), both(2, -3), both(-1, -3)
    ),
    Case(
        "figure 1",
        lambda z: jnp.stack([2 * z[0] ** 2 + z[1], z[0] - z[1]]),
        lambda z: [2 * z[0] ** 2 + z[1], z[0] - z[1]],
        (-1, 1),
        (2, 3),
        [(0, 1), (-1, 3)],
        [(2, 3), (2, 1)],
    ),
    Case(
        "van der pol step",
        van_der_pol,
        van_der_pol_ball,
        (1, -0.5),
        (1.25, 0.5),
        [(1, -0.5), (1, -0.5)],
        [(1.25, 0.5), (1, 0.5)],
    ),
    Case("tanh network", network, network_ball, (-1, -0.5), (0.5, 1), [(-1, -0.5)] * 2, [(0.5, 1)] * 2),
    Case(
        "two double tanks",
        tanks,
        tanks_ball,
        (1, 1, 0.5, 0.25),
        (2, 1.5, 1, 1),
        [(1, 1, 0.5, 0.25)] * 4,
        [(2, 1.5, 1, 1)] * 4,
    ),
    Case(
        "scan of 50 steps",
        scanned,
        scanned_ball,
        (0.5, 0.25),
        (0.625, 0.5),
        both(0.5, 0.25),
        both(0.625, 0.5),
    ),
    Case("horner", horner, horner_ball, (2,), (3,), both(2), both(3)),
    Case(
        "quadratic form",
        lambda z: z @ jnp.asarray(A, z.dtype) @ z,
        lambda z: [2 * (z[0] ** 2 + z[0] * z[1] + z[1] ** 2)],
        (-1, -1),
        (1, 1),
        both(0, 0),
        both(1, 1),
    ),
    Case(
        "norm",
        lambda z: jnp.linalg.norm(z),
        lambda z: [(z[0] ** 2 + z[1] ** 2).sqrt()],
        (3, 4),
        (3.5, 4.5),
        both(3, 4),
        both(3.5, 4.5),
    ),
    Case(
        "log sum exp",
        lambda z: jax.nn.logsumexp(z),
        lambda z: [(z[0].exp() + z[1].exp()).log()],
        (0, 0),
        (1, 1),
        both(0, 0),
        both(1, 1),
    ),
    Case(
        "power", lambda z: z[0] ** 0.375, lambda z: [z[0] ** (arb(3) / 8)], (0.5,), (2,), both(0.5), both(2)
    ),
    Case(
        "sigmoid",
        lambda z: jax.nn.sigmoid(z[0]),
        lambda z: [1 / (1 + (-z[0]).exp())],
        (-1,),
        (1,),
        both(-1),
        both(1),
    ),
    Case(
        "small differences",
        lambda z: jnp.stack([jnp.expm1(z[0]), jnp.log1p(z[0])]),
        lambda z: [z[0].expm1(), z[0].log1p()],
        (0,),
        (2**-30,),
        [(0,)] * 2,
        [(2**-30,)] * 2,
    ),
    Case(
        "rosenbrock",
        lambda z: (1 - z[0]) ** 2 + 100 * (z[1] - z[0] ** 2) ** 2,
        lambda z: [(1 - z[0]) ** 2 + 100 * (z[1] - z[0] ** 2) ** 2],
        (-1, -1),
        (1, 1),
        both(1, 1),
        both(-1, -1),
    ),
    Case(
        "clip",
        lambda z: jnp.clip(z[0], 0, 1),
        lambda z: [min(max(z[0], arb(0)), arb(1))],
        (-1,),
        (2,),
        both(-1),
        both(2),
    ),
    Case(
        "branch",
        lambda z: jax.lax.cond(z[0] < 0, lambda x: -x, lambda x: 2 * x, z[0]),
        lambda z: [-z[0] if z[0] < 0 else 2 * z[0]],
        (-1,),
        (1,),
        both(0),
        both(1),
    ),
    Case("while", until_large, until_large_ball, (1.5,), (5,), both(1.5), both(5)),
    Case(
        "remainder",
        lambda z: z[0] % 1.0,
        lambda z: [z[0] - z[0].floor()],
        (-0.75,),
        (0.5,),
        both(0),
        both(-0.25 / 2),
    ),
    Case(
        "running sum",
        lambda z: jnp.cumsum(z)[::-1][:2],
        lambda z: [z[0] + z[1] + z[2], z[0] + z[1]],
        (-1, 0, 1),
        (1, 2, 3),
        [(-1, 0, 1)] * 2,
        [(1, 2, 3)] * 2,
    ),
    Case(
        "scatter and gather",
        lambda z: z.at[jnp.array([0, 0])].add(z[1]).at[1].set(3.0)[jnp.array([0, 1])],
        lambda z: [z[0] + 2 * z[1], arb(3)],
        (-1, 1),
        (1, 2),
        [(-1, 1)] * 2,
        [(1, 2)] * 2,
    ),
]


def values_at(case, points):
    """Return the balls of f at a list of points, as [point][output]."""
    out = []
    for point in points:
        out.append(case.ball([ball(x) for x in point]))
    return out


def misses(enclosed, value):
    """True if a ball lies outside [lo, hi] beyond doubt."""
    lo, hi = enclosed
    return value.upper() < arb(float(lo)) or value.lower() > arb(float(hi))
