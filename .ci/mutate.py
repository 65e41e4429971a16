"""Who notices a broken line: `.ci/mutate.py ROOM [LINES]` breaks lines of a room, drawn by its name, one by
one in a copy, and runs the tests of the room until one fails. What nobody notices lacks a test.
"""

import ast
import copy
import os
import random
import shutil
import subprocess
import sys
import tempfile
import zlib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LT, LE, GT, GE = ast.Lt, ast.LtE, ast.Gt, ast.GtE
COMPARED = {LT: [LE, GT], LE: [LT, GT], GT: [GE, LT], GE: [GT, LT], ast.Eq: [ast.NotEq], ast.NotEq: [ast.Eq]}
COMPARED |= {ast.Is: [ast.IsNot], ast.IsNot: [ast.Is], ast.In: [ast.NotIn], ast.NotIn: [ast.In]}
COMPUTED = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Mult}
COMPUTED |= {ast.Pow: ast.Mult, ast.Mod: ast.FloorDiv}
PAIRS = "min max, minimum maximum, any all, amin amax, floor ceil, argmin argmax".split(", ")
SWAPPED = dict(pair.split() for pair in PAIRS) | dict(pair.split()[::-1] for pair in PAIRS)
SKIPPED = ast.Raise | ast.JoinedStr | ast.Import | ast.ImportFrom | ast.Match


def number(x):
    """Return another number."""
    if isinstance(x, bool):
        return not x
    if isinstance(x, int):
        return x + 1 if abs(x) < 10 else 2 * x
    return x * 1.5 or 1.0


def changed(node, **fields):
    """Return a copy of a node with other fields."""
    new = copy.copy(node)
    for name, value in fields.items():
        setattr(new, name, value)
    return new


def broken(node):
    """Yield (node, what to write in its place)."""
    match node:
        case ast.Compare():
            for i, op in enumerate(node.ops):
                for other in COMPARED[type(op)]:
                    yield node, changed(node, ops=[*node.ops[:i], other(), *node.ops[i + 1 :]])
        case ast.BinOp() if type(node.op) in COMPUTED:
            yield node, changed(node, op=COMPUTED[type(node.op)]())
        case ast.Constant(bool() | int() | float() as x):
            yield node, ast.Constant(number(x))
        case ast.BoolOp():
            yield node, changed(node, op=ast.And() if isinstance(node.op, ast.Or) else ast.Or())
        case ast.UnaryOp(ast.Not() | ast.USub(), operand):
            yield node, operand
        case ast.Name(name) if name in SWAPPED:
            yield node, ast.Name(SWAPPED[name])
        case ast.Attribute(_, name) if name in SWAPPED:
            yield node, changed(node, attr=SWAPPED[name])
        case ast.Return(ast.AST() as value):
            yield value, ast.Constant(None)
        case ast.Slice():
            for end in filter(None, [node.lower, node.upper]):
                yield end, ast.BinOp(end, ast.Add(), ast.Constant(1))
        case ast.If() | ast.While() | ast.IfExp():
            yield node.test, ast.UnaryOp(ast.Not(), node.test)
        case ast.Continue() | ast.Break() | ast.AugAssign() | ast.Expr(ast.Call()):
            yield node, ast.Pass()
        case ast.Assign() if all(isinstance(t, ast.Attribute | ast.Subscript) for t in node.targets):
            yield node, ast.Pass()


def everything(node):
    """Yield all that may be broken below a node: no sentences, no types."""
    if isinstance(node, SKIPPED) or "__all__" in ast.dump(node)[:80]:
        return
    yield from broken(node)
    for name, value in ast.iter_fields(node):
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST) and name not in ("annotation", "returns"):
                yield from everything(child)


def drawn(room, count):
    """Return [(path, line, what is there, what is written, the text so)] of some lines of a room."""
    by_line, rng = {}, random.Random(zlib.crc32(room.encode()))
    for path in sorted((ROOT / "jaxbound" / room).rglob("*.py")):
        for node, new in everything(ast.parse(path.read_text())):
            by_line.setdefault((path, node.lineno), []).append((node, new))
    for path, line in rng.sample(sorted(by_line), min(count, len(by_line))):
        (node, new), lines = rng.choice(by_line[path, line]), path.read_bytes().splitlines(keepends=True)
        start, stop = (
            sum(map(len, lines[: row - 1])) + column
            for row, column in ((node.lineno, node.col_offset), (node.end_lineno, node.end_col_offset))
        )
        text, code = b"".join(lines), ast.unparse(ast.fix_missing_locations(new))
        code = code if isinstance(new, ast.Pass) else f"({code})"
        yield path, line, text[start:stop].decode(), code, text[:start] + code.encode() + text[stop:]


if __name__ == "__main__":
    room, count = sys.argv[1], int([*sys.argv[2:], 20][0])
    with tempfile.TemporaryDirectory() as folder:
        tree = shutil.copytree(ROOT, Path(folder) / "tree", ignore=shutil.ignore_patterns(".*"))
        env = os.environ | {"PYTHONPATH": str(tree), "JAXBOUND_SHARED": str(ROOT.parent / "shared")}
        for path, line, old, new, text in drawn(room, count):
            place, tests = tree / path.relative_to(ROOT), sorted((tree / "tests" / room).rglob("test_*.py"))
            tests.sort(key=lambda test: path.stem not in test.read_text())
            place.write_bytes(text)
            try:
                command = [sys.executable, "-m", "pytest", "-x", "-q", *tests, tree / "jaxbound" / room]
                done = subprocess.run(command, cwd=tree, env=env, capture_output=True, timeout=600)
                noticed = "noticed" if done.returncode else "NOBODY NOTICES"
            except subprocess.TimeoutExpired:
                noticed = "noticed"
            place.write_bytes(path.read_bytes())
            print(f"{noticed:15}{path.relative_to(ROOT)}:{line}: {old} -> {new}", flush=True)
