"""A widened model on the terminal and as JSON."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from jaxbound.cli.terminal import Conclusion, Row
from jaxbound.studies.identification.adding import Widened, place
from jaxbound.text.quantities import times


@dataclass(frozen=True)
class WideningConclusion(Conclusion):
    """The conclusion of `fit --add`."""

    widened: Widened

    @property
    def headline(self) -> str:
        """The name of the model, and by how much its bounds have grown."""
        widened = self.widened
        text = f"{widened.model.name}: "
        if widened.factor > 1:
            return text + f"widened, bounds up to {times(widened.factor)} as wide"
        if widened.changed:
            return text + "its bounds hold, the region of training grows"
        return text + "its bounds hold, nothing changes"

    def plain(self) -> dict[str, Any]:
        """Return the factors and what they cost."""
        widened = self.widened
        tests = {}
        for name, grown in widened.tests.items():
            asking = None
            if grown.day is not None:
                asking = place(widened.days, grown.day, grown.sample)
            tests[name] = {"factor": grown.factor, "asked_for_by": asking}
        sizes = {}
        for when, (jump, steady) in (("before", widened.before), ("after", widened.after)):
            sizes[when] = {"jump": jump, "steady": steady}
        return {
            "out": list(map(str, self.written)),
            "factor": widened.factor,
            "tests": tests,
            "sizes": sizes,
            "ranges": widened.ranges,
            "hints": self.hints,
        }

    def rows(self) -> Iterator[Row]:
        """Yield the tests, and what the widening costs."""
        return self.widened.rows()
