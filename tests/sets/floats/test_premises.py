"""What proofs rest on beside rounding: each premise is asked, and its refusal comes where it does not
hold."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from corners import DTYPES
from test_probe import in_a_process_with

from jaxbound.sets.floats import examined, probe, settings, unrolled
from jaxbound.sets.floats.examination import premises, reductions

each_dtype = pytest.mark.parametrize("dtype", DTYPES, ids=["float32", "float64"])
CPU = jax.devices("cpu")[0]
QUOTIENTS, CALLS = "quotients that are not one number for all uses", "calls that are not kept apart"


@pytest.fixture
def fresh(monkeypatch):
    """Have the probe compiled and run anew, and forget what it found."""
    kernel = probe._kernel.__wrapped__
    monkeypatch.setattr(probe, "_kernel", jax.jit(lambda *given: kernel(*given)))
    probe._found.cache_clear()
    yield monkeypatch
    probe._found.cache_clear()


def broken(monkeypatch, premise):
    """Let the house's own means do nothing, as a compiler that sees through them would."""
    if premise == QUOTIENTS:
        monkeypatch.setattr(unrolled, "stored", lambda x: x)
    else:
        monkeypatch.setattr(probe, "_squared", lambda a: a * a)
        monkeypatch.setattr(unrolled, "apart", jax.jit)


@pytest.mark.parametrize("premise", [QUOTIENTS, CALLS])
@each_dtype
def test_the_probe_finds_a_premise_that_does_not_hold(fresh, premise, dtype):
    broken(fresh, premise)
    found = probe.measure(CPU, np.dtype(dtype))
    assert [name for name, (value, most) in found.items() if not value <= most] == [premise]


@pytest.mark.parametrize("premise", [QUOTIENTS, CALLS])
def test_a_premise_that_does_not_hold_is_refused_with_versions_and_advice(fresh, premise):
    broken(fresh, premise)
    with pytest.raises(RuntimeError) as refusal:
        probe.refuse_unverified()
    said = str(refusal.value)
    assert (
        premise in said and f"jaxlib {jax.lib.__version__}" in said and "install" in said and "\n" not in said
    )


@pytest.mark.parametrize("premise", [QUOTIENTS, CALLS])
def test_the_examination_finds_a_premise_that_does_not_hold_at_any_size(monkeypatch, premise):
    broken(monkeypatch, premise)
    lost = [name for name, (value, most) in premises(CPU, np.float64).items() if not value <= most]
    assert lost == [f"{premise}, of {count}" for count in (16, 300, 5000)]


@pytest.mark.parametrize(
    "premise, lossy",
    [
        ("sums of 8192 numbers that lose NaN", jnp.nan_to_num),
        ("maxima of 8192 numbers that lose infinity", lambda x: jnp.clip(x, -1, 1)),
    ],
)
def test_the_examination_finds_reductions_that_lose_what_proofs_read(monkeypatch, premise, lossy):
    for name in ("sum", "max"):
        whole = getattr(jnp, name)
        monkeypatch.setattr(jnp, name, lambda x, axis, whole=whole: whole(lossy(x), axis))
    found = reductions(np.ones((1024, 8)), lambda f, *x: jax.tree.map(np.asarray, f(*x)))
    assert not found[premise][0] <= found[premise][1]


# settings and versions: known by name, or examined in full, once


