# Front of the set-up; `make help` lists the targets. Each names what it needs, so a fresh machine needs no other step.

# GNU Radio of a distribution lives in the distribution's own Python; another python3 may stand before it on PATH.
SYSTEM_PYTHON ?= /usr/bin/python3
PREFIX        ?= /usr/local
FLOWGRAPH     ?= $(wildcard flowgraphs/ota_sim.grc)
WORKERS       ?= $(shell env -u OMP_NUM_THREADS -u OMP_THREAD_LIMIT nproc)
ARGS          ?=
PACKAGES      ?= yes

VENV       := .venv
PYTHON     := $(VENV)/bin/python
TRAIN_VENV := .venv-train
DOCS_VENV  := .venv-docs
STAMPS     := .stamps
PIP        := -m pip --disable-pip-version-check -q

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.NOTPARALLEL:
.PHONY: help eval test test-debian12 test-debian13 fuzz mutants count types lock check-pins lint format grc flowgraphs screenshot docs setup setup-test train ctest install uninstall deb test-deb wheel test-wheel clean distclean

help: ## list the targets
	@sed -n 's/^\([a-z0-9-]*\):.*## /\1|/p' $(MAKEFILE_LIST) | awk -F'|' '{printf "  make %-14s %s\n", $$1, $$2}'
	@echo "Arguments are handed on in ARGS, e.g. make eval ARGS='--overlap 0.5 --out results/half'."

# Without ARGS two cases: the paper's, and one that only a canceller solves.
eval: $(VENV)/.runtime ## the main job: the whole experiment in the simulated channel, to a report
	@$(PYTHON) flowgraphs/ota_eval.py --sim $(ARGS)
	@test -n "$(ARGS)" || $(PYTHON) flowgraphs/ota_eval.py --sim --scene base_station

# A worker that dies ends the run, which names its test: started again, it dies of the same test, and pytest-xdist waits for ever.
test: lint ## format, lint and every test
	@$(PYTHON) -m pytest -n $(WORKERS) --dist loadfile --max-worker-restart=0 $(ARGS)

types: $(VENV)/.test ## mypy, strict on what `import radalt` offers; prints what is left elsewhere
	@$(PYTHON) tools/check_types.py $(ARGS)

fuzz: $(VENV)/.test ## hostile input at random, RADALT_FUZZ_S seconds (default 3600); prints how many and how they ended
	@RADALT_FUZZ_S=$${RADALT_FUZZ_S:-3600} $(PYTHON) -m pytest -q -s -o faulthandler_timeout=0 tests/test_fuzz.py $(ARGS)

mutants: $(VENV)/.test ## which small mistakes the tests find, in RADALT_MUTANTS_S seconds (default 3600)
	@$(PYTHON) tools/mutants.py $(ARGS)

count: $(PYTHON) ## lines of the package, the tests and the tools, with their ceilings, which a test holds
	@$(PYTHON) tools/count_lines.py $(ARGS)

# ARGS go to both targets: with them, better name one, e.g. TARGETS=test ARGS='-k flowgraph'.
test-debian12: ## `make test` and `make eval` on a bare Debian 12, from nothing (root; TARGETS=..., BARE=folder to keep)
	@tools/test-debian.sh bookworm $(TARGETS)

test-debian13: ## the same on a bare Debian 13
	@tools/test-debian.sh trixie $(TARGETS)

lock: ## write requirements.lock and requirements-test.lock anew, with the hash of every file (network)
	@tools/lock.sh

check-pins: $(VENV)/.test ## ask the package index for every pin of Python 3.10 to 3.13 (network)
	@$(PYTHON) tools/check_pins.py

lint: $(VENV)/.test ## ruff's checks alone
	@$(PYTHON) -m ruff check --quiet .
	@$(PYTHON) -m ruff format --check --quiet . || { echo "ruff format: run 'make format'" >&2; exit 1; }

format: $(VENV)/.test ## write the code in ruff's format
	@$(PYTHON) -m ruff format .

