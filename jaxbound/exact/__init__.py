"""Exact rational arithmetic on the host: matrices, null spaces, best approximations. No rounding, and nothing
of plants.
"""
