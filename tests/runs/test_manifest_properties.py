"""Manifests that people write, drawn by hypothesis: units with names of any letters are read as they were
written, and a manifest with anything changed is a list of units or a sentence.
"""

import json
import tempfile
from pathlib import Path

import hypothesis
from hypothesis import strategies as st

from jaxbound.runs.fleet import Unit, read_manifest

letters = st.characters(exclude_categories=("Cc", "Cs"), exclude_characters="\ufeff")
names = st.text(letters, min_size=1, max_size=8).map(str.strip).filter(bool)
paths = st.from_regex(r"[a-z0-9_ ]{1,6}\.(csv|toml)", fullmatch=True).map(str.strip)
fleets = st.lists(st.tuples(names, paths, paths), min_size=1, max_size=5, unique_by=lambda row: row[0])
few = hypothesis.settings(max_examples=40)
many = hypothesis.settings(max_examples=80)


def read(text, kind):
    """Return the units of a manifest, and the folder where it lies."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"fleet.{kind}"
        path.write_bytes(text.encode())
        return read_manifest(path), Path(folder)


def in_quotes(cell):
    """Return a cell in quotes, as every table program writes it; without them it may hold a delimiter."""
    return '"' + cell.replace('"', '""') + '"'


@few
@hypothesis.given(fleets, st.sampled_from(",;\t"), st.sampled_from(["\n", "\r\n", "\r"]), st.booleans())
def test_a_manifest_in_any_dialect_names_its_units(fleet, delimiter, end, mark):
    rows = [delimiter.join(map(in_quotes, row)) for row in fleet]
    head = delimiter.join(("unit", "model", "recording"))
    units, folder = read("\ufeff" * mark + end.join([head, *rows]) + end, "csv")
    assert units == [Unit(name, folder / model, folder / data) for name, model, data in fleet]


@few
@hypothesis.given(fleets)
def test_a_manifest_of_blocks_names_its_units(fleet):
    field = lambda name, value: f"{name} = {json.dumps(value, ensure_ascii=False)}\n"
    blocks = [
        "[[units]]\n" + field("unit", name) + field("model", model) + field("recording", data)
        for name, model, data in fleet
    ]
    units, folder = read("".join(blocks), "toml")
    assert units == [Unit(name, folder / model, folder / data) for name, model, data in fleet]


TABLE = "unit,model,recording\n" + "".join(f"P-{k},m.toml,{k}.csv\n" for k in range(4))
BLOCKS = '[[units]]\nunit = "P-1"\nmodel = "m.toml"\nrecording = "1.csv"\n' * 2
SIGNS = "abc019.,;\t\r\n\"'[]=-# \0\ufeff\u2028ä"
CHANGES = st.lists(
    st.tuples(st.integers(0, len(BLOCKS)), st.integers(0, 5), st.text(st.sampled_from(SIGNS), max_size=4)),
    max_size=4,
)


@many
@hypothesis.given(CHANGES, st.sampled_from([(TABLE, "csv"), (BLOCKS.replace("P-1", "P-2", 1), "toml")]))
def test_a_changed_manifest_is_a_fleet_or_a_sentence(changes, written):
    text, kind = written
    for at, length, piece in changes:
        text = text[:at] + piece + text[at + length :]
    try:
        units, _ = read(text, kind)
    except ValueError as error:
        words = str(error)
        assert 10 < len(words) < 2300 and words.isprintable(), words
    else:
        assert len({unit.name for unit in units}) == len(units) > 0
