"""Verdicts, alarms, certificates."""
