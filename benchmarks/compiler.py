"""What the compiler does to arithmetic, copies and speed: the facts that the design rests on, each measured.

Run: python -m benchmarks.compiler [--windows 1000000]

Prints a line a fact: its name, as docs/design.md calls it, the measured value, and the sentence that follows
from it. Nothing here is asserted: another version of jax or another processor may well print other values.
"""

import sys
import threading
import time
from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.timing import machine, option

FACTS = {}
SAMPLES = 4096


def fact(name):
    """Add a function to FACTS: it returns (value, sentence)."""

    def add(measure):
        FACTS[name] = measure
        return measure

    return add


def numbers(count=SAMPLES, lo=0.5, hi=2.0, seed=0):
    """Return random numbers of no special form."""
    return np.random.default_rng(seed).uniform(lo, hi, count)


def ulps(computed, exact):
    """Return the largest error of computed numbers against exact fractions, in units in the last place."""
    errors = [
        abs(Fraction(float(x)) - y) / Fraction(float(np.spacing(abs(float(y)))))
        for x, y in zip(np.asarray(computed), exact, strict=True)
    ]
    return float(max(errors))


def residual(x, y, z):
    """Return x y - z: exactly 0 if z is the rounded product and the product here is rounded too."""
    return x * y - z


@fact("contraction")
def contraction():
    x, y = numbers(), numbers(seed=1)
    changed = np.count_nonzero(np.asarray(jax.jit(residual)(x, y, x * y)))
    return f"{changed} of {SAMPLES}", "products that a compiled x y - z does not round: it is one FMA"


@fact("barrier")
def barrier():
    def kept_apart(x, y, z):
        return jax.lax.optimization_barrier(x * y) - z

    x, y = numbers(), numbers(seed=1)
    changed = np.count_nonzero(np.asarray(jax.jit(kept_apart)(x, y, x * y)))
    return f"{changed} of {SAMPLES}", "the same behind optimization_barrier, which is dropped before fusion"


@fact("loop carry")
def loop_carry():
    def carried(x, y, z):
        product = jax.lax.fori_loop(0, 1, lambda _, carry: carry[0] * carry[1] + carry * 0, jnp.stack([x, y]))
        return product[0] - z

    x, y = numbers(), numbers(seed=1)
    changed = np.count_nonzero(np.asarray(jax.jit(carried)(x, y, x * y)))
    return f"{changed} of {SAMPLES}", "the same with the product carried by a loop: it is rounded first"


@fact("reciprocal")
def reciprocal():
    x = numbers()
    exact = [Fraction(float(a)) / Fraction(0.7) for a in x]
    error = ulps(jax.jit(lambda a: a / 0.7)(x), exact)
    return f"{error:.3f} ulp", "error of x / 0.7: divisions by one number become products (0.5 is correct)"


@fact("quotients")
def quotients():
    x, y, z = numbers(), numbers(seed=1), numbers(seed=2)
    exact = [
        Fraction(float(a)) / Fraction(float(b)) / Fraction(float(c)) for a, b, c in zip(x, y, z, strict=True)
    ]
    error = ulps(jax.jit(lambda a, b, c: a / b / c)(x, y, z), exact)
    return f"{error:.3f} ulp", "error of (x / y) / z, which may become x / (y z)"


@fact("subnormal numbers")
def subnormal_numbers():
    half = jax.jit(lambda a: a * 0.5)(np.full(8, np.finfo(float).tiny))
    return f"{float(half[0]):g}", "half of the smallest normal number: what underflows is flushed to zero"


@fact("copies")
def copies():
    def shifted(base):
        return base.at[1:].set(base[:-1]).reshape((1, *base.shape))

    base = np.arange(128.0).reshape(4, 32)
    right = base.copy()
    right[1:] = base[:-1]
    wrong = np.count_nonzero(np.asarray(jax.jit(shifted)(base))[0] != right)
    return f"{wrong} of {base.size}", "numbers that a compiled copy of an array onto itself gets wrong"


