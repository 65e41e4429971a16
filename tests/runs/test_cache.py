"""Compiled kernels kept on a disk: where, for whom, and what is said where they cannot be."""

import os
from contextlib import contextmanager

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.experimental.compilation_cache import compilation_cache

import jaxbound as jb

OPTIONS = (
    "jax_compilation_cache_dir",
    "jax_persistent_cache_min_compile_time_secs",
    "jax_persistent_cache_min_entry_size_bytes",
)


@pytest.fixture(autouse=True)
def nowhere():
    """Let a test begin without a cache, and the others go on with theirs."""
    before = [getattr(jax.config, name) for name in OPTIONS]
    jax.config.update(OPTIONS[0], None)
    compilation_cache.reset_cache()
    yield
    for name, value in zip(OPTIONS, before, strict=True):
        jax.config.update(name, value)
    compilation_cache.reset_cache()


@contextmanager
def hits():
    """Count what is taken from the cache."""
    found = []

    def listen(event, **about):
        if event == "/jax/compilation_cache/cache_hits":
            found.append(event)

    jax.monitoring.register_event_listener(listen)
    try:
        yield found
    finally:
        jax.monitoring.unregister_event_listener(listen)


def kernel():
    return jax.jit(lambda x: jnp.sin(x) * 3)


def test_what_one_process_compiled_the_next_one_reads(tmp_path):
    assert jb.use_cache(tmp_path / "kernels") == tmp_path / "kernels"
    x = jax.device_put(np.arange(7.0))
    first = kernel()(x)
    with hits() as found:
        assert (kernel()(x) == first).all() and len(found) == 1
    assert any((tmp_path / "kernels").iterdir())


def test_another_folder_takes_the_place_of_the_one_before(tmp_path):
    x = jax.device_put(np.arange(7.0))
    for name in ("a", "b"):
        jb.use_cache(str(tmp_path / name))
        kernel()(x)
    assert any((tmp_path / "a").iterdir()) and any((tmp_path / "b").iterdir())


def test_the_folder_that_jax_was_told_of_is_kept(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    jax.config.update(OPTIONS[0], str(tmp_path / "mine"))
    assert jb.use_cache() == tmp_path / "mine" and not (tmp_path / "home").exists()


def test_without_a_name_it_is_the_folder_of_the_command_line(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert jb.use_cache() == tmp_path / "jaxbound" == jb.use_cache() and (tmp_path / "jaxbound").is_dir()


@pytest.mark.parametrize("named", [True, False])
def test_a_folder_that_cannot_be_is_refused_in_a_sentence(tmp_path, monkeypatch, named):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    with pytest.raises(
        ValueError, match="cannot be kept in .*: Not a directory; give use_cache a folder that can be written"
    ):
        jb.use_cache(tmp_path / "file" / "sub" if named else None)
    assert jax.config.jax_compilation_cache_dir is None and os.listdir(tmp_path) == ["file"]
