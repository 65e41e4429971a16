"""The pictures of the first pages: `python -m benchmarks.pictures [FOLDER]`, where the commands run.

- docs/pictures/report.png: the page of the tutorial's jump, as a browser shows it; needs chromium
- docs/pictures/verdicts.svg: what windows, means, lags and a monitor of two say of that jump
- docs/pictures/sizes.svg: the smallest faults that tests see, as `python -m benchmarks.memory` measures them
- docs/pictures/which.svg: which test for which fault
- docs/pictures/check.svg: what is searched for a window, and what is proved
- docs/pictures/house.svg: the folders of jaxbound, floor by floor

What stands in FOLDER already is used. SVG files are light or dark, as the reader's system is.
"""

import csv
import io
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

__all__ = ["check", "house", "sizes", "verdicts", "which", "write"]

PICTURES = Path(__file__).parents[1] / "docs" / "pictures"
SIGNALS = ["--inputs", "Q1=Heater 1,Q2=Heater 2", "--outputs", "T1=Temperature 1,T2=Temperature 2"]
FITS = {
    "windows": ("windows of 16 samples", ["--recipe", "horizon=15"]),
    "lags": ("8 of 61 samples (lags)", ["--recipe", "lags=0,1,2,4,8,16,32,60"]),
    "means": ("windows of 31, means of 8", ["--recipe", "horizon=30,average=8"]),
    "plant": ("a monitor of two tests", []),
}
"""{model file: (what it tests, options of `fit`)}."""
WIDTH, HEIGHT = 1280, 1180  # px of the page that the picture shows
COLOURS, LARGEST = 160, 150_000  # of the picture, and its bytes

STYLE = """<style>
text { font: 15px system-ui, "Segoe UI", "DejaVu Sans", sans-serif; fill: #1b2733 }
.soft { fill: #5b6672; font-size: 13px } .head { font-weight: 600 }
.code { font: 12.5px ui-monospace, "DejaVu Sans Mono", monospace; fill: #16324f }
.page { fill: #fff } .card { fill: #f5f7f9; stroke: #aab4be }
.line { stroke: #5b6672; fill: none; stroke-width: 1.5 }
.curve { stroke: #16324f; fill: none; stroke-width: 2 }
.FAULT { fill: #b33c00 } .CONSISTENT { fill: #6fcfb0 } .MISSING { fill: #c9ccd1 }
@media (prefers-color-scheme: dark) {
text { fill: #e6eaee } .soft { fill: #a3adb8 } .code { fill: #a9d0f5 }
.page { fill: #14181d } .card { fill: #1e242b; stroke: #5b6672 }
.line { stroke: #a3adb8 } .curve { stroke: #cfe4f7 }
.FAULT { fill: #ff9655 } .CONSISTENT { fill: #0c6450 } .MISSING { fill: #4a525b } }
</style>"""


def words(x, y, text, kind="", anchor="start"):
    """Return a line of text at (x, y), px."""
    return f'<text x="{x:.1f}" y="{y:.1f}" class="{kind}" text-anchor="{anchor}">{text}</text>'


def box(x, y, width, height, kind, corner=0):
    """Return a rectangle."""
    place = f'x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="{height:.1f}"'
    return f'<rect {place} rx="{corner}" class="{kind}"/>'


def drawing(width, height, label, parts):
    """Return the text of an SVG file with a ground of its own."""
    kind = 'xmlns="http://www.w3.org/2000/svg" role="img"'
    head = f'<svg {kind} viewBox="0 0 {width} {height}" aria-label="{label}">'
    return "\n".join([head, STYLE, box(0, 0, width, height, "page", 8), *parts, "</svg>"]) + "\n"