@fact("slices")
def slices():
    def window(x, k, start):
        return jax.lax.dynamic_slice(jnp.roll(x, k), [start], [4])

    x = np.arange(16.0)
    wrong = sum(
        not np.array_equal(jax.jit(window)(x, 3, start), window(x, 3, start)) for start in range(-4, 20)
    )
    return f"{wrong} of 24", "starts from which a compiled slice of a rolled array reads another window"


@fact("largest")
def largest():
    lost = []
    for count in (16, 256, 4096, 65536):
        x = numbers(count)
        x[count // 2] = np.nan
        if not np.isnan(float(jax.jit(jnp.max)(x))):
            lost.append(str(count))
    return " ".join(lost) or "none", "lengths of arrays whose compiled maximum does not show a NaN"


@fact("comparison")
def comparison():
    said = bool(jax.jit(lambda a: jnp.abs(a) >= 0)(np.nan))
    return str(said), "the compiled value of |NaN| >= 0"


@fact("threads")
def threads():
    seen = []
    with jax.enable_x64(not jax.config.jax_enable_x64):
        inside = jax.config.jax_enable_x64
        worker = threading.Thread(target=lambda: seen.append(jax.config.jax_enable_x64))
        worker.start()
        worker.join()
    return f"{inside} and {seen[0]}", "jax_enable_x64 in a context, and in a thread started there"


def seconds(run, *arguments, repeats=5):
    """Return the least seconds of a compiled call, without those of compiling."""
    jax.block_until_ready(run(*arguments))
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        jax.block_until_ready(run(*arguments))
        times.append(time.perf_counter() - start)
    return min(times)


@fact("small matrices")
def small_matrices():
    count = int(option("--windows", 1_000_000))
    M = np.random.default_rng(0).normal(size=(3, 4))
    x = np.random.default_rng(1).normal(size=(4, count))

    def unrolled(x):
        return jnp.stack([sum(M[i, j] * x[j] for j in range(4)) for i in range(3)])

    dot = seconds(jax.jit(jax.vmap(lambda M, v: M @ v, (None, 1), 1)), M, x)
    return f"{dot / seconds(jax.jit(unrolled), x):.1f}", "time of a vmapped 3 x 4 product over unrolled sums"


@fact("selection")
def selection():
    x, y = numbers(1_000_000), numbers(1_000_000, seed=1)
    chosen = seconds(jax.jit(lambda a, b: jnp.where(a > b, a, b) * a), x, y)
    return f"{chosen / seconds(jax.jit(lambda a, b: jnp.maximum(a, b) * a), x, y):.1f}", (
        "time of where(a > b, a, b) over maximum(a, b)"
    )


@fact("vectors")
def vectors():
    y = numbers(2 * 2**16).astype(np.float32).reshape(-1, 2)

    def chain(y):
        a, b = y[:, 0], y[:, 1]
        for k in range(20):
            a, b = jnp.abs(a * b - k), jnp.abs(b + a * 0.5)
        return a + b

    wide = jax.jit(chain, compiler_options={"xla_cpu_prefer_vector_width": 512})
    return f"{seconds(jax.jit(chain), y, repeats=50) / seconds(wide, y, repeats=50):.1f}", (
        "time of interleaved float32 samples with vectors of 256 bits over 512, where there are such"
    )


@fact("compiling")
def compiling():
    took = []
    for operations in (200, 800):

        def chain(x, operations=operations):
            for k in range(operations):
                x = x * (1 + k / 1024) + x[..., ::-1] * 0.5
            return x

        start = time.perf_counter()
        jax.jit(chain).lower(np.ones(64)).compile()
        took.append(time.perf_counter() - start)
    return (
        f"{took[0]:.2f} s, {took[1]:.2f} s",
        "compiling 200 and 800 unrolled steps: more than in proportion",
    )


def main():
    """Print the machine and every fact."""
    jax.config.update("jax_enable_x64", True)
    print(machine())
    for name, measure in FACTS.items():
        value, sentence = measure()
        print(f"{name:18}{value:>18}   {sentence}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
