"""What can be detected and isolated with a model, as text for `jaxbound info`."""

import math

from jaxbound.diagnosis.detectability import detectable
from jaxbound.models.system import LinearSystem
from jaxbound.relations.cost import duration_text, elimination_seconds, relation_cost
from jaxbound.relations.decoupling import isolability, signatures, structured_relations
from jaxbound.relations.redundancy import redundancy

__all__ = ["isolation_text"]

SIGNALS = 12
"""Up to here relations of minimal support are looked for and every pair of faults is listed."""
PATIENCE = 60.0
"""Seconds, roughly, beyond which tables are left to whoever asks for them."""


def isolation_text(model: LinearSystem, horizon: int) -> str:
    """Return paragraphs on a certain model: its relations of fewest signals, which single faults they tell apart, guaranteed sizes."""
    signals = model.outputs + model.inputs
    if len(signals) > SIGNALS:
        return f"(more than {SIGNALS} signals: jb.structured_relations(model, [...]) has the relations that ignore those of your choice)"
    seconds = len(signals) * (elimination_seconds(model, model.n, unknown=1) + relation_cost(model, horizon)[0])
    if seconds > PATIENCE:
        return (f"(signatures, isolability and guaranteed sizes are not worked out: that would take {duration_text(seconds)}; "
                "jb.isolability(model) and jb.detectable(model, signal, horizon) do it)")  # fmt: skip
    out = []
    try:
        bank = structured_relations(model)
    except ValueError as e:
        return f"(no table of signatures: {e})"
    if bank.count:
        out += ["relations of fewest signals, q the step to the next sample:", bank.text(), ""]
        out += ["how they react to a fault of one signal: 1 yes, t only while it changes, . not at all", signatures(bank).text(), ""]
    out += [
        "a fault of the row shows although that of the column is ignored: 1 yes, t only while it changes, . no",
        isolability(model).text(),
        "",
    ]
    return "\n".join([*out, *_sizes(model, signals, max(horizon, redundancy(model).horizon))])


def _sizes(model, signals, horizon):
    if any(model.tolerance):
        return ["guaranteed sizes depend on the operating range: jb.detectable(model, signal, operating_range=...)"]
    lines = [f"a constant fault that fills a window of {horizon + 1} samples is detected, whatever else happens, from this size on:"]
    for name in signals:
        size = detectable(model, name, horizon)
        amount = "never guaranteed" if math.isinf(size) else f"{float(size):.4g} {model.unit(name)}".rstrip()
        lines.append(f"{name}: {amount}")
    return lines