TREE = (
    ("several of these, or who knows", "a monitor of several tests", "jaxbound fit ... --out plant.toml"),
    ("a jump", "windows of 16 samples", "fit ... --recipe horizon=15"),
    ("an error that lasts", "longer windows, with bounds on means", "fit ... --recipe horizon=30,average=8"),
    ("a slow drift", "lags, as far back as the plant remembers", "fit ... --recipe lags=0,1,2,4,8,16,32,60"),
    (
        "faults of an uncertain plant",
        "an observer: everything since the start",
        "detect ... --test observer=joint",
    ),
)
"""(fault, test, command) of each box."""


def which():
    """Return the drawing of which test is for which fault: a question and five boxes."""
    step, top, left = 66, 62, 300
    parts = [words(24, 36, "What must be seen?", "head"), words(left, 36, "The test", "head")]
    trunk = top + step * (len(TREE) - 1) + 24
    parts.append(f'<path class="line" d="M 14 44 V {trunk}"/>')
    for i, (fault, test, command) in enumerate(TREE):
        y = top + step * i
        parts += [
            f'<path class="line" d="M 14 {y + 24} H 24"/>',
            f'<path class="line" d="M {left - 26} {y + 24} H {left - 6} l -7 -4 m 7 4 l -7 4"/>',
            words(30, y + 29, fault),
            box(left, y, 396, 50, "card", 8),
            words(left + 14, y + 21, test, "head"),
            words(left + 14, y + 40, command, "code"),
        ]
    return drawing(716, top + step * len(TREE), "which test for which fault", parts)


STEPS = (
    ("image", "rows of a window", "z, R, r: samples", "and bounds, NumPy"),
    ("search", "any device or solver", "plain floats,", "nothing is claimed"),
    ("hint", "an array, no more", "multipliers h,", "or unknowns d"),
    ("check", "one bound of rounding", "from the samples:", "floats or integers"),
)
"""(noun, what it is, two lines more) of each box."""
PROOFS = (
    ("FAULT", "FAULT: no d explains it", "|h z| &gt; sum |h_j| r_j + sum |h R|_i r_i + error"),
    ("CONSISTENT", "CONSISTENT: this d does", "|z - R d| + error &lt;= r,  |d| + error &lt;= r"),
    ("MISSING", "UNDECIDED: neither holds", "a worse hint, never a wrong verdict"),
)
"""(colour, what is proved, by which inequality) of each verdict."""


def check():
    """Return the drawing of search, hint and check."""
    wide, gap, top = 172, 30, 24
    parts = []
    for i, (noun, what, *more) in enumerate(STEPS):
        x = 16 + (wide + gap) * i
        parts += [box(x, top, wide, 96, "card", 8), words(x + 12, top + 24, noun, "head")]
        for j, text in enumerate((what, *more)):
            parts.append(words(x + 12, top + 44 + 19 * j, text, "soft"))
        if i:
            parts.append(
                f'<path class="line" d="M {x - gap + 5} {top + 48} H {x - 6} l -7 -4 m 7 4 l -7 4"/>'
            )
    for i, (kind, claim, inequality) in enumerate(PROOFS):
        y = top + 126 + 34 * i
        parts += [
            box(16, y, 12, 12, kind),
            words(36, y + 11, claim),
            words(258, y + 11, inequality, "code"),
        ]
    return drawing(16 + (wide + gap) * len(STEPS), top + 126 + 34 * len(PROOFS), "search, hint, check", parts)


HOUSE = (
    ("what a user meets", ("reports", "pages", "9"), ("cli", "commands", "1")),
    ("recordings of any size", ("runs", "source, judge, sinks", "4, 8")),
    (
        "verbs over many recordings",
        ("studies", "fit, tune, study, assess", ""),
        ("sklearn", "a Detector", ""),
        ("plots", "matplotlib", ""),
    ),
    ("one recording", ("diagnosis", "Result, alarms, names", "7")),
    (
        "beyond one window",
        ("certificates", "proofs in fractions", "9"),
        ("estimation", "observers, validation", ""),
    ),
    (
        "one window",
        ("consistency", "image, check, driver", "5"),
        ("relations", "unknowns eliminated", "4"),
    ),
    ("a plant", ("workers", "other processes", ""), ("models", "matrices, bounds, files", "2")),
    ("samples and sets", ("recordings", "files, pipes, gaps", "3"), ("sets", "kernels, rounding", "6")),
    (
        "ground",
        ("text", "safe to show", ""),
        ("exact", "fractions", ""),
        ("random", "keys", ""),
        ("files", "written whole", ""),
    ),
)
"""(storey, (room, what is in it, steps of the way of a sample), ..), from the roof down. A room imports those
on storeys below and to its left.
"""


