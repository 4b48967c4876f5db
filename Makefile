# Each target makes what it needs in .venv first, with the newest Python of this machine; a second call finds it there.
# PYTHON=python3.11 chooses another Python for a new .venv.
#   make chart [SCENE=P1]   table on the terminal and chart-$(SCENE).png
#   make test               a fixed set of the tests, for two cores: all but what is marked `sample`, and the files
#                           that tests/conftest.py leaves to make test-rest
#   make test-rest          what make test leaves out: half an hour; MINUTES=10 skips what would begin later; BEGIN=7 begins
#                           with another third of the files
#   make test-all           both: all laws for one method of each kind
#   make test-full          every law for every method, dtype and driver: hours
#   make notebooks          executes the notebooks, each of which must end without an error within 3 minutes; LIMIT=400
#                           allows 400 seconds
#   make notebooks-write    makes the notebooks from their scripts, with their outputs: notebooks/*.ipynb
#   make lint               formatting, lint, types
#   make fuzz [MINUTES=5]   a random search for wrong results
#   make mutants            thirty wrong lines, each of which a test of make test must find: a few minutes
#   make bench              the benchmarks
#   make claims             what is claimed of the methods, measured: docs/reports/claims.md and its picture
#   make rivals             error against time beside other programs: docs/reports/work-precision.md and its charts
#   make test-gpu           the laws on the accelerator that JAX sees; installs JAX='jax[cuda13]' unless told otherwise
#   make gpu                the speed there: docs/reports/gpu.md and docs/reports/gpu.png
#   make kernels            the kernels of a step on a GPU, counted without one: docs/reports/gpu.md
#   make test-kernels       tests of these
#   make docs               the pages of docs/ as a site: site/index.html
#   make figures            draws every picture of docs/ again, each by the command beside it: hours
#   make test-release       runs all that README and docs say, with the wheel in an empty environment
#   make test-lowest        some of make test on the oldest Python, with the least versions of what the package depends on

# The newest and the oldest of these Pythons that the machine has, in PATH or among pyenv's; else python3.
VERSIONS = 3.13 3.12 3.11
first = $(shell for v in $(1); do for python in "python$$v" "$$(pyenv root 2>/dev/null)"/versions/$$v.*/bin/python; do \
	"$$python" -c "" 2>/dev/null && echo "$$python" && exit; done; done; echo python3)
PYTHON ?= $(call first,$(VERSIONS))
OLDEST ?= $(call first,3.11 3.12 3.13)
SCENE ?= P1
LIMIT ?= 180
JAX ?= jax[cuda13]
# tests/conftest.py says what one worker runs.
PYTEST = .venv/bin/pytest -n 2 --no-loadscope-reorder
# What the type checkers make of the package is kept with its compiled Python: 10 seconds of each worker.
export PYTHONDONTWRITEBYTECODE =
PIP = .venv/bin/python -m pip install --quiet --disable-pip-version-check

.DEFAULT_GOAL := chart
.PHONY: chart test test-rest test-all test-full test-gpu test-kernels notebooks notebooks-write lint fuzz mutants bench \
	claims rivals gpu kernels docs figures test-release test-lowest
.NOTPARALLEL: # pip must not run twice at once in one environment

chart: .venv/.cli
	.venv/bin/midlie chart $(SCENE)

test: .venv/.test
	$(PYTEST) --sample

test-all: .venv/.test
	$(PYTEST)

test-rest: .venv/.test
	$(PYTEST) --rest $(if $(MINUTES),--minutes $(MINUTES)) $(if $(BEGIN),--begin $(BEGIN))

test-full: .venv/.test
	$(PYTEST) -m "full or not full"

# Each worker takes of the accelerator's memory only what it needs.
LAWS = $(patsubst %,tests/test_%.py,laws rounding diffrax ensemble flights free_motion \
	shared_inputs)
test-gpu: .venv/.test .venv/.accelerator
	XLA_PYTHON_CLIENT_PREALLOCATE=false $(PYTEST) --accelerator $(LAWS)

test-kernels: .venv-cuda/.compiler
	.venv-cuda/bin/pytest -n 2 tests/test_kernels.py

notebooks: .venv/.notebooks
	.venv/bin/python benchmarks/notebooks.py --limit $(LIMIT)

notebooks-write: .venv/.notebooks
	.venv/bin/python benchmarks/notebooks.py --write

# Left alone, pyright takes the version of the first python in PATH for that of .venv.
lint: .venv/.lint
	.venv/bin/ruff format --check
	.venv/bin/ruff check
	.venv/bin/pyright --pythonpath .venv/bin/python
	.venv/bin/pyright --pythonpath .venv/bin/python -p tests

fuzz: .venv/.fuzz
	.venv/bin/python tests/fuzz.py --minutes $(or $(MINUTES),5)

mutants: .venv/.test
	.venv/bin/python tests/mutants.py --all

bench: .venv/.bench
	.venv/bin/python benchmarks/speed.py bench

claims: .venv/.cli
	.venv/bin/python benchmarks/claims.py --out docs/reports/claims.png --page docs/reports/claims.md

rivals: .venv/.bench
	.venv/bin/python benchmarks/work_precision.py

gpu: .venv/.test .venv/.accelerator
	.venv/bin/python benchmarks/gpu.py --write

kernels: .venv-cuda/.compiler
	.venv-cuda/bin/python benchmarks/kernels.py --write

docs: .venv/.docs
	NO_MKDOCS_2_WARNING=1 .venv/bin/mkdocs build --strict

figures: .venv/.bench
	.venv/bin/python benchmarks/figures.py

test-release: .venv/.test
	$(PYTEST) tests/newcomer.py tests/test_docs.py tests/test_release.py

LOWEST = $(patsubst %,tests/test_%.py,laws ensemble stepper so3 bodies inputs scalars leaves cli fit_calls release)
test-lowest: .venv-lowest/.lowest
	.venv-lowest/bin/pytest -n 2 --no-loadscope-reorder --sample $(LOWEST)

.venv/bin/python:
	$(PYTHON) -m venv .venv

.venv/.accelerator: pyproject.toml | .venv/bin/python
	$(PIP) '$(JAX)'
	@touch $@

# XLA's CUDA compiler, which needs no GPU, apart from .venv: there JAX would look for a GPU at every start.
.venv-cuda/.compiler: pyproject.toml
	@echo "installing midlie_jax[test] and XLA's CUDA compiler into .venv-cuda"
	$(OLDEST) -m venv .venv-cuda
	.venv-cuda/bin/python -m pip install --quiet --disable-pip-version-check -e '.[test]'
	.venv-cuda/bin/python -m pip install --quiet --disable-pip-version-check \
		"jax-cuda12-plugin==$$(.venv-cuda/bin/python -c 'import jax; print(jax.__version__)')"
	@touch $@

# The least versions that pyproject.toml allows, of direct dependencies; of theirs the newest that fit.
.venv-lowest/.lowest: pyproject.toml
	@echo "installing the least versions of what midlie_jax[test] depends on into .venv-lowest"
	$(OLDEST) -m venv --clear .venv-lowest
	.venv-lowest/bin/python -m pip install --quiet --disable-pip-version-check uv
	.venv-lowest/bin/uv pip install --quiet --python .venv-lowest/bin/python --resolution lowest-direct -e '.[test]'
	@touch $@

# One stamp for each extra: installed since pyproject.toml last changed.
.venv/.%: pyproject.toml | .venv/bin/python
	@echo "installing midlie_jax[$*] into .venv (about a minute the first time)"
	$(PIP) -e '.[$*]'
	@touch $@
