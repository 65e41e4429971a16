"""Floats that bound real numbers: directed rounding, what it assumes of a machine, verdicts in three
values.
"""
