# Each target sets up what it needs: its own virtual environment and the compiled kernel.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
KERNEL := setup.py $(wildcard ekf_companion/core/*.py ekf_companion/core/*.pxd) \
	$(wildcard ekf_companion/logs/*_search.py ekf_companion/logs/*.pxd)
STAMP := $(VENV)/.installed

.PHONY: setup test explore reference lint types contracts check demo bench bits accuracy truth filters delays sitl fuzz e2e reconnect endurance soak wheel install uninstall installcheck clean

setup: $(STAMP)

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)

# Whoever waits sees every five seconds that it goes on
$(STAMP): $(VENV)/bin/python pyproject.toml $(KERNEL)
	@echo "Setting up $(VENV): packages are downloaded and the kernel is compiled, one to three minutes"
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[dev]' & job=$$!; \
	seconds=0; while kill -0 $$job 2> /dev/null; do sleep 1; seconds=$$((seconds + 1)); \
	[ $$((seconds % 5)) -ne 0 ] || echo "  setting up, $$seconds s"; done; wait $$job
	@touch $@

test: $(STAMP)
	$(BIN)/python -W error -m pytest -n 2 --dist loadfile

# Property tests on examples never tried before
explore: $(STAMP)
	HYPOTHESIS_PROFILE=explore $(BIN)/python -W error -m pytest -n 2 --dist loadfile

# config/reference.yaml, from the fields of the settings
reference: $(STAMP)
	$(BIN)/python -m tests.reference

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
	$(BIN)/python -m benchmarks.speed

# Whether a refactoring has changed a bit of any estimate, message or status; five minutes
bits: $(STAMP)
	$(BIN)/python -m benchmarks.bits check

accuracy: $(STAMP)
	$(BIN)/python -m benchmarks.accuracy

# Flights with faults from an independent generator; a quarter of an hour
truth: $(STAMP)
	$(BIN)/python -m benchmarks.truth

filters: $(STAMP)
	$(BIN)/python -m benchmarks.filters

# Whether the interval of calibrate delay contains the truth, in 120 flights; seven minutes
delays: $(STAMP)
	$(BIN)/python -m benchmarks.delay

# PX4's and ArduCopter's simulators, where a built one is named; half an hour each: docs/SITL.md
sitl: $(STAMP)
	$(BIN)/python -m benchmarks.sitl $(if $(PX4),--px4 $(PX4)) $(if $(ARDUPILOT),--ardupilot $(ARDUPILOT))

# A quarter of an hour: 10^7 bytes, 10^6 messages, then what coverage leads to
fuzz: $(STAMP)
	$(BIN)/python -m benchmarks.reliability.fuzz
	$(BIN)/python -m pip install --quiet --disable-pip-version-check atheris
	$(BIN)/python -m benchmarks.reliability.guided stream tlog bin ulg csv txt mat --seconds 60

# Clients that nobody here wrote: MAVSDK and MAVProxy, in an environment of their own
$(VENV)-e2e/.installed:
	$(PYTHON) -m venv $(VENV)-e2e
	$(VENV)-e2e/bin/python -m pip install --quiet --disable-pip-version-check mavsdk MAVProxy
	@touch $@

e2e: $(STAMP) $(VENV)-e2e/.installed
	E2E_CLIENTS=$(abspath $(VENV)-e2e/bin) $(BIN)/python -W error -m pytest tests/e2e

endurance: $(STAMP)
	$(BIN)/python -m benchmarks.reliability.endurance

# Every fault again and again for hours of flight, then against the daemon; forty minutes
soak: $(STAMP)
	$(BIN)/python -m benchmarks.reliability.soak --daemon

# A hundred times unplugged and restarted, links and the daemon; eight minutes
reconnect: $(STAMP)
	RECONNECT_CYCLES=100 $(BIN)/python -W error -m pytest --log-cli-level=INFO tests/daemon/test_reconnect.py

wheel: $(STAMP)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check build
	$(BIN)/python -m build

# See systemd/install.sh for PREFIX, DESTDIR, CONFIG, WHEEL, PIP_FLAGS
export PYTHON PREFIX DESTDIR CONFIG WHEEL PIP_FLAGS

install uninstall:
	systemd/install.sh $@

# The whole way to a board, with all that is downloaded, in a folder of its own
CHECKED := $(CURDIR)/build/installcheck
installcheck: $(STAMP)
	$(BIN)/python -W error -m pytest tests/installation.py
	rm -rf $(CHECKED) && mkdir -p $(CHECKED)
	$(BIN)/python -m pip wheel --quiet --disable-pip-version-check --no-deps --no-build-isolation \
		--wheel-dir $(CHECKED) .
	$(MAKE) install PREFIX=$(CHECKED)/opt DESTDIR=$(CHECKED)/board WHEEL=$$(ls $(CHECKED)/*.whl)
	mv $(CHECKED)/board$(CHECKED)/opt $(CHECKED)/opt
	$(CHECKED)/opt/bin/ekf-companion check-config $(CHECKED)/board/etc/ekf-companion/config.yaml \
		> /dev/null
	$(CHECKED)/opt/bin/sim-autopilot generate --duration 15 -o $(CHECKED)/flight.tlog
	$(CHECKED)/opt/bin/ekf-companion convert $(CHECKED)/flight.tlog -o $(CHECKED)/flight.csv
	$(CHECKED)/opt/bin/python -c "from ekf_companion.status.assets import NO_CHARTS, index; \
		assert NO_CHARTS not in index('live').decode()"
	rm -rf $(CHECKED)

clean:
	rm -rf $(VENV) $(VENV)-e2e build dist demo *.egg-info ekf_companion/core/*.so ekf_companion/core/*.c \
		ekf_companion/logs/*.so ekf_companion/logs/*.c
