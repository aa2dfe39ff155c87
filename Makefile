# One word each: setup, run, test, check, bench, docs. `make help` lists them all.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
CORE := $(VENV)/.core
READY := $(VENV)/.ready
# pip says what it fetches; what is there already goes without saying.
INSTALL := $(BIN)/python -m pip install --disable-pip-version-check --progress-bar off
PYTEST := $(BIN)/python -m pytest

.DEFAULT_GOAL := help
.PHONY: help setup run test test-failed check test-browser test-evm test-gpsd test-contracts test-nodes test-hosts test-survival test-sumo test-peers test-all nodes peers bench docs docs-notebooks docs-pictures release-check clean

help: ## list the targets
	@awk -F':.*## ' '/^[a-z-]+:.*## / {printf "make %-16s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup: $(READY) ## make the environment in .venv with all that work on SkyRelay needs (Python 3.11 or later)

# The core alone, which `make run` needs; the tests' packages come on top of it in the same environment.
$(CORE): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; v = sys.version_info; sys.exit(0 if v >= (3, 11) else f"SkyRelay needs Python 3.11 or later, this is {v.major}.{v.minor}: set PYTHON=python3.11")'
	@echo "Making $(VENV) with SkyRelay's core (0.7 GB; under a minute where the network is quick)"
	$(PYTHON) -m venv $(VENV)
	$(INSTALL) --constraint constraints.txt --editable .
	@touch $@

$(READY): $(CORE)
	@echo "Installing what training, the tests and the linters need into $(VENV) (1.3 GB more)"
	$(INSTALL) --constraint constraints.txt --editable ".[dev]"
	@touch $@

run: $(CORE) ## play the whole system on the Bologna trace; ends in out/bologna/report.html
	$(BIN)/skyrelay run bologna --out out/bologna --force

test: $(READY) ## all tests that need Python alone
	$(PYTEST) -n 2 --dist loadgroup -m "not browser and not contracts and not gpsd and not nodes and not evm and not hosts and not survival"

test-failed: $(READY) ## what failed in the last `make test`, one after the other
	$(PYTEST) --last-failed --last-failed-no-failures none

check: $(READY) ## lint, format, types, layers, declared packages
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/deptry src

test-browser: $(READY) ## the report page in a real headless Chromium
	@command -v chromium >/dev/null && command -v chromedriver >/dev/null || { \
		echo "test-browser needs chromium and chromedriver (Debian: apt-get install chromium chromium-driver)" >&2; exit 1; }
	$(PYTEST) -m browser

test-evm: $(READY) ## the official EVM state tests, where ../shared/data has them
	$(PYTEST) -m evm -n 2 -rs

contracts/node_modules/.ready: contracts/package-lock.json
	@command -v npm >/dev/null || { echo "test-contracts needs Node 20 or later with npm" >&2; exit 1; }
	cd contracts && npm ci --no-audit --no-fund --loglevel=error
	@touch $@

web/node_modules/.ready: web/package-lock.json
	@command -v npm >/dev/null || { echo "test-page needs Node 20 or later with npm" >&2; exit 1; }
	cd web && npm ci --no-audit --no-fund --loglevel=error
	@touch $@

test-page: web/node_modules/.ready ## the page's script: a build from web/ gives the committed bytes
	cd web && npm run --silent check

# Slither pins other versions of the chain's libraries than we do, so it lives in an environment of its own.
$(VENV)/slither/.ready: constraints-slither.txt
	@$(PYTHON) -m venv $(VENV)/slither
	@$(VENV)/slither/bin/python -m pip install --quiet --disable-pip-version-check --constraint constraints-slither.txt slither-analyzer
	@touch $@

test-contracts: $(READY) contracts/node_modules/.ready $(VENV)/slither/.ready ## the contract under attack: Foundry, Slither, the committed artefacts
	SLITHER=$(CURDIR)/$(VENV)/slither/bin/slither $(PYTEST) -m contracts -n 2

test-gpsd: $(READY) ## positions from Debian's gpsd (apt-get install gpsd)
	$(PYTEST) -m gpsd

nodes: ## build Kubo, go-ethereum and GoQuorum into .tools/bin (needs Go; minutes the first time)
	@command -v go >/dev/null || { echo "make nodes needs Go 1.24 or later" >&2; exit 1; }
	tools/build-nodes

