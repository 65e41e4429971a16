"""Every notebook runs from top to bottom, uses public names only and stays short."""

import re
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

import jaxbound as jb

NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.ipynb"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of the notebook machinery, not of the notebook
def test_notebook_runs(path, kernels):
    NotebookClient(
        nbformat.read(path, as_version=4), timeout=300, resources={"metadata": {"path": str(path.parent)}}
    ).execute()


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_notebook_is_short_and_uses_public_names_only(path):
    cells = nbformat.read(path, as_version=4).cells
    assert len(cells) <= 15
    source = "\n".join(c.source for c in cells if c.cell_type == "code")
    assert set(re.findall(r"\bjb\.(\w+)", source)) <= set(jb.__all__)
    assert "from jaxbound" not in source


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_every_figure_of_a_notebook_is_kept_as_a_picture(path):
    """Pages show what was kept: the text "<Figure size ..>" shows nobody anything."""
    outputs = [o for c in nbformat.read(path, as_version=4).cells for o in c.get("outputs", ())]
    shown = [o["data"] for o in outputs if "data" in o]
    drawn = [data for data in shown if re.match(r"<\w+ size .* Axes", data.get("text/plain", ""))]
    assert drawn and all("image/png" in data for data in drawn)
