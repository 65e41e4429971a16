"""Figures and the table of docs/benchmarks.md from the results of the sweeps."""

from pathlib import Path

__all__ = ["MARKERS", "draw", "rewritten", "table"]

MARKERS = "<!-- benchmarks: start -->", "<!-- benchmarks: end -->"
FIGURES = Path(__file__).parent / "figures"


def draw(results, folder=FIGURES):
    """Write a PNG for each sweep, for the shares of the limits and for compile times; return their names."""
    from matplotlib.figure import Figure

    folder.mkdir(exist_ok=True)
    names, sweeps = [], {k: v for k, v in results["sweeps"].items() if "series" in v and v["series"]}
    for name, sweep in sweeps.items():
        for what, field, unit in (
            ("", "rates", sweep["unit"]),
            ("_compile", "first call s", "first call, s"),
        ):
            figure = Figure((7, 4.2), layout="constrained")
            axes = figure.subplots()
            for who, series in sweep["series"].items():
                if what and not who.startswith("jaxbound"):
                    continue
                values = series[field]
                points = [(x, v) for x, v in zip(sweep["sizes"], values, strict=False) if v is not None]
                ours = who.startswith("jaxbound")
                label = who if what else f"{who}, {'proved' if series['proved'] else 'not proved'}"
                axes.plot(
                    *zip(*points, strict=True),
                    "o-" if ours else "s--",
                    lw=2 if ours else 1.2,
                    ms=4,
                    label=label,
                )
            axes.set(
                xlabel=sweep["x"],
                ylabel=unit,
                title=sweep["title"] + (", compilation" if what else ""),
                yscale="log",
            )
            if sweep["x"] == "boxes":
                axes.set_xscale("log")
            else:
                axes.set_xticks(sweep["sizes"])
            axes.grid(alpha=0.3)
            axes.legend(fontsize=8, frameon=False)
            names.append(_save(figure, folder / f"{name}{what}.png"))
    if "limits" in results["sweeps"]:
        figure = Figure((7, 3), layout="constrained")
        axes = figure.subplots()
        bars = [
            (f"{who}, {kind}", row["share of the memory limit"])
            for kind in ("float64", "float32")
            for who, row in results["sweeps"]["limits"][kind].items()
            if who != "one pass"
        ]
        axes.barh(*zip(*bars[::-1], strict=True), color="#1565c0")
        axes.set(xlabel="share of the speed of one pass over the same bytes", xlim=(0, 1))
        names.append(_save(figure, folder / "limits.png"))
    return names


def _save(figure, path):
    figure.savefig(path, dpi=110)
    return path.name


def table(results):
    """Return the results as lines of a Markdown table: jaxbound's rate beside each peer's, at the ends of
    each sweep.
    """
    lines = ["| work | jaxbound | peers in the same run |", "|---|---|---|"]
    for kind in ("float64", "float32"):
        row = results["sweeps"].get("limits", {}).get(kind)
        if row:
            ours = ", ".join(
                f"{who} {rate(row[who]['windows/s'])}" for who in ("margins", "detect") if who in row
            )
            theirs = ", ".join(
                f"{who} {rate(r['windows/s'])}" for who, r in row.items() if who not in ("margins", "detect")
            )
            lines.append(f"| section 5, horizon 1, {kind}, windows/s | {ours} | {theirs} |")
    for sweep in results["sweeps"].values():
        for at in sorted({0, len(sweep.get("sizes", ())) - 1} & set(range(len(sweep.get("sizes", ()))))):
            shown = {
                who: s["rates"][at]
                for who, s in sweep["series"].items()
                if at < len(s["rates"]) and s["rates"][at]
            }
            side = lambda ours, shown=shown: ", ".join(
                f"{who.removeprefix('jaxbound ')} {rate(v)}"
                for who, v in shown.items()
                if who.startswith("jaxbound") == ours
            )
            if shown:
                lines.append(
                    f"| {sweep['title']}, {sweep['x']} {sweep['sizes'][at]}, {sweep['unit']} | {side(True)} "
                    f"| {side(False)} |"
                )
    about = results["machine"]
    here = ", ".join(f"{name} {version}" for name, version in results["peers"].items())
    lines += [
        "",
        f"{about['cpu']}, {about['cores']} cores, {about['device']}, jax {about['jax']}, {results['date']}; "
        f"{here}.",
    ]
    if results["absent"]:
        lines.append(f"Not installed: {', '.join(results['absent'])}.")
    return lines


def rate(x):
    """Return a rate as a reader would say it."""
    for size, word in ((1e6, " million"), (1e3, " thousand")):
        if x >= size:
            return f"{x / size:.3g}{word}"
    return f"{x:.3g}"


def rewritten(text, lines, markers=MARKERS):
    """Return a text with the lines between the markers replaced; raises ValueError where it has no
    markers.
    """
    start, end = markers
    if text.count(start) != 1 or text.count(end) != 1 or text.index(start) > text.index(end):
        raise ValueError(f"the text needs the two lines {start} and {end}, once each, in this order")
    before, after = text.split(start)[0], text.split(end)[1]
    return "\n".join([before + start, *lines, end + after])