# The companion runs in the system's Python: the module and the packages of the environment come by PYTHONPATH.
# Without a terminal program what a flowgraph prints stays in the console of the companion, where it can be read.
grc: $(VENV)/.runtime ## open the flowgraph in GNU Radio Companion, without installing (FLOWGRAPH=...)
	@test -n "$${DISPLAY:-}$${WAYLAND_DISPLAY:-}" || { echo "make grc: no display; set DISPLAY, or use xvfb-run" >&2; exit 2; }
	@PYTHONPATH="$(CURDIR)/python:$$($(PYTHON) -c 'import sysconfig; print(sysconfig.get_path("purelib"))')$${PYTHONPATH:+:$$PYTHONPATH}" \
	GRC_BLOCKS_PATH="$(CURDIR)/grc$${GRC_BLOCKS_PATH:+:$$GRC_BLOCKS_PATH}" GR_CONF_GRC_XTERM_EXECUTABLE=/dev/null gnuradio-companion $(FLOWGRAPH)

flowgraphs: $(VENV)/.runtime ## make the simulated flowgraphs again from ota_b210 and ota_live
	@$(PYTHON) tools/make_flowgraphs.py

screenshot: $(VENV)/.runtime ## pictures of the companion and of the live view, docs/*.png, from runs of both
	@PYTHONPATH="$(CURDIR)/python:$$($(PYTHON) -c 'import sysconfig; print(sysconfig.get_path("purelib"))')" GRC_BLOCKS_PATH="$(CURDIR)/grc" \
	xvfb-run -a $(SYSTEM_PYTHON) tests/companion_probe.py --picture docs/companion.png flowgraphs/bring_your_own.grc >/dev/null
	@$(PYTHON) tools/screenshot.py $(ARGS)
	@$(PYTHON) tools/screenshot.py --show start --out docs/live_view_start.png $(ARGS)
	@$(PYTHON) tools/screenshot.py --show jammed --out docs/live_view_jammed.png $(ARGS)
	@$(PYTHON) tools/screenshot.py --show lost --out docs/live_view_lost.png $(ARGS)

setup: $(VENV)/.runtime ## Debian packages and the runtime environment (done by the targets that need it)

docs: $(DOCS_VENV)/.docs ## the documentation as a site, build/site/index.html; fails at a link that leads nowhere
	@NO_MKDOCS_2_WARNING=1 $(DOCS_VENV)/bin/python -m mkdocs build --strict $(ARGS)
	@echo build/site/index.html

setup-test: $(VENV)/.test

train: $(TRAIN_VENV)/.training ## train the models, in an environment of its own
	@PYTHONPATH="$(CURDIR)/python" $(TRAIN_VENV)/bin/python training/train.py $(ARGS)

ctest: $(VENV)/.test ## the tests through CMake
	@cmake -S . -B build -DCMAKE_INSTALL_PREFIX="$(PREFIX)" -DPYTHON_EXECUTABLE="$(SYSTEM_PYTHON)"
	@ctest --test-dir build --output-on-failure $(ARGS)

install: $(STAMPS)/debian ## install below PREFIX (default /usr/local; may need root), PACKAGES=no: without Python packages
	@cmake -S . -B build -DCMAKE_INSTALL_PREFIX="$(PREFIX)" -DPYTHON_EXECUTABLE="$(SYSTEM_PYTHON)"
	@cmake --install build
	@test "$(PACKAGES)" = no || { echo "gr-radalt: Python packages of requirements.lock to $(PREFIX)/lib/gr-radalt" && \
	  "$(SYSTEM_PYTHON)" -m venv --system-site-packages "$(PREFIX)/lib/gr-radalt" && \
	  "$(PREFIX)/lib/gr-radalt/bin/python" $(PIP) install --require-hashes -r requirements.lock; }
	@echo 'gr-radalt: "$(PREFIX)/bin/radalt" lists the commands; below an unusual prefix: eval "$$($(PREFIX)/bin/radalt env)"'

uninstall: ## remove what the last install wrote
	@"$(SYSTEM_PYTHON)" cmake/uninstall.py build/install_manifest.txt

deb: $(STAMPS)/debian ## a package for this Debian, build/gr-radalt_VERSION_ARCHITECTURE.deb
	@"$(SYSTEM_PYTHON)" packaging/make_deb.py build

test-deb: $(STAMPS)/debian ## build that package, install it into a bare Debian, run it and remove it (root; BARE=folder to keep)
	@packaging/test-deb.sh $$(. /etc/os-release && echo $$VERSION_CODENAME)

