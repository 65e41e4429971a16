"""What the pages take from elsewhere: sections of the README, the help of the commands, the notebooks and the project's other files.

- `<!-- README: Heading -->`: the section of README.md under that heading, without it
- `<!-- HELP: detect -->`: what `jaxbound detect --help` prints
- `<!-- FIGURES -->`: the figures that `python -m benchmarks` has drawn, if there are any
"""

import contextlib
import io
import os
import re
from pathlib import Path

from mkdocs.structure.files import File

ROOT = Path(__file__).parents[1]
FIGURES = ROOT / "benchmarks" / "figures"


def on_files(files, config):
    """Publish the notebooks, the figures of the benchmarks and the project's own pages beside the docs."""
    for path in (
        *sorted((ROOT / "notebooks").glob("*.*")),
        *sorted(FIGURES.glob("*.png")),
        ROOT / "CONTRIBUTING.md",
        ROOT / "CHANGELOG.md",
    ):
        files.append(File.generated(config, path.relative_to(ROOT).as_posix(), abs_src_path=str(path)))
    return files


def on_page_markdown(markdown, page, config, files):
    """Put sections of the README and the help of commands in their places."""
    up = "../" * page.file.src_uri.count("/")
    markdown = re.sub(r"<!-- README: (.+?) -->", lambda m: moved(section(m[1]), up), markdown)
    markdown = markdown.replace("<!-- FIGURES -->", figures(up))
    return re.sub(r"<!-- HELP: (\w+) -->", lambda m: f"```text\n{usage(m[1])}\n```", markdown)


def section(heading):
    """Return the text under a heading of the README; raises KeyError if there is none."""
    parts = re.split(r"^## (.+)$", (ROOT / "README.md").read_text(), flags=re.M)
    found = dict(zip(["top", *parts[1::2]], parts[0::2], strict=True))
    if heading == "top":
        return found["top"].split("\n", 1)[1].strip()
    return found[heading].strip()


def figures(up):
    """Return the figures of the benchmarks as images, or a sentence that says how to draw them."""
    found = [f"![{p.stem.replace('_', ', ')}]({up}benchmarks/figures/{p.name})" for p in sorted(FIGURES.glob("*.png"))]
    return "\n\n".join(found) or "There are no figures yet: `python -m benchmarks` draws them."


def moved(text, up):
    """Return text of the README with links that work from a page `up` folders deep; a file that is not published is only named."""

    def link(match):
        mark, words, target = match.groups()
        if target.startswith(("http://", "https://", "#")):
            return match[0]
        if target.startswith("docs/"):
            return f"{mark}[{words}]({up}{target.removeprefix('docs/')})"
        published = target.startswith(("notebooks/", "benchmarks/figures/")) or target in ("CONTRIBUTING.md", "CHANGELOG.md")
        return f"{mark}[{words}]({up}{target})" if published else words

    return re.sub(r"(!?)\[([^\]\n]*)\]\(([^)\s]+)\)", link, text)


def usage(command):
    """Return the help of a command, 84 columns wide."""
    from jaxbound.cli.main import main

    out = io.StringIO()
    before, os.environ["COLUMNS"] = os.environ.get("COLUMNS"), "84"
    with contextlib.redirect_stdout(out):
        main([command, "--help"])
    os.environ.pop("COLUMNS") if before is None else os.environ.update(COLUMNS=before)
    return out.getvalue().strip()
