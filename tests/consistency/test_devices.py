"""Any number of devices gives the same verdicts and the same margins, bit for bit, from one program; which
devices are used.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import devices_case
import jax
import numpy as np
import pytest

from jaxbound.consistency import devices
from jaxbound.sets.floats.probe import usable_devices

pytestmark = pytest.mark.compiled


def on_eight_devices(block, samples, counts, cases):
    """Return what devices_case.py prints in a process with 8 virtual devices, of which it uses so many."""
    flags = f"{os.environ.get('XLA_FLAGS', '')} --xla_force_host_platform_device_count=8"
    cache = {
        "JAX_COMPILATION_CACHE_DIR": jax.config.jax_compilation_cache_dir or "",
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.1",
    }
    out = subprocess.run(
        [sys.executable, devices_case.__file__, str(block), str(samples), counts, *cases],
        env={**os.environ, **cache, "XLA_FLAGS": flags, "JAX_PLATFORMS": "cpu"},
        cwd=Path(devices_case.__file__).parent,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert out.returncode == 0, out.stderr
    return json.loads(out.stdout)


@pytest.mark.parametrize(
    "counts, cases",
    [
        ("1,8", ["one sensor", "lying, one sensor"]),
        pytest.param("1,2,8", ["lying, bank"], marks=pytest.mark.long),
        pytest.param("1,2,8", ["lying, long windows"], marks=pytest.mark.long),
        pytest.param("1,2,8", ["joint", "bank"], marks=pytest.mark.long),
        pytest.param(
            "1,2,4,8",
            ["joint", "margins", "bank", "box", "batch", "float32"],
            marks=pytest.mark.long,
        ),
        pytest.param("1,2,8", ["long windows"], marks=pytest.mark.long),
    ],
)
def test_any_number_of_devices_finds_the_same_bits(counts, cases, monkeypatch):
    """Also those of this process, which has one device, and with blocks that do not come out even."""
    block, samples = 512, 4780
    found = on_eight_devices(block, samples, counts, cases)
    for kind in devices_case.KINDS:
        monkeypatch.setattr(kind, "block", None)  # put back at the end
    monkeypatch.setattr(devices_case.drive, "usable_devices", None)
    here = devices_case.digests(cases, block, samples, [1])
    for case in cases:
        *digests, kinds = found[case]
        assert (
            set(digests) == {here[case][0]}
            and len(digests) == len(counts.split(","))
            and kinds >= 3 - ("lying" in case)
        ), case
    if "one sensor" in cases:
        assert found["compiled"] == 1  # for all 8 devices


def test_a_single_device_gets_the_kernel_itself():
    one, block = jax.local_devices()[:1], (np.ones((4, 2)),)
    (out,) = devices.on_devices(jax.jit(lambda c, x: c + x[:, 0]), devices.everywhere(2.0, one), [block], one)
    np.testing.assert_array_equal(out, np.full(4, 3.0))


def test_the_default_device_is_respected():
    device = jax.local_devices()[0]
    assert usable_devices() == tuple(jax.local_devices())
    for chosen in (device, "cpu"):
        with jax.default_device(chosen):
            assert usable_devices() == (device,)
