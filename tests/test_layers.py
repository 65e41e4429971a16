"""The house: a folder is a floor, imports point down, nothing goes round in a circle, what is public is
documented.
"""

import inspect
import subprocess
import sys
from pathlib import Path

import pytest
from sources import imports

import jaxbound as jb
from benchmarks.pictures import HOUSE

PACKAGE = Path(jb.__file__).parent
FLOORS = (
    "text",
    "exact",
    "random",
    "files",
    "recordings",
    "sets",
    "workers",
    "models",
    "consistency",
    "relations",
    "certificates",
    "estimation",
    "diagnosis",
    "studies",
    "sklearn",
    "plots",
    "runs",
    "reports",
    "cli",
    "__main__",
)
ROOMS = {
    "certificates": {"checker"},
    "sets": {"floats", "intervals", "strips", "inclusion", "linear_systems", "paving", "zonotopes"},
    "studies": {"assessment", "identification", "tuning", "montecarlo"},
    "reports": {"templates", "vendor", "vendor/uplot"},
}
FILES = {
    ".".join(p.relative_to(PACKAGE).with_suffix("").parts).removesuffix(".__init__"): p
    for p in sorted(PACKAGE.rglob("*.py"))
}
OUTSIDE = "__init__"  # the public names: whoever asks for one of them from inside wants the version


def depends(path):
    """Return the files of the package that a file imports, wherever in it."""
    found = set()
    for module, within in imports(path):
        name = f"{module}.{within}".rstrip(".")
        if name.split(".")[0] == "jaxbound" and name != "jaxbound.__version__":
            inner = name.removeprefix("jaxbound").removeprefix(".")
            while inner and inner not in FILES:
                inner = inner.rpartition(".")[0]
            found.add(inner or OUTSIDE)
    return found


GRAPH = {name: depends(path) for name, path in FILES.items()}
GRAPH["diagnosis.units"].discard("diagnosis.detection")  # until there is one driver that both may call


def circle(graph):
    """Return the names along one circle of a graph, or none."""
    done, path = set(), []

    def follow(name):
        if name in path:
            return path[path.index(name) :]
        if name in done:
            return []
        path.append(name)
        found = next((c for x in sorted(graph.get(name, ())) if x != name and (c := follow(x))), [])
        path.pop()
        done.add(name)
        return found

    return next((c for name in sorted(graph) if (c := follow(name))), [])


def folder(name):
    return name.rpartition(".")[0] if FILES[name].name != "__init__.py" else name


def test_every_folder_is_known():
    folders = {
        str(p.relative_to(PACKAGE)) for p in PACKAGE.rglob("*") if p.is_dir() and p.name != "__pycache__"
    }
    assert (
        folders - {*FLOORS, *(f"{floor}/{room}" for floor, rooms in ROOMS.items() for room in rooms)} == set()
    )
    assert {p.name for p in PACKAGE.iterdir() if p.is_file()} <= {
        "__init__.py",
        "__main__.py",  # the command, without a place on the path
        "py.typed",
        "sklearn.py",  # an optional face
    }


def test_the_drawing_of_the_house_has_every_floor():
    drawn = [room for _, *rooms in reversed(HOUSE) for room, *_ in rooms]
    assert [*drawn, "__main__"] == [*FLOORS]


def test_imports_point_down():
    floor = {name: FLOORS.index(name.split(".")[0]) for name in GRAPH if name != OUTSIDE}
    up = [(name, other) for name in floor for other in GRAPH[name] - {OUTSIDE} if floor[other] > floor[name]]
    assert up == [], "files that import from a floor above"


def test_no_files_in_a_circle():
    assert circle(GRAPH) == []


def test_no_folders_in_a_circle():
    folders = {}
    for name, others in GRAPH.items():
        if name != OUTSIDE:
            folders.setdefault(folder(name), set()).update(folder(o) for o in others)
    assert circle(folders) == []


def test_a_circle_is_found():
    assert (
        circle({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == ["b", "c"] and circle({"a": {"b"}, "b": set()}) == []
    )


def test_no_private_jax():
    assert [name for name, path in FILES.items() if "jax._src" in path.read_text()] == []


ROOMS_OF_TYPES = [
    jb.certificates,
    jb.consistency,
    jb.diagnosis,
    jb.estimation,
    jb.models,
    jb.relations,
    jb.runs,
    jb.sets,
    jb.studies,
]


@pytest.mark.parametrize("module", [jb, *ROOMS_OF_TYPES], ids=lambda m: m.__name__)
def test_every_public_name_has_a_docstring(module):
    for name in module.__all__:
        thing = getattr(module, name)
        assert inspect.getdoc(thing), f"{module.__name__}.{name} has no docstring"
        if inspect.isclass(thing) and thing.__module__.startswith("jaxbound"):
            for member, value in vars(thing).items():
                if not member.startswith("_") and (inspect.isfunction(value) or isinstance(value, property)):
                    assert inspect.getdoc(value), f"{name}.{member} has no docstring"


def test_the_top_has_verbs_and_what_is_constructed_and_types_of_results_live_in_their_rooms():
    types = {room: names.split() for room, names in jb._HOMES.items() if "." not in room}
    verbs = {name for home, names in jb._HOMES.items() if "." in home for name in names.split()}
    assert len(jb.__all__) <= 54 and verbs | {"sets"} == set(jb.__all__) <= set(dir(jb))
    assert jb.Result is jb.diagnosis.Result and jb.Certificate is jb.certificates.Certificate
    assert all(
        getattr(jb, name) is getattr(getattr(jb, room), name)
        for room, names in types.items()
        for name in names
    )
    with pytest.raises(AttributeError, match="has no attribute 'nothing'"):
        _ = jb.nothing
    seen = {name for _, name in imports(FILES[OUTSIDE])}  # what type checkers and the pages read
    assert verbs - {"sets"} <= seen, verbs - seen


def test_import_loads_nothing_heavy_beyond_jax_makes_no_arrays_and_changes_no_configuration():
    code = """
import sys, jax
modules, configuration = set(sys.modules), dict(jax.config.values)
import jaxbound
for name in jaxbound.__all__:
    getattr(jaxbound, name)
heavy = {"pandas", "matplotlib", "pyarrow", "rich", "scipy", "jinja2"}
print([m for m in set(sys.modules) - modules if m.split(".")[0] in heavy])
print(len(jax.live_arrays()), len(configuration) > 20 and dict(jax.config.values) == configuration)
"""
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.split() == ["[]", "0", "True"]


def test_import_itself_loads_nothing_not_even_jax():
    code = (
        "import sys; import jaxbound; print([name for name in ('jax', 'numpy') if name in sys.modules], "
        "jaxbound.__version__)"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert out.split() == ["[]", jb.__version__]
