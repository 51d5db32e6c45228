# Work with a checkout: make run | test | mutate | attack | bench | deps | clean. A fresh machine needs make and Python 3.11 or newer.
#
#   make run                start the daemon on the simulated board (ARGS="--rate-hz 2000" and other options of `hapticd run`)
#   make lab                add the batch engine and figures: hapticd zwidth, sim
#   make practice           a simulated rig with hidden truths, to try `hapticd rig` without hardware (docs/first-day.md)
#   make test               format, lint, types, layers, unit and lock-step tests and the main job in real processes; minutes
#   make check              that and all other tests: what continuous integration runs; half an hour
#   make test-usb           of these the ones on a true Linux USB stack, in a user-mode kernel (docs/development/usb.md); with what was measured
#   make mutate [ONLY=stop] put known defects back, one at a time, and see that a test fails for each; minutes
#   make structure          files, statements and shared names of the package, with their limits
#   make attack [ONLY=frames] [FACTOR=0.01]  hostile requests, frames and files at length; results in build/attack.json
#   make hands [ARGS="--hands 100"]  random passive hands against environments at the edge of what the guard calls safe; counts those that one shakes
#   make soak [HOURS=2]     the daemon in real time with faults, re-plugs, commands and subscribers at random; then as long in virtual time; build/soak*.json
#   make firmware [FIRMWARE=FOLDER] check the reference firmware, or sources of your own, against the simulated board; minutes
#   make circuit            the analog circuit in ngspice: its tests, figures, schematic and device file in build/circuit; minutes
#   make pico [ARGS=DAC_PART=MCP4922]  the firmware for a Raspberry Pi Pico, build/pico/hapticd.uf2 (docs/pico.md); needs gcc-arm-none-eabi alone
#   make bench [ONLY=wake]  measure; results in build/bench.json
#   make reproduce          the paper's figures and table in build/reproduction; with ARGS=--quick by prediction, in seconds, in
#                           build/reproduction-quick
#   make reproduction-docs  the same, then tables, numbers and figures of docs/reproduction.md from it, and of docs/timing.md
#   make pictures           take the pictures of README and docs again
#   make docs               build the documentation in build/docs; warnings are errors
#   make site               the documentation as static files for any web server, build/hapticd-site.tar.gz
#   make deps               install the system packages that are missing
#   make pins               write constraints.txt and requirements.lock again: the newest of every library that pyproject.toml allows
#   make test-lowest        what talks to a library, with the lowest versions that pyproject.toml declares; minutes
#   make clean              remove what was made, the environment included
#
# A checkout has the libraries and tools of constraints.txt, so that what passed yesterday passes today. With the newest
# that pyproject.toml allows, as an installation by pip has them:  make test PINS= VENV=build/newest

SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DEFAULT_GOAL := run
.PHONY: run lab practice test check check-installed usb-kernel test-usb mutate structure attack hands soak firmware circuit pico bench reproduce reproduction-docs pictures docs site deps deps-run deps-test deps-check deps-bench deps-pico pins lock test-lowest clean

VENV ?= .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --quiet --disable-pip-version-check
PINS ?= constraints.txt
PINNED := $(if $(PINS),--constraint $(PINS))
PYTHON ?= $(shell .ci/python)

run: $(VENV)/run.stamp
	@echo "$$($(BIN)/python -VV); hapticd doctor says how it was built"
	@exec $(BIN)/hapticd run $(ARGS)

lab: $(VENV)/lab.stamp
	@echo "simulated trials and figures are ready: source $(BIN)/activate"

practice: $(VENV)/run.stamp
	@exec $(BIN)/python tests/practice_rig.py build/practice $(if $(ARGS),$(ARGS),rig)

# Tests that need no clock run on all cores, a worker on each, so that BLAS needs no threads of its own. Tests of real processes run
# one after the other, at the same time; the first get the time that these leave, and must not delay their ticks.
PYTEST := $(BIN)/python -m pytest
WORKERS := OPENBLAS_NUM_THREADS=1 $(PYTEST) --numprocesses auto
MAIN_JOB := tests/process/test_main_job.py

# what is imported is compiled once, also where the environment says that nothing be kept
test check bench: export PYTHONDONTWRITEBYTECODE =

