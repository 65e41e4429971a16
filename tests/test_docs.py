"""The pages: their commands run and print what is shown, every public name is documented, links lead
somewhere, they build.
"""

import contextlib
import importlib.util
import inspect
import io
import os
import re
import shlex
import shutil
import subprocess
import sys
import types
from pathlib import Path

import pytest

import jaxbound as jb

ROOT = Path(__file__).parents[1]
PAGES = sorted((ROOT / "docs").rglob("*.md"))
RUN_ELSEWHERE = "start.md", "extending.md"
"""Pages that others run: the first one in an empty folder, and one whose families a test takes away again."""


def script(name):
    spec = importlib.util.spec_from_file_location(name, ROOT / "docs" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def docstrings(monkeypatch):
    """The extension of the pages, without the package that calls it."""
    monkeypatch.setitem(sys.modules, "griffe", types.SimpleNamespace(Extension=object))
    return script("docstrings")


def documented():
    for page in PAGES:
        for path in re.findall(r"^::: (jaxbound[\w.]*)$", page.read_text(), re.M):
            thing = jb
            for part in path.split(".")[1:]:
                thing = getattr(thing, part)
            yield path, thing


@pytest.mark.parametrize("module", [jb, jb.sets], ids=lambda m: m.__name__)
def test_every_public_name_has_its_place_in_the_reference(module):
    things = [thing for _, thing in documented()]
    missing = [n for n in module.__all__ if n != "sets" and not any(getattr(module, n) is t for t in things)]
    assert not missing, f"add to docs/api: {missing}"


@pytest.mark.parametrize("module", [jb, jb.sets], ids=lambda m: m.__name__)
def test_a_module_lists_every_name_once(module):
    assert len(dir(module)) == len(set(dir(module))) and set(module.__all__) <= set(dir(module))


def test_every_parameter_has_an_entry(docstrings):
    """Functions whose one sentence says all, x + y and the like, need none."""
    missing = {}
    for path, thing in documented():
        if inspect.isclass(thing) or not callable(thing):
            continue
        names, text = list(inspect.signature(thing).parameters), inspect.getdoc(thing)
        told = [name for name, _ in docstrings.entries(docstrings.arguments(text), names)]
        left = set(names) - set(told)
        if "fields of the recipe" in text:
            left -= set(jb.Recipe.__dataclass_fields__)
        if len(told) != len(set(told)) or left and (told or not left <= {"x", "y", "z", "n", "axis"}):
            missing[path] = sorted(left) or told
    assert not missing


def test_a_line_that_tells_of_several_parameters_becomes_several_entries(docstrings):
    text = (
        "Args:\n    u (T, m), y (T, p): samples; see u.\n        None: no n. n: few,\n        most. at: "
        "once; *more: rest\n\nReturns: x"
    )
    found = docstrings.entries(docstrings.arguments(text), ["u", "y", "n", "at", "more"])
    seen = [("u", "(T, m) samples; see u. None: no n."), ("y", "(T, p) samples; see u. None: no n.")]
    assert found == [*seen, ("n", "few, most."), ("at", "once"), ("more", "rest")]


def test_nothing_is_documented_twice():
    paths = [path for path, _ in documented()]
    assert len(paths) == len(set(paths)) and len({id(t) for _, t in documented()}) == len(paths)


def test_sections_taken_from_the_readme_are_there():
    pytest.importorskip("properdocs")
    hooks = script("hooks")
    taken = [heading for page in PAGES for heading in re.findall(r"<!-- README: (.+?) -->", page.read_text())]
    assert taken and all(hooks.section(heading) for heading in taken)


def test_docstrings_become_paragraphs_and_examples(docstrings):
    text = "Do it.\n\nReturns:\n    A thing: good.\n\nEncloses: all\n    of it.\n\nExample:\n    >>> 1\n    1"
    out = docstrings.readable(text)
    assert (
        "**Returns**  A thing: good." in out
        and "**Encloses**  all of it." in out.replace("\n", " ")
        and "Examples:\n    >>> 1" in out
    )


def test_every_entry_of_a_list_of_fields_is_a_field(docstrings):
    """A sentence that begins with "None:" tells of the field before it."""
    wrong = {}
    for path, thing in documented():
        if not inspect.isclass(thing):
            continue
        lists = re.findall(
            r"\*\*(?:Fields|Attributes)\*\*\n\n((?:- .*\n?)+)",
            docstrings.readable(inspect.getdoc(thing) or ""),
        )
        names = [
            name
            for entry in "".join(lists).splitlines()
            for name in re.findall(r"\w+", (re.match("- `([^`]+)`", entry) or [0, ""])[1])
        ]
        known = {*dir(thing), *getattr(thing, "__annotations__", {}), *inspect.signature(thing).parameters}
        if others := [name for name in names if name not in known]:
            wrong[path] = others
    assert not wrong


@pytest.mark.long(by_day="test_sections_taken_from_the_readme_are_there")
def test_pages_build_without_a_warning(tmp_path):
    for package in ("properdocs", "material", "mkdocstrings"):
        pytest.importorskip(package)
    command = [
        sys.executable,
        "-m",
        "properdocs",
        "build",
        "--strict",
        "-f",
        ROOT / "mkdocs.yml",
        "-d",
        tmp_path / "site",
    ]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert "jaxbound.LinearSystem" in (tmp_path / "site" / "api" / "models.html").read_text()


def test_links_of_the_readme_work_from_a_page():
    pytest.importorskip("properdocs")
    moved = script("hooks").moved
    text = "![a](notebooks/a.png) [b](docs/start.md) [c](Makefile) [d](https://x.y)"
    assert moved(text, "../") == "![a](../notebooks/a.png) [b](../start.md) c [d](https://x.y)"


BLOCK = re.compile(r"(?P<mark><!-- not run: [^>]+ -->\n)?^```(?P<kind>\w+)\n(?P<text>.*?)^```$", re.M | re.S)


def blocks(page):
    """Yield (kind, text, text that is shown as printed or None, whether it is run) of each block of commands
    of a page.
    """
    found = list(BLOCK.finditer(page.read_text()))
    for block, after in zip(found, [*found[1:], None], strict=False):
        shown = None
        if (
            after is not None
            and after["kind"] == "text"
            and not page.read_text()[block.end() : after.start()].strip()
        ):
            shown = after["text"]
        if block["kind"] in ("sh", "python"):
            yield block["kind"], block["text"], shown, block["mark"] is None


def differs(shown, printed):
    """Return the first line that is shown and not printed, or None. A line "..." is any lines, "..." in a
    line any characters of it.
    """
    lines = [" ".join(line.split()) for line in printed.splitlines()]
    at, skip = 0, False
    for wanted in (" ".join(line.split()) for line in shown.splitlines() if line.strip()):
        if wanted == "...":
            skip = True
            continue
        pattern = re.compile(".*".join(map(re.escape, wanted.split("..."))))
        while at < len(lines) and (not lines[at] or skip and not pattern.fullmatch(lines[at])):
            at += 1
        if at == len(lines) or not pattern.fullmatch(lines[at]):
            return f"shown: {wanted}\nprinted: {lines[at] if at < len(lines) else 'nothing more'}"
        at, skip = at + 1, False
    left = [line for line in lines[at:] if line]
    return f"printed and not shown: {left[0]}" if left and not skip else None


def test_what_is_shown_is_compared_but_for_what_is_marked_as_left_out():
    assert (
        differs("a  b\n...\nd", "a b\n\nc\nc\nd\n") is None
        and differs("a\n...", "a\nb") is None
        and differs("x 1...", "x 1.25") is None
    )
    for shown, printed in (
        ("a", "a\nb"),
        ("a\nb", "a"),
        ("...\nd", "a\nc"),
        ("a\nd", "a\nc\nd"),
        ("x 2...", "x 1.25"),
        ("a.b", "axb"),
    ):
        assert differs(shown, printed)


def typed(command, place):
    """Run one line of a shell in this process, or in bash where it has a pipe; return what it printed, its
    place and its exit codes.
    """
    from jaxbound.cli import main

    line, codes = re.sub(r"\s+# .*", "", command), []
    if " | " in line:
        shim = f'jaxbound() {{ {shlex.quote(sys.executable)} -m jaxbound.cli "$@"; }}; '
        done = subprocess.run(
            ["bash", "-c", shim + line], cwd=place, capture_output=True, text=True, check=False
        )
        return done.stdout, place, [done.returncode]
    printed = io.StringIO()
    for part in line.split(" && "):
        words, _, target = part.partition(" > ")
        words = shlex.split(words)
        if words[0] == "cd":
            place = place / words[1]
            os.chdir(place)
            continue
        assert words[0] == "jaxbound", f"say why it is not run: {command}"
        out = io.StringIO() if target else printed
        with contextlib.redirect_stdout(out):
            codes.append(main.main(words[1:]))
        if target:
            (place / target.strip()).write_text(out.getvalue())
    return printed.getvalue(), place, codes


def follow(page, place, done=()):
    """Do what a page says in a folder and compare what is printed with what is shown; return the folder where
    that ends.

    done: sets of words; a command that has no other than one of these was typed elsewhere.
    """
    os.chdir(place)
    names = {}
    for kind, text, shown, wanted in blocks(page):
        if not wanted:
            continue
        printed = ""
        if kind == "python":
            out = io.StringIO()
            with contextlib.redirect_stdout(out):
                exec(compile(text, str(page), "exec"), names)
            printed = out.getvalue()
        else:
            for command in lines_of(text):
                if any(words(command) <= known for known in done):
                    continue
                more, place, codes = typed(command, place)
                printed += more
                stated = re.search(r"exit code (\d)", command)
                assert all(code == int(stated[1]) if stated else code in (0, 1) for code in codes), (
                    command,
                    codes,
                )
        wrong = differs(shown, printed) if shown is not None else None
        assert not wrong, f"{page.name}\n{text}\n{wrong}"
    return place


def lines_of(text):
    """Return the commands of a block."""
    return [line for line in text.replace("\\\n", " ").splitlines() if line]


def words(command):
    """Return the words of a command, without its comment."""
    return set(re.sub(r"\s+# .*", "", command).split())


def at_a_prompt(folder, monkeypatch):
    """Type commands in a folder; nothing of them reaches other tests."""
    from jaxbound.cli import main
    from jaxbound.runs import cache

    monkeypatch.chdir(folder)
    monkeypatch.setattr(main, "_configure", lambda: None)
    monkeypatch.setattr(cache, "use_cache", lambda *args: None)
    monkeypatch.setattr(jb, "use_cache", lambda *args: None, raising=False)
    return folder


@pytest.fixture
def empty(tmp_path, monkeypatch, kernels):
    """Return an empty folder to which commands are typed."""
    return at_a_prompt(tmp_path, monkeypatch)


@pytest.fixture(scope="module")
def laboratory(tmp_path_factory):
    """Return the folder that the first page leaves, typed in an empty one: the example and its fitted model,
    without what was found; two recordings in a folder.
    """
    import pandas as pd

    with pytest.MonkeyPatch.context() as monkeypatch:
        empty = at_a_prompt(tmp_path_factory.mktemp("laboratory"), monkeypatch)
        place = follow(ROOT / "docs" / "start.md", empty)
    for found in ("report", "live"):
        shutil.rmtree(place / found)
    (place / "recordings").mkdir()
    for i in (1, 2):
        table = pd.read_csv(place / f"healthy_{i}.csv")
        table["Time (s)"] += 6000.0 * (i - 1)  # another day
        table.to_parquet(place / "recordings" / f"{i}.parquet")
    return place


def test_every_command_of_the_first_pages_runs_in_an_empty_folder(laboratory, empty):
    page = blocks(ROOT / "docs" / "start.md")
    typed = [words(line) for kind, text, *_ in page if kind == "sh" for line in lines_of(text)]
    follow(ROOT / "README.md", empty, [known for known in typed if len(known) > 3])  # the example is made


@pytest.mark.parametrize(
    "page", [p.name for p in PAGES if p.name not in RUN_ELSEWHERE and any(run for *_, run in blocks(p))]
)
def test_every_command_of_the_other_pages_runs_beside_the_laboratory(page, laboratory, empty):
    follow(next(p for p in PAGES if p.name == page), shutil.copytree(laboratory, empty / laboratory.name))


def test_every_block_of_commands_is_run_or_says_why_not():
    marked = [text for page in [ROOT / "README.md", *PAGES] for _, text, _, run in blocks(page) if not run]
    assert len(marked) <= 7 and any("make demo" in text for text in marked)


def test_every_command_has_its_help_on_the_page_and_every_key_of_a_model_file_its_entry():
    from jaxbound.cli.main import commands
    from jaxbound.models.filevalues import AVERAGE, TIMES
    from jaxbound.models.modelfields import field_names
    from jaxbound.models.statedtests import FIELDS

    page = (ROOT / "docs" / "commands.md").read_text()
    assert re.findall("<!-- HELP: (\\w+) -->", page) == re.findall("^## (\\w+)$", page, re.M) and set(
        commands()
    ) == set(re.findall("^## (\\w+)$", page, re.M))
    known = [
        *map(field_names, ("", "states", "inputs", "outputs")),
        TIMES,
        field_names("disturbances"),
        AVERAGE,
        field_names("uncertainty"),
        FIELDS,
        *map(field_names, ("fault", "alarms", "recording", "matrices", "provenance")),
    ]
    sections = re.split("^## .+$", (ROOT / "docs" / "modelfile.md").read_text(), flags=re.M)[1:]
    for keys, section in zip(known, sections, strict=True):
        assert sorted(re.findall("^\\| `(\\w+)` \\| \\S", section, re.M)) == sorted(keys)


def test_the_first_page_says_as_a_file_how_to_install():
    page, readme = (ROOT / "docs" / "start.md").read_text(), (ROOT / "README.md").read_text()
    (install,) = re.findall("^## 1. Install\n(.+?)^## ", page, re.M | re.S)
    (commands, *_) = re.findall("^```sh\n(.+?)^```", install, re.M | re.S)
    for part in re.split(r" && |\n", commands)[:2]:
        assert part in readme, part  # one way, on both pages
    assert (
        ". .venv/bin/activate" in commands
        and "run `jaxbound COMMAND --help`" in (ROOT / "docs" / "commands.md").read_text()
    )


LINK = re.compile(r"\[[^\]\n]*\]\(([^)\s#]+)(#[^)\s]*)?\)")


@pytest.mark.parametrize("page", [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *PAGES], ids=lambda p: p.name)
def test_links_lead_to_files(page):
    text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.M | re.S)
    targets = [
        target
        for target, _ in LINK.findall(re.sub(r"`[^`\n]+`", "", text))
        if not target.startswith(("http://", "https://"))
    ]
    places = [page.parent, ROOT] if page.parent.name == "docs" else [page.parent]
    assert not [target for target in targets if not any((place / target).exists() for place in places)]


