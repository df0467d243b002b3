# Each target sets up what it needs: its own virtual environment and the compiled kernel.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
KERNEL := $(wildcard ekf_companion/core/*.py ekf_companion/core/*.pxd)
STAMP := $(VENV)/.installed

.PHONY: setup test explore lint types contracts check demo bench accuracy filters endurance reconnect wheel clean

setup: $(STAMP)

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)

# All of the kernel is compiled anew: its modules share layout.pxd, whose changes the compiler misses
$(STAMP): $(VENV)/bin/python pyproject.toml $(KERNEL)
	rm -rf build ekf_companion/core/*.c ekf_companion/core/*.so
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[dev]'
	@touch $@

test: $(STAMP)
	$(BIN)/python -W error -m pytest -n 2 --dist loadfile

# Property tests on examples never tried before
explore: $(STAMP)
	HYPOTHESIS_PROFILE=explore $(BIN)/python -W error -m pytest -n 2 --dist loadfile

lint: $(STAMP)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .

types: $(STAMP)
	$(BIN)/mypy

contracts: $(STAMP)
	$(BIN)/lint-imports

check: lint types contracts test

demo: $(STAMP)
	$(BIN)/python -m sim_autopilot demo --out demo

bench: $(STAMP)
	$(BIN)/python -m benchmarks.run

accuracy: $(STAMP)
	$(BIN)/python -m benchmarks.accuracy

filters: $(STAMP)
	$(BIN)/python -m benchmarks.filters

endurance: $(STAMP)
	$(BIN)/python -m benchmarks.endurance

# A hundred times unplugged and restarted, links and the daemon; eight minutes
reconnect: $(STAMP)
	RECONNECT_CYCLES=100 $(BIN)/python -W error -m pytest --log-cli-level=INFO tests/test_reconnect.py

wheel: $(STAMP)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check build
	$(BIN)/python -m build

clean:
	rm -rf $(VENV) build dist demo *.egg-info ekf_companion/core/*.so ekf_companion/core/*.c
