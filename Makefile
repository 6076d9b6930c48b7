# `make help` explains every target.

VENV := .venv
BIN := $(VENV)/bin
ARGS ?=
# A version of its own, so that an index that has a CPU build of it can provide it.
TORCH ?= torch==2.13.0
# Versions that are known to work together; CONSTRAINTS= takes the newest that pyproject.toml allows.
CONSTRAINTS ?= constraints.txt
# The tests of "make newest", unless ARGS names others.
QUICK := tests/test_cli.py tests/test_report.py tests/test_storage.py tests/discrete tests/models tests/rendering
PIP = $(BIN)/python -m pip install --quiet --disable-pip-version-check $(COMPILE) $(addprefix --constraint ,$(CONSTRAINTS))

.DEFAULT_GOAL := help
.PHONY: help demo test bench lint style types suite compiled format docs golden campaigns gallery constraints newest recipes packages libraries clean

help:  ## Explain the targets
	@echo "Usage: make TARGET [ARGS='...']"
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "  %-11s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

demo: $(VENV)/installed libraries  ## Build the simple two-story building in physics: report and film in out/demo (ARGS are passed on)
	$(BIN)/craftsim demo --out out/demo $(ARGS)

# Tests run beside one another, and not beside threads of their own; what one process has compiled, all read.
test newest: export OMP_NUM_THREADS := 1
test newest: export PYTHONDONTWRITEBYTECODE :=
# Modules are compiled when they are imported, which most of those of torch, Ray and others never are.
test newest: export COMPILE := --no-compile
test: libraries  ## Lint, type-check and run all tests, from a fresh checkout (ARGS are passed to pytest)
	@$(MAKE) --no-print-directory -j2 style compiled
	@$(MAKE) --no-print-directory -j2 types suite

bench: $(VENV)/installed-dev  ## Run the benchmarks on a quiet machine (half an hour; ARGS='benchmarks/bench_physics.py --benchmark-json FILE')
	OMP_NUM_THREADS=1 $(BIN)/pytest -c benchmarks/pytest.ini $(or $(ARGS),benchmarks)

lint: style types  ## Check style, formatting and types

style: $(VENV)/installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

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

golden: $(VENV)/installed-dev  ## Compare what craftsim does with its golden records (some minutes; ARGS=--write stores them, ARGS='--base REVISION' compares here)
	PYTHONPATH=tests $(BIN)/python -m golden $(ARGS)

campaigns: $(VENV)/installed  ## Measure the skills at length (hours on two cores): what the rules allow with and without noise, the six tasks, long episodes, both audits
	$(BIN)/craftsim audit --rules physical --only legal --randomize none --workers 2 --out out/legal
	$(BIN)/craftsim audit --rules physical --only legal --randomize strong --workers 2 --out out/legal-strong
	$(BIN)/craftsim validate --order concurrent --randomize strong --trials 20 --workers 2 --video none --out out/tasks-strong
	$(BIN)/craftsim validate random --randomize none --trials 505 --seed 2026 --workers 2 --video none --out out/random
	$(BIN)/craftsim audit --rules physical --workers 2 --out out/audit-physical
	$(BIN)/craftsim audit --workers 2 --out out/audit-published

gallery: $(VENV)/installed libraries  ## Make the films of docs/gallery and docs/gallery.md again (half an hour on two cores)
	$(BIN)/craftsim audit --quick --workers 2 --out out/gallery || [ $$? -eq 1 ]
	# A rule that fails one time in twelve: a single trial of each row does not find it.
	$(BIN)/craftsim audit --situations 'MOVE-off-foot/load=none/near=block/allowed in the way' --trials 100 --workers 2 --out out/chance || [ $$? -eq 1 ]
	$(BIN)/python scripts/gallery.py all --audits out/gallery out/chance --workers 2

constraints: $(VENV)/installed-dev  ## Write the versions that are installed here into constraints.txt
	scripts/freeze $(BIN)/python > .constraints && mv .constraints constraints.txt

newest:  ## Lint and run quick tests with the newest packages that pyproject.toml allows (a virtual environment of its own)
	rm -rf .venv-newest
	$(MAKE) VENV=.venv-newest CONSTRAINTS= TORCH=torch lint
	.venv-newest/bin/python -m pip --disable-pip-version-check list
	.venv-newest/bin/pytest -n 2 --dist worksteal $(or $(ARGS),$(QUICK))

recipes:  ## Run the scripts of examples/trainers whose libraries want other versions, each in a virtual environment of its own
	scripts/run-recipe rllib ray.rllib.algorithms 'ray[rllib]' '$(TORCH)'
	scripts/run-recipe benchmarl_ippo benchmarl 'benchmarl>=1.5' '$(TORCH)'

packages:  ## Look the versions of constraints.txt up among known vulnerabilities (pip-audit, needs the network)
	scripts/make-venv .venv-audit
	.venv-audit/bin/python -m pip install --quiet --disable-pip-version-check --upgrade pip-audit
	.venv-audit/bin/pip-audit --strict --no-deps --disable-pip --requirement constraints.txt

libraries: $(VENV)/installed  ## Check for the system libraries of off-screen rendering (installs them when root)
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
