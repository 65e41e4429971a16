"""What the pages take from elsewhere: sections of the README, the help of the commands, the notebooks and the
project's other files.

- `<!-- README: Heading -->`: the section of README.md under that heading, without it
- `<!-- HELP: detect -->`: what `jaxbound detect --help` prints
- `<!-- FIGURES -->`: the figures that `python -m benchmarks` has drawn, if there are any
- `<!-- GALLERY -->`: the notebooks, each with its question and its first picture

Notebooks become pages, with what they printed and drew when they were last executed. Equations between
dollars become MathML, which browsers draw themselves: the pages need no network.
"""

import base64
import contextlib
import io
import json
import os
import re
from functools import cache
from pathlib import Path

from properdocs.structure.files import File

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
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
    for path in NOTEBOOKS:
        text, pictures = notebook(path)
        files.append(File.generated(config, f"notebooks/{path.stem}.md", content=text))
        for name, data in pictures.items():
            files.append(File.generated(config, f"notebooks/{name}", content=data))
    return files


def on_page_markdown(markdown, page, config, files):
    """Put sections of the README and the help of commands in their places."""
    up = "../" * page.file.src_uri.count("/")
    if page.file.src_uri in ("CONTRIBUTING.md", "CHANGELOG.md"):
        markdown = moved(markdown, up)
    markdown = re.sub(r"<!-- README: (.+?) -->", lambda m: moved(section(m[1]), up), markdown)
    markdown = markdown.replace("<!-- FIGURES -->", figures(up)).replace("<!-- GALLERY -->", gallery(up))
    markdown = re.sub(r"<!-- not run: [^>]+ -->\n", "", markdown)
    markdown = re.sub(r"\]\(((?:\.\./)*notebooks/\w+)\.ipynb\)", r"](\1.md)", markdown)
    return equations(re.sub(r"<!-- HELP: (\w+) -->", lambda m: f"```text\n{usage(m[1])}\n```", markdown))


def on_post_page(output, page, config):
    """Take the script that lets search work from a folder from the pages themselves, not from elsewhere."""
    return output.replace(
        "https://unpkg.com/iframe-worker/shim", "../" * page.file.src_uri.count("/") + "folder_search.js"
    )


def on_post_template(output_content, template_name, config):
    """Do the same for pages without a source."""
    return output_content.replace("https://unpkg.com/iframe-worker/shim", "folder_search.js")


@cache
def notebook(path):
    """Return (Markdown, {file name: PNG}) of a notebook: its texts, its code, and what that printed and
    drew.
    """
    parts, pictures = [], {}
    for number, cell in enumerate(json.loads(path.read_text())["cells"]):
        text = "".join(cell["source"])
        parts.append(text if cell["cell_type"] == "markdown" else f"```python\n{text}\n```")
        for i, output in enumerate(cell.get("outputs", ())):
            data = output.get("data", {"text/plain": output.get("text", "")})
            if "image/png" in data:
                name = f"{path.stem}_{number}_{i}.png"
                pictures[name] = base64.b64decode(data["image/png"])
                parts.append(f"![drawn by the code above]({name})")
            elif data["text/plain"]:
                parts.append(f"```text\n{''.join(data['text/plain']).rstrip()}\n```")
    return "\n\n".join(
        [*parts, f"[This page as a notebook]({path.name}), executed by a test of the project."]
    ) + "\n", pictures


def gallery(up):
    """Return a table of the notebooks: picture, and question with its first sentence."""
    rows = ["| | |", "|---|---|"]
    for path in NOTEBOOKS:
        text, pictures = notebook(path)
        heading, paragraph = text.split("\n\n")[:2]
        picture = ""
        if pictures:
            image = f"![{path.stem}]({up}notebooks/{next(iter(pictures))}){{ width=220 }}"
            picture = f"[{image}]({up}notebooks/{path.stem}.md)"
        sentence = (
            re.split(r"(?<=[.?!:])\s", " ".join(paragraph.split()))[0].replace("**Question.**", "").strip()
        )
        if len(sentence) <= 3:
            sentence = ""
        link = f"[**{heading.lstrip('# ')}**]({up}notebooks/{path.stem}.md)"
        rows.append(f"| {picture} | {link}<br>{sentence} |")
    return "\n".join(rows)


def equations(markdown):
    """Return Markdown whose equations, between dollars and outside of code, are MathML: what needs no script
    and no network.
    """
    from latex2mathml.converter import convert

    def drawn(match):
        if match["code"]:
            return match[0]
        block = match["block"] is not None
        # the package is the one that knows LaTeX; entities keep Markdown away from signs
        mathml = convert(match["block"] if block else match["inline"], display="block" if block else "inline")
        return f'<div class="equation">{mathml}</div>' if block else mathml

    code = r"(?P<code>^```.*?^```[^\n]*$|`[^`\n]+`)"
    return re.sub(
        code + r"|\$\$(?P<block>.+?)\$\$|\$(?P<inline>[^$\s](?:[^$\n]*[^$\s])?)\$",
        drawn,
        markdown,
        flags=re.M | re.S,
    )


def section(heading):
    """Return the text under a heading of the README; raises KeyError if there is none."""
    parts = re.split(r"^## (.+)$", (ROOT / "README.md").read_text(), flags=re.M)
    found = dict(zip(["top", *parts[1::2]], parts[0::2], strict=True))
    if heading == "top":
        return found["top"].split("\n", 1)[1].strip()
    return found[heading].strip()


def figures(up):
    """Return the figures of the benchmarks as images, or a sentence that says how to draw them."""
    found = [
        f"![{p.stem.replace('_', ', ')}]({up}benchmarks/figures/{p.name})"
        for p in sorted(FIGURES.glob("*.png"))
    ]
    return "\n\n".join(found) or "There are no figures yet: `python -m benchmarks` draws them."


def moved(text, up):
    """Return text of the README with links that work from a page `up` folders deep; a file that is not
    published is only named.
    """

    def link(match):
        mark, words, target = match.groups()
        if target.startswith(("http://", "https://", "#")):
            return match[0]
        if target.startswith("docs/"):
            return f"{mark}[{words}]({up}{target.removeprefix('docs/')})"
        published = target.startswith(("notebooks/", "benchmarks/figures/")) or target in (
            "CONTRIBUTING.md",
            "CHANGELOG.md",
        )
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
