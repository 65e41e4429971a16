"""What rounding.py assumes of the compiler, one claim a test: a new XLA that breaks one of them fails here,
and says which.
"""

import json
import operator
import os
import subprocess
import sys
from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import proving
import pytest
from corners import DTYPES, corners, floats

import jaxbound as jb
from jaxbound.sets.floats import examined, kinds, probe, rounding
from jaxbound.sets.intervals import angles

COUNT = 2000
each_dtype = pytest.mark.parametrize("dtype", DTYPES, ids=["float32", "float64"])
EXACTLY = {"add": operator.add, "sub": operator.sub, "mul": operator.mul, "div": operator.truediv}


@pytest.fixture(autouse=True)
def nobody_examined_a_device(monkeypatch, tmp_path):
    """What a user of this machine examined is not what these tests find."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    forget()
    yield
    forget()


def forget():
    """Have the probe ask anew."""
    probe._named_doubt.cache_clear()
    probe._found.cache_clear()


def numbers(rng, dtype, low=-40, high=40, count=COUNT):
    return (np.exp2(rng.uniform(low, high, count)) * rng.choice([-1, 1], count)).astype(dtype)


def exact(x):
    return list(map(Fraction, np.asarray(x, float).tolist()))


def errors(found, exacts, dtype):
    """Return |found - exact| / |found| in units u."""
    u = Fraction(float(np.finfo(dtype).eps)) / 2
    return [
        float(abs(f - e) / abs(f) / u) if f else float(e != 0) * np.inf
        for f, e in zip(exact(found), exacts, strict=True)
    ]


@jax.jit
def operations(a, b):
    return {"add": a + b, "sub": a - b, "mul": a * b, "div": a / b}


@pytest.mark.parametrize("form", ["array", "broadcast", "scalar", "constant"])
@each_dtype
def test_one_operation_is_off_by_at_most_2_84_units(rng, form, dtype):
    a = numbers(rng, dtype, count=600)
    for d in numbers(rng, dtype, count=4):
        b = np.full_like(a, d)
        given = {"array": b, "broadcast": b[:1], "scalar": d}.get(form)
        found = jax.jit(lambda a, d=d: operations(a, d))(a) if form == "constant" else operations(a, given)
        for op, f in found.items():
            want = [EXACTLY[op](x, y) for x, y in zip(exact(a), exact(b), strict=True)]
            assert max(errors(f, want, dtype)) <= 2.84, op


@each_dtype
def test_a_chain_of_operations_is_off_by_at_most_the_sum_of_its_errors(rng, dtype):
    a, b, c = (abs(numbers(rng, dtype, -8, 8)) for _ in range(3))
    chains = {
        "(a b) c": lambda a, b, c: (a * b) * c,
        "(a / b) / c": lambda a, b, c: (a / b) / c,
        "a b + c": lambda a, b, c: a * b + c,
        "(a + b) c": lambda a, b, c: (a + b) * c,
        "a / (b + c)": lambda a, b, c: a / (b + c),
    }
    for name, f in chains.items():
        want = [f(*row) for row in zip(*map(exact, (a, b, c)), strict=True)]
        assert max(errors(jax.jit(f)(a, b, c), want, dtype)) <= 2 * 2.84, name


@each_dtype
def test_a_flushed_result_or_operand_costs_at_most_the_smallest_normal_number(rng, dtype):
    info = np.finfo(dtype)
    a, b = (
        numbers(rng, dtype, info.minexp + 1, info.minexp + 4),
        numbers(rng, dtype, info.minexp + 1, info.minexp + 4),
    )
    half = numbers(rng, dtype, -6, -1)
    found = {"add": (a, b), "sub": (a, b), "mul": (a, half), "div": (a, 1 / half)}
    for op, operands in found.items():
        results = operations(*operands)[op]
        for f, x, y in zip(exact(results), *map(exact, operands), strict=True):
            assert abs(f - EXACTLY[op](x, y)) <= Fraction(float(info.tiny)) + Fraction(float(info.eps)) * abs(
                f
            ), op


@each_dtype
def test_a_quotient_that_underflows_keeps_its_sign(dtype):
    """interval.div reads from the sign of a flushed quotient on which side of 0 the exact one lies."""
    info = np.finfo(dtype)
    a = np.array([info.tiny, -info.tiny, 4 * info.tiny, -4 * info.tiny, 0.0, -0.0], dtype)
    for d in (np.full_like(a, 2.0 ** (info.maxexp // 2)), np.asarray(2.0 ** (info.maxexp // 2), dtype)):
        assert np.signbit(np.asarray(jax.jit(lambda a, d: a / d)(a, d))).tolist() == np.signbit(a).tolist()


@each_dtype
def test_an_overflow_is_infinite(dtype):
    top = np.array([np.finfo(dtype).max, -np.finfo(dtype).max])
    found = jax.jit(lambda a: (a + a, a * 2, a / np.asarray(0.5, dtype)))(top)
    assert all(f.tolist() == [np.inf, -np.inf] for f in found)


@each_dtype
def test_square_roots_are_off_by_at_most_2_84_units(rng, dtype):
    x = abs(numbers(rng, dtype, np.finfo(dtype).minexp + 1, np.finfo(dtype).maxexp - 1))
    u = Fraction(float(np.finfo(dtype).eps)) / 2
    limit = Fraction(284, 100) * u
    for s, v in zip(exact(jax.jit(jnp.sqrt)(x)), exact(x), strict=True):
        assert (s * (1 - limit)) ** 2 <= v <= (s * (1 + limit)) ** 2


@each_dtype
def test_two_sum_and_two_prod_lose_nothing_next_to_constants_and_inexact_operands(rng, dtype):
    a, b = numbers(rng, dtype, -12, 12), numbers(rng, dtype, -12, 12)

    @jax.jit
    def kernel(a, b):
        c = a * b + a  # inexact, and free to be fused
        return {
            "sum": (c, b, rounding.two_sum(c, b)),
            "with 1": (jnp.ones_like(b), b, rounding.two_sum(jnp.ones_like(b), b)),
            "product": (a, b, rounding.two_prod(a, b)),
            "square": (a, a, rounding.two_prod(a, a)),
        }

    for name, (x, y, (s, e)) in kernel(a, b).items():
        want = [
            p + q if name in ("sum", "with 1") else p * q for p, q in zip(exact(x), exact(y), strict=True)
        ]
        assert [p + q for p, q in zip(exact(s), exact(e), strict=True)] == want, name


@each_dtype
def test_contraction_leaves_exact_products_alone(rng, dtype):
    """x - k p is exact for the k and the first part p of pi/2 that angles uses, with or without an FMA."""
    limit = angles.LARGEST_ANGLE[np.dtype(dtype).itemsize]
    x = rng.uniform(-limit, limit, COUNT).astype(dtype)
    r, rest, k = jax.jit(angles._reduced)(x)
    quarter = angles.PI / 2
    for a, b, n, v in zip(*map(exact, (r, rest, k, x)), strict=True):
        assert abs(a + b - (v - n * quarter)) <= abs(a) * Fraction(float(np.finfo(dtype).eps)) ** 2


@each_dtype
def test_reductions_round_to_the_nearest_integer(rng, dtype):
    x = np.concatenate([rng.uniform(-2000, 2000, COUNT), [0.5, 1.5, -0.5, 0.49, -2.51]]).astype(dtype)
    assert (abs(np.asarray(jax.jit(jnp.round)(x), float) - x.astype(float)) <= 0.5).all()


@each_dtype
def test_powers_of_two_are_exact(dtype):
    info = np.finfo(dtype)
    k = np.arange(info.minexp, info.maxexp).astype(dtype)
    assert exact(jax.jit(rounding.power_of_two)(k)) == [Fraction(2) ** int(n) for n in k]


@each_dtype
def test_mantissa_and_exponent_give_the_number_back_subnormal_or_not(rng, dtype):
    x = np.concatenate(
        [
            abs(floats(rng, dtype, COUNT)),
            abs(corners(dtype)),
            np.finfo(dtype).smallest_subnormal * rng.integers(1, 2**20, 50),
        ]
    )
    x = x[x > 0].astype(dtype)
    m, k = jax.jit(rounding.mantissa_exponent)(x)
    assert [a * Fraction(2) ** int(n) for a, n in zip(exact(m), np.asarray(k), strict=True)] == exact(x)
    assert (np.asarray(m) >= np.asarray(np.sqrt(0.5), dtype)).all() and (np.asarray(m) < np.sqrt(2)).all()


@each_dtype
def test_scale_is_exact_over_the_whole_range(rng, dtype):
    info = np.finfo(dtype)
    m = rng.uniform(1, 2, COUNT).astype(dtype)
    k = rng.integers(info.minexp, info.maxexp, COUNT).astype(dtype)
    assert exact(jax.jit(rounding.scale)(m, k)) == [
        a * Fraction(2) ** int(n) for a, n in zip(exact(m), k, strict=True)
    ]


@each_dtype
def test_corrected_quotients_and_roots_are_off_by_at_most_1_01_units(rng, dtype):
    n, d = numbers(rng, dtype, -20, 20), numbers(rng, dtype, -20, 20)
    for divisor in (d, d[:1]):
        want = [a / b for a, b in zip(exact(n), exact(np.broadcast_to(divisor, n.shape)), strict=True)]
        assert max(errors(jax.jit(rounding.quotient)(n, divisor), want, dtype)) <= 1.01
    small = numbers(rng, dtype, np.finfo(dtype).minexp + 1, -60), abs(numbers(rng, dtype, -64, 0))
    found = np.asarray(jax.jit(rounding.quotient)(*small))
    normal = abs(found) > np.finfo(dtype).tiny
    want = [a / b for a, b in zip(*(exact(v[normal]) for v in small), strict=True)]
    assert normal.sum() > COUNT / 4 and max(errors(found[normal], want, dtype)) <= 2.84
    limit = Fraction(101, 100) * Fraction(float(np.finfo(dtype).eps)) / 2
    for s, v in zip(exact(jax.jit(rounding.root)(abs(n))), exact(abs(n)), strict=True):
        assert (s * (1 - limit)) ** 2 <= v <= (s * (1 + limit)) ** 2


@each_dtype
def test_a_sum_in_the_compilers_order_is_off_by_at_most_one_unit_a_term(rng, dtype):
    x = numbers(rng, dtype, -4, 4, 10_000)
    u = Fraction(float(np.finfo(dtype).eps)) / 2
    terms = exact(x)
    for run in (jnp.sum, lambda x: jnp.dot(x, jnp.ones_like(x), precision=jax.lax.Precision.HIGHEST)):
        assert abs(exact([jax.jit(run)(x)])[0] - sum(terms)) <= (len(x) - 1) * u * sum(
            map(abs, terms)
        ) * Fraction(101, 100)


MANY = 2**13
"""Numbers of a reduction that XLA hands to a library, with the operations that it alone reads."""


def within_a_reduction(f, *given):
    """Return f of arrays (N,) as the largest of two equal numbers, f computed by what reduces."""
    return np.asarray(jax.jit(lambda *x: jnp.max(f(*x), 1))(*(np.stack([x, x], 1) for x in given)))


@each_dtype
def test_operations_that_a_large_reduction_takes_along_are_off_by_at_most_2_84_units(rng, dtype):
    a, b = numbers(rng, dtype, count=MANY), numbers(rng, dtype, count=MANY)
    for op, f in EXACTLY.items():
        found = within_a_reduction(f, a, b)
        assert (
            max(errors(found, [f(x, y) for x, y in zip(exact(a), exact(b), strict=True)], dtype)) <= 2.84
        ), op


@each_dtype
def test_what_proofs_read_of_many_numbers_keeps_nan(rng, dtype):
    """A maximum need not, which is why no proof asks it."""
    x = numbers(rng, dtype, count=MANY).reshape(-1, 8)
    x[::5, 3] = np.nan
    read = jax.jit(
        lambda x: [
            jnp.sum(x, 1),
            jnp.sum(jnp.abs(x) * 0, 1),
            jnp.max(jnp.where(jnp.isfinite(x), 0, jnp.inf), 1),
        ]
    )
    none = jax.jit(
        lambda x: [jnp.all(x < jnp.inf, 1), jnp.all(jnp.abs(x) - 1 < jnp.inf, 1), jnp.all(jnp.isfinite(x), 1)]
    )
    assert all(np.array_equal(~np.isfinite(f), np.arange(len(x)) % 5 == 0) for f in read(x))
    assert all(np.array_equal(f, np.arange(len(x)) % 5 != 0) for f in none(x))


@each_dtype
def test_a_maximum_of_many_numbers_keeps_infinity(rng, dtype):
    x = numbers(rng, dtype, count=MANY).reshape(-1, 8)
    x[::5, 3], x[::7, 2] = np.inf, -np.inf
    most, least = jax.jit(lambda x: (jnp.max(x, 1), jnp.min(x, 1)))(x)
    assert np.array_equal(most, x.max(1)) and np.array_equal(least, x.min(1))


@each_dtype
def test_a_comparison_with_a_number_other_than_0_is_false_for_nan(dtype):
    """|x| >= 0, compiled, may be true of NaN: what cannot be below 0 is not looked at."""
    x = np.full(MANY, np.nan, dtype)
    said = jax.jit(
        lambda x: [
            x >= x,
            x == x,
            x <= jnp.inf,
            jnp.abs(x) < jnp.inf,
            jnp.abs(x) > -1,
            jnp.isfinite(x),
            x >= 0,
            x <= 0,
            x - 1 >= 0,
        ]
    )
    assert not any(np.asarray(s).any() for s in said(x))


# what every proof asks first

FAST = "--xla_cpu_enable_fast_math=true"


class Accelerator:
    """A device that nobody has examined."""

    platform = "gpu"


@each_dtype
def test_the_probe_measures_what_is_assumed(dtype):
    for count in (examined.FEW, examined.MANY):
        measured = examined.measure(jax.devices()[0], np.dtype(dtype), count)
        assert len(measured) == 11 and all(value <= most for value, most in measured.values()), measured
        assert 0.75 < measured["error of a sum"][0] <= 1, "a CPU rounds a sum correctly"


def test_every_public_name_is_known_to_prove_or_not():
    proving_names = {name.split(".")[0].split(",")[0] for name in proving.doors()} - {"sets"}
    assert not proving_names & proving.EXACT_OR_UNPROVED
    assert proving_names | proving.EXACT_OR_UNPROVED == set(jb.__all__)


def test_doors_of_sets_refuse_other_devices_in_one_sentence_and_those_of_recordings_prove_elsewhere(
    monkeypatch,
):
    """Windows are searched for and proved on the host; all else that takes samples goes to the CPU."""
    host = jax.devices()[0]
    monkeypatch.setattr(
        probe, "usable_devices", lambda: (Accelerator(),) if probe.default_device() is None else (host,)
    )
    monkeypatch.setattr(probe, "is_cpu_default", lambda: False)
    monkeypatch.setattr("jaxbound.consistency.drive.usable_devices", lambda: (host,))
    for name, said in proving.answers().items():
        if name not in proving.OF_SETS:
            assert said is None, f"{name}: {said}"
            continue
        assert said is not None, f"{name} answered"
        assert "so far only CPU, not gpu: set JAX_PLATFORMS=cpu" in said and "\n" not in said, name


class Card:
    """A device of NVIDIA, as jax shows one."""

    platform, device_kind, compute_capability = "gpu", "NVIDIA H100 80GB HBM3", "9.0"


def test_a_card_is_known_by_its_capability_and_refused_until_it_was_examined(monkeypatch):
    assert (
        probe.kind_of_device(Card())["platform"] == "NVIDIA"
        and probe.kind_of_device(Card())["capability"] == "9.0"
    )
    assert "so far only CPU, not NVIDIA 9.0: set JAX_PLATFORMS=cpu" in probe._doubt(Card())
    monkeypatch.setattr(probe, "EXAMINED", probe.EXAMINED | {"NVIDIA 9.0"})
    monkeypatch.setattr(examined, "measure", lambda *given: {"error of a quotient": (4.1, 2.84)})
    assert "error of a quotient: 4.1, at most 2.84 assumed" in probe._doubt(Card())
    monkeypatch.setattr(examined, "measure", lambda *given: {"error of a quotient": (1.0, 2.84)})
    forget()
    assert not probe._doubt(Card())
    with jax.enable_x64(False):  # bounds are widened for its quotients
        assert not probe._doubt(Card())


def in_a_process_with(flags, *command):
    """Return what a Python process prints whose XLA has these flags."""
    out = subprocess.run(
        [sys.executable, *command],
        env={
            **os.environ,
            "XLA_FLAGS": flags,
            "JAX_PLATFORMS": "cpu",
            "PYTHONPATH": os.pathsep.join(sys.path),
        },
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert out.returncode == 0, out.stderr
    return out.stdout


def test_every_door_that_proves_refuses_fast_math_in_one_sentence():
    for name, said in json.loads(in_a_process_with(FAST, proving.__file__)).items():
        assert said is not None, f"{name} answered"
        assert (
            said
            == f"XLA_FLAGS has {FAST}, with which the compiler keeps to no rounding: start without, nothing "
            f"can be proved so"
        ), name


def test_the_probe_finds_fast_math_that_no_name_tells(tmp_path):
    """Also the command line refuses to compile, with the exit code of bad input; NumPy needs no compiler."""
    jb.save_model(jb.LinearSystem([["1/2"]], None, [[1]], dt=1, noise=0.1), tmp_path / "model.toml")
    (tmp_path / "run.csv").write_text("time,y1\n0,1\n1,0.5\n2,0.9\n")
    code = f"""
