# Two commands for a newcomer: `make demo` and `make test`. Each sets up what it needs in its own virtual environment.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

# Each run takes the next fifth of the slow tests: by the commits of this branch, or by days where they are not known.
ROTA ?= $(shell if [ "$$(git rev-parse --is-shallow-repository 2>/dev/null)" = false ]; \
	then git rev-list --count --first-parent HEAD; else echo $$(( $$(date +%s) / 86400 )); fi)

.PHONY: demo test test-slow test-slow-rota check docs format clean

demo: $(VENV)/.installed
	$(BIN)/mammometry demo demo-session

test: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -n auto --dist loadfile

test-slow: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -m slow

test-slow-rota: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -m slow --rota $(ROTA)/5 -n auto --dist loadgroup

check: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/zensical build --strict --clean

docs: $(VENV)/.installed-dev
	$(BIN)/zensical serve

format: $(VENV)/.installed-dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean:
	rm -rf build demo-session

$(VENV)/.installed: pyproject.toml constraints.txt hatch_build.py $(shell find viewer -path viewer/node_modules -prune -o -type f -print)
	$(PYTHON) -c 'import sys; sys.exit(0 if (3, 11) <= sys.version_info < (3, 14) else "mammometry needs Python 3.11 to 3.13, found " + sys.version.split()[0] + ": call make PYTHON=python3.12 (or another) demo")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e .
	touch $@

$(VENV)/.installed-dev: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	touch $@
