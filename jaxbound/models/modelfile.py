"""Model files: TOML in, TOML out, every decimal kept exactly.

Saving and loading again gives the same model, Fraction by Fraction: see `filevalues` for the numbers, and
`modelfields` for the table of all fields.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, MutableMapping
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxbound.files.whole import put
from jaxbound.models.filevalues import NUMBER, TEXT, number_text
from jaxbound.models.modelchanges import changes_between, with_changes
from jaxbound.models.modelfields import LISTS, Entry, model_arguments, value_texts
from jaxbound.models.statedtests import test_lines
from jaxbound.models.system import LinearSystem
from jaxbound.models.template import template

if TYPE_CHECKING:
    from tomlkit import TOMLDocument

__all__ = [
    "changed_text",
    "load_model",
    "model_document",
    "model_text",
    "number_text",
    "save_model",
    "template",
]

SHARED = ("inputs", "outputs", "dt", "columns")
"""Arguments of a model by which recordings are read."""
RECORDED = (".csv", ".parquet", ".pq", ".tsv", ".xlsx")  # ends of names of what is no model


def load_model(path: str | PathLike[str]) -> LinearSystem:
    """Read a LinearSystem from a TOML file; `jaxbound info --template` prints a commented one.

    Args:
        path: of the file, UTF-8.

    Raises:
        OSError: no such file, or it cannot be read.
        ValueError: not TOML (names the line), an unknown field (names the nearest), numbers that do not make
            a model.

    Example:
        >>> import tempfile, pathlib
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "tank.toml"
        >>> _ = path.write_text(template())
        >>> load_model(path).outputs
        ('level', 'flow')
    """
    return _loaded(Path(path), alone=False)


def _loaded(path: Path, alone: bool) -> LinearSystem:
    """Return the model of a file. alone: tests of it name no other files."""
    import tomllib

    text = ""
    if path.is_dir():
        raise IsADirectoryError(f"{path} is a folder: a model file is needed")
    if not path.exists():
        raise FileNotFoundError(f"there is no model file {path}")
    try:
        # Windows puts a byte order mark in front, on which tomllib stumbles
        text = path.read_bytes().decode("utf-8-sig")
        return _parsed(text, None if alone else path.parent)
    except UnicodeDecodeError:
        raise ValueError(
            f"{path}: this is not a text file in UTF-8, so it is no model file{_swapped(path)}"
        ) from None
    except tomllib.TOMLDecodeError as e:
        raise ValueError(
            f"{path}: this is not valid TOML: {e}{_swapped(path) or _comma(text, str(e))}"
        ) from None
    except RecursionError:
        raise ValueError(f"{path}: this is no model file: its lists are nested too deeply") from None
    except ValueError as e:
        raise ValueError(f"{path}: {e}{_swapped(path)}") from None


def _swapped(path: Path) -> str:
    """Return the end of a sentence on a file that looks like a recording, "" of any other."""
    if path.suffix.lower() in RECORDED:
        return "; it looks like a recording: the model comes first"
    return ""


def _comma(text: str, failure: str) -> str:
    """Return the end of a sentence on a number with a decimal comma in the line that TOML stumbles over."""
    at = re.search(r"at line (\d+)", failure)
    lines = text.splitlines()
    if not at or int(at[1]) > len(lines):
        return ""
    number = re.search(r"=\s*([-+]?\d+),(\d+)\s*(#.*)?$", lines[int(at[1]) - 1])
    if not number:
        return ""
    return f"; write {number[1]}.{number[2]} with a point"


def save_model(model: LinearSystem, path: str | PathLike[str]) -> None:
    """Write a LinearSystem to a TOML file from which `load_model` reads the very same model.

    What the file held before is replaced, completely or not at all; only the commands of the shell ask first.
    A model that `fit` returned has its recipe written too; one that was read from a file has none.

    Args:
        model: a LinearSystem. path: of the file to write.

    Raises:
        TypeError: not a LinearSystem. OSError: it cannot be written.
    """
    if not isinstance(model, LinearSystem):
        raise TypeError(f"save_model needs a LinearSystem, not {type(model).__name__}")
    put(path, model_text(model).encode())


def _parsed(text: str, folder: Path | None) -> LinearSystem:
    """Return the model that the text of a file states. folder: of the file; None: files that its tests name
    are not looked for.
    """
    document = _document(text)
    tests = document.get("test")
    if isinstance(tests, list) and any(isinstance(test, dict) and _names_a_file(test) for test in tests):
        if folder is None:
            raise ValueError("a test names the file of its model: here one model is needed")
        alone = {key: value for key, value in document.items() if key != "test"}
        base = LinearSystem(**model_arguments(alone))
        document["test"] = [_with_its_model(base, test, folder) for test in tests]
    return LinearSystem(**model_arguments(document))


def _document(text: str) -> dict[str, Any]:
    """Return the text of a model file as tables, decimals as texts, which lose no digit."""
    import tomllib

    # TOML's own underscores stand in numbers only: those in quotes are refused
    return tomllib.loads(text, parse_float=lambda number: number.replace("_", ""))


def _names_a_file(test: Mapping[str, Any]) -> bool:
    """Return whether the model of a test is that of another file."""
    return isinstance(test.get("model"), str)


def _with_its_model(base: LinearSystem, test: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Return the table of a test with the fields of the model file that it names, as far as they differ.

    Raises:
        ValueError: other signals, dt or ways to read a recording; tests of its own; fields that it lacks.
    """
    if not _names_a_file(test):
        return test
    file, where = test["model"], f"model of test {test.get('name')!r}"
    try:
        other = _loaded(folder / file, alone=True)
    except (OSError, ValueError) as e:
        raise ValueError(f"{where}: {e}") from None
    other = other.replace(alarms=base.alarms)  # alarms are those of the monitor
    for field in SHARED:
        theirs, own = getattr(other, field), getattr(base, field)
        if theirs != own:
            raise ValueError(
                f"{where}: {file} has {field} {theirs}, this file {own}: all tests of a monitor judge "
                f"the same samples"
            )
    if other.tests:
        raise ValueError(f"{where}: {file} states tests of its own: name a file with one model")
    mine = model_document(base)
    changes = changes_between(mine, model_document(other))
    changed = LinearSystem(**model_arguments(with_changes(mine, changes)))
    if model_text(changed.replace(name=other.name)) != model_text(other):
        raise ValueError(
            f"{where}: {file} leaves out what this file states, which a test cannot take away: state it "
            f"there, as 0 perhaps"
        )
    return {**test, "model": changes}


