"""The runner of the benchmarks: who takes part, the table, and where it goes; nothing is measured here."""

import ctypes
import ctypes.util
import importlib
import platform
import sys
from unittest.mock import MagicMock

import numpy as np
import pytest

from benchmarks import (
    drawing,
    intervals,
    linear_systems,
    paving,
    peers,
    sweeps,
    timing,
    varying,
)

RESULTS = {
    "machine": {"cpu": "a CPU", "cores": 2, "device": "cpu", "jax": "0"},
    "date": "today",
    "peers": {"NumPy": "2"},
    "absent": {"codac": "no"},
    "sweeps": {
        "limits": {
            "float64": {
                "one pass": {"windows/s": 2e8, "share of the memory limit": 1.0},
                "margins": {"windows/s": 1e8, "share of the memory limit": 0.5},
            },
            "float32": {},
        },
        "horizon": {
            "title": "a plant",
            "x": "horizon",
            "unit": "windows/s",
            "sizes": [1, 8],
            "failed": {},
            "series": {
                "jaxbound detect": {"proved": True, "rates": [5e7, 123456.0], "first call s": [1, 2]},
                "HiGHS": {"proved": False, "rates": [6000.0], "first call s": [0]},
            },
        },
    },
}


def test_table_has_a_line_for_the_ends_of_each_sweep():
    lines = drawing.table(RESULTS)
    assert (
        lines[2]
        == "| section 5, horizon 1, float64, windows/s | margins 100 million | one pass 200 million |"
    )
    assert "| a plant, horizon 1, windows/s | detect 50 million | HiGHS 6 thousand |" in lines
    assert (
        "| a plant, horizon 8, windows/s | detect 123 thousand |  |" in lines
        and lines[-1] == "Not installed: codac."
    )


def test_only_the_lines_between_the_markers_are_rewritten():
    start, end = drawing.MARKERS
    text = f"before\n{start}\nold\n{end}\nafter\n"
    once = drawing.rewritten(text, ["new"])
    assert once == f"before\n{start}\nnew\n{end}\nafter\n" == drawing.rewritten(once, ["new"])
    for bad in ("nothing", end + start, text + start):
        with pytest.raises(ValueError, match="needs the two lines"):
            drawing.rewritten(bad, [])


def test_peers_are_present_or_said_to_be_absent():
    here, absent = peers.present()
    assert set(here) | set(absent) == set(peers.PEERS) and not set(here) & set(absent) and "NumPy" in here
    assert all("pip install" in why for why in absent.values())


def test_figures_are_drawn(tmp_path):
    pytest.importorskip("matplotlib")
    fewer = RESULTS | {"sweeps": {"horizon": RESULTS["sweeps"]["horizon"]}}
    names = drawing.draw(fewer, tmp_path)
    assert names == ["horizon.png", "horizon_compile.png"] and all(
        (tmp_path / n).stat().st_size > 5000 for n in names
    )


UPWARD = 0x800
LIBRARY = ctypes.CDLL(ctypes.util.find_library("m"))


class RoundsUpward(MagicMock):
    """Stands in for codac: the import, and each call of whatever it has, sets the processor to round
    upward.
    """

    def _mock_call(self, *args, **options):
        LIBRARY.fesetround(UPWARD)
        return super()._mock_call(*args, **options)


ONE = (
    (np.ones((2, 1, 1)),) * 2,
    (np.ones((2, 1)),) * 2,
)  # two systems of one unknown: the ends of the matrix, and of the right side
CODAC = {
    "peers": lambda: peers.load("codac"),
    "paving": lambda: paving.peer_sivia([((0.0, 0.0), (1.0, 1.0))], 0.1),
    "varying": lambda: varying.set_inversion(np.ones((4, 1)), np.ones((4, 1))),
    "intervals": lambda: intervals.scalar_libraries(),
    "linear systems": lambda: linear_systems.fastest({"codac": linear_systems.codac(*ONE, True)}, 1),
    "sweeps": lambda: sweeps.Series("title", "x", "unit", (1,)).time(
        "codac", 1, 1, lambda: bool(sys.modules["codac"].eval()), True, 1
    ),
}


@pytest.mark.skipif(
    platform.machine() != "x86_64", reason="the numbers of the modes are those of this processor family"
)
@pytest.mark.parametrize("benchmark", CODAC)
def test_a_peer_that_leaves_the_processor_rounding_upward_leaves_it_so_for_itself_only(
    benchmark, monkeypatch
):
    peer = RoundsUpward()
    monkeypatch.setitem(sys.modules, "codac", peer)
    monkeypatch.setattr(sweeps.jax, "clear_caches", lambda: None)  # the other tests' too, ten seconds' work
    monkeypatch.setattr(intervals, "seconds", lambda f, a, b: f(a, b))
    monkeypatch.setattr(importlib, "import_module", lambda name: peer())
    try:
        with timing.own_rounding():
            peer()
            assert LIBRARY.fegetround() == UPWARD
        CODAC[benchmark]()
        assert LIBRARY.fegetround() == 0
    finally:
        LIBRARY.fesetround(0)
