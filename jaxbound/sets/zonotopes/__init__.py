"""Zonotopes and constrained zonotopes: their facets, and decisions about them that carry proofs."""
