# Each target makes what it needs in .venv first; a second call finds it there.
#   make chart [SCENE=P1]   table on the terminal and chart-$(SCENE).png
#   make test               the tests
#   make test-full         the same and the whole matrix of methods, dtypes and drivers: hours
#   make lint               formatting, lint, types
#   make fuzz [MINUTES=5]   a random search for wrong results
#   make bench              the benchmarks
#   make rivals             error against time beside other programs: docs/work-precision.md and its charts
#   make docs               the pages of docs/ as a site: site/index.html

PYTHON ?= $(shell python3.11 --version >/dev/null 2>&1 && echo python3.11 || echo python3)
SCENE ?= P1
MINUTES ?= 5
# A file is one worker's, so that a program that it needs twice is compiled once; in the order of the names.
PYTEST = .venv/bin/pytest -n 2 --dist loadgroup --no-loadscope-reorder
PIP = .venv/bin/python -m pip install --quiet --disable-pip-version-check

.DEFAULT_GOAL := chart
.PHONY: chart test test-full lint fuzz bench rivals docs
.NOTPARALLEL: # pip must not run twice at once in one environment

chart: .venv/.cli
	.venv/bin/midlie chart $(SCENE)

test: .venv/.test
	$(PYTEST)

test-full: .venv/.test
	$(PYTEST) -m "full or not full"

lint: .venv/.lint
	.venv/bin/ruff format --check
	.venv/bin/ruff check
	.venv/bin/pyright
	.venv/bin/pyright -p tests

fuzz: .venv/.fuzz
	.venv/bin/python tests/fuzz.py --minutes $(MINUTES)

bench: .venv/.bench
	.venv/bin/python benchmarks/run.py

rivals: .venv/.bench
	.venv/bin/python benchmarks/work_precision.py

docs: .venv/.docs
	.venv/bin/mkdocs build --strict

.venv/bin/python:
	$(PYTHON) -m venv .venv

# One stamp for each extra: installed since pyproject.toml last changed.
.venv/.%: pyproject.toml | .venv/bin/python
	@echo "installing midlie_jax[$*] into .venv (about a minute the first time)"
	$(PIP) -e '.[$*]'
	@touch $@
