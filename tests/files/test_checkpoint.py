"""A checkpoint is taken up by the run that left it, whole or not at all, and by no other."""

import json
import os

import jax
import numpy as np
import pytest

from jaxbound.files.checkpoint import Checkpoint, as_texts, differences, from_texts

MINE = {"model": "a", "steps": "3"}


def test_what_was_saved_is_loaded(tmp_path, rng):
    x = rng.normal(size=(3, 2))
    Checkpoint(tmp_path / "x.state", MINE).save(x=x, done=3, none=np.zeros((0, 2), np.float32))
    found = Checkpoint(tmp_path / "x.state", dict(MINE)).load()
    assert found.keys() == {"x", "done", "none"} and int(found["done"]) == 3
    assert found["x"].tobytes() == x.tobytes() and found["none"].dtype == np.float32
    assert os.listdir(tmp_path) == ["x.state"]


def test_a_state_comes_back_from_texts(rng):
    state = {"x": rng.normal(size=(3, 2)), "none": (np.int32(3), np.zeros((0, 2), np.float32))}
    texts = json.loads(json.dumps(as_texts(state)))
    found = from_texts(jax.tree.map(np.zeros_like, state), texts)
    same = jax.tree.map(lambda a, b: a.dtype == b.dtype and np.array_equal(a, b), state, found)
    assert jax.tree.all(same) and as_texts(found) == texts


def test_nothing_is_loaded_from_nothing(tmp_path):
    assert Checkpoint(tmp_path / "x.npz", MINE).load() is None and not os.listdir(tmp_path)


@pytest.mark.parametrize(
    "now, what",
    [
        ({**MINE, "steps": "4"}, "steps"),
        ({"model": "b", "steps": "4"}, "model and steps"),
        ({**MINE, "bounds": "c"}, "bounds"),
    ],
)
def test_another_run_is_refused_and_the_file_stays(tmp_path, now, what):
    path = tmp_path / "x.npz"
    Checkpoint(path, MINE).save(done=3)
    kept = path.read_bytes()
    with pytest.raises(
        ValueError, match=f"x.npz is of another {what}: choose another place, or delete it to begin anew"
    ):
        Checkpoint(path, now).load()
    assert path.read_bytes() == kept


def test_a_file_without_an_identity_is_another_in_everything(tmp_path):
    np.savez(tmp_path / "x.npz", mark="of an earlier version", done=3)
    with pytest.raises(ValueError, match="x.npz is of another model and steps: choose"):
        Checkpoint(tmp_path / "x.npz", MINE).load()


@pytest.mark.parametrize("damage", [b"", b"PK", b"years of work", "half", "bit", "array"])
def test_a_damaged_file_is_refused(tmp_path, damage):
    path = tmp_path / "x.npz"
    Checkpoint(path, MINE).save(x=np.arange(1000.0))
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    np.save(tmp_path / "x.npy", data)
    spoiled = {
        "half": path.read_bytes()[:4000],
        "bit": bytes(data),
        "array": (tmp_path / "x.npy").read_bytes(),
    }
    path.write_bytes(spoiled.get(damage, damage))
    with pytest.raises(ValueError, match="x.npz is damaged, or no state of jaxbound"):
        Checkpoint(path, MINE).load()


def test_objects_are_not_loaded(tmp_path):
    np.savez(tmp_path / "x.npz", identity=np.array([MINE], object))
    with pytest.raises(ValueError, match="x.npz is damaged, or no state of jaxbound"):
        Checkpoint(tmp_path / "x.npz", MINE).load()


def test_a_full_disk_leaves_what_was_saved_before(tmp_path, monkeypatch):
    kept = Checkpoint(tmp_path / "x.npz", MINE)
    kept.save(done=1)

    def full(fd):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch, pytest.raises(OSError, match="No space left"):
        patch.setattr(os, "fsync", full)
        kept.save(done=2)
    assert int(kept.load()["done"]) == 1 and os.listdir(tmp_path) == ["x.npz"]


@pytest.mark.parametrize("before", [None, [], "text", {}])
def test_what_is_no_identity_differs_in_all(before):
    assert differences(before, MINE) == "model and steps" and differences(MINE, MINE) == ""