def house():
    """Return the drawing of the folders of jaxbound on their floors."""
    left, wide, gap, high, top = 232, 178, 12, 46, 44
    parts = [
        words(16, 28, "storey", "head"),
        words(left, 28, "rooms: each knows those below, and those to its left", "head"),
    ]
    for i, (storey, *rooms) in enumerate(HOUSE):
        y = top + (high + gap) * i
        parts.append(words(16, y + 28, storey, "soft"))
        for j, (room, what, steps) in enumerate(rooms):
            x = left + (wide + gap) * j
            parts += [
                box(x, y, wide, high, "card", 8),
                words(x + 12, y + 20, room, "head"),
                words(x + 12, y + 38, what, "soft"),
                words(x + wide - 10, y + 20, steps, "code", "end"),
            ]
    foot = top + (high + gap) * len(HOUSE)
    down = f"M {left - 18} {top} V {foot - gap} l -4 -7 m 4 7 l 4 -7"
    parts += [
        f'<path class="line" d="{down}"/>',
        words(16, foot + 12, "numbers: the way of a sample, from a line of a file to the page", "soft"),
    ]
    return drawing(left + (wide + gap) * 4 + 4, foot + 26, "the folders of jaxbound, floor by floor", parts)


def verdicts(reading, rows):
    """Return the drawing of a reading above the verdicts of several tests.

    Args:
        reading: numbers, a sample each. rows: (words, names of verdicts, a sample each).
    """
    left, width, high, step = 230, 470, 46, 44
    each, low, span = width / len(reading), min(reading), max(reading) - min(reading)
    points = []
    for k, value in enumerate(reading):
        points.append(f"{left + each * k:.1f},{20 + high * (1 - (value - low) / span):.1f}")
    parts = [
        words(16, 48, "what T1 shows too much"),
        f'<polyline class="curve" points="{" ".join(points)}"/>',
    ]
    for i, (name, status) in enumerate(rows):
        y = 88 + step * i
        faults = status.count("FAULT")
        tested = len(status) - status.count("MISSING")
        parts += [words(16, y + 10, name), words(16, y + 27, f"{faults} FAULT of {tested}", "soft")]
        begun = 0
        for k in range(1, len(status) + 1):
            if k == len(status) or status[k] != status[begun]:
                parts.append(box(left + each * begun, y, each * (k - begun), 24, status[begun]))
                begun = k
    foot = 88 + step * len(rows) + 8
    for i, (name, more) in enumerate((("FAULT", ""), ("CONSISTENT", ""), ("MISSING", ": no full window"))):
        x = left + 130 * i
        parts += [box(x, foot - 11, 12, 12, name), words(x + 18, foot, name + more, "soft")]
    return drawing(720, foot + 18, "verdicts of four tests on a jump of 0.8 degC that lasts", parts)


SIZES = (
    ("windows of 16 samples", 1.5, 14, None),
    ("windows of 61 samples", 1.5, 3, 3.45),
    ("lags: 16 of 61 samples", 1.5, 2, 2.75),
    ("observer, zonotope", 6, 9, None),
    ("observer, joint", 1.5, 3, 3.45),
)
"""(test, jump, lasting error, drift), degC, by `python -m benchmarks.memory`: process noise .05, room .02."""