def model_text(model: LinearSystem) -> str:
    """Return the TOML text of a model, from which `load_model` reads the very same model."""
    lines: list[str] = []
    for entry, texts in value_texts(model).items():
        if entry.place in LISTS:
            lines += ["", f"[[{entry.place}]]"]
        elif entry.place:
            lines += ["", f"[{entry.place}]"]
        for name, text in texts.items():
            unit = "  # s" if name == "dt" else ""
            lines.append(f"{name} = {text}{unit}")
    if model.provenance:
        lines += ["", "[provenance]"]
        lines += [f"{name} = {TEXT.spell(origin)}" for name, origin in model.provenance.items()]
    for title, table in model._notes().items():
        lines += ["", f"[{title}]", *(f"{name} = {text}" for name, text in table.items())]
    for test in model.tests:
        lines += ["", *test_lines(test)]
    return "\n".join(lines) + "\n"


def model_document(model: LinearSystem) -> dict[str, Any]:
    """Return the file that `save_model` writes as tables, decimals as texts, which lose no digit."""
    return _document(model_text(model))


def changed_text(text: str, model: LinearSystem) -> str:
    """Return the text of a model file with the values of another model of the same signals.

    Comments, order and spacing stay, and equal values stay as they are spelled. Where that cannot be done, or
    a test names another file, the text is a new one: it reads back as the very same model, wherever it lies.

    Args:
        text: of a file that `load_model` reads. model: a copy with other bounds, windows or origins.
    """
    from tomlkit import parse
    from tomlkit.exceptions import TOMLKitError

    try:
        document = parse(text)
        before = _parsed(text, None)
        _change(document, before, model)
        changed = document.as_string()
        if _parsed(changed, None) == model:
            return changed
    except (TOMLKitError, ValueError, KeyError, IndexError):
        pass  # a spelling of TOML that tomlkit cannot change: the values matter more than the comments
    return model_text(model)


def _change(document: TOMLDocument, before: LinearSystem, after: LinearSystem) -> None:
    """Change the values of a tomlkit document where two models differ."""
    earlier = value_texts(before)
    for entry, new in value_texts(after).items():
        old = earlier.get(entry, {})
        table = _table_of(document, entry)
        for name in dict.fromkeys((*old, *new)):
            if old.get(name) != new.get(name):
                _set(table, name, new.get(name))
    for number, (was, test) in enumerate(zip(before.tests, after.tests, strict=True)):
        if was.factor != test.factor:  # other changes of tests are written anew
            _set(document["test"][number], "factor", NUMBER.spell(test.factor))
    if dict(before.provenance) != dict(after.provenance):
        if "provenance" not in document:
            document["provenance"] = {}
        for name, origin in after.provenance.items():
            if before.provenance.get(name) != origin:
                _set(document["provenance"], name, TEXT.spell(origin))


def _table_of(document: TOMLDocument, entry: Entry) -> MutableMapping[str, Any]:
    """Return the table of a document that an entry stands for."""
    table: MutableMapping[str, Any] = document
    if entry.place in LISTS:
        table = document[entry.place][entry.number]
    elif entry.place:
        table = document[entry.place]
    return table


def _set(table: MutableMapping[str, Any], name: str, text: str | None) -> None:
    """Give a field of a tomlkit table the value of a text; None: take the field away."""
    from tomlkit import value

    if text is None:
        table.pop(name, None)
    else:
        table[name] = value(text)
