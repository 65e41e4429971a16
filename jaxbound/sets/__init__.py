"""Rigorous sets and kernels, useful without any plant: intervals, zonotopes, strips, pavings."""

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
from jaxbound.sets.zonotopes.facets import membership, strips
from jaxbound.sets.zonotopes.zonotope import Zonotope, support, zonotope

__all__ = [*_interval, *_elementary, "Answer", "ConstrainedZonotope", "Decision", "Inclusion", "Paving", "Separation", "Solution",
           "Solvability", "Status", "Zonotope", "constrained_zonotope", "contains", "inclusion", "intersects", "is_empty", "membership",
           "pave", "separate", "solve_interval", "strips", "support", "zonotope"]  # fmt: skip
