# Two commands do all the set-up on a fresh machine: `make demo` and `make test`.
# Needed beforehand: Python 3.11 or later with venv, make, git.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet

.PHONY: all demo test test-fast test-long lint types docs mongo-server clean

all: $(VENV)/.runtime

$(VENV)/.runtime: pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(0 if sys.version_info >= (3, 11) else "BlockRobot needs Python 3.11 or later: make PYTHON=python3.11")'
	$(PYTHON) -m venv $(VENV)
	$(PIP) install --constraint constraints.txt --editable .
	touch $@

$(VENV)/.develop: $(VENV)/.runtime
	$(PIP) install --constraint constraints.txt --editable '.[dev]'
	touch $@

demo: $(VENV)/.runtime
	$(BIN)/blockrobot demo

lint: $(VENV)/.develop
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/.develop
	$(BIN)/mypy

test: lint types
	$(BIN)/python -m pytest -m 'not long'

test-fast: $(VENV)/.develop
	$(BIN)/python -m pytest tests/unit tests/property tests/architecture

test-long: $(VENV)/.develop
	$(BIN)/python -m pytest -m long

docs: $(VENV)/.develop
	$(BIN)/blockrobot reference

mongo-server: $(VENV)/.develop
	$(BIN)/python -m tests.offchain.secantus

clean:
	rm -rf $(VENV) build *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
