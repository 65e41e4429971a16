"""Put the figures of benchmarks.zonotopes and benchmarks.zonotope_algebra into docs/benchmarks.md.

python -m benchmarks.zonotope_tables, after both of them; rows of the first table are found by their first
cell.
"""

import json
from pathlib import Path

from benchmarks import drawing

HERE = Path(__file__).parent
MARKERS = "<!-- zonotopes: start -->", "<!-- zonotopes: end -->"
PEERS = ("HiGHS", "zonoopt", "linrax", "mpax")
POINTS = "1 000 points in a zonotope of 2 / 10 / 50 dimensions and twice as many generators, proved"
SUMS = (
    "zonotopes 4 x 20, rounded outward, on both cores: linear map / sum / strip / reduction without sorting"
)


def cell(row):
    """Return what a peer did: its time in terms of ours, how many of its answers were wrong, how many it did
    not give.
    """
    if not isinstance(row, dict):
        return ""
    said = [f"{row['ratio']:g}"]
    if row["wrong"]:
        said.append(f"{row['wrong']} of {row['of']} wrong")
    if row["decided"] < 1:
        said.append(f"{round((1 - row['decided']) * row['of'])} of {row['of']} open")
    return ", ".join(said)


def decisions(figures):
    """Return the lines of the table of containment and emptiness."""
    lines = [
        "| question | decided, wrong | us a test | " + " | ".join(PEERS) + " |",
        "|---|---|---|" + "---|" * len(PEERS),
    ]
    for name, row in figures.items():
        if isinstance(row, dict) and "decided" in row:
            peers = " | ".join(cell(row.get(peer)) for peer in PEERS)
            lines.append(
                f"| {name} | {100 * row['decided']:g} %, {row['wrong']} | {row['us a test']:,.4g} | {peers} |"
            )
    return lines


def algebra(figures):
    """Return the lines of the table of operations."""
    columns = (
        "million sets/s",
        "share of the limit",
        "ratio to NumPy",
        "ratio to zonoopt",
        "ratio to codac, boxes",
        "first call s",
    )
    lines = ["| operation | " + " | ".join(columns) + " |", "|---|" + "---|" * len(columns)]
    for shape, table in figures.items():
        for name, row in table.items() if isinstance(table, dict) else ():
            if isinstance(row, dict):
                lines.append(
                    f"| {shape}, {name} | "
                    + " | ".join(f"{row[c]}" if c in row else "" for c in columns)
                    + " |"
                )
    return lines


def replaced(text, first, row):
    """Return a text with the one row of a table whose first cell this is; raises ValueError where there is
    none, or two.
    """
    lines = text.split("\n")
    at = [i for i, line in enumerate(lines) if line.startswith(f"| {first} |")]
    if len(at) != 1:
        raise ValueError(f"the text needs one row of a table whose first cell is {first!r}: it has {len(at)}")
    lines[at[0]] = f"| {first} | {' | '.join(row)} |"
    return "\n".join(lines)


def main():
    """Rewrite the page."""
    points, sums = (
        json.loads((HERE / f"{name}.json").read_text()) for name in ("zonotopes", "zonotope_algebra")
    )
    about, here = (
        points["machine"],
        ", ".join(f"{k} {v}" for k, v in (points["peers"] | sums["peers"]).items()),
    )
    page = HERE.parent / "docs" / "benchmarks.md"
    busy = ", on a machine that did other work too" if "processor" in points["seconds"] else ""
    told = (
        f"{about['cpu']}, {about['cores']} cores, seconds {points['seconds']}{busy}, jax {about['jax']}; "
        f"{here}."
    )
    text = drawing.rewritten(page.read_text(), [*decisions(points), "", *algebra(sums), "", told], MARKERS)
    rows = lambda where, what: [points[f"{n} dimensions, one set, {where}"][what] for n in (2, 10, 50)]
    each = lambda values: " / ".join(f"{v:,.3g}" for v in values)
    near, far = "within 1e-6", "far"
    ratios = lambda where: each(row["ratio"] for row in rows(where, "HiGHS"))
    wrong = " / ".join(f"{100 * row['wrong'] / row['of']:.2g}" for row in rows(near, "HiGHS"))
    text = replaced(
        text,
        POINTS,
        [
            f"{each(rows(far, 'us a test'))} µs a point 5 % or more from the boundary, "
            f"{each(rows(near, 'us a test'))} within 1e-6 of it",
            f"HiGHS with a reused model {ratios(far)} and {ratios(near)} times as long; within 1e-6, {wrong} "
            f"% of its answers are wrong",
        ],
    )
    four = sums["4 x 20"]
    chosen = [
        four[name] for name in ("linear_map", "minkowski_sum", "strip_intersection", "reduce_order last")
    ]
    page.write_text(
        replaced(
            text,
            SUMS,
            [
                f"{each(row['million sets/s'] for row in chosen)} million sets/s",
                f"{each(row['share of the limit'] for row in chosen)} of what memory allows",
            ],
        )
    )


if __name__ == "__main__":
    main()
