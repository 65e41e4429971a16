"""Benchmarks against peers and against the memory limit: `python -m benchmarks.strips`, `python -m benchmarks.paving`, ..."""
