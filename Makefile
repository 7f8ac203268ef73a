# `make` alone lists what there is. Every target works as the first command typed on a fresh machine
# with Python 3.11 or later: it creates .venv and installs the pinned versions first.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
JOBS ?= 2

.DEFAULT_GOAL := help
.PHONY: help setup engines browser report study drift gate claims showcase test check trust bench clean

help:  ## list the targets
	@awk 'BEGIN {FS = ":.*## "} /^[a-z]+:.*## / {printf "  %-8s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

setup: $(READY)  ## create .venv and install

$(READY): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
		|| { echo "umbra-bench: Python 3.11 or later is needed; set PYTHON=..." >&2; exit 2; }
	$(PYTHON) -m venv $(VENV)
	PIP_CONSTRAINT=constraints.txt $(BIN)/python -m pip install --quiet --disable-pip-version-check \
		--editable '.[dev]'
	@touch $@

engines: $(READY)  ## install Box2D, Bullet, PhysX and MuJoCo beside pymunk
	PIP_CONSTRAINT=constraints.txt $(BIN)/python -m pip install --quiet --disable-pip-version-check \
		--editable '.[dev,engines]'

browser: $(READY)  ## install what drives the page in Chromium (as root: Chromium itself, on Debian)
	PIP_CONSTRAINT=constraints.txt $(BIN)/python -m pip install --quiet --disable-pip-version-check \
		--editable '.[browser,dev]'
	command -v chromium >/dev/null || { apt-get update -qq && \
		DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends chromium; } >/dev/null

study: $(READY)  ## sweep all methods over all scenarios into results/
	$(BIN)/umbra-bench study --if-changed

report: study  ## run the study if anything changed, and write reports/index.html with its figures
	$(BIN)/umbra-bench report

drift: $(READY)  ## follow the energy error over ten million steps
	$(BIN)/umbra-bench drift spring --steps 1e7

showcase: study  ## renew the figures that the README shows
	$(BIN)/umbra-bench report --png
	mkdir -p reports/showcase
	cp reports/figures/spring-error.png reports/figures/spring-energy-time.png reports/showcase/

gate: $(READY)  ## judge the integrators against results/baseline.json
	$(BIN)/umbra-bench gate

claims: $(READY)  ## measure the devlog's statements
	$(BIN)/umbra-bench claims

test: $(READY)  ## run the test suite
	$(BIN)/python -m pytest -n $(JOBS) --dist loadgroup

check: $(READY)  ## formatting, lint and types
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

trust: $(READY)  ## odd files, kills and repeated runs, in ten minutes or less
	$(BIN)/python trust/all.py

bench: $(READY)  ## measure speed, as ratios within one run (some minutes)
	PIP_CONSTRAINT=constraints.txt $(BIN)/python -m pip install --quiet --disable-pip-version-check \
		--editable '.[bench,dev]'
	$(BIN)/python benchmarks/speed.py
	$(BIN)/python benchmarks/engine_overhead.py
	$(BIN)/python benchmarks/scaling.py

clean:  ## remove everything generated, .venv included
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache .hypothesis build
	find results reports -mindepth 1 -not -name '.gitkeep' -not -name baseline.json \
		-not -path 'reports/showcase*' -delete
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
