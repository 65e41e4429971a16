"""What the tests of the house read of sources: statements, and the names of what is called and imported."""

import ast
from functools import cache

BODIES = "body", "orelse", "finalbody", "handlers", "cases"


def statements(node):
    """Yield the statements below a node, wherever they stand; expressions, nine tenths of a tree, are left
    out.
    """
    for body in BODIES:
        for below in getattr(node, body, ()):
            yield below
            yield from statements(below)


def last_name(expression):
    """Return the name behind the last dot of an expression, "" where it ends in none."""
    return getattr(expression, "attr", getattr(expression, "id", ""))


@cache
def imports(path):
    """Return (module, name) of what a file imports, wherever in it; the name "" where it is a module."""
    found = []
    for node in statements(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found += [(a.name, "") for a in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} has a relative import"
            found += [(node.module, a.name) for a in node.names]
    return found
