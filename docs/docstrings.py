"""Make the sections that this library's docstrings have beside Google's readable to mkdocstrings."""

import re
import textwrap

import griffe

LISTS = ("Fields", "Attributes")
SECTIONS = ("Encloses", "Source", "Returns", "Fields", "Attributes", "Costs")


class Sections(griffe.Extension):
    """Turns `Encloses:`, `Source:` and the like into paragraphs, and `Example:` into the section that shows code."""

    def on_object(self, *, obj, **_):
        """Rewrite the docstring of an object that was found."""
        if obj.docstring is not None:
            obj.docstring.value = readable(obj.docstring.value)


def readable(text):
    """Return a docstring with paragraphs in place of sections that Google's style does not have."""
    out, lines, i = [], text.split("\n"), 0
    while i < len(lines):
        found = re.match(rf"({'|'.join(SECTIONS)})( \([^)]*\))?:(?: (.*))?$", lines[i])
        if lines[i].strip() == "Example:":
            out += ["", "Examples:"]
        elif found:
            body = []
            while i + 1 < len(lines) and (not lines[i + 1].strip() or lines[i + 1].startswith("    ")):
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
    items = re.split(r"(?:^|\n|(?<=[.;]) )(?=[A-Za-z_]\w*(?:, [A-Za-z_]\w*)*(?: \([^)]*\))*: )", words)
    items = [" ".join(item.split()) for item in items if item.strip()]
    named = [re.sub(r"^([\w, ]+?)((?: \([^)]*\))*): ", r"`\1`\2: ", item) for item in items]
    return "\n".join(f"- {item}" for item in named) if len(items) > 1 else words
