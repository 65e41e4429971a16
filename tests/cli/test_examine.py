"""`jaxbound examine`: a card is examined once by its user, and CONSISTENT counts there from then on."""

import json

import jax
import numpy as np
import pytest

from jaxbound.cli import main
from jaxbound.consistency import searched
from jaxbound.sets.floats import examined, kinds, probe, rounding


class Client:
    platform_version = "PJRT C API\ncuda 13000"


class Card:
    """A device of NVIDIA, as jax shows one."""

    platform, device_kind, compute_capability = "gpu", "NVIDIA H900", "12.3"
    client = Client()


@pytest.fixture
def card(monkeypatch, tmp_path):
    """Let a card be the device of this process that keeps to what is assumed; return it."""
    device = Card()
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(probe, "usable_devices", lambda: (device,))
    monkeypatch.setattr(searched, "usable_devices", lambda: (device,))
    monkeypatch.setattr(probe, "is_cpu_default", lambda: False)
    monkeypatch.setattr(probe, "measure", lambda device, dtype: {})
    monkeypatch.setattr(examined, "examination", lambda device, dtype: {"error of a sum": (1.0, 2.84)})
    yield device
    probe._found.cache_clear()


def test_a_card_proves_once_its_user_examined_it(card, capsys, tmp_path):
    assert probe._doubt(card) and probe.searching_device() == "NVIDIA 12.3"
    assert main.main(["examine"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "NVIDIA H900: may prove" in shown and "assumed float32: a quotient may be off" in shown
    (file,) = (tmp_path / "jaxbound" / "examined" / "cards").iterdir()
    record = json.loads(file.read_text())
    assert record["outcome"] == "passed" and record["driver"] == "PJRT C API cuda 13000"
    assert {"card", "capability", "jaxlib", "date"} <= set(record)
    assert not probe._doubt(card) and not probe.searching_device()
    words = searched.judging_device()
    assert words == f"NVIDIA H900 (driver PJRT C API cuda 13000, examined on {record['date']})"


@pytest.mark.parametrize("changed", ["driver", "jaxlib", "card", "jaxbound"])
def test_a_changed_driver_or_jaxlib_asks_for_another_examination(card, changed, monkeypatch):
    assert main.main(["examine", "-q"]) == 0 and not probe._doubt(card)
    if changed == "driver":
        monkeypatch.setattr(Client, "platform_version", "of next year")
    elif changed == "jaxlib":
        monkeypatch.setattr(kinds, "_jaxlib", lambda: "0.99")
    elif changed == "card":
        monkeypatch.setattr(Card, "device_kind", "NVIDIA H901")
    else:
        monkeypatch.setattr(examined, "__version__", "99.0")
    probe._found.cache_clear()
    assert probe._doubt(card) and probe.searching_device() == "NVIDIA 12.3"


def test_a_card_that_breaks_a_premise_goes_on_searching(card, capsys, monkeypatch):
    monkeypatch.setattr(examined, "examination", lambda device, dtype: {"NaN that are lost": (3.0, 0.0)})
    assert main.main(["examine", "--json"]) == 1
    (record,) = json.loads(capsys.readouterr().out)["devices"]
    assert record["outcome"].startswith("NaN that are lost, float32: 3, at most 0 assumed; ")
    assert probe._doubt(card)
    said = probe._doubt(card)
    assert f"examined on {record['date']}, it broke what proofs assume (NaN that are lost" in said


def test_a_record_that_somebody_damaged_admits_nothing(card, tmp_path):
    assert main.main(["examine", "-q"]) == 0
    (file,) = (tmp_path / "jaxbound" / "examined" / "cards").iterdir()
    for text in ("", "[]", file.read_text().replace("H900", "H100"), '{"outcome": "passed"}'):
        file.write_text(text)
        probe._found.cache_clear()
        assert probe._doubt(card)


def test_switches_that_change_arithmetic_are_refused_in_one_sentence(card, capsys, monkeypatch):
    monkeypatch.setenv("NVIDIA_TF32_OVERRIDE", "1")
    assert main.main(["examine"]) == 2
    assert "the environment has NVIDIA_TF32_OVERRIDE=1" in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize("failure", [RuntimeError, AssertionError])  # jax has both, by what is installed
@pytest.mark.parametrize("command", ["examine", "demo --out out", "example heater"])
def test_a_platform_that_is_not_there_is_refused_in_one_sentence(
    command, failure, capsys, monkeypatch, tmp_path
):
    def nothing():
        raise failure

    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("JAX_PLATFORMS", "cuda")
    monkeypatch.setattr(jax, "default_backend", nothing)
    assert main.main(command.split()) == 2
    said = capsys.readouterr().err
    assert "JAX_PLATFORMS=cuda names no device of this machine: unset it, or use cpu" in said
    assert not list(tmp_path.iterdir())


def test_a_cpu_is_examined_and_known_by_its_version(capsys, monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert main.main(["examine", "--json"]) == 0
    (record,) = json.loads(capsys.readouterr().out)["devices"]
    assert record["platform"] == "cpu" and record["outcome"] == "passed" and not record["kept"]


@pytest.mark.parametrize("coarse, dtype, units", [(0, np.float32, 4), (1, np.float32, 6), (1, np.float64, 4)])
def test_quotients_are_widened_by_six_units_beside_a_coarse_card(monkeypatch, coarse, dtype, units):
    monkeypatch.setattr(kinds, "has_coarse_quotients", lambda: bool(coarse))
    one = np.ones((), dtype)
    lo, hi = rounding.outward(one, one)
    u = float(rounding.unit(dtype))
    assert float(hi) - 1 == pytest.approx(units * u, abs=2 * u)
    assert 1 - float(lo) == pytest.approx(units * u, abs=u)
    assert kinds.most_of_a_quotient(Card(), dtype) == (4.84 if dtype == np.float32 else 2.84)


def test_programs_of_a_cpu_stay_as_they_are():
    assert not kinds.has_coarse_quotients()
    x = jax.ShapeDtypeStruct((3,), np.float32)
    constants = str(jax.make_jaxpr(lambda x: rounding.outward(x, x))(x))
    assert f"{4 * float(rounding.unit(np.float32)):.8g}"[:8] in constants