test-nodes: $(READY) nodes ## real validators and real IPFS nodes on loopback
	$(PYTEST) -m nodes -n 4 --dist loadgroup

test-hosts: $(READY) ## five hosts in network namespaces, one cut off and back (root)
	timeout 900 $(PYTEST) -m hosts

test-survival: $(READY) ## agents as processes, killed, late, cut off, by their own clocks (minutes)
	$(PYTEST) -m survival -n 2 --dist loadgroup

# SUMO is half a gigabyte: an environment of its own.
$(VENV)/sumo/.ready: pyproject.toml constraints.txt
	@$(PYTHON) -m venv $(VENV)/sumo
	@$(VENV)/sumo/bin/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt beartype eclipse-sumo pytest --editable ".[sumo,train]"
	@touch $@

test-sumo: $(VENV)/sumo/.ready ## traces recorded from the real simulator (installs SUMO, 0.9 GB)
	$(VENV)/sumo/bin/python -m pytest tests/mobility/test_recording.py

# The peers pin other versions than we do, and PyTorch brings CUDA's libraries along: environments of their own.
$(VENV)/peers/.ready: pyproject.toml constraints-peers.txt
	@echo "Installing PyTorch, TorchRL, BenchMARL and VMAS into $(VENV)/peers (5 GB)"
	@$(PYTHON) -m venv $(VENV)/peers
	@$(VENV)/peers/bin/python -m pip install --quiet --disable-pip-version-check --constraint constraints-peers.txt beartype torch vmas mpe2 pytest --editable ".[peers]"
	@touch $@

$(VENV)/jaxmarl/.ready: constraints-jaxmarl.txt
	@$(PYTHON) -m venv $(VENV)/jaxmarl
	@$(VENV)/jaxmarl/bin/python -m pip install --quiet --disable-pip-version-check --constraint constraints-jaxmarl.txt jaxmarl
	@touch $@

peers: $(VENV)/peers/.ready $(VENV)/jaxmarl/.ready ## what the benchmarks of environment and training compare with (6 GB)

# Its own pins (pandas 1.4) have no wheel for our Pythons: what its reader imports, and no more.
$(VENV)/marl-eval/.ready: constraints-marl-eval.txt
	@$(PYTHON) -m venv $(VENV)/marl-eval
	@$(VENV)/marl-eval/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --requirement constraints-marl-eval.txt
	@touch $@

test-peers: $(VENV)/peers/.ready $(VENV)/marl-eval/.ready ## BenchMARL and TorchRL train on the game, marl-eval reads our export (installs PyTorch, 5 GB)
	$(VENV)/peers/bin/python -m pytest tests/peers
	$(VENV)/marl-eval/bin/python tests/peers/read_marl_eval.py

test-all: check test test-survival test-browser test-evm test-gpsd test-contracts test-nodes test-sumo test-peers ## everything

bench: $(READY) ## every benchmark, one after the other; figures and JSON
	@for file in benchmarks/*.py; do echo "== $$file"; $(BIN)/python $$file || exit 1; done

docs: $(READY) ## build the documentation into site/; broken links and undocumented public names fail
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet
	@echo "site/index.html; with the search: $(BIN)/mkdocs serve"

docs-notebooks: $(READY) ## execute the notebooks of the docs and keep what they show (2 minutes)
	$(BIN)/python tools/site/notebooks.py

docs-pictures: $(READY) ## draw the pictures of the docs again: maps, outlook, sequence, deployment, animation (2 minutes)
	$(BIN)/python tools/site/pictures.py

$(VENV)/release/.ready:
	@$(PYTHON) -m venv $(VENV)/release
	@$(VENV)/release/bin/python -m pip install --quiet --disable-pip-version-check build check-wheel-contents twine uv
	@touch $@

release-check: $(VENV)/release/.ready ## wheel and sdist, installed with the lowest and newest dependencies and used from another folder
	tools/release-check $(VENV)/release/bin/python

clean: ## remove the environment and what runs left
	rm -rf $(VENV) out site build dist .pytest_cache .mypy_cache .ruff_cache .import_linter_cache
