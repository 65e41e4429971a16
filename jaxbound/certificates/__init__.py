"""Exact proofs of one window, for people and as JSON."""
