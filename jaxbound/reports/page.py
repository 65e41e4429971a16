"""Templates become pages: the engine escapes every value and refuses one that is missing."""

import base64
import functools
from pathlib import Path
from typing import TYPE_CHECKING

from jaxbound.relations.sentence import main_terms
from jaxbound.text.characters import printable
from jaxbound.text.quantities import factor, percent

if TYPE_CHECKING:
    from jinja2 import Environment

HOME = Path(__file__).parent
TITLE = {
    "fault": "Fault proved",
    "outside the bounds as fitted": "Outside the bounds as fitted",
    "not tested": "Not all units could be tested",
    "too little evidence": "Too little evidence",
    "no fault": "No fault found",
    "study": "What this monitor sees",
    "look": "What was read",
}


def render(template: str, **values: object) -> str:
    """Return the HTML text of a template of this folder.

    Args:
        template: "fleet.html" and the like. values: what it shows, by name. The style sheet is in the page.

    Raises:
        jinja2.UndefinedError: it shows something that is not there.
    """
    return str(_template_environment().get_template(f"templates/{template}").render(**values))


@functools.cache
def _template_environment() -> "Environment":
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("jaxbound", "reports"),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_readable,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"after": _after, "embedded": _embedded}
    environment.filters |= {"factor": factor, "main_terms": main_terms, "percent": percent}
    environment.globals |= {"TITLE": TITLE, "source": _source}
    return environment


def _source(name: str) -> str:
    """Return a file of this folder as it stands: a script or a style sheet, which holds nothing of a user."""
    return (HOME / name).read_text(encoding="utf-8")


def _readable(value: object) -> object:
    """Return a value as text without control characters, which a name may hold."""
    if hasattr(value, "__html__"):  # of a macro, in which each value was
        return value
    return printable(str(value), keep="\n")


def _after(sentence: str, title: str) -> str:
    """Return a sentence without the title that stands above it, with a capital letter."""
    plain = sentence.removeprefix(f"{title}: ").removeprefix(f"{title}, ")
    return plain[:1].upper() + plain[1:]


def _embedded(picture: bytes) -> str:
    """Return a picture, PNG or SVG, as a data URL."""
    kind = "png"
    if picture.startswith(b"<svg"):
        kind = "svg+xml"
    return f"data:image/{kind};base64,{base64.b64encode(picture).decode()}"