def anchors(page):
    """Return the anchors of a page: its headings as words between hyphens, and the paths of the names that it
    documents.
    """
    text = page.read_text()
    headings = re.findall(r"^#+ (.+)$", text, re.M)
    words = {re.sub(r"[\s-]+", "-", re.sub(r"[^\w\s-]", "", heading).strip().lower()) for heading in headings}
    return words | set(re.findall(r"^::: (jaxbound[\w.]*)$", text, re.M))


def test_links_lead_to_places_within_pages():
    astray, known = [], 0
    for page in [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *PAGES]:
        for target, anchor in re.findall(r"\]\(([^)\s#:]*)#([^)\s]+)\)", page.read_text()):
            there = page.parent / target if target else page
            known += 1
            if anchor not in anchors(there):
                astray.append(f"{page.name}: {target}#{anchor}")
    assert not astray and known > 20


def test_the_gate_of_the_pages_hears_what_it_counts():
    """ProperDocs counts no warning that --quiet hides: with both a build that is wrong succeeds."""
    (line,) = re.findall("properdocs build.*", (ROOT / "Makefile").read_text())
    assert "--strict" in line and "--quiet" not in line and "-q" not in line.split()


def test_equations_become_mathml_outside_of_code():
    pytest.importorskip("properdocs")
    pytest.importorskip("latex2mathml")
    drawn = script("hooks").equations("$x_1$ and `$y$` cost 5 $ and 6 $\n```sh\necho $a $b\n```\n$$x = 1$$")
    assert drawn.count("<math") == 2 and "`$y$`" in drawn and "echo $a $b" in drawn and "5 $ and 6 $" in drawn


def test_every_file_and_script_that_the_design_names_is_there():
    text = (ROOT / "docs" / "design.md").read_text()
    files = re.findall(r"`((?:\w+/)+\w+\.py)`", text)
    scripts = re.findall(r"`(?:python -m )?(benchmarks\.\w+)`", text)
    paths = [ROOT / "jaxbound" / name for name in files if not name.startswith("tests/")]
    paths += [ROOT / name for name in files if name.startswith("tests/")]
    paths += [ROOT / f"{script.replace('.', '/')}.py" for script in scripts]
    assert len(paths) > 20 and not [path for path in paths if not path.exists()]


def test_pictures_of_the_first_pages_are_as_their_script_draws_them():
    pictures = importlib.import_module("benchmarks.pictures")
    for name in ("check", "house", "which", "sizes"):
        assert (pictures.PICTURES / f"{name}.svg").read_text() == getattr(pictures, name)()
    assert (pictures.PICTURES / "report.png").stat().st_size < pictures.LARGEST
    for page in ("README.md", "docs/start.md"):
        assert "pictures/report.png" in (ROOT / page).read_text()