test: deps-test $(VENV)/test.stamp
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/lint-imports & imports=$$!; $(BIN)/mypy; wait $$imports
	@mkdir -p build
	@nice -n 19 env $(WORKERS) --dist worksteal tests/unit tests/lockstep $(ARGS) & computing=$$!; \
	failed=0; \
	$(PYTEST) $(MAIN_JOB) $(ARGS) >build/main-job.txt 2>&1 || failed=1; \
	wait $$computing || failed=1; \
	cat build/main-job.txt; \
	exit $$failed

# all are run, then all must have passed; .ci/idle begins a session, which a Ctrl-C here does not reach
COMPUTING := .ci/idle env $(WORKERS) --dist loadfile --no-loadscope-reorder --timeout 1800 -m "not process" tests/acceptance
check: ARGS += --all-must-run
check: check-installed test
	@mkdir -p build
	@$(COMPUTING) $(ARGS) >build/computing.txt 2>&1 & computing=$$!; \
	trap 'kill -- -$$computing 2>/dev/null || true' EXIT; \
	failed=0; \
	$(PYTEST) tests/process --ignore $(MAIN_JOB) $(ARGS) || failed=1; \
	$(PYTEST) -m process tests/acceptance $(ARGS) || failed=1; \
	wait $$computing || failed=1; \
	cat build/computing.txt; \
	exit $$failed

# system packages and libraries at the same time; the kernel as soon as its source is there
check-installed: deps-run
	@$(MAKE) --no-print-directory --jobs=2 usb-kernel $(VENV)/check.stamp

# built once, beside what comes before the tests that boot it; they wait for it, and say it if it failed
usb-kernel: deps-check
	@mkdir -p build
	@PYTHONPATH=tests nice -n 19 "$(PYTHON)" -m support.usb_kernel </dev/null >build/usb-kernel.txt 2>&1 &

test-usb: deps-check $(VENV)/check.stamp
	$(BIN)/python -m pytest -rP tests/acceptance/test_usb_stack.py $(ARGS)

mutate: deps-check $(VENV)/check.stamp
	$(BIN)/python tests/mutate.py $(ONLY)

structure:
	@"$(PYTHON)" tests/structure.py $(ARGS)

firmware: deps-check $(VENV)/check.stamp
	$(BIN)/python tests/million_frames.py $(FIRMWARE)

circuit: deps-check $(VENV)/check.stamp
	$(PYTEST) --all-must-run tests/acceptance/test_circuit_*.py $(ARGS)
	$(BIN)/python -m firmware_iface.hardware build/circuit

pico: deps-pico
	@"$(PYTHON)" -m firmware_iface.pico.build $(ARGS)

attack: deps-check $(VENV)/check.stamp
	ONLY="$(ONLY)" FACTOR="$(FACTOR)" $(BIN)/python tests/attack.py

hands: deps-check $(VENV)/check.stamp
	$(BIN)/python tests/hands.py $(ARGS)

soak: deps-bench $(VENV)/bench.stamp
	HOURS="$(HOURS)" $(BIN)/python tests/soak.py
	HOURS="$(HOURS)" $(BIN)/python tests/soak_lockstep.py

bench: deps-bench $(VENV)/bench.stamp
	ONLY="$(ONLY)" $(BIN)/python benchmarks/run.py

REPRODUCTION := build/reproduction$(if $(filter --quick,$(ARGS)),-quick)

reproduce: $(VENV)/lab.stamp
	@$(BIN)/python -m examples.weir2008 --out $(REPRODUCTION) $(ARGS)

reproduction-docs: reproduce
	$(BIN)/python docs/reproduce.py $(REPRODUCTION)
	$(BIN)/python docs/travel.py
	$(BIN)/python docs/rotor_loss.py
	$(BIN)/python docs/timing.py

pictures: deps-check $(VENV)/check.stamp
	$(BIN)/python docs/pictures.py

docs: $(VENV)/docs.stamp
	$(BIN)/python docs/generate.py
	$(BIN)/python -m sphinx -W --keep-going -q -j auto -b html docs build/docs
	@echo "open build/docs/index.html"

