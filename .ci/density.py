"""How densely the code is written, room by room, and whether it became denser than it was.

Run: python .ci/density.py [ROOT]     prints the table of ROOT/jaxbound; the exit code is 1 where a budget of
                                      ROOT/.ci/density.json is exceeded, or where there is none
     python .ci/density.py --lower    makes what is reached the new budget, where it is less
     python .ci/density.py --places conditionals cli    prints the lines of a measure in a room

A room is a folder of jaxbound. Measures are per 1 000 lines of code (without blank lines, comments and
docstrings), but for those that are counts. In sets/ the rates have no budget: kernels may look like their
equation.
"""

import ast
import io
import json
import re
import sys
import tokenize
from collections import Counter
from functools import cache
from pathlib import Path

HOME = Path(__file__).resolve().parents[1]
WIDTH = 110
RATES = ("conditionals", "comprehensions", "lambdas")
COUNTS = ("wide", "skips", "any", "sentences", "locals", "families")
ROOTS = {"Relations", "WindowTest"}
FREE = {"sets": RATES}
VAGUE = {"told", "said", "given", "found", "beside", "asked", "seen", "held", "kept", "known"}
DEFINITIONS = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
COMPREHENSIONS = (ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)


def docstring(node):
    """Return the docstring's expression of a definition, or None."""
    first = node.body[0] if node.body else None
    if (
        isinstance(first, ast.Expr)
        and isinstance(first.value, ast.Constant)
        and isinstance(first.value.value, str)
    ):
        return first
    return None


def strings_alone(tree):
    """Return the numbers of the lines of docstrings, those of constants too."""
    lines = set()
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Expr)
            and isinstance(node.value, ast.Constant)
            and isinstance(node.value.value, str)
        ):
            lines.update(range(node.lineno, node.end_lineno + 1))
    return lines


def signature_types(node):
    """Return the annotations of a function's arguments and of its result."""
    arguments = [
        *node.args.posonlyargs,
        *node.args.args,
        *node.args.kwonlyargs,
        node.args.vararg,
        node.args.kwarg,
    ]
    annotations = [a.annotation for a in arguments if a is not None and a.annotation is not None]
    if node.returns is not None:
        annotations.append(node.returns)
    return annotations


def vague_names(function):
    """Return the lines where a vague local name is read more than ten lines after it got its value."""
    stored, far = {}, []
    names = [n for n in ast.walk(function) if isinstance(n, ast.Name) and n.id in VAGUE]
    for node in sorted(names, key=lambda n: (n.lineno, n.col_offset)):
        if isinstance(node.ctx, ast.Store):
            stored[node.id] = node.lineno
        elif node.id in stored and node.lineno - stored[node.id] > 10:
            far.append(node.lineno)
    return far


def vague_sentence(text):
    """Return whether a docstring's first sentence has "what", "who" or "where" as the head of an object."""
    sentence = re.split(r"(?<=[.:])\s", " ".join(text.split()))[0]
    return bool(re.match(r"(What|Who|Where)\b|\w+ (what|who|where)\b", sentence))


@cache
def families(package):
    """Return {name: file} of the classes that derive from ROOTS, these too: who differs has a method."""
    classes, found = {}, {}
    for path in package.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef):
                names = [name for base in node.bases for name in ast.walk(base)]
                classes[node.name] = path, {getattr(name, "id", "") for name in names}
    new = ROOTS & set(classes)
    while new:
        found |= {name: classes[name][0] for name in new}
        new = {name for name, (_, bases) in classes.items() if name not in found and bases & set(found)}
    return found


def asked_types(call, path, known):
    """Return whether a call asks if something is of a family that another file defines."""
    if getattr(call.func, "id", "") != "isinstance" or len(call.args) < 2:
        return False
    names = {name.id for name in ast.walk(call.args[1]) if isinstance(name, ast.Name)}
    return any(known[name] != path for name in names & set(known))


def places(path, package):
    """Return {measure: [line]} of a file, and its numbers of lines of code and of comments."""
    source = path.read_text(encoding="utf-8")
    tree, known = ast.parse(source), families(package)
    found = {measure: [] for measure in (*RATES, *COUNTS)}
    for node in ast.walk(tree):
        if isinstance(node, ast.IfExp):
            found["conditionals"].append(node.lineno)
        if isinstance(node, COMPREHENSIONS):
            found["comprehensions"].append(node.lineno)
        if isinstance(node, (ast.Assign, ast.AnnAssign)) and isinstance(node.value, ast.Lambda):
            found["lambdas"].append(node.lineno)
        if isinstance(node, ast.Call) and asked_types(node, path, known):
            found["families"].append(node.lineno)
        if isinstance(node, FUNCTIONS):
            bare = [a.lineno for a in signature_types(node) if isinstance(a, ast.Name) and a.id == "Any"]
            found["any"].extend(bare)
            found["locals"].extend(vague_names(node))
        if isinstance(node, DEFINITIONS):
            written = docstring(node)
            if written is not None and vague_sentence(written.value.value):
                found["sentences"].append(written.lineno)
    texts, comments = strings_alone(tree), 0
    code = set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            comments += 1
            if re.match(r"#\s*fmt:", token.string):
                found["skips"].append(token.start[0])
        elif token.type not in (
            tokenize.NL,
            tokenize.NEWLINE,
            tokenize.INDENT,
            tokenize.DEDENT,
            tokenize.ENDMARKER,
        ):
            code.update(range(token.start[0], token.end[0] + 1))
    for number, line in enumerate(source.splitlines(), 1):
        if len(line) > WIDTH and not path.name == "template.py":
            found["wide"].append(number)
    return found, len(code - texts), comments


