"""Every case of the ITF1788 suite whose operation is implemented. Source: oheim/ITF1788, in the shared
folder.

Decorations are ignored, cases on NaI (there is none here) left out. The suite gives the tightest results,
some of them with subnormal bounds. Compiled code reads a subnormal as 0, so the factory moves such bounds
outward, and outward rounding adds two smallest normal numbers. What is allowed for subnormals is therefore
only this: a bound or number may be off, outward, by three smallest normal numbers. Soundness, emptiness and
the truth of relations admit no exception, subnormals or not.
"""

import importlib.util
import math
import sys
from collections import Counter
from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from elementary_cases import COUNT, box

from jaxbound import sets
from jaxbound.sets import Interval, interval
from jaxbound.sets.floats import rounding

TINY, TINY_32 = (float(np.finfo(dtype).tiny) for dtype in (np.float64, np.float32))
ELEMENTARY = [
    "exp",
    "exp2",
    "exp10",
    "log",
    "log2",
    "log10",
    "sin",
    "cos",
    "tan",
    "asin",
    "acos",
    "atan",
    "atan2",
    "sinh",
    "cosh",
    "tanh",
    "asinh",
    "acosh",
    "atanh",
]
SETS = {  # ITF1788's name: (ours, largest distance from the tightest bound in ulps)
    "neg": ("neg", 0),
    "abs": ("abs", 0),
    "min": ("min", 0),
    "max": ("max", 0),
    "convexHull": ("hull", 0),
    "intersection": ("intersection", 0),
    "add": ("add", 5),
    "sub": ("sub", 5),
    "mul": ("mul", 5),
    "div": ("div", 5),
    "recip": ("recip", 5),
    "sqr": ("sqr", 5),
    "sqrt": ("sqrt", 5),
    "fma": ("fma", 5),
    **{op: (op, 8) for op in ELEMENTARY},
}
RUNS = [
    pytest.param(
        op, mode, marks=[pytest.mark.long] if mode == "vmap" or (mode == "jit" and op in ELEMENTARY) else []
    )
    for mode in ("eager", "jit", "vmap")
    for op in SETS
]
POWERS = "pown"
RELATIONS = ["equal", "subset", "interior", "disjoint", "less", "precedes", "isEmpty", "isEntire"]
NUMBERS = {
    "mid": 0,
    "mag": 0,
    "mig": 0,
    "inf": 0,
    "sup": 0,
    "rad": 2,
    "wid": 2,
}  # largest distance in ulps, upward
COUNTS = {
    "abs": 20,
    "acos": 23,
    "acosh": 19,
    "add": 36,
    "asin": 23,
    "asinh": 16,
    "atan": 15,
    "atan2": 376,
    "atanh": 24,
    "convexHull": 10,
    "cos": 55,
    "cosh": 16,
    "disjoint": 20,
    "div": 346,
    "equal": 30,
    "exp": 21,
    "exp10": 21,
    "exp2": 20,
    "fma": 567,
    "inf": 28,
    "interior": 32,
    "intersection": 10,
    "isEmpty": 28,
    "isEntire": 30,
    "less": 52,
    "log": 24,
    "log10": 22,
    "log2": 23,
    "mag": 16,
    "max": 19,
    "mid": 24,
    "midRad": 24,
    "mig": 22,
    "min": 19,
    "mul": 121,
    "neg": 14,
    "pown": 174,
    "precedes": 42,
    "rad": 18,
    "recip": 26,
    "sin": 55,
    "sinh": 16,
    "sqr": 16,
    "sqrt": 17,
    "sub": 36,
    "subset": 53,
    "sup": 28,
    "tan": 66,
    "tanh": 16,
    "wid": 16,
}


@pytest.fixture(scope="module")
def itl(shared):
    """Return the suite's own reader."""
    spec = importlib.util.spec_from_file_location("itl_parse", shared("external/itf1788/itl_parse.py"))
    module = sys.modules["itl_parse"] = importlib.util.module_from_spec(
        spec
    )  # its dataclasses look their module up
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def cases(itl, shared):
    """Return the cases without NaI, by operation."""
    is_nai = lambda v: isinstance(v, itl.Interval) and v.nai
    by_op = {}
    for case in itl.read_tree(shared("external/itf1788")):
        if not any(map(is_nai, (*case.inputs, *case.expected))):
            by_op.setdefault(case.op, []).append(case)
    return by_op