# .nojekyll: code hosts would else leave out folders that begin with an underscore
site: docs
	@touch build/docs/.nojekyll
	tar -czf build/hapticd-site.tar.gz --exclude=./.doctrees -C build/docs .

deps:
	@.ci/deps all

deps-run deps-test deps-check deps-bench deps-pico: deps-%:
	@PYTHON="$(PYTHON)" .ci/deps $*

deps-test deps-check deps-bench: deps-run # one after the other, also with --jobs

# for every Python from the oldest on: what a checkout has, and the same for installations, with the hash of every file
RESOLVED := $(BIN)/uv pip compile --quiet --universal --python-version 3.11 --all-extras --no-header --no-annotate
pins: $(VENV)/check.stamp
	@echo '# Written by `make pins`: what a checkout has. An installation has the ranges of pyproject.toml.' >$(VENV)/pins.txt
	@$(RESOLVED) --upgrade --group bench --group test --group check --group lint --group docs pyproject.toml >>$(VENV)/pins.txt
	@cp $(VENV)/pins.txt constraints.txt
	@$(MAKE) --no-print-directory lock

lock: $(VENV)/check.stamp
	@echo '# Written by `make pins`: the libraries of constraints.txt that an installation may have, by hash; docs/installing.md.' >$(VENV)/lock.txt
	@$(RESOLVED) --generate-hashes --constraint constraints.txt pyproject.toml >>$(VENV)/lock.txt
	@cp $(VENV)/lock.txt requirements.lock

# with the lowest versions that pyproject.toml declares: what talks to a library
LOWEST_NAMES := settings_load settings_build gateway_server gateway_codec gateway_relay client client_aio console cli_terminal \
	cli_daemon cli_bridge recording_file recording_live recording_pack report_trial report_envelope engine_compiled \
	analysis_batch_spectra rig_device_file link_usb
LOWEST := $(foreach name,$(LOWEST_NAMES),$(wildcard tests/*/test_$(name).py tests/*/test_$(name)_long.py))
test-lowest: deps-check $(VENV)/check.stamp
	$(BIN)/uv venv --quiet --clear --python $(BIN)/python build/lowest
	$(BIN)/uv pip install --quiet --python build/lowest/bin/python --resolution lowest-direct --editable '.[$(ALL)]' --group test --group check
	build/lowest/bin/python -m pytest $(or $(ARGS),$(LOWEST))

# --- the environment, made again when pyproject.toml or the pins change ---------------------------
ENGINE := engine,plot
ALL := engine,plot,mat,lsl,cluster

$(VENV)/run.stamp: pyproject.toml $(PINS) | deps-run
	@$(if $(strip $(PYTHON)),,echo "hapticd needs Python 3.11 or newer; install it, or name it: make PYTHON=/path/to/python3"; exit 1)
	@test -x $(BIN)/python || "$(PYTHON)" -m venv $(VENV)
	@echo "installing hapticd and its libraries into $(VENV)"
	@$(PIP) install 'pip>=25.1'
	@$(PIP) install $(PINNED) --editable .
	@touch $@

$(VENV)/lab.stamp: $(VENV)/run.stamp
	@echo "installing the batch engine and figures into $(VENV)"
	@$(PIP) install $(PINNED) --editable '.[$(ENGINE)]'
	@touch $@

$(VENV)/docs.stamp: $(VENV)/lab.stamp
	@echo "installing the documentation tools into $(VENV)"
	@$(PIP) install $(PINNED) --group docs
	@touch $@

$(VENV)/test.stamp: $(VENV)/run.stamp
	@echo "installing all libraries and the tools of tests and lint into $(VENV)"
	@$(PIP) install $(PINNED) --editable '.[$(ALL)]' --group test --group lint
	@touch $@

$(VENV)/check.stamp: $(VENV)/test.stamp
	@echo "installing the tools of make check into $(VENV)"
	@$(PIP) install $(PINNED) --group check --group docs
	@touch $@

$(VENV)/bench.stamp: $(VENV)/check.stamp
	@echo "installing the programs that benchmarks race against into $(VENV)"
	@$(PIP) install $(PINNED) --group bench
	@touch $@

clean:
	rm -rf $(VENV) build dist docs/generated .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
