"""Make the sections that this library's docstrings have beside Google's readable to mkdocstrings."""

import re
import textwrap

import griffe

LISTS = ("Fields", "Attributes")
VALUES = "(?:None|NaN|[A-Z]{2,})"  # "None: there were none" tells of the field before it
ARGUMENTS = re.compile(r"^Args:\n((?:(?: {4}.*)?\n)*(?: {4}.*)?)", re.M)
SECTIONS = ("Encloses", "Source", "Returns", "Fields", "Attributes", "Costs")


class Sections(griffe.Extension):
    """Turns `Encloses:`, `Source:` and the like into paragraphs, and `Example:` into the section that shows
    code.
    """

    def on_object(self, *, obj, **_):
        """Rewrite the docstring of an object that was found."""
        if obj.docstring is not None:
            names = [p.name for p in obj.parameters] if obj.is_function or obj.is_class else []
            obj.docstring.value = readable(obj.docstring.value, names)


def arguments(text):
    """Return what the `Args:` section of a docstring says, or ""."""
    found = re.search(ARGUMENTS, text)
    return textwrap.dedent(found[1]) if found else ""


def entries(text, names):
    """Return (name, text) of each parameter in such a section, where one line may tell of several: "u (T, m),
    y (T, p): samples".
    """
    item = rf"\*{{0,2}}(?:{'|'.join(map(re.escape, names))})(?: \([^()]*\))*"
    heads = (
        list(re.finditer(rf"(?:^|\n|(?<=[.;,] )|(?<=[.;,]\n))({item}(?:,\s{item})*):\s", text))
        if names
        else []
    )
    found = []
    for head, after in zip(heads, [*heads[1:], None], strict=False):
        words = " ".join(text[head.end() : after.start() if after else None].split()).rstrip(";,")
        for name, shape in re.findall(r"(\w+)((?: \([^()]*\))*)(?:,\s|$)", head[1]):
            found.append((name, f"{shape.strip()} {words}".strip()))
    return found


def readable(text, names=()):
    """Return a docstring with an entry for each parameter, and paragraphs in place of sections that Google's
    style does not have.
    """
    if found := entries(arguments(text), names):
        told = "".join(f"    {name}: {words}\n" for name, words in found)
        text = re.sub(ARGUMENTS, lambda _: f"Args:\n{told}\n", text)
    text = re.sub(r"(?<=[.;])\s+(?=[A-Z]\w+Error: )", "\n    ", text)  # an entry for each error
    out, lines, i = [], text.split("\n"), 0
    while i < len(lines):
        found = re.match(rf"({'|'.join(SECTIONS)})( \([^)]*\))?:(?: (.*))?$", lines[i])
        if lines[i].strip() == "Example:":
            out += ["", "Examples:"]
        elif found:
            body = []
            inside = lambda line, begun=bool(found[3]): (
                bool(line.strip()) if begun else not line.strip() or line.startswith("    ")
            )
            while i + 1 < len(lines) and inside(lines[i + 1]):
                i += 1
                body.append(lines[i])
            words = textwrap.dedent("\n".join(body)).strip("\n")
            title, words = f"**{found[1]}{found[2] or ''}**", "\n".join(filter(None, [found[3], words]))
            out += ["", f"{title}  {words}" if found[1] not in LISTS else f"{title}\n\n{listed(words)}", ""]
        else:
            out.append(lines[i])
        i += 1
    return "\n".join(out)


def listed(words):
    """Return "name: what it is" lines as a list, and text without such lines as it is."""
    field = rf"(?!{VALUES}\b)[A-Za-z_]\w*"
    items = re.split(rf"(?:^|\n|(?<=[.;]) )(?={field}(?:, {field})*(?: \([^)]*\))*: )", words)
    items = [" ".join(item.split()) for item in items if item.strip()]
    named = [re.sub(r"^([\w, ]+?)((?: \([^)]*\))*): ", r"`\1`\2: ", item) for item in items]
    return "\n".join(f"- {item}" for item in named) if len(items) > 1 else words
