"""Recordings as values: signals, time, gaps, what does not count; and where they come from."""
