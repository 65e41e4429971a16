"""Bisection: pavings of sets that inequalities describe, and proofs that a box holds a solution."""
