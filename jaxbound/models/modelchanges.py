"""Fields of a model file that stand in place of others: what a test of a monitor states for itself."""

from collections.abc import Iterator, Mapping
from typing import Any

from jaxbound.models.filevalues import Table
from jaxbound.models.modelfields import LISTS, READ_BY
from jaxbound.recordings.recordingformat import TABLE

MERGED = ("inputs", "outputs")
"""Tables that are changed by the name of their signal; others stand in place of those of the file."""
ABSENT: Mapping[str, object] = {"averages": [], "noise": "0", "resolution": "0", "offset": "0"}
"""Fields of a signal that are stated where one model has them and the other has not."""
ONCE = ("test", "name")
"""Fields that a test does not repeat."""


def with_changes(document: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return the document of a model file with fields that stand in place of its own.

    Raises:
        ValueError: a field by which the recording is read, a signal that the file has not.
    """
    changed = dict(document)
    for key, value in changes.items():
        if key in (*READ_BY, TABLE, "test"):
            raise ValueError(f"{key} is for the whole file: a recording is read once for all tests")
        if key == "horizon":
            # a window is said by either: the other of the file would contradict it
            changed.pop("lags", None)
        if key == "lags":
            changed.pop("horizon", None)
        if key in MERGED:
            value = _by_name(key, document.get(key, []), value)
        elif isinstance(value, dict) and key not in LISTS:
            value = {**document.get(key, {}), **value}
        changed[key] = value
    return changed


def _by_name(place: str, tables: list[Table], changes: object) -> list[Table]:
    """Return tables of signals with fields that stand in place of their own, found by their names."""
    if not isinstance(changes, list):
        raise ValueError(f"{place} must be tables with the name of a signal each")
    changed = {table["name"]: dict(table) for table in tables}
    for change in changes:
        name = change.get("name")
        if name not in changed:
            raise ValueError(f"{place} has no {name!r}: it has {', '.join(changed)}")
        changed[name] |= change
    return list(changed.values())


def changes_between(mine: Mapping[str, Any], theirs: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of the document of a model file that differ from those of another, its signals the
    same: what `with_changes` makes theirs of mine by, but for fields that it cannot take away.
    """
    changes: dict[str, Any] = {}
    for key, value in theirs.items():
        if key in ONCE or mine.get(key) == value:
            continue
        if key in MERGED:
            changes[key] = list(_changed_signals(mine[key], value))
        elif isinstance(value, dict):
            own = mine.get(key, {})
            changes[key] = {field: x for field, x in value.items() if own.get(field) != x}
        else:
            changes[key] = value
    return changes


def _changed_signals(mine: list[dict[str, Any]], theirs: list[dict[str, Any]]) -> Iterator[dict[str, Any]]:
    """Yield for each signal whose fields differ its name and those fields."""
    for before, after in zip(mine, theirs, strict=True):
        changed = {field: x for field, x in after.items() if before.get(field) != x}
        for field, nothing in ABSENT.items():
            if field in before and field not in after:
                changed[field] = nothing
        if changed:
            yield {"name": after["name"], **changed}