def batch(cases, k, build=interval):
    """Return the k-th arguments of cases as one Interval, repeated up to one length for all."""
    ends = [np.array([float(getattr(c.inputs[k], end)) for c in cases]) for end in ("lo", "hi")]
    return (
        box(*ends)
        if build is interval
        else Interval(*(jnp.asarray(np.resize(end, max(COUNT, len(end)))) for end in ends))
    )


def results(cases, f, arguments, mode="jit", build=interval):
    run = {"eager": f, "jit": jax.jit(f), "vmap": jax.jit(jax.vmap(f))}[mode]
    z = run(*(batch(cases, k, build) for k in range(arguments)))
    return jax.tree.map(lambda v: v[: len(cases)], z)


built_both_ways = pytest.mark.parametrize("build", [interval, Interval], ids=["factory", "class"])


def unsound(cases, z):
    """Return the cases whose tightest result ours does not contain, or whose emptiness differs."""
    rows = zip(cases, z.lo.tolist(), z.hi.tolist(), strict=True)
    return [
        c
        for c, lo, hi in rows
        if (lo > hi) != c.expected[0].empty or not (lo <= c.expected[0].lo and c.expected[0].hi <= hi)
    ]


def widest(itl, cases, z):
    """Return the largest distance in ulps from the tightest bounds, bounds within three smallest normal
    numbers left out.
    """
    worst = 0
    for c, lo, hi in zip(cases, z.lo.tolist(), z.hi.tolist(), strict=True):
        if not c.expected[0].empty:
            for got, want in ((lo, float(c.expected[0].lo)), (hi, float(c.expected[0].hi))):
                if got != want and abs(got - want) > 3 * TINY:
                    worst = max(worst, abs(itl.ulps(got, want)))
    return worst


@built_both_ways
@pytest.mark.parametrize(("op", "mode"), RUNS)
def test_the_tightest_result_is_contained_and_within_the_stated_ulps(itl, cases, op, mode, build):
    ours, ulps = SETS[op]
    some = cases[op]
    z = results(some, getattr(sets, ours), len(some[0].inputs), mode, build)
    worst = widest(itl, some, z)
    print(f"{op}: {len(some)} cases, at most {worst} ulps wide of the tightest bound")
    assert not unsound(some, z) and worst <= ulps


def in_float32(cases, arguments):
    """Return the arguments as float32 Intervals rounded outward, repeated up to one length for all, and which
    cases fit float32 exactly.
    """
    ends = [
        [np.array([float(getattr(c.inputs[k], end)) for c in cases]) for end in ("lo", "hi")]
        for k in range(arguments)
    ]
    outward = [[rounding.round_down(lo, np.float32), rounding.round_up(hi, np.float32)] for lo, hi in ends]
    fits = np.all(
        [
            (a == b) & ((abs(b) >= TINY_32) | (b == 0))
            for x, y in zip(ends, outward, strict=True)
            for a, b in zip(x, y, strict=True)
        ],
        0,
    )
    return [interval(*(np.resize(end, COUNT) for end in x)) for x in outward], fits


IN_FLOAT32 = [
    pytest.param(op, marks=[] if op in ("add", "mul", "div", "sqr", "exp") else pytest.mark.long)
    for op in SETS
]