@pytest.fixture
def folder(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "jaxbound" / "examined"


def test_a_version_that_is_not_listed_is_examined_once_in_one_sentence(fresh, folder):
    runs = []
    fresh.setattr(settings, "VERSIONS", frozenset())
    fresh.setattr(
        examined, "examination", lambda *given: runs.append(given) or {"error of a sum": (1.0, 2.84)}
    )
    with pytest.warns(
        UserWarning,
        match=rf"jaxlib {jax.lib.__version__} is not among the versions that were examined: .* once",
    ) as said:
        probe.refuse_unverified()
    assert len(said) == 1 and "\n" not in str(said[0].message) and len(runs) == 2
    probe._found.cache_clear()
    probe.refuse_unverified()  # a warning would be an error
    kept = list(folder.iterdir())
    assert len(runs) == 2 and len(kept) == 1
    kept[0].write_text(kept[0].read_text().replace(jax.__version__, "0.0"))  # of another version
    probe._found.cache_clear()
    with pytest.warns(UserWarning, match="once"):
        probe.refuse_unverified()
    assert len(runs) == 4


def test_a_version_that_fails_the_examination_is_refused_and_not_kept(fresh, folder):
    fresh.setattr(settings, "VERSIONS", frozenset())
    fresh.setattr(
        examined,
        "examination",
        lambda *given: {"error of a sum": (1.0, 2.84), "NaN that are lost": (3.0, 0.0)},
    )
    with (
        pytest.warns(UserWarning, match="once"),
        pytest.raises(RuntimeError, match=r"NaN that are lost, float32: 3, at most 0 assumed"),
    ):
        probe.refuse_unverified()
    assert not folder.exists()


def test_an_examination_that_cannot_be_kept_still_allows_proofs(fresh, tmp_path):
    (tmp_path / "file").write_text("")
    fresh.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    fresh.setattr(settings, "VERSIONS", frozenset())
    fresh.setattr(examined, "examination", lambda *given: {})
    with pytest.warns(UserWarning, match="once"):
        probe.refuse_unverified()


def test_the_installed_version_was_examined_or_says_so():
    """The lowest that pyproject.toml allows is listed; 0.11.1 is neither listed nor installed."""
    assert (
        "0.8.0" in settings.VERSIONS and "0.11.1" not in settings.VERSIONS and jax.lib.__version__ != "0.11.1"
    )


@pytest.mark.parametrize(
    "flags, unknown",
    [
        ("", []),
        (
            "--xla_force_host_platform_device_count=8 --xla_dump_to=x --xla_gpu_autotune_level=0 "
            "--xla_cpu_enable_fast_math=false",
            [],
        ),
        (
            "--xla_cpu_use_fusion_emitters=false --xla_dump_hlo_as_text",
            ["--xla_cpu_use_fusion_emitters=false"],
        ),
        ("'--xla_cpu_prefer_vector_width=128'", ["--xla_cpu_prefer_vector_width=128"]),
    ],
)
def test_flags_are_known_by_name_or_not(flags, unknown):
    assert settings.unknown_flags(flags, "cpu") == unknown


def test_flags_for_cards_are_unknown_on_a_card():
    assert settings.unknown_flags("--xla_gpu_autotune_level=0 --xla_dump_to=x", "NVIDIA") == [
        "--xla_gpu_autotune_level=0"
    ]


def test_an_unknown_flag_or_option_is_examined_and_named(fresh, folder):
    fresh.setattr(examined, "examination", lambda *given: {})
    fresh.setenv("XLA_FLAGS", "--xla_cpu_prefer_vector_width=128")
    with pytest.warns(
        UserWarning, match="^XLA_FLAGS has --xla_cpu_prefer_vector_width=128, under which .* once"
    ):
        probe.refuse_unverified()
    fresh.delenv("XLA_FLAGS")
    fresh.setattr(settings, "OPTIONS", {"jax_exec_time_optimization_effort": (0.5,)})
    with pytest.warns(UserWarning, match="^jax has jax_exec_time_optimization_effort=0.0, under"):
        probe.refuse_unverified()
    assert len(list(folder.iterdir())) == 2


ASKS = """
import json, warnings
import jax
jax.config.update("jax_enable_x64", True)
from jaxbound.sets.floats import probe
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    probe.refuse_unverified()
print(json.dumps([str(w.message) for w in said]))
"""


def test_harmless_flags_are_not_examined(fresh, folder):
    fresh.setenv("XLA_FLAGS", "--xla_force_host_platform_device_count=2 --xla_dump_hlo_as_text")
    probe.refuse_unverified()  # a warning would be an error
    assert not folder.exists()


@pytest.mark.slow
@pytest.mark.parametrize("flag", ["--xla_cpu_prefer_vector_width=128", "--xla_cpu_use_fusion_emitters=false"])
def test_a_process_with_an_unknown_flag_is_examined_once(folder, flag):
    first, then = (json.loads(in_a_process_with(flag, "-c", ASKS)) for _ in range(2))
    assert len(first) == 1 and f"XLA_FLAGS has {flag}" in first[0] and then == []


HARMLESS_OPTIONS = (
    "jax_array_garbage_collection_guard",
    "jax_auto_pcast",
    "jax_bcoo_cusparse_lowering",
    "jax_captured_constants_",
    "jax_check_",
    "jax_compilation_cache_",
    "jax_compiler_detailed_logging_min_ops",
    "jax_compiler_enable_remat_pass",
    "jax_cpu_",
    "jax_cross_host_",
    "jax_cuda_visible_devices",
    "jax_custom_vjp",
    "jax_debug_",
    "jax_default_",
    "jax_disable_",
    "jax_disallow_mesh_context_manager",
    "jax_distributed_debug",
    "jax_dump_ir_",
    "jax_embedded_constants_max_bytes",
    "jax_enable_",
    "jax_error_checking_behavior_",
    "jax_explain_cache_misses",
    "jax_explicit_x64_dtypes",
    "jax_export_",
    "jax_force_dcn_cross_host_transfers",
    "jax_high_dynamic_range_gumbel",
    "jax_hlo_source_file_canonicalization_regex",
    "jax_include_",
    "jax_legacy_prng_key",
    "jax_log",
    "jax_mosaic_allow_hlo",
    "jax_mutable_array_checks",
    "jax_no_tracing",
    "jax_num_cpu_devices",
    "jax_numpy_",
    "jax_oneapi_",
    "jax_pallas_",
    "jax_persistent_cache_",
    "jax_pgle_",
    "jax_platform",
    "jax_pprint_use_color",
    "jax_ragged_dot_",
    "jax_raise_",
    "jax_random_seed_offset",
    "jax_refs_to_pins",
    "jax_remat3",
    "jax_remove_",
    "jax_rocm_visible_devices",
    "jax_scan3",
    "jax_send_traceback_to_runtime",
    "jax_serialization_version",
    "jax_share_binary_",
    "jax_softmax_custom_jvp",
    "jax_sort_devices_",
    "jax_source_url_schema",
    "jax_thread_guard",
    "jax_threefry_",
    "jax_traceback_",
    "jax_tracer_",
    "jax_transfer_guard",
    "jax_use_",
    "jax_pmap_",
    "jax_safer_randint",
    "jax_vjp3",
    "jax_vmap_primitive",
    "jax_collectives_common_channel_id",
    "jax_dynamic_shapes",
    "jax_xla_backend",
    "jax_mock_gpu_topology",
    "jax_memory_fitting_",
    "mock_num_gpu_processes",
    "check_vma",
    "eager_constant_folding",
    "jax2tf_",
)
"""Beginnings of the names of options that say how jax traces, logs, stores and moves, not how XLA
compiles."""


def test_every_option_of_a_listed_jax_is_known_to_reach_the_compiler_or_not():
    if jax.lib.__version__ not in settings.VERSIONS:
        pytest.skip("an unlisted version is examined in full")
    new = [
        name
        for name in jax.config.values
        if name not in settings.OPTIONS and not name.startswith(HARMLESS_OPTIONS)
    ]
    assert not new, f"read what these do, then list them here or in settings.OPTIONS: {new}"
    assert all(
        jax.config.values[name] in values
        for name, values in settings.OPTIONS.items()
        if name in jax.config.values
    )
