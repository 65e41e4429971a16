# On a machine with nothing but Python 3.11+: `make demo` or `make test`. Without make, run the lines yourself.
PYTHON ?= python3
# where this is set, every process compiles every file again: a tenth of what the tests take
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test long lowest newest upcoming nightly lint docs bench clean

demo: .venv/installed
	.venv/bin/jaxbound demo --out demo-report

# each worker begins with half of the files, in order, and takes over from one that has more left: neighbours share
# what they compile, and none waits for the last file
test: .venv/tested
	.venv/bin/python -m pytest -n auto --dist worksteal

long: .venv/tested
	.venv/bin/python -m pytest -n auto --dist loadfile -m long $(WHERE)

lowest:
	.ci/versions lowest

newest:
	.ci/versions newest

upcoming:
	.ci/versions upcoming

nightly: test long lowest newest

lint: .venv/tested
	.venv/bin/pip install --quiet --editable ".[dev]"
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .
	.venv/bin/mypy
	.venv/bin/python .ci/density.py

docs: .venv/installed
	.venv/bin/pip install --quiet --editable ".[docs]"
	.venv/bin/properdocs build --strict

bench: .venv/tested
	.venv/bin/python -m benchmarks.strips
	.venv/bin/python -m benchmarks.paving
	.venv/bin/python -m benchmarks.false_alarms
	.venv/bin/python -m benchmarks.command_line
	.venv/bin/python -m benchmarks.first_call --against first_call_before
	.venv/bin/python -m benchmarks.fleet
	.venv/bin/python -m benchmarks.long_windows
	.venv/bin/python -m benchmarks.parquet
	.venv/bin/python -m benchmarks.intervals
	.venv/bin/python -m benchmarks.inclusion
	.venv/bin/python -m benchmarks.redundancy
	.venv/bin/python -m benchmarks.uncertain
	.venv/bin/python -m benchmarks.varying
	.venv/bin/python -m benchmarks.twice
	.venv/bin/python -m benchmarks.linear_systems
	.venv/bin/python -m benchmarks.validation
	.venv/bin/python -m benchmarks.tuning
	.venv/bin/python -m benchmarks.study
	.venv/bin/python -m benchmarks.stream
	.venv/bin/python -m benchmarks.scale
	.venv/bin/python -m benchmarks.zonotopes
	.venv/bin/python -m benchmarks.zonotope_algebra
	.venv/bin/python -m benchmarks

.venv/installed: pyproject.toml
	$(PYTHON) -m venv .venv
	.venv/bin/pip install --quiet --editable .
	touch $@

.venv/tested: .venv/installed
	.venv/bin/pip install --quiet --editable ".[test]"
	touch $@

clean:
	rm -rf .venv .venv-lowest .venv-newest .venv-upcoming .lowest.txt build dist *.egg-info demo-report site
