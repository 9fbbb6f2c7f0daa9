# Two commands do all the set-up on a fresh machine: `make demo` and `make test`.
# Needed beforehand: Python 3.11 to 3.14 with venv, make, git. Everything from PyPI is a wheel with a pinned hash (requirements/). `make test` installs eight Debian packages if they are missing, `make test-long` seven more
# (as root, or by sudo without a password); `make test SYSTEM_PACKAGES=none` leaves out the tests that need them.
# Tests of several hosts need root and iproute2; `make test-long HOSTS=none` leaves those out.
# Tests of ROS 2 need Python 3.11 and a network of their own; `make test ROS2=none` leaves those out.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet

SYSTEM_PACKAGES ?= install
ifeq ($(SYSTEM_PACKAGES),none)
LEFT_OUT := and not system_packages
else ifneq ($(SYSTEM_PACKAGES),install)
$(error SYSTEM_PACKAGES is `install` (what `make test` does anyway) or `none`, not `$(SYSTEM_PACKAGES)`)
endif

ROS2 ?= install
ifeq ($(ROS2),none)
LEFT_OUT += and not ros2
else ifneq ($(ROS2),install)
$(error ROS2 is `install` (what `make test` does anyway) or `none`, not `$(ROS2)`)
endif

HOSTS ?= here
ifeq ($(HOSTS),none)
LEFT_OUT += and not hosts
else ifneq ($(HOSTS),here)
$(error HOSTS is `here` (what `make test-long` does anyway) or `none`, not `$(HOSTS)`)
endif

# How many processes share the tests of `make test`, each file in one of them.
WORKERS ?= 2

EXTRAS := attack cluster keyring kit llrp s3 zenoh
INSTALLED_EXTRAS := $(EXTRAS:%=install-%)
HASHED := install --require-hashes --requirement

.PHONY: all help demo system-packages ros2 test test-fast test-long lint types docs mongo-server lock wheelhouse collected-wheels image sbom clean install-fuzz $(INSTALLED_EXTRAS)

all: $(VENV)/.runtime

$(VENV)/.runtime: pyproject.toml requirements/build.txt requirements/runtime.txt
	$(PYTHON) -c 'import sys; sys.exit(0 if (3, 11) <= sys.version_info < (3, 15) else "BlockRobot needs Python 3.11 to 3.14: make PYTHON=python3.13")'
	$(PYTHON) -m venv $(VENV)
	$(PIP) $(HASHED) requirements/build.txt --requirement requirements/runtime.txt
	$(PIP) install --no-deps --no-build-isolation --editable .
	touch $@

$(VENV)/.develop: $(VENV)/.runtime requirements/dev.txt
	$(PIP) $(HASHED) requirements/dev.txt
	touch $@

$(INSTALLED_EXTRAS): install-%: $(VENV)/.runtime
	$(PIP) $(HASHED) requirements/$*.txt

help:
	@echo 'make               install BlockRobot into .venv: .venv/bin/blockrobot'
	@echo 'make demo          the demonstration; installs first (minutes)'
	@echo 'make test          what must hold before a change lands; installs what it needs (minutes)'
	@echo 'make test-fast     unit and property tests only'
	@echo 'make test-long     all tests (an hour and three quarters); TEST_EFFORT=10 searches ten times as long'
	@echo 'make lint types    ruff; mypy'
	@echo 'make docs          write what is made from code and catalogues'
	@echo 'make wheelhouse    what deploy/ansible installs on hosts; make image: an OCI image (deploy/image)'
	@echo 'make lock          pin all requirements anew'
	@echo 'make clean         remove .venv and what was built'
	@echo 'make install-NAME  an extra: $(EXTRAS) fuzz'

# Beside the tests' packages; Linux x86-64 with Python 3.11 to 3.13 only.
install-fuzz: $(VENV)/.develop
	$(PIP) $(HASHED) requirements/fuzz.txt

demo: $(VENV)/.runtime
	$(BIN)/blockrobot demo

lint: $(VENV)/.develop
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/.develop
	$(BIN)/mypy

system-packages:
	@$(PYTHON) tests/system_packages.py $(SYSTEM_PACKAGES) $(TIER)

ros2: $(VENV)/.develop
ifneq ($(ROS2),none)
	@$(BIN)/python -m tests.robot_live.ros2_wheels
endif

# The tests start hundreds of programs: each would compile all of ours anew.
unexport PYTHONDONTWRITEBYTECODE
PYTEST = TMPDIR=$$($(PYTHON) tests/temporary_folder.py) $(BIN)/python -m pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder

