# `make demo` needs what a bench runs on (requirements.lock), everything else what tests, linters and docs need as well
# (requirements-dev.lock).
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
DEV_STAMP := $(VENV)/.installed-dev

# python-can's own tests (they are in its source distribution only), in the version and with the hash of the lock file.
SUITE := .cache/python-can

# npm's canopen, the other side of the simulated drive in tests/foreign, in the version of its lock file.
STATION := .cache/node-canopen
STATION_FILES := $(addprefix tests/foreign/,package.json package-lock.json .npmrc crc)

# Foxglove's own readers of what is streamed (tests/streams), likewise.
READERS := .cache/stream-readers
READERS_FILES := $(addprefix tests/streams/readers/,package.json package-lock.json .npmrc)

# What a lock file says of one package: its version and hashes.
pinned = awk '/^$(1)==/ {on = 1} on {print} on && !/\\$$/ {exit}' requirements.lock

# Where it is set, each of the many processes of runs and tests would compile what it imports anew.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: setup setup-dev compiled demo wheel test test-slow test-vcan docs bench claims lint lock clean

setup: $(STAMP)

# uv in the version and with the hash of the lock file installs the rest in a tenth of pip's time; of what is behind a
# mirror UV_DEFAULT_INDEX tells it. Only what is imported is compiled to bytecode, when it is. For a Python newer than
# the locked numpy it says so, and builds none.
INSTALL := $(BIN)/uv pip install --quiet --native-tls --python $(BIN)/python
$(STAMP): requirements.lock pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(call pinned,uv) > $(VENV)/uv.txt
	$(BIN)/python -m pip install --quiet --no-compile --no-deps --require-hashes -r $(VENV)/uv.txt
	$(INSTALL) --require-hashes --only-binary numpy -r requirements.lock
	$(INSTALL) --no-deps --no-build-isolation --editable .
	touch $@

setup-dev: $(DEV_STAMP)

$(DEV_STAMP): requirements-dev.lock $(STAMP)
	$(INSTALL) --require-hashes -r requirements-dev.lock
	touch $@

# All compiled functions, what has changed since: once, not in each worker or run.
compiled: $(DEV_STAMP)
	$(BIN)/hilbench compile

$(SUITE)/.extracted: requirements.lock $(DEV_STAMP)
	rm -rf $(SUITE)
	mkdir -p $(SUITE)
	$(call pinned,python-can) > $(SUITE)/requirement.txt
	$(BIN)/python -m pip download --quiet --no-deps --no-binary python-can --require-hashes \
	    --requirement $(SUITE)/requirement.txt --dest $(SUITE)
	tar -xzf $(SUITE)/python_can-*.tar.gz -C $(SUITE) --strip-components=1
	touch $@

$(STATION)/.installed: $(STATION_FILES) $(wildcard tests/foreign/crc/*)
	rm -rf $(STATION)
	mkdir -p $(STATION)
	cp -r $(STATION_FILES) $(STATION)
	cd $(STATION) && npm ci --loglevel=error
	touch $@

$(READERS)/.installed: $(READERS_FILES)
	rm -rf $(READERS)
	mkdir -p $(READERS)
	cp $(READERS_FILES) $(READERS)
	cd $(READERS) && npm ci --loglevel=error
	touch $@

demo: setup
	$(BIN)/hilbench run bench_configs/web_section_step.yaml

# A wheel for this interpreter in build/wheel, with the machine code of all compiled functions.
wheel: compiled
	$(BIN)/python tools/wheel.py build/wheel

# Without `-m` those that pyproject.toml deselects are left out. Without Node.js the tests that need it are skipped.
# On two cores three workers: while one waits for a bus, the others run. The slow ones keep both busy, and some of them
# run by the clock.
test: WORKERS := 3
test-slow: WORKERS := 2
test-slow: TIER := -m "slow and not vcan and not docs"
test test-slow: compiled $(SUITE)/.extracted $(if $(shell command -v npm),$(STATION)/.installed $(READERS)/.installed)
	$(BIN)/python -m pytest -q -n $(WORKERS) --dist worksteal $(TIER)

# On a vcan of this machine, or in a guest whose kernel has CAN (made on first use, kept in .cache/vcan-guest).
test-vcan: compiled $(if $(shell command -v npm),$(STATION)/.installed)
	$(BIN)/python tools/test_vcan.py

# The docs as a site in build/site (a warning is an error), and every command that they show, run.
docs: compiled
	$(BIN)/mkdocs build
	$(BIN)/python -m pytest -q -n 2 --dist worksteal -m docs tests/docs

# Beside scipy, plain Python, canopen and a bare timer loop; rewrites docs/tables/performance.csv and docs/performance.md.
SECONDS ?= 60
bench: compiled
	$(BIN)/python tools/bench.py --seconds $(SECONDS) --json performance.json --write

# Runs what the first pages claim, and writes CLAIMS.md from what the runs left.
claims: setup
	$(BIN)/hilbench run bench_configs/web_section_step.yaml
	$(BIN)/hilbench run bench_configs/web_section_step_pid.yaml
	$(BIN)/hilbench diagnose bench_configs/hidden_friction.yaml
	$(BIN)/python tools/claims.py

lint: setup-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-logo --cache-dir .cache/import-linter

# Rewrites both lock files from pyproject.toml: newest versions that its bounds allow, with hashes. What a bench runs on
# is what the tests need allow: both locks have the same versions, for the oldest Python as for newer ones.
LOCK := $(BIN)/uv pip compile --quiet --generate-hashes --python-version 3.11 --extra build \
    --custom-compile-command "make lock" pyproject.toml
lock: setup
	$(LOCK) --upgrade --extra dev --output-file requirements-dev.lock
	cp requirements-dev.lock requirements.lock
	$(LOCK) --output-file requirements.lock

clean:
	rm -rf $(VENV) build .cache .pytest_cache .mypy_cache .ruff_cache .hypothesis
