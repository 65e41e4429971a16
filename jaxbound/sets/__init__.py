"""Rigorous sets and kernels, useful without any plant: intervals, zonotopes, strips, pavings."""

from jaxbound.sets.comparisons import *  # noqa: F403
from jaxbound.sets.comparisons import __all__ as _comparisons
from jaxbound.sets.elementary import *  # noqa: F403
from jaxbound.sets.elementary import __all__ as _elementary
from jaxbound.sets.inclusion import Inclusion, inclusion
from jaxbound.sets.interval import *  # noqa: F403
from jaxbound.sets.interval import __all__ as _interval
from jaxbound.sets.linear_systems import Solution, Solvability, solve_interval
from jaxbound.sets.paving import Paving, pave
from jaxbound.sets.status import Status
from jaxbound.sets.zonotopes.constrained import ConstrainedZonotope, constrained_zonotope
from jaxbound.sets.zonotopes.containment import contains
from jaxbound.sets.zonotopes.decisions import Answer, Decision, Separation, intersects, is_empty, separate
from jaxbound.sets.zonotopes.extents import interval_hull, support
from jaxbound.sets.zonotopes.facets import membership, strips
from jaxbound.sets.zonotopes.intersections import eliminate_constraints, intersection, strip_intersection
from jaxbound.sets.zonotopes.maps import cartesian_product, convex_hull, from_interval, linear_map, minkowski_sum, scale, translate
from jaxbound.sets.zonotopes.reduction import reduce_order
from jaxbound.sets.zonotopes.shapes import minkowski_difference, sample, vertices, volume
from jaxbound.sets.zonotopes.zonotope import Zonotope, zonotope

__all__ = [*_interval, *_comparisons, *_elementary, "Answer", "ConstrainedZonotope", "Decision", "Inclusion", "Paving", "Separation",
           "Solution", "Solvability", "Status", "Zonotope", "cartesian_product", "constrained_zonotope", "contains", "convex_hull",
           "eliminate_constraints", "from_interval", "inclusion", "intersection", "intersects", "interval_hull", "is_empty", "linear_map",
           "membership", "minkowski_difference", "minkowski_sum", "pave", "reduce_order", "sample", "scale", "separate", "solve_interval",
           "strip_intersection", "strips", "support", "translate", "vertices", "volume", "zonotope"]  # fmt: skip
