"""Monitors on many simulated plants."""
