# `make help` explains every target.

VENV := .venv
BIN := $(VENV)/bin
ARGS ?=
# A version of its own, so that an index that has a CPU build of it can provide it.
TORCH ?= torch==2.13.0
# Versions that are known to work together; CONSTRAINTS= takes the newest that pyproject.toml allows.
CONSTRAINTS ?= constraints.txt
PIP = $(BIN)/python -m pip install --quiet --disable-pip-version-check $(COMPILE) $(addprefix --constraint ,$(CONSTRAINTS))

.DEFAULT_GOAL := help
.PHONY: help demo test bench lint style types suite compiled format docs watch golden plants libraries clean

help:  ## Explain the targets
	@echo "Usage: make TARGET [ARGS='...']"
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "  %-11s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

demo: $(VENV)/installed libraries  ## Build the simple two-story building in physics: report and film in out/demo (ARGS are passed on)
	$(BIN)/craftsim demo --out out/demo $(ARGS)

# Tests run beside one another, and not beside threads of their own; what one process has compiled, all read.
test: export OMP_NUM_THREADS := 1
test: export PYTHONDONTWRITEBYTECODE :=
# Modules are compiled when they are imported, which most of those of torch, Ray and others never are.
test: export COMPILE := --no-compile
test: libraries  ## Lint, type-check and run all tests, from a fresh checkout (ARGS are passed to pytest)
	@$(MAKE) --no-print-directory -j2 style compiled
	@$(MAKE) --no-print-directory -j2 types suite

bench: $(VENV)/installed-dev  ## Run the benchmarks on a quiet machine (half an hour; ARGS='benchmarks/bench_physics.py --benchmark-json FILE')
	OMP_NUM_THREADS=1 $(BIN)/pytest -c benchmarks/pytest.ini $(or $(ARGS),benchmarks)

lint: style types  ## Check style, formatting, plainness and types

style: $(VENV)/installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/python scripts/plainness.py

# One process for a minute, which tests use better than they wait for it.
types: $(VENV)/installed-dev
	$(BIN)/mypy

suite: $(VENV)/installed-dev
	$(BIN)/pytest -n 3 --dist worksteal $(ARGS)

# Beside installing and linting; what it leaves out, tests compile. A package that is just being installed stops it.
compiled: $(VENV)/installed
	-@PYTHONPATH=. $(BIN)/python scripts/precompile.py

format: $(VENV)/installed-dev  ## Format the code and apply safe lint fixes
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

docs: $(VENV)/installed-dev  ## Build the documentation site with its API reference in out/docs
	$(BIN)/sphinx-build -W --keep-going -q docs out/docs
	@echo "Open out/docs/index.html"

watch:  ## Show recordings in 3D at http://127.0.0.1:8000, and simulate there, with python3 and npm alone
	python3 docs/_extensions/player.py
	python3 -m http.server --bind 127.0.0.1 --directory out/player $(ARGS)

golden: $(VENV)/installed-dev  ## Compare what craftsim does with its golden records (some minutes; ARGS=--write stores them, ARGS='--base REVISION' compares here)
	PYTHONPATH=tests $(BIN)/python -m golden $(ARGS)

plants: $(VENV)/installed-dev  ## Insert faults, and see which instrument finds which (35 minutes the first time; ARGS='--faults hinge', ARGS=rules)
	OMP_NUM_THREADS=1 $(BIN)/python scripts/plants.py $(ARGS)

# System libraries of off-screen rendering; installed when root.
libraries: $(VENV)/installed
	@scripts/system-libraries $(BIN)/python

clean:  ## Remove the virtual environment, outputs and caches
	rm -rf $(VENV) .venv-newest .venv-recipe .venv-audit out build dist *.egg-info .mypy_cache .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# The stamp files make a second call quick; both are made again when the packaging changes.
$(VENV)/installed: pyproject.toml $(CONSTRAINTS) scripts/make-venv
	scripts/make-venv $(VENV)
	$(PIP) --editable .
	@touch $@

$(VENV)/installed-dev: $(VENV)/installed
	$(PIP) '$(TORCH)'
	$(PIP) --editable '.[dev,train]'
	@touch $@