wheel: $(VENV)/.test ## the package for any Python, without GNU Radio, into build/
	@$(PYTHON) -m hatchling build -t wheel -d build

test-wheel: ## install that wheel into fresh environments and measure with it (network; PYTHONS=...)
	@SYSTEM_PYTHON="$(SYSTEM_PYTHON)" tools/test-wheel.sh $(PYTHONS)

clean: ## remove what was built; the environments stay
	rm -rf build .pytest_cache .ruff_cache
	find python flowgraphs tests training -name __pycache__ -type d -prune -exec rm -rf {} + 2>/dev/null || true

distclean: clean ## remove the environments as well
	rm -rf $(VENV) $(TRAIN_VENV) $(DOCS_VENV) $(STAMPS)

# ---- set-up. Stamps make it free when nothing is missing: they are older than what they were made from or they hold.

# dpkg's status file is younger than the stamp after any apt run, and then the list is checked again (milliseconds).
$(STAMPS)/debian: requirements-debian.txt tools/install-debian-packages.sh $(wildcard /var/lib/dpkg/status)
	@tools/install-debian-packages.sh requirements-debian.txt
	@mkdir -p $(@D) && touch $@

$(PYTHON): | $(STAMPS)/debian
	@test -x "$(SYSTEM_PYTHON)" || \
	  { echo "gr-radalt set-up: no $(SYSTEM_PYTHON); name the Python of GNU Radio 3.10: make SYSTEM_PYTHON=/path/to/python3" >&2; exit 2; }
	@"$(SYSTEM_PYTHON)" -c 'from gnuradio import gr' 2>/dev/null || \
	  { echo "gr-radalt set-up: $(SYSTEM_PYTHON) cannot import gnuradio; install GNU Radio 3.10 or name its Python: make SYSTEM_PYTHON=/path/to/python3" >&2; exit 2; }
	@"$(SYSTEM_PYTHON)" tools/say_if_unknown.py
	@echo "gr-radalt set-up: environment $(VENV)"
	@"$(SYSTEM_PYTHON)" -m venv --clear --system-site-packages $(VENV)

# Of the tree whose .venv it is called by, since worktrees may share an environment.
define RADALT
#!/bin/sh
bin=$(dirname "$0")
tree=$(cd "$bin/../.." && pwd)
PYTHONPATH="$tree/python${PYTHONPATH:+:$PYTHONPATH}" exec "$bin/python" -m radalt "$@"
endef
$(VENV)/bin/radalt: export RADALT := $(value RADALT)
$(VENV)/bin/radalt: | $(PYTHON)
	@printf '%s\n' "$$RADALT" > $@
	@chmod +x $@

$(VENV)/.runtime: requirements.lock | $(PYTHON) $(VENV)/bin/radalt
	@echo "gr-radalt set-up: Python packages of requirements.lock"
	@$(PYTHON) $(PIP) install --require-hashes -r requirements.lock
	@$(PYTHON) -c 'import onnxruntime; from gnuradio import gr' || \
	  { echo "gr-radalt set-up: GNU Radio does not import in $(VENV); make distclean, then try again" >&2; exit 2; }
	@touch $@

$(VENV)/.test: requirements-test.lock $(VENV)/.runtime
	@$(PYTHON) $(PIP) install --require-hashes -r requirements-test.lock
	@touch $@

$(TRAIN_VENV)/.training: training/requirements.txt | $(STAMPS)/debian
	@echo "gr-radalt set-up: environment $(TRAIN_VENV): PyTorch, 1.3 GB on the disk, more where pip brings CUDA; some minutes"
	@"$(SYSTEM_PYTHON)" -m venv --clear $(TRAIN_VENV)
	@$(TRAIN_VENV)/bin/python $(PIP) install -r $<
	@touch $@

$(DOCS_VENV)/.docs: requirements-docs.txt | $(STAMPS)/debian
	@echo "gr-radalt set-up: environment $(DOCS_VENV)"
	@"$(SYSTEM_PYTHON)" -m venv --clear $(DOCS_VENV)
	@$(DOCS_VENV)/bin/python $(PIP) install -r $<
	@touch $@
