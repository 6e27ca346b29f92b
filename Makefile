# `make help` lists what there is. `make PYTHON=python3.12 test` chooses the interpreter.
SHELL := /bin/bash
.DEFAULT_GOAL := help

PYTHON ?= $(firstword $(foreach p,python3.11 python3.12 python3.13 python3,$(if $(shell command -v $(p)),$(p))))
BIN := .venv/bin
INSTALLED := .venv/.installed
DEMO_INSTALLED := .venv/.installed_demo
DOCS_INSTALLED := .venv/.docs_installed
RL_INSTALLED := .venv/.rl_installed
SOURCES := foresight_env agents evaluation benchmarks docs examples tests
# `make paper DATA=inD/data`: the paper's own window; else a recording that the project makes.
DATA ?=
WINDOW ?= --recording 07 --tracks 201,205,207,208 --frames 26158:26320 --every 6
PAPER ?= results/paper
# What pip is asked for: a release of PyTorch (`TORCH=torch==2.13.0`), or a wheel without CUDA.
TORCH ?= torch

.PHONY: help demo test test-bare test-rl lint format bench paper docs clean

help: ## Show this list
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 10

$(INSTALLED): EXTRA := dev
$(DEMO_INSTALLED): EXTRA := evaluation
$(INSTALLED) $(DEMO_INSTALLED): pyproject.toml
	@test -n "$(PYTHON)" || { echo "no python3.11, 3.12 or 3.13 found; name one with PYTHON="; exit 1; }
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[$(EXTRA)]'
	@touch $@

# What the tests need includes what the demo needs.
demo: $(or $(wildcard $(INSTALLED)),$(DEMO_INSTALLED)) ## All parts in small: recorded data, comparison, one episode, accuracy
	$(BIN)/python -m evaluation demo

test: $(INSTALLED) ## Run the tests
	$(BIN)/python -m pytest $(ARGS)

test-bare: ## Install the wheel without extras in a temporary environment and use it
	@test -n "$(PYTHON)" || { echo "no python3.11, 3.12 or 3.13 found; name one with PYTHON="; exit 1; }
	@set -e; folder=$$(mktemp -d); trap 'rm -rf "$$folder"' EXIT; \
	$(PYTHON) -m venv "$$folder/venv"; \
	pip="$$folder/venv/bin/python -m pip --quiet --disable-pip-version-check"; \
	$$pip wheel --no-deps --wheel-dir "$$folder" .; \
	$$pip install "$$folder"/*.whl; \
	"$$folder/venv/bin/python" -I tests/bare_install.py

$(RL_INSTALLED): $(INSTALLED)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check '$(TORCH)' --editable '.[dev,rl]'
	@touch $@

test-rl: $(RL_INSTALLED) ## Run the tests of what needs PyTorch (installs it: some GB)
	$(BIN)/python -m pytest -m rl $(ARGS)

lint: $(INSTALLED) ## Check formatting, style, words, types and imports between rooms
	$(BIN)/ruff format --check $(SOURCES)
	$(BIN)/ruff check $(SOURCES)
	$(BIN)/python -m tests.support.plain_words
	$(BIN)/lint-imports --no-logo
	$(BIN)/mypy

format: $(INSTALLED) ## Format the code and sort its imports
	$(BIN)/ruff check --select I --fix $(SOURCES)
	$(BIN)/ruff format $(SOURCES)

bench: $(INSTALLED) ## Measure speed and accuracy
	$(BIN)/python -m benchmarks $(ARGS)

paper: $(INSTALLED) ## The paper's studies at full size, and a report (under an hour on two cores)
	$(BIN)/foresight evaluate crosswalk --levels 50 --sequences 50 --episodes 100 --grid 181 --out $(PAPER)/crosswalk
	$(BIN)/foresight evaluate intersection $(if $(DATA),--data $(DATA) $(WINDOW)) --levels 11 --sequences 5 --out $(PAPER)/intersection$(if $(DATA),_recorded)
	$(BIN)/foresight evaluate driving --episodes 50 --out $(PAPER)/driving
	$(BIN)/foresight report $(PAPER) --markdown docs/results.md

$(DOCS_INSTALLED): $(INSTALLED)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[docs]'
	@touch $@

docs: $(DOCS_INSTALLED) ## Build the documentation site in site/ (executes the notebooks)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet
	@echo "page: site/index.html"

clean: ## Remove caches and build products (keeps .venv and results)
	rm -rf .cache site .pytest_cache .mypy_cache .ruff_cache .hypothesis build dist *.egg-info
	find $(SOURCES) -name __pycache__ -type d -prune -exec rm -rf {} +
