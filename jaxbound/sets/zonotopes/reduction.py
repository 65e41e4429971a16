"""Fewer generators: sets around zonotopes and constrained zonotopes that cost less to carry on.

All methods keep some generators and put the others into a box, or a turned box, around them. Source: Girard
2005 (largest difference of the 1-norm and the largest entry stay); Combastel 2003 (longest stay); Kopetzki,
Schuermann, Althoff 2017 (PCA: the box lies along the principal axes); Scott et al. 2016, section 4.3
(constraints: the lifted zonotope is reduced).
"""

from functools import partial

import jax
import jax.numpy as jnp

from jaxbound.sets.floats import rounding
from jaxbound.sets.zonotopes.constrained import AnySet, parts
from jaxbound.sets.zonotopes.maps import dimension, product, reach, up, weighed, whole

METHODS = ("girard", "combastel", "pca", "last")


def reduce_order(S: AnySet, order: float, method: str = "girard") -> AnySet:
    """Return a set around S with at most `order` generators a coordinate (and a constraint, if it has some).

    Args:
        S: a Zonotope or ConstrainedZonotope; order: at least 1 ("pca": at least 2); a set with no more
            generators comes back as it is.
        method: "girard", "combastel", "pca"; "last" boxes the last generators without sorting, for scans: put
            new ones first.

    Returns:
        A set of the same kind with int(order * n) generators, n counting coordinates and constraints.

    Encloses: S.

    Raises:
        ValueError: an unknown method, an order below its least.

    Example:
        >>> from jaxbound import sets
        >>> Z = sets.zonotope([0.0, 0.0], [[2.0, 0.0, 0.1, 0.2], [0.0, 1.0, 0.1, -0.1]])
        >>> sets.reduce_order(Z, 1).generators.round(3)
        Array([[2.3, 0. ],
               [0. , 1.2]], dtype=...)
    """
    if method not in METHODS:
        raise ValueError(f"method must be one of {', '.join(METHODS)}, not {method!r}")
    least = 2 if method == "pca" else 1
    if not order >= least:
        raise ValueError(f"the order must be at least {least} with {method!r}: it is {order}")
    n, (_, G, _, b) = dimension(S), parts(S)
    wanted = int(order * (n + len(b)))
    return S if G.shape[1] <= wanted else _reduced(S, wanted, method)


@partial(jax.jit, static_argnums=(1, 2))
def _reduced(S: AnySet, wanted: int, method: str) -> AnySet:
    (S,) = rounding.one_dtype(S)
    c, G, A, b = parts(S)
    lifted = jnp.concatenate([G, A])
    keep = wanted - (2 if method == "pca" else 1) * len(lifted)
    if method != "last":
        size = jnp.abs(lifted)
        key = jnp.sum(size, 0) - jnp.max(size, 0) if method == "girard" else jnp.sum(size * size, 0)
        lifted = lifted[:, jnp.argsort(-key)]
    kept, rest = lifted[:, :keep], lifted[:, keep:]
    H = jnp.concatenate([kept, *(_turned_box(rest) if method == "pca" else [jnp.diag(_sums(rest))])], 1)
    return whole(c, H[: len(c)], H[len(c) :], b)


def _sums(G: jax.Array) -> jax.Array:
    """Return (n,) upper bounds of sum_j |G_ij|."""
    return reach(jnp.zeros_like(G[:, 0]), G)


def _turned_box(R: jax.Array) -> list[jax.Array]:
    """Return [U diag(r), diag(e)] around the generators R: R x = U (V R x) + (I - U V) R x for any U and V,
    here V = U' nearly U^-1.
    """
    U = jnp.linalg.eigh(product(R, R.T))[1]
    U = jnp.where(jnp.isfinite(U), U, 0)
    n, far = len(R), _sums(R)
    gamma, least = rounding.product_error(n, R.dtype)
    floor = least * (R.shape[1] + n) * n * (1 + jnp.max(jnp.abs(R))) * (1 + jnp.max(jnp.abs(U)))
    bound = lambda weight, x: up(weighed(weight, x) + floor)
    r = up(_sums(product(U.T, R)) + bound(gamma * jnp.abs(U.T), far))
    rest = jnp.abs(jnp.eye(n, dtype=R.dtype) - product(U, U.T)) + gamma * (
        jnp.eye(n, dtype=R.dtype) + product(jnp.abs(U), jnp.abs(U.T))
    )
    e = up(bound(up(rest + floor), far) + bound(4 * rounding.unit(R.dtype) * jnp.abs(U), r))
    return [U * r[None], jnp.diag(e)]
