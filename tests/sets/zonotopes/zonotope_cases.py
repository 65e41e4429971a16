"""What the tests of zonotopes share."""

import numpy as np
import pytest
from corners import DTYPES
from scipy.spatial import HalfspaceIntersection

from jaxbound import sets
from jaxbound.sets import zonotope as factory

each_dtype = pytest.mark.parametrize("dtype", DTYPES, ids=["float32", "float64"])


def build(case):
    return factory(np.array(case.get("c", np.zeros(len(case["G"]))), float), np.array(case["G"], float))


def margin(Z, point):
    return float(sets.membership(Z, np.array([point], float))[0])


def polytope(Z):
    """Return the vertices of a solid zonotope from its strips, by an independent halfspace intersection."""
    normals, widths = sets.strips(Z)
    center = np.asarray(Z.center)
    sides = [np.r_[s * n, -s * n @ center - w] for n, w in zip(normals, widths, strict=True) for s in (1, -1)]
    return HalfspaceIntersection(np.array(sides), center).intersections


def widths_along(Z, normals):
    """Return how far Z reaches along each normal: sum |normal . g|."""
    return abs(normals @ np.asarray(Z.generators)).sum(1)
