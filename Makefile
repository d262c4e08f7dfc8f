# Every target sets up what it needs first; PYTHON=python3.12 make ... chooses the interpreter.
ENV := scripts/ros_env
PYTEST_ARGS ?= -n 2
SEARCH_TIME ?= 3600

.PHONY: help setup demo live test search lint clean

help:
	@echo "make demo    identify a synthetic palpation live over DDS; picture and JSON in demo/"
	@echo "make live    simulator, node, controller and monitor together, until Ctrl-C"
	@echo "make test    lint, then every test, on the same examples each time"
	@echo "make search  property tests and fuzzers on new examples for SEARCH_TIME seconds (3600)"
	@echo "make lint    ruff and mypy"
	@echo "make setup   make or mend the environment (PYTHON=... chooses the interpreter)"
	@echo "make clean   remove the environment and everything built"

setup:
	@scripts/setup

demo:
	@$(ENV) fden demo -o demo

live:
	@$(ENV) fden live

lint:
	@$(ENV) ruff check
	@$(ENV) mypy

test: lint
	@$(ENV) python -m pytest $(PYTEST_ARGS)

search: setup
	@$(ENV) python test/search.py $(SEARCH_TIME)

clean:
	rm -rf .venv .venv-jazzy build install log demo *.egg-info
	rm -rf .hypothesis .mypy_cache .pytest_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
