"""Relations as a reader would write them."""

from typing import Any

from jaxbound.exact.linalg import Vector
from jaxbound.models import window
from jaxbound.models.system import LinearSystem

__all__ = ["few_lines", "latched", "looked_at", "relation_text", "remembers"]

FEW = 8
"""Relations that are shown at a prompt."""


def remembers(relations: Any) -> bool:
    """Return whether verdicts rest on all samples before, as those of an observer, and not on windows."""
    return getattr(relations, "remembers", False)


def latched(relations: Any) -> bool:
    """Return whether a FAULT stays until a gap, as that of an observer that does not begin anew."""
    return remembers(relations) and not relations.restart


def looked_at(relations: Any) -> str:
    """Say what a verdict of relations, or of an observer, rests on."""
    if remembers(relations):
        return "everything since it began"
    return f"windows of {relations.horizon + 1} samples"


def few_lines(relations: Any) -> dict[str, str]:
    """Return what relations show of themselves at a prompt: their model, and each of them where they are few."""
    lines = relations.text().splitlines() if relations.count <= FEW else ()
    return {"model": repr(relations.model), **{f"{i + 1}": line for i, line in enumerate(lines)}}


def relation_text(model: LinearSystem, horizon: int, h: Vector, k: Vector) -> str:
    """Return one relation h Y - k U = 0 as text."""
    at = [f"[k-{horizon - j}]" if j < horizon else "[k]" for j in range(horizon + 1)]
    count = (horizon + 1) * model.p
    terms = [(x, model.outputs[i % model.p] + at[i // model.p]) for i, x in enumerate(h[:count])]
    averaged = count + model.g * horizon
    terms += [(x, f"w{i % model.g + 1}" + at[i // model.g]) for i, x in enumerate(h[count:averaged])]
    for x, (a, rows) in zip(h[averaged:], window.runs(model, horizon), strict=False):
        last = rows[-1] // model.p if rows[-1] < count else (rows[-1] - count) // model.g
        terms.append((x, f"({model.averages[a].text})" + at[last]))
    terms += [(-x, model.inputs[i % model.m] + at[i // model.m]) for i, x in enumerate(k)]
    out = ""
    for x, signal in terms:
        if x:
            sign = ("- " if x < 0 else "") if not out else (" - " if x < 0 else " + ")
            size = abs(x)
            factor = "" if size == 1 else f"{size} " if size.denominator == 1 else f"{float(size):.6g} "
            out += sign + factor + signal
    return out + " = 0"
