# Each target sets up what it needs: its own virtual environment and the compiled kernel.
PYTHON ?= python3
SYSTEM_PYTHON ?= /usr/bin/python3
VENV := .venv
BIN := $(VENV)/bin
KERNEL := setup.py ekf_companion/core/memory/overlay.pxd ekf_companion/mavlink/definitions.txt \
	$(wildcard $(patsubst %,ekf_companion/%/*.py,core core/* logs mavlink mavlink/decode nav))
STAMP := $(VENV)/.built
FLYING := $(VENV)/.built-demo

.PHONY: setup test campaigns explore reference lock lint types contracts check demo bench bits accuracy truth sensitivity tune filters lidar delays sitl fuzz links e2e reconnect endurance soak site wheel wheels deb image release install uninstall installcheck clean

setup: $(STAMP)

# A command in the background; whoever waits sees every four seconds that it goes on
WAITING := & job=$$!; seconds=0; while kill -0 $$job 2> /dev/null; do sleep 1; \
	seconds=$$((seconds + 1)); [ $$((seconds % 4)) -ne 0 ] || echo "  working, $$seconds s"; \
	done; wait $$job
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check

$(VENV)/bin/python:
	@echo "Creating $(VENV)"
	@$(PYTHON) -m venv $(VENV) $(WAITING)

BOTH := packages are downloaded and the kernel is compiled

# Compiles what has changed, and what depends on it; objects are kept in build/kernel
BUILD := $(BIN)/python -W ignore setup.py --quiet build_ext --inplace

$(VENV)/.installed: $(VENV)/bin/python pyproject.toml
	@echo "Setting up $(VENV): $(if $(wildcard $(FLYING)),more packages are downloaded,$(BOTH), up to six minutes on two cores of a server)"
	@$(INSTALL) -e '.[dev]' $(WAITING)
	@touch $@

$(STAMP): $(VENV)/.installed $(KERNEL)
	@$(BUILD)
	@touch $@

# What the demo needs, a fifth of what the tests need
$(VENV)/.installed-demo: $(VENV)/bin/python pyproject.toml
	@echo "Setting up $(VENV): $(BOTH), up to six minutes on two cores of a server"
	@$(INSTALL) -e '.[sim,plot]' 'cython>=3.1' 'setuptools>=77' $(WAITING)
	@touch $@

$(FLYING): $(VENV)/.installed-demo $(KERNEL)
	@$(BUILD)
	@touch $@

# Three processes on two processors: some tests wait for a flight in real time
TEST := $(BIN)/python -W error -m pytest -n 3 --dist loadfile --no-loadscope-reorder

test: $(STAMP)
	$(TEST) -m "not campaign"

# Tests that fly often or long, and those that kill and restart daemons: five minutes more
campaigns: $(STAMP)
	$(TEST) -m campaign

# Property tests on examples never tried before
explore: $(STAMP)
	HYPOTHESIS_PROFILE=explore $(TEST) -m "not campaign"

# What is written from the code: config/reference.yaml, from the fields of the settings; the table
# of MAVLink's messages; the man page and the completions of shells, from the commands;
# the notebook with what its cells print and draw; the picture of the flow of data
reference: $(STAMP)
	$(BIN)/python -m tests.reference
	$(BIN)/python -m tests.definitions
	$(BIN)/python -m tests.manual
	$(BIN)/python -m tests.notebook
	$(BIN)/python -m tests.flow

# Versions and hashes of what `make install` installs, for all Pythons and processors; keeps the
# versions that are there, unless UPGRADE=--upgrade
LOCKED := $(BIN)/uv pip compile --quiet --universal --generate-hashes --no-header \
	--no-emit-index-url --no-emit-find-links --python-version 3.10 $(UPGRADE)
BUILD_NEEDS := import tomllib; \
	print(*tomllib.load(open("pyproject.toml", "rb"))["build-system"]["requires"], sep="\n")
lock: $(STAMP)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check uv
	$(LOCKED) pyproject.toml -o systemd/requirements-run.txt
	$(LOCKED) pyproject.toml --extra report -c systemd/requirements-run.txt \
		-o systemd/requirements-report.txt
	$(BIN)/python -c '$(BUILD_NEEDS)' | $(LOCKED) --no-annotate - -c systemd/requirements-run.txt \
		-o systemd/requirements-build.txt

lint: $(STAMP)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/check-jsonschema --quiet --builtin-schema vendor.github-workflows .github/workflows/*.yml
	$(BIN)/zizmor --quiet --offline .github/workflows

types: $(STAMP)
	$(BIN)/mypy

contracts: $(STAMP)
	$(BIN)/lint-imports

check: lint types contracts test campaigns

demo: $(if $(wildcard $(STAMP)),$(STAMP),$(FLYING))
	$(BIN)/python -m sim_autopilot demo --out demo --duration 45

bench: $(STAMP)
	$(BIN)/python -m benchmarks.speed $(if $(EKF2),--ekf2 $(EKF2))

# Whether a bit of any estimate, message or status differs from a revision's: BASE=main; ten minutes
bits: $(STAMP)
	$(BIN)/python -m benchmarks.bits $(or $(BASE),HEAD) $(CASES)

accuracy: $(STAMP)
	$(BIN)/python -m benchmarks.accuracy

# Who runs the flights of campaigns: ENGINE=dask, a Dask cluster here, or ENGINE=tcp://HOST:8786
export ENGINE

# Flights with faults from an independent generator: SEEDS of each case, 20 take half an hour;
# ALL=1 adds the faults of sources while there is no receiver
truth: $(STAMP)
	$(BIN)/python -m benchmarks.truth $(if $(SEEDS),--seeds $(SEEDS)) $(if $(ALL),--all)

# `fleet tune` on 40 flights of one vehicle whose noise, delay and lever arm are known; ten minutes
tune: $(STAMP)
	$(BIN)/python -m benchmarks.tune

# What 30 % more or less of each constant of a file in core does to these: MODULE=gate; a quarter hour
sensitivity: $(STAMP)
	$(BIN)/python -m benchmarks.sensitivity $(MODULE)

filters: $(STAMP)
	$(BIN)/python -m benchmarks.filters

# Lidar-inertial odometry on the sequences of ../shared; a quarter of an hour. ONLY=room takes a part
lidar: $(STAMP)
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m benchmarks.lidar $(ONLY)

# Whether the interval of calibrate delay contains the truth, in 120 flights; seven minutes
delays: $(STAMP)
	$(BIN)/python -m benchmarks.delay

# PX4's and ArduPilot's simulators, where a built one is named; half an hour to an hour each, and
# ONLY="cold late" flies parts: docs/SITL.md
sitl: $(STAMP)
	$(BIN)/python -m benchmarks.sitl $(if $(PX4),--px4 $(PX4)) $(if $(ARDUPILOT),--ardupilot $(ARDUPILOT)) \
		$(if $(ONLY),--only $(ONLY))

# A quarter of an hour: 10^7 bytes, 10^6 messages, then what coverage leads to
fuzz: $(STAMP)
	$(BIN)/python -m benchmarks.reliability.fuzz
	$(BIN)/python -m benchmarks.reliability.damaged
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

# Links that deliver frames late, twice, or by another path; a quarter of an hour
links: $(STAMP)
	$(BIN)/python -m benchmarks.reliability.links

# Every fault again and again for hours of flight, then against the daemon; forty minutes
soak: $(STAMP)
	$(BIN)/python -m benchmarks.reliability.soak --daemon

# A hundred times unplugged and restarted, links and the daemon; eight minutes
reconnect: $(STAMP)
	RECONNECT_CYCLES=100 $(BIN)/python -W error -m pytest --log-cli-level=INFO tests/daemon/test_reconnect.py

# Packs what is compiled in build/kernel, but no module that an earlier wheel had and that is gone
PACK := rm -rf build/lib.* && $(BIN)/python -m pip wheel --quiet --disable-pip-version-check --no-deps

wheel: $(VENV)/bin/python
	@echo "Making a wheel in dist: $(BOTH) unless it is, up to six minutes on two cores of a server"
	@$(PACK) --wheel-dir dist . $(WAITING)
	@ls -sh dist/ekf_companion-*.whl

# README and docs as a site in build/site, for a browser without a network; a broken link is an error
PAGES := build/site-pages
site: $(STAMP)
	rm -rf build/site $(PAGES) && mkdir -p $(PAGES)
	cp -R README.md CHANGELOG.md LICENSE docs config $(PAGES)
	cp --parents $$(grep -rohE '\]\((\.\./)+(ekf_companion|sim_autopilot|systemd|tests|benchmarks)/[^)#]*' \
		--include=*.md docs | sed 's/.*\.\.\///' | sort -u) $(PAGES)
	printf '\n```{toctree}\n:hidden:\n:glob:\n\ndocs/*\ndocs/accuracy/*\ndocs/filters/*\nCHANGELOG\n```\n' >> $(PAGES)/README.md
	$(BIN)/sphinx-build -q -W --keep-going -b html -c docs $(PAGES) build/site
	cp build/site/README.html build/site/index.html

# Wheels for every Python and for x86-64 and aarch64, in dist/. Needs Docker or Podman; for the other
# processor also QEMU: docker run --privileged --rm tonistiigi/binfmt --install arm64
wheels: $(STAMP)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check cibuildwheel
	$(BIN)/cibuildwheel --platform linux --output-dir dist

# See systemd/install.sh for what these say
export PYTHON PREFIX DESTDIR CONFIG WHEEL EXTRAS LOCK LAYOUT PIP_FLAGS OUT MAINTAINER

install uninstall:
	systemd/install.sh $@

# A package for this processor and this system's Python, in dist/; see systemd/deb.sh
deb:
	@echo "Making a package in $(or $(OUT),dist): $(BOTH), up to six minutes on two cores of a server"
	@PYTHON=$(SYSTEM_PYTHON) systemd/deb.sh $(WAITING)
	@ls -sh $(or $(OUT),dist)/ekf-companion_*.deb

# A container image, which BlueOS takes as an extension; DOCKER=podman where that is it
DOCKER ?= docker
image:
	$(DOCKER) build -f systemd/Containerfile -t ekf-companion .

# Everything of a release, in dist/, of a clean checkout (docs/RELEASE.md): TAG=v1.2.3 must be its
# version. Without Docker or Podman the only wheel is this system's
release: $(STAMP)
	@test -z "$$(git status --porcelain)" || { echo "make release: this checkout has changes; commit them, or remove them" >&2; exit 1; }
	$(BIN)/python -m tests.release check $(TAG)
	rm -rf dist && mkdir dist
	$(BIN)/python -m pip install --quiet --disable-pip-version-check build cyclonedx-bom
	SOURCE_DATE_EPOCH=$$(git log -1 --format=%ct) $(BIN)/python -m build --sdist --outdir dist . > /dev/null
	$(MAKE) $(if $(shell $(DOCKER) info > /dev/null 2>&1 && echo yes),wheels,wheel)
	$(MAKE) deb
	cp systemd/Containerfile dist/
	$(BIN)/cyclonedx-py requirements --pyproject pyproject.toml --output-reproducible \
		--output-file dist/SBOM.cdx.json systemd/requirements-run.txt
	$(BIN)/python -m tests.release notes > dist/NOTES.md
	cd dist && sha256sum * > SHA256SUMS
	@ls -sh dist

# The whole way to a board, with all that is downloaded, in a folder of its own
CHECKED := $(CURDIR)/build/installcheck
installcheck: $(STAMP)
	$(BIN)/python -W error -m pytest tests/installation.py tests/debian.py
	rm -rf $(CHECKED) && mkdir -p $(CHECKED)
	$(PACK) --no-build-isolation --wheel-dir $(CHECKED) .
	$(MAKE) install PREFIX=$(CHECKED)/opt DESTDIR=$(CHECKED)/board WHEEL=$$(ls $(CHECKED)/*.whl)
	mv $(CHECKED)/board$(CHECKED)/opt $(CHECKED)/opt
	$(CHECKED)/opt/bin/ekf-companion check-config $(CHECKED)/board/etc/ekf-companion/config.yaml \
		> /dev/null
	$(BIN)/sim-autopilot generate --duration 30 -o $(CHECKED)/flight.tlog
	$(CHECKED)/opt/bin/ekf-companion convert $(CHECKED)/flight.tlog -o $(CHECKED)/flight.csv
	$(CHECKED)/opt/bin/ekf-companion report $(CHECKED)/flight.tlog -o $(CHECKED)/flight.html
	$(CHECKED)/opt/bin/python -c "from ekf_companion.status.assets import NO_CHARTS, index; \
		assert NO_CHARTS not in index('live').decode()"
	rm -rf $(CHECKED)

clean:
	rm -rf $(VENV) $(VENV)-e2e build dist demo *.egg-info ekf_companion/status/page/uPlot.*
	find ekf_companion -name '*.so' -delete -o -name '*.c' -delete