test: system-packages ros2 lint types
	$(PYTEST) -m 'not long $(LEFT_OUT)'

test-fast: $(VENV)/.develop
	$(PYTEST) tests/unit tests/property tests/architecture

test-long: TIER := long
test-long: system-packages ros2 lint types
	HYPOTHESIS_PROFILE=long $(PYTEST) -m '(long or not long) $(LEFT_OUT)'

docs: $(VENV)/.develop
	$(BIN)/blockrobot reference
	$(BIN)/pybabel --quiet compile --directory clients/wallet/texts

mongo-server: $(VENV)/.develop
	$(BIN)/python -m tests.offchain.secantus

TOOLS := build/tools
COMPILE := $(TOOLS)/bin/uv pip compile --quiet --universal --fork-strategy fewest --generate-hashes --python-version 3.11 \
	--only-binary :all: --emit-build-options --no-annotate \
	--custom-compile-command 'make lock' $(UPGRADE)
LISTED := $(TOOLS)/bin/python requirements/listed.py

$(TOOLS)/.tools: requirements/tools.txt
	$(PYTHON) -m venv --clear $(TOOLS)
	$(TOOLS)/bin/python -m pip --disable-pip-version-check --quiet $(HASHED) requirements/tools.txt
	touch $@

# What the long tests judge deploy/ with.
build/deploy-tools/.tools: requirements/deploy.txt
	$(PYTHON) -m venv --clear $(@D)
	$(@D)/bin/python -m pip --disable-pip-version-check --quiet $(HASHED) $<
	touch $@

SHIPPED := requirements/runtime.txt requirements/s3.txt
# Each pin once: the two overlap.
PINS := awk '/^[^ ]/ {is_new = !seen[$$0]++} is_new' $(SHIPPED)

# All that a host installs, for the Python of $(PYTHON) on this platform: what is committed, and what it needs.
wheelhouse: $(TOOLS)/.tools
	@wanted="$$(git rev-parse HEAD) $$($(PYTHON) --version)"; test "$$(cat build/wheelhouse.made 2>&1)" = "$$wanted" || \
		{ $(MAKE) --no-print-directory collected-wheels && echo "$$wanted" > build/wheelhouse.made; }

collected-wheels:
	rm -rf build/wheelhouse build/committed
	mkdir -p build/committed
	git archive HEAD | tar -x -C build/committed
	$(TOOLS)/bin/python -m pip --python "$$(command -v $(PYTHON))" --disable-pip-version-check --quiet download \
		--require-hashes --no-deps $(SHIPPED:%=--requirement %) --dest build/wheelhouse
	$(TOOLS)/bin/uv build --quiet --wheel --require-hashes --build-constraint requirements/build.txt \
		--out-dir build/wheelhouse build/committed
	{ $(PINS); cd build/wheelhouse; sha256sum blockrobot-*.whl | sed 's|\(.*\)  \(.*\)|./\2 --hash=sha256:\1|'; } \
		> build/wheels.txt
	mv build/wheels.txt build/wheelhouse/wheels.txt
	tar -C build/wheelhouse -cf build/wheelhouse.tar .

image: wheelhouse
	deploy/image/build.sh
	@echo build/image

# Keeps every pin that still fits; `make lock UPGRADE=--upgrade` renews them all, `UPGRADE='--upgrade-package NAME'` one.
lock: $(TOOLS)/.tools
	$(LISTED) build | $(COMPILE) - --output-file requirements/build.txt
	$(COMPILE) requirements/tools.in --output-file requirements/tools.txt
	$(COMPILE) requirements/fuzz.in --output-file requirements/fuzz.txt
	$(COMPILE) requirements/deploy.in --output-file requirements/deploy.txt
	$(COMPILE) pyproject.toml --extra dev --output-file requirements/dev.txt
	$(COMPILE) pyproject.toml --constraint requirements/dev.txt --output-file requirements/runtime.txt
	for extra in $(EXTRAS); do \
		$(LISTED) $$extra | $(COMPILE) - --constraint requirements/dev.txt --output-file requirements/$$extra.txt || exit 1; \
	done

sbom: $(TOOLS)/.tools
	$(PINS) | $(TOOLS)/bin/cyclonedx-py requirements --output-reproducible --output-format JSON --pyproject pyproject.toml \
		--output-file build/sbom.cdx.json -
	@echo build/sbom.cdx.json

clean:
	rm -rf $(VENV) build *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
