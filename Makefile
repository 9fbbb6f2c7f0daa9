# Two commands do all the set-up on a fresh machine: `make demo` and `make test`.
# Needed beforehand: Python 3.11 or later with venv, make, git. `make test` installs seven Debian packages if they are missing
# (as root, or by sudo without a password); `make test SYSTEM_PACKAGES=none` leaves out the tests that need them.
# Tests of ROS 2 need Python 3.11 and a network of their own; `make test ROS2=none` leaves those out.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet

SYSTEM_PACKAGES ?= install
ifeq ($(SYSTEM_PACKAGES),none)
TESTS := not long and not system_packages
else ifeq ($(SYSTEM_PACKAGES),install)
TESTS := not long
else
$(error SYSTEM_PACKAGES is `install` (what `make test` does anyway) or `none`, not `$(SYSTEM_PACKAGES)`)
endif

ROS2 ?= install
ifeq ($(ROS2),none)
TESTS := $(TESTS) and not ros2
else ifneq ($(ROS2),install)
$(error ROS2 is `install` (what `make test` does anyway) or `none`, not `$(ROS2)`)
endif

.PHONY: all demo system-packages ros2 test test-fast test-long lint types docs mongo-server clean

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

system-packages:
	@$(PYTHON) tests/system_packages.py $(SYSTEM_PACKAGES)

ros2: $(VENV)/.develop
ifneq ($(ROS2),none)
	@$(BIN)/python -m tests.robot_live.ros2_wheels
endif

test: system-packages ros2 lint types
	$(BIN)/python -m pytest -m '$(TESTS)'

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
