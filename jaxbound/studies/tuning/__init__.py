"""Bounds from healthy recordings."""
