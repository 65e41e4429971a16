"""The runner of the benchmarks: who takes part, the table, and where it goes; nothing is measured here."""

import pytest

from benchmarks import drawing, peers

RESULTS = {
    "machine": {"cpu": "a CPU", "cores": 2, "device": "cpu", "jax": "0"},
    "date": "today",
    "peers": {"NumPy": "2"},
    "absent": {"codac": "no"},
    "sweeps": {
        "limits": {"float64": {"one pass": {"windows/s": 2e8, "share of the memory limit": 1.0},
                               "margins": {"windows/s": 1e8, "share of the memory limit": 0.5}}, "float32": {}},
        "horizon": {"title": "a plant", "x": "horizon", "unit": "windows/s", "sizes": [1, 8], "failed": {}, "series": {
            "jaxbound detect": {"proved": True, "rates": [5e7, 123456.0], "first call s": [1, 2]},
            "HiGHS": {"proved": False, "rates": [6000.0], "first call s": [0]}}},
    },
}  # fmt: skip


def test_table_has_a_line_for_the_ends_of_each_sweep():
    lines = drawing.table(RESULTS)
    assert lines[2] == "| section 5, horizon 1, float64, windows/s | margins 100 million | one pass 200 million |"
    assert "| a plant, horizon 1, windows/s | detect 50 million | HiGHS 6 thousand |" in lines
    assert "| a plant, horizon 8, windows/s | detect 123 thousand |  |" in lines and lines[-1] == "Not installed: codac."


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


@pytest.mark.slow
def test_figures_are_drawn(tmp_path):
    pytest.importorskip("matplotlib")
    fewer = RESULTS | {"sweeps": {"horizon": RESULTS["sweeps"]["horizon"]}}
    names = drawing.draw(fewer, tmp_path)
    assert names == ["horizon.png", "horizon_compile.png"] and all((tmp_path / n).stat().st_size > 5000 for n in names)
