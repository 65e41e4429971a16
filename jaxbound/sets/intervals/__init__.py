"""Intervals: arithmetic, comparisons, elementary functions."""
