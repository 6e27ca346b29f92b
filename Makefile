# `make help` lists what there is. `make PYTHON=python3.12 test` chooses the interpreter.
SHELL := /bin/bash
.DEFAULT_GOAL := help

PYTHON ?= $(firstword $(foreach p,python3.11 python3.12 python3.13 python3,$(if $(shell command -v $(p)),$(p))))
BIN := .venv/bin
INSTALLED := .venv/.installed
SOURCES := foresight_env agents evaluation benchmarks examples tests

# Compiled programs are kept between runs; the library itself sets nothing of the kind.
export JAX_COMPILATION_CACHE_DIR ?= $(CURDIR)/.cache/jax
export JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS ?= 0.3
export JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES ?= -1

.PHONY: help demo test lint format bench clean

help: ## Show this list
	@grep -E '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 10

$(INSTALLED): pyproject.toml
	@test -n "$(PYTHON)" || { echo "no python3.11, 3.12 or 3.13 found; name one with PYTHON="; exit 1; }
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $@

demo: $(INSTALLED) ## Estimate foresight from one noisy crossing and drive with it
	$(BIN)/python -m evaluation demo

test: $(INSTALLED) ## Run the tests
	$(BIN)/python -m pytest $(ARGS)

lint: $(INSTALLED) ## Check formatting, style and types
	$(BIN)/ruff format --check $(SOURCES)
	$(BIN)/ruff check $(SOURCES)
	$(BIN)/mypy

format: $(INSTALLED) ## Format the code and sort its imports
	$(BIN)/ruff check --select I --fix $(SOURCES)
	$(BIN)/ruff format $(SOURCES)

bench: $(INSTALLED) ## Measure speed and accuracy
	$(BIN)/python -m benchmarks $(ARGS)

clean: ## Remove caches and build products (keeps .venv and results)
	rm -rf .cache .pytest_cache .mypy_cache .ruff_cache .hypothesis build dist *.egg-info
	find $(SOURCES) -name __pycache__ -type d -prune -exec rm -rf {} +
