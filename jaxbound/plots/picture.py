"""A matplotlib Figure that a notebook shows by itself: pyplot, which else sees to that, is never asked for.

Imported where a figure is made, never with the package: matplotlib takes half a second.
"""

import io
import warnings

from matplotlib.figure import Figure

DPI = 100
"""Of a picture in a notebook, which is as wide as a page there."""


class Picture(Figure):
    """A Figure with a canvas of its own, which a notebook displays as a PNG picture.

    A notebook that has pyplot's own display switched on uses that one instead: each picture comes once.
    """

    def _repr_png_(self) -> bytes:
        return png(self, DPI)


def png(fig: Figure, dpi: int) -> bytes:
    """Return a Figure as the bytes of a PNG picture."""
    out = io.BytesIO()
    with warnings.catch_warnings():
        # a name in letters that the font does not have
        warnings.filterwarnings("ignore", "Glyph .* missing from")
        fig.savefig(out, format="png", dpi=dpi, facecolor="white")
    return out.getvalue()