@pytest.mark.parametrize("op", IN_FLOAT32)
def test_float32_contains_the_tightest_result_and_is_as_tight_where_the_arguments_fit(cases, op):
    """The suite's float64 bounds say which float32 bounds are the tightest: the same ones, rounded
    outward.
    """
    ours, ulps = SETS[op]
    some = cases[op]
    arguments, fits = in_float32(some, len(some[0].inputs))
    z = jax.jit(getattr(sets, ours))(*arguments)
    worst, tight = 0.0, []
    for c, lo, hi, fit in zip(some, z.lo.tolist(), z.hi.tolist(), fits.tolist(), strict=False):
        want = c.expected[0]
        assert want.empty or lo <= want.lo and want.hi <= hi, c
        assert not fit or (lo > hi) == want.empty, c
        if fit and not want.empty:
            for got, bound, directed in (
                (lo, want.lo, rounding.round_down),
                (hi, want.hi, rounding.round_up),
            ):
                tightest = directed(np.array(float(bound)), np.float32)[()]
                off = abs(got - float(tightest)) if got != tightest else 0.0
                tight.append(off)
                worst = max(worst, off / float(np.spacing(abs(tightest))) if off > 3 * TINY_32 else 0.0)
    print(
        f"{op}: {len(some)} cases, {int(fits.sum())} fit float32, at most {worst:.0f} ulps wide of the "
        f"tightest bound"
    )
    assert z.lo.dtype == np.float32 and tight and worst <= ulps


def by_exponent(some):
    return {n: [c for c in some if c.inputs[1] == n] for n in sorted({int(c.inputs[1]) for c in some})}


@built_both_ways
@pytest.mark.parametrize(
    "mode", ["eager", *(pytest.param(mode, marks=pytest.mark.long) for mode in ("jit", "vmap"))]
)
def test_tightest_powers_are_contained_and_within_eight_ulps(itl, cases, mode, build):
    for n, some in by_exponent(cases[POWERS]).items():
        z = results(some, lambda x, n=n: sets.pown(x, n), 1, mode, build)
        assert not unsound(some, z)
        worst = widest(itl, some, z)
        print(f"pown {n}: {len(some)} cases, at most {worst} ulps wide of the tightest bound")
        assert worst <= (8 if n < 0 else 5 if n > 1 else 0)


@built_both_ways
@pytest.mark.parametrize("op", RELATIONS)
def test_relations_agree_subnormals_included(cases, op, build):
    ours = {
        "isEmpty": lambda x: x.is_empty,
        "isEntire": lambda x: sets.equal(x, interval(-np.inf, np.inf)),
    }.get(op) or getattr(sets, op)
    some = cases[op]
    got = results(some, ours, len(some[0].inputs), build=build).tolist()
    assert got == [c.expected[0] for c in some] and {True, False} == set(got)


@built_both_ways
@pytest.mark.parametrize("op", NUMBERS)
def test_numbers_agree_within_the_stated_ulps_upward(itl, cases, op, build):
    ours = {"inf": lambda x: x.lo, "sup": lambda x: x.hi}.get(op) or getattr(sets, op)
    some = cases[op]
    for c, got in zip(some, results(some, ours, 1, build=build).tolist(), strict=True):
        want = float(c.expected[0])
        if math.isnan(want):
            assert math.isnan(got), c
        else:
            outward = {"inf": got <= want, "rad": got >= want, "wid": got >= want, "sup": got >= want}.get(
                op, True
            )
            assert outward and (abs(itl.ulps(want, got)) <= NUMBERS[op] or abs(got - want) <= 3 * TINY), c


@built_both_ways
def test_mid_and_rad_together_cover(cases, build):
    some = cases["midRad"]
    m, r = results(some, lambda x: (x.mid, x.rad), 1, build=build)
    for c, mid, rad in zip(some, m.tolist(), r.tolist(), strict=True):
        x = c.inputs[0]
        if x.empty:
            assert math.isnan(mid) and math.isnan(rad)
        else:
            assert abs(mid - float(c.expected[0])) <= 3 * TINY and rad >= float(c.expected[1])
            assert (
                rad == math.inf
                or Fraction(mid) - Fraction(rad) <= x.lo
                and x.hi <= Fraction(mid) + Fraction(rad)
            )


def test_no_case_of_an_implemented_operation_is_left_out(cases):
    tested = [*SETS, POWERS, *RELATIONS, *NUMBERS, "midRad"]
    counts = Counter({op: len(cases[op]) for op in tested})
    print(f"{counts.total()} cases of {len(tested)} operations")
    assert counts == COUNTS