def sizes():
    """Return the drawing of the smallest faults that each test sees."""
    left, wide, top, step = 210, 160, 62, 34
    parts = []
    heads = ("a jump", "an error, always there", "a drift, when seen")
    for j, head in enumerate(heads):
        parts.append(words(left + (wide + 40) * j, 34, head, "head"))
    for i, (name, *row) in enumerate(SIZES):
        y = top + step * i
        parts.append(words(16, y + 13, name))
        for j, size in enumerate(row):
            x = left + (wide + 40) * j
            if size is None:
                parts.append(words(x, y + 13, "never", "soft"))
                continue
            long = wide * size / 14
            parts += [box(x, y, long, 18, "FAULT"), words(x + long + 6, y + 14, f"{size:g}", "soft")]
    foot = top + step * len(SIZES) + 12
    parts.append(words(16, foot, "degC of one thermometer of a heater: the shorter, the better", "soft"))
    return drawing(830, foot + 18, "smallest faults that six tests see", parts)


def jaxbound(folder, *options):
    """Run a command in a folder; it may find a fault."""
    command = [sys.executable, "-m", "jaxbound.cli", *options]
    done = subprocess.run(command, cwd=folder, check=False)
    if done.returncode not in (0, 1):
        raise SystemExit(done.returncode)


def recorded(folder):
    """Fit, detect and return (T1 minus its healthy twin, [(words, verdicts)]) of the tutorial's jump."""
    if not (folder / "jump.csv").exists():
        jaxbound(folder.parent, "example", "heater", "--out", folder)
    rows = []
    for name, (about, options) in FITS.items():
        file, out = f"{name}.toml", folder / f"report_{name}"
        if not (folder / file).exists():
            healthy = ["healthy_1.csv", "healthy_2.csv"]
            jaxbound(folder, "fit", *healthy, *SIGNALS, *options, "--out", file)
        if not (out / "verdicts.csv").exists():
            jaxbound(folder, "detect", file, "jump.csv", "--out", out)
        with open(out / "verdicts.csv", newline="") as table:
            rows.append((about, [row["status"] for row in csv.DictReader(table)]))
    columns = []
    for name in ("jump.csv", "healthy_3.csv"):
        with open(folder / name, newline="") as table:
            columns.append([float(row["Temperature 1"]) for row in csv.DictReader(table)])
    return [a - b for a, b in zip(*columns, strict=True)], rows


def page(report):
    """Return the top of a page as the bytes of a PNG picture, as chromium shows it."""
    from PIL import Image

    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None:
        raise SystemExit("report.png is not drawn: it needs the browser chromium")
    with tempfile.TemporaryDirectory() as folder:
        shot = Path(folder) / "shot.png"
        options = ["--headless=new", "--no-sandbox", "--hide-scrollbars", "--virtual-time-budget=4000"]
        size = [f"--window-size={WIDTH},{HEIGHT}", f"--screenshot={shot}"]
        subprocess.run([browser, *options, *size, report.resolve().as_uri()], check=True, capture_output=True)
        picture = Image.open(shot).convert("RGB")
    few, out = picture.quantize(COLOURS, dither=Image.Dither.NONE), io.BytesIO()
    few.save(out, "PNG", optimize=True)
    data = out.getvalue()
    if len(data) > LARGEST:
        raise SystemExit(f"report.png would have {len(data)} bytes, more than {LARGEST}")
    return data


def write(folder):
    """Write all pictures; folder: where the commands run."""
    PICTURES.mkdir(exist_ok=True)
    (PICTURES / "which.svg").write_text(which())
    (PICTURES / "check.svg").write_text(check())
    (PICTURES / "house.svg").write_text(house())
    (PICTURES / "sizes.svg").write_text(sizes())
    (PICTURES / "verdicts.svg").write_text(verdicts(*recorded(folder)))
    (PICTURES / "report.png").write_bytes(page(folder / "report_plant" / "report.html"))


if __name__ == "__main__":
    if len(sys.argv) > 1:
        write(Path(sys.argv[1]).resolve())
    else:
        with tempfile.TemporaryDirectory() as place:
            write(Path(place) / "heater")