def table(package):
    """Return {room: row}: lines, comments per 100 lines, and each measure."""
    rooms = {}
    for path in sorted(package.rglob("*.py")):
        parts = path.relative_to(package).parts
        room = parts[0] if len(parts) > 1 else "."
        found, lines, comments = places(path, package)
        row = rooms.setdefault(room, Counter())
        row.update({"lines": lines, "comments": comments})
        row.update({measure: len(where) for measure, where in found.items()})
    return {room: finished(row) for room, row in rooms.items()}


def finished(row):
    """Return a room's row with rates for counts, rounded up."""
    lines = row["lines"]
    rates = {measure: -(-1000 * row[measure] // max(lines, 1)) for measure in RATES}
    rest = {measure: row[measure] for measure in COUNTS}
    return {"lines": lines, "comments": round(100 * row["comments"] / max(lines, 1), 1), **rates, **rest}


def twice(package):
    """Return the names of classes and of functions that stand in two modules or more."""
    classes, functions = Counter(), Counter()
    for path in sorted(package.rglob("*.py")):
        body = ast.parse(path.read_text(encoding="utf-8")).body
        classes.update({node.name for node in body if isinstance(node, ast.ClassDef)})
        # what `register` and `overload` define anew in a module is one name in it
        functions.update({node.name for node in body if isinstance(node, FUNCTIONS)})
    return [sorted(name for name, n in names.items() if n > 1) for names in (classes, functions)]


def exceeded(rooms, budget):
    """Return a sentence for each measure of a room that is above its budget."""
    sentences = []
    for room, row in rooms.items():
        for measure in (*RATES, *COUNTS):
            most = budget.get(room, {}).get(measure, 0)
            if measure not in FREE.get(room, ()) and row[measure] > most:
                sentences.append(
                    f"{room}: {measure} {row[measure]}, the budget is {most}: "
                    f"python .ci/density.py --places {measure} {room}"
                )
    return sentences


def show(rooms, package):
    """Print the table, a line a room, and the names that stand twice."""
    columns = ("lines", "comments", *RATES, *COUNTS)
    print(f"{'':14}" + "".join(f"{c:>15}" for c in columns))
    for room, row in rooms.items():
        print(f"{room:14}" + "".join(f"{row[c]:>15}" for c in columns))
    total = {c: sum(row[c] for row in rooms.values()) for c in ("lines", *COUNTS)}
    lines = total["lines"]
    for c in ("comments", *RATES):
        total[c] = round(sum(row[c] * row["lines"] for row in rooms.values()) / lines, 1)
    print(f"{'all':14}" + "".join(f"{total[c]:>15}" for c in columns))
    classes, functions = twice(package)
    print(f"names in two modules or more: {len(classes)} classes, {len(functions)} functions")


def lowered(rooms, budget):
    """Return the budget that is left once nothing may be denser than what each room reaches now."""
    left = {}
    for room, row in sorted(rooms.items()):
        before = row | budget.get(room, {})
        left[room] = {measure: min(row[measure], before[measure]) for measure in (*RATES, *COUNTS)}
    return left


def print_places(measure, room):
    """Print the lines of a room that a measure counts."""
    for path in sorted((HOME / "jaxbound" / room).rglob("*.py")):
        for line in places(path, HOME / "jaxbound")[0][measure]:
            print(f"{path.relative_to(HOME)}:{line}")


def main(arguments):
    """Print the table, or the places of a measure; return the exit code."""
    if arguments[:1] == ["--places"]:
        print_places(*arguments[1:3])
        return 0
    lower = arguments == ["--lower"]
    root = Path(arguments[0]) if arguments and not lower else HOME
    stated = root / ".ci" / "density.json"
    budget = json.loads(stated.read_text()) if stated.exists() else {}
    rooms = table(root / "jaxbound")
    if lower:
        budget = lowered(rooms, budget)
        stated.write_text(json.dumps(budget, indent=1) + "\n")
    show(rooms, root / "jaxbound")
    sentences = exceeded(rooms, budget)
    print(*sentences, sep="\n")
    return 1 if sentences else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
