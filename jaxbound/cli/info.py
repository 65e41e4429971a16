"""The command `jaxbound info`: what a model file says, and what can be detected and isolated with it."""

import argparse
import json
import math

from jaxbound.cli.terminal import OK, Refused, door, progress_bars, show, write
from jaxbound.cli.window import window_relations
from jaxbound.diagnosis.detectability import detectable
from jaxbound.diagnosis.hints import bound_hints
from jaxbound.models.modelfile import load_model, template
from jaxbound.models.system import LinearSystem
from jaxbound.plots.residuals import distinct_relations
from jaxbound.relations.cost import elimination_seconds, relation_cost
from jaxbound.relations.decoupling import isolability, signatures, structured_relations
from jaxbound.relations.redundancy import redundancy
from jaxbound.relations.sentence import main_terms
from jaxbound.relations.uncertain import UncertainRelations
from jaxbound.text.quantities import rough_duration

__all__ = ["isolation_text", "run"]

SIGNALS = 12
"""Up to here relations of minimal support are looked for and every pair of faults is listed."""
PATIENCE = 60.0
"""Seconds, roughly, beyond which tables are left to whoever asks for them."""


def run(args: argparse.Namespace) -> int:
    """Run `jaxbound info`; return the exit code."""
    if args.template == (args.model is not None):
        raise Refused("jaxbound info needs either a model file or --template")
    if args.template:
        write(template())
        return OK
    with door(), progress_bars(("relations",)) as step:
        m, r = window_relations(load_model(args.model), args, args.model, None, step)
    if args.json:
        write(json.dumps(_plain(m, r), indent=1, allow_nan=False, ensure_ascii=False) + "\n")
        return OK
    exact = lambda names, values: (
        ", ".join(f"{n} {float(v):.6g}" for n, v in zip(names, values, strict=True) if v) or "none"
    )
    signals = lambda names: ", ".join(f"{n} [{m.unit(n)}]" if m.unit(n) else n for n in names) or "none"
    origin = lambda field: (
        f"({x})" if (x := m.provenance.get(field) or ("" if _bare(m, field) else "origin not stated")) else ""
    )
    bounds = [
        (b, f"{exact(m.outputs, getattr(m, b))}   {origin(b)}".rstrip())
        for b in ("tolerance", "noise", "resolution")
    ]
    ranges = ", ".join(
        f"w{j + 1} in [{float(lo):.6g}, {float(hi):.6g}]" for j, (lo, hi) in enumerate(m.disturbance)
    )
    bounds += [("disturbance", f"{ranges}   {origin('disturbance')}")] if m.g else []
    bounds += [("average", f"{a.text} within {float(a.bound):.6g}") for a in m.averages]
    bounds += [("unknown inputs", f"{m.d}, of which nothing is known")] if m.d else []
    bounds += [
        (
            "parameter",
            f"{p.name} in [{float(p.between[0]):.6g}, {float(p.between[1]):.6g}], "
            f"{'varies' if p.varying else 'constant'}",
        )
        for p in m.uncertainties
    ]
    if isinstance(r, UncertainRelations):
        tested = f"polynomials of order {r.order} in {len(r.variables)} uncertain numbers"
    else:
        tested = (
            f"{len(r.circuits)} combinations tested"
            if r.frame is None
            else "combinations too many to list, the worst is searched for"
        )
    rows = [
        ("states", f"{m.n}: {', '.join(m.states)}"),
        ("inputs", f"{m.m}: {signals(m.inputs)}"),
        ("outputs", f"{m.p}: {signals(m.outputs)}"),
        ("dt", f"{m.dt:g} s"),
        (
            "matrices",
            f"A {m.n}x{m.n}, B {m.n}x{m.m}, C {m.p}x{m.n}, D {'present' if m.has_feedthrough else 'zero'}"
            f"   {origin('model')}",
        ),
        *bounds,
        ("offset", exact(m.inputs + m.outputs, m.offset["u"] + m.offset["y"])),
        *[(f"column of {s}" if s in m.inputs + m.outputs else s, c) for s, c in m.columns.items()],
        ("horizon", f"{r.horizon}: a window has {r.horizon + 1} samples"),
        *(
            [("lags", f"{', '.join(map(str, lags))}: so long before its last sample outputs are looked at")]
            if (lags := getattr(r, "lags", None))
            else []
        ),
        ("relations", f"{r.count} independent, {tested}"),
        *[("note", n) for n in getattr(r, "notes", ())],
        *[("hint", h) for h in bound_hints(m)],
    ]
    distinct = distinct_relations(r)
    if len(distinct) < r.count:
        rows.append(("", f"the {len(distinct)} below and the same some samples earlier"))
    lines = r.text().splitlines()
    text = "\n".join(main_terms(lines[j]) for j in distinct)
    show(
        m.name,
        "bold",
        rows,
        text=text
        if m.uncertainties
        else f"{text}\n\n{isolation_text(m, r.horizon, getattr(r, 'lags', None))}",
    )
    return OK


