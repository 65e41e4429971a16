"""Rigorous sets and kernels, useful without any plant: intervals, zonotopes, strips, pavings."""

from jaxbound.sets.floats.status import Status
from jaxbound.sets.inclusion.inclusion import Inclusion, inclusion
from jaxbound.sets.intervals.comparisons import *  # noqa: F403
from jaxbound.sets.intervals.comparisons import __all__ as _comparisons
from jaxbound.sets.intervals.elementary import *  # noqa: F403
from jaxbound.sets.intervals.elementary import __all__ as _elementary
from jaxbound.sets.intervals.errorfunctions import *  # noqa: F403
from jaxbound.sets.intervals.errorfunctions import __all__ as _errors
from jaxbound.sets.intervals.interval import *  # noqa: F403
from jaxbound.sets.intervals.interval import __all__ as _interval
from jaxbound.sets.linear_systems.solve import Solution, Solvability, solve_interval
from jaxbound.sets.paving.paving import Paving, pave
from jaxbound.sets.strips import __name__ as _strips  # noqa: F401  # before `strips`, which it hides
from jaxbound.sets.zonotopes.constrained import ConstrainedZonotope, constrained_zonotope
from jaxbound.sets.zonotopes.decisions import (
    Answer,
    Decision,
    Separation,
    contains,
    intersects,
    is_empty,
    separate,
)
from jaxbound.sets.zonotopes.extents import interval_hull, support
from jaxbound.sets.zonotopes.facets import membership, strips
from jaxbound.sets.zonotopes.intersections import eliminate_constraints, intersection, strip_intersection
from jaxbound.sets.zonotopes.maps import (
    cartesian_product,
    convex_hull,
    from_interval,
    linear_map,
    minkowski_sum,
    scale,
    translate,
)
from jaxbound.sets.zonotopes.reduction import reduce_order
from jaxbound.sets.zonotopes.shapes import minkowski_difference, sample, vertices, volume
from jaxbound.sets.zonotopes.zonotope import Zonotope, zonotope

__all__ = [
    *_interval,
    *_comparisons,
    *_elementary,
    *_errors,
    "Answer",
    "ConstrainedZonotope",
    "Decision",
    "Inclusion",
    "Paving",
    "Separation",
    "Solution",
    "Solvability",
    "Status",
    "Zonotope",
    "cartesian_product",
    "constrained_zonotope",
    "contains",
    "convex_hull",
    "eliminate_constraints",
    "from_interval",
    "inclusion",
    "intersection",
    "intersects",
    "interval_hull",
    "is_empty",
    "linear_map",
    "membership",
    "minkowski_difference",
    "minkowski_sum",
    "pave",
    "reduce_order",
    "sample",
    "scale",
    "separate",
    "solve_interval",
    "strip_intersection",
    "strips",
    "support",
    "translate",
    "vertices",
    "volume",
    "zonotope",
]
