"""The pace of this machine: CPU seconds of a fixed task, printed beside how long tests took.

Seconds of a suite say nothing alone: the same first call of `fit`, five programs of 4 060 instructions, took
6.9 CPU s on a quiet machine and 11.3 on a busy one of the same make. Most of what tests take is XLA's
compiler, so that is what is measured, with jax alone. Divide by it before seconds of two days are compared.
"""

import time

import jax
import jax.numpy as jnp

STEPS = 60


def task(x):
    """Return what some products, sines and comparisons make of a matrix."""
    for k in range(STEPS):
        x = jnp.where(x > k, jnp.sin(x) @ jnp.cos(x.T), jnp.sort(x, axis=0) + k)
    return x


def seconds():
    """Return the CPU seconds that the compiler takes for the task."""
    jax.clear_caches()  # else the second time takes none
    lowered = jax.jit(task).lower(jnp.ones((8, 8)))
    start = time.process_time()
    lowered.compile()
    return time.process_time() - start


if __name__ == "__main__":
    best = min(seconds() for _ in range(3))
    print(f"pace of this machine: {best:.2f} CPU s to compile a fixed program")
