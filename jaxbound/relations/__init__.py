"""How unknowns are eliminated; each kind of relations says which test decides its windows."""

from jaxbound.relations.decoupling import Isolability, Signatures
from jaxbound.relations.parity import ParityRelation
from jaxbound.relations.redundancy import Redundancy
from jaxbound.relations.residual import Residual
from jaxbound.relations.uncertain import UncertainRelations

__all__ = ["Isolability", "ParityRelation", "Redundancy", "Residual", "Signatures", "UncertainRelations"]