def _bare(model, field):
    """Return whether a bound of the sensors is 0 throughout, so that it has no origin."""
    return field in ("tolerance", "noise", "resolution") and not any(getattr(model, field))


def _plain(model, r):
    """Return what --json prints: the model file's own words and numbers, the relations, and the sizes that
    are guaranteed.
    """

    def signals(side, names, *bounds):
        found = []
        for i, name in enumerate(names):
            about = {
                "name": name,
                "unit": model.unit(name),
                "column": model.column(name),
                "offset": float(model.offset[side][i]),
            }
            if name in model.ranges and side == "u":
                about["range"] = [float(x) for x in model.ranges[name]]
            found.append(about | {bound: float(getattr(model, bound)[i]) for bound in bounds})
        return found

    parameters = [
        {"name": p.name, "between": [float(x) for x in p.between], "varying": p.varying}
        for p in model.uncertainties
    ]
    told = {
        "name": model.name,
        "dt": model.dt,
        "horizon": r.horizon,
        "states": list(model.states),
        "inputs": signals("u", model.inputs),
        "outputs": signals("y", model.outputs, "tolerance", "noise", "resolution"),
        "unknown_inputs": model.d,
        "disturbances": [[float(x) for x in ends] for ends in model.disturbance],
        "parameters": parameters,
        "provenance": dict(model.provenance),
        "relations": r.text().splitlines(),
        "notes": list(getattr(r, "notes", ())),
        "hints": bound_hints(model),
    }
    if not model.uncertainties and not any(model.tolerance) and _seconds(model, r.horizon) <= PATIENCE:
        sizes = _guaranteed(model, r.horizon, getattr(r, "lags", None))
        told["guaranteed"] = {name: None if math.isinf(size) else float(size) for name, size in sizes.items()}
    return told


def _seconds(model, horizon):
    """Return about how long the tables of `isolation_text` take."""
    signals = model.outputs + model.inputs
    return len(signals) * (elimination_seconds(model, model.n, unknown=1) + relation_cost(model, horizon)[0])


def _guaranteed(model, horizon, lags):
    """Return {signal: size} of the constant faults that fill a window and are detected whatever else
    happens.
    """
    window = {"horizon": max(horizon, redundancy(model).horizon)} if lags is None else {"lags": lags}
    return {name: detectable(model, name, **window) for name in model.outputs + model.inputs}


def isolation_text(model: LinearSystem, horizon: int, lags: tuple[int, ...] | None = None) -> str:
    """Return paragraphs on a certain model: its relations of fewest signals, which single faults they tell
    apart, guaranteed sizes.
    """
    signals = model.outputs + model.inputs
    if len(signals) > SIGNALS:
        return (
            f"(more than {SIGNALS} signals: jb.structured_relations(model, [...]) has the relations that "
            f"ignore those of your choice)"
        )
    seconds = _seconds(model, horizon)
    if seconds > PATIENCE:
        return (
            f"(signatures, isolability and guaranteed sizes are not worked out: that would take "
            f"{rough_duration(seconds)}; "
            "jb.isolability(model) and jb.detectable(model, signal, horizon) do it)"
        )
    out = []
    try:
        bank = structured_relations(model)
    except ValueError as e:
        return f"(no table of signatures: {e})"
    if bank.count:
        out += [
            "relations of fewest signals, q the step to the next sample:",
            *map(main_terms, bank.text().splitlines()),
            "",
        ]
        out += [
            "how they react to a fault of one signal: 1 yes, t only while it changes, . not at all",
            signatures(bank).text(),
            "",
        ]
    out += [
        "a fault of the row shows although that of the column is ignored: 1 yes, t only while it changes, . "
        "no",
        isolability(model).text(),
        "",
    ]
    return "\n".join([*out, *_sizes(model, horizon, lags)])


def _sizes(model, horizon, lags):
    if any(model.tolerance):
        return [
            "guaranteed sizes depend on the operating range: jb.detectable(model, signal, "
            "operating_range=...)"
        ]
    samples = (max(horizon, redundancy(model).horizon) if lags is None else lags[-1]) + 1
    lines = [
        f"a constant fault that fills a window of {samples} samples is detected, whatever else happens, from "
        f"this size on:"
    ]
    for name, size in _guaranteed(model, horizon, lags).items():
        amount = "never guaranteed" if math.isinf(size) else f"{float(size):.4g} {model.unit(name)}".rstrip()
        lines.append(f"{name}: {amount}")
    return lines
