"""The page of a look at a recording."""

from jaxbound.plots.look import plot_look
from jaxbound.recordings.look import Look
from jaxbound.reports.chart import picture_of
from jaxbound.reports.page import render


def look_page(found: Look) -> str:
    """Return the HTML text."""
    head, *cells = found.cells(wide=80)
    return render(
        "look.html",
        name=found.source,
        verdict="look",
        sentence=found.extent,
        rows=list(found.rows()),
        head=head,
        cells=cells,
        table=found.table,
        picture=picture_of(plot_look(found)),
    )