import contextlib, os, sys, jax, jax.numpy as jnp
jnp.ones(2) + 1  # the flags are read
del os.environ["XLA_FLAGS"]
import jaxbound as jb
from jaxbound.cli.main import main
print(jb.detect("{tmp_path}/model.toml", "{tmp_path}/run.csv").counts["FAULT"])
try:
    jb.pave(lambda z: z * z, jb.interval([0.0], [1.0]), [2.0], q=2)
except RuntimeError as e:
    print(e)
jb.compile("always")
with contextlib.redirect_stderr(sys.stdout):
    print(main(["detect", "{tmp_path}/model.toml", "{tmp_path}/run.csv", "--out", "{tmp_path}/out"]))
"""
    faults, said, *shown, exit_code = in_a_process_with(FAST, "-c", code).splitlines()
    assert faults == "1"
    assert (
        said.startswith("compiled arithmetic in this process is not what proofs rest on (")
        and "two_sum" in said
    )
    assert (
        exit_code == "2"
        and "compiled arithmetic in this process" in " ".join(shown)
        and not (tmp_path / "out").exists()
    )


@pytest.mark.parametrize(
    "name, value",
    [
        ("NVIDIA_TF32_OVERRIDE", "1"),
        ("CUBLAS_EMULATE_DOUBLE_PRECISION", "1"),
        ("CUBLAS_EMULATE_SINGLE_PRECISION", "1"),
        ("CUBLAS_EMULATION_STRATEGY", "eager"),
        ("XLA_FLAGS", "--xla_gpu_enable_fast_min_max=true"),
    ],
)
def test_switches_that_change_arithmetic_are_refused_by_name_on_a_card_that_was_examined(
    monkeypatch, name, value
):
    card = Card()
    monkeypatch.setattr(probe, "EXAMINED", probe.EXAMINED | {"NVIDIA 9.0"})
    monkeypatch.setattr(probe, "usable_devices", lambda: (card,))
    monkeypatch.setattr(examined, "measure", lambda *given: {})
    assert not probe._doubt(card)
    monkeypatch.setenv(name, value)
    assert f"{name}={value}" in probe._doubt(card) or value in probe._doubt(card)
    with pytest.raises(probe.Unverified, match=value):
        probe.examined_devices()
    if name != "XLA_FLAGS":
        assert not probe._doubt(jax.devices()[0])  # no CPU knows them
        monkeypatch.setenv(name, "" if name.endswith("STRATEGY") else "0")
        assert not probe._doubt(card)


@pytest.mark.parametrize("coarse, dtype, units", [(0, np.float32, 4), (1, np.float32, 6), (1, np.float64, 4)])
def test_quotients_are_widened_by_six_units_beside_a_coarse_card(monkeypatch, coarse, dtype, units):
    monkeypatch.setattr(kinds, "has_coarse_quotients", lambda: bool(coarse))
    one = np.ones((), dtype)
    lo, hi = rounding.outward(one, one)
    u = float(rounding.unit(dtype))
    assert float(hi) - 1 == pytest.approx(units * u, abs=2 * u)
    assert units * u <= 1 - float(lo) < (units + 0.5) * u
    assert kinds.most_of_a_quotient(Card(), dtype) == (4.84 if dtype == np.float32 else 2.84)


def test_a_card_proves_once_its_user_examined_it_with_this_driver_and_these_versions(monkeypatch, tmp_path):
    class Examined(Card):
        client = type("Client", (), {"platform_version": "cuda 13000"})()

    card = Examined()
    monkeypatch.setattr(probe, "usable_devices", lambda: (card,))
    monkeypatch.setattr(probe, "is_cpu_default", lambda: False)
    measured = {"NaN that are lost": (3.0, 0)}
    monkeypatch.setattr(examined, "measure", lambda *given: measured)
    forget()
    (words,) = probe.examined_devices().values()
    assert "NaN that are lost: 3" in words and probe._doubt(card) and probe.searching_device()
    for _ in range(2):  # again, where a process found it broken after all
        measured["NaN that are lost"] = (3.0, 0)
        forget()
        assert probe._doubt(card)
        measured["NaN that are lost"] = (0.0, 0)
        assert probe.examined_devices() == {"NVIDIA H100 80GB HBM3 (NVIDIA 9.0)": ""}
        assert not probe._doubt(card) and not probe.searching_device()
    (record,) = (tmp_path / "jaxbound" / "examined").iterdir()
    for damaged in (b"", record.read_bytes().replace(b"H100", b"H900")):
        kept = record.read_bytes()
        record.write_bytes(damaged)
        forget()
        assert probe._doubt(card)
        record.write_bytes(kept)
    changes = (
        (Examined.client, "platform_version", "of next year"),
        (Card, "device_kind", "NVIDIA H900"),
        (kinds.jax.lib, "__version__", "0.99"),
        (jax, "__version__", "0.99"),
        (examined, "__version__", "99.0"),
    )
    for what, name, value in changes:
        with monkeypatch.context() as patch:
            patch.setattr(what, name, value)
            forget()
            assert probe._doubt(card), name


@pytest.mark.parametrize(
    "flags, refused",
    [
        ("", []),
        (
            "--xla_force_host_platform_device_count=8 --xla_cpu_enable_fast_math=false "
            "--xla_cpu_fast_math_honor_nans=true",
            [],
        ),
        ("--xla_cpu_enable_fast_math --xla_dump_to=x", ["--xla_cpu_enable_fast_math"]),
        ("--xla_cpu_fast_math_honor_nans=false", ["--xla_cpu_fast_math_honor_nans=false"]),
        ("--xla_cpu_experimental_ynn_fusion_type=2", ["--xla_cpu_experimental_ynn_fusion_type=2"]),
    ],
)
def test_flags_that_give_arithmetic_up_are_refused_by_name(flags, refused, monkeypatch, tmp_path):
    (tmp_path / "flags").write_text(flags)
    for given in (flags, f"{tmp_path}/flags") if flags else ("",):
        monkeypatch.setenv("XLA_FLAGS", given)
        assert bool(probe._doubt(jax.devices()[0])) == bool(refused)
        if refused:
            with pytest.raises(RuntimeError, match=f"XLA_FLAGS has {refused[0]}, with which"):
                probe.refuse_unverified()


def test_arrays_that_lie_on_a_device_that_is_not_verified_are_refused(monkeypatch):
    x = jnp.zeros(1)
    monkeypatch.setattr(type(x), "devices", lambda self: {Accelerator()})
    probe.refuse_unverified(np.zeros(1))
    with pytest.raises(RuntimeError, match="not gpu"):
        probe.refuse_unverified({"x": (x,)})


def test_the_probe_runs_once_and_also_inside_a_trace(monkeypatch):
    forget()
    runs, measure = [], examined.measure
    monkeypatch.setattr(examined, "measure", lambda *given: runs.append(given) or measure(*given))
    F = jb.inclusion(proving.square)
    upper = jax.jit(lambda x: F(jb.Interval(x, x)).hi)(np.ones(2))
    assert (np.asarray(upper) >= 1).all()
    jb.membership(jb.zonotope([0.0], [[1.0]]), np.zeros((1, 1)))
    assert len(runs) == 1


def test_a_device_that_is_chosen_beside_a_cpu_is_asked_for(monkeypatch):
    monkeypatch.setattr(probe, "default_device", Accelerator)
    assert probe.searching_device() == "gpu"


@pytest.mark.compiled
@pytest.mark.parametrize("chosen", [None, "cpu"])
def test_what_numpy_decides_asks_nothing_of_the_compiler(monkeypatch, chosen):
    asked = []
    monkeypatch.setattr(probe, "broken", lambda *given: asked.append(given) or "asked for")
    relations = jb.parity_relations(jb.LinearSystem([[0.5]], None, [[1]], noise=0.1))
    with jax.default_device(chosen and jax.devices(chosen)[0]):
        jb.compile()
        assert jb.detect(relations, None, [[1.0], [0.5], [3.0]]).counts["FAULT"] == 1 and not asked
        jb.compile("always")
        with pytest.raises(probe.Unverified, match="asked for"):
            jb.detect(relations, None, [[1.0], [0.5], [3.0]])
