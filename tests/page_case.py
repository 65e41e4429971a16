"""Pages ask nobody: addresses that a page names beside those of the libraries that it holds."""

import re

BANNER = "/*! https://github.com/leeoniya/uPlot (v1.6.32) */"  # of the library that draws, which must stay


def foreign(page):
    """Return what a page would fetch or leads to elsewhere."""
    return re.findall(r"url\(|@import|https?:|fetch\(|XMLHttpRequest", page.replace(BANNER, "", 1))
