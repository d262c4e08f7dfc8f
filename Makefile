# Every target sets up what it needs first; PYTHON=python3.12 make ... chooses the interpreter.
ENV := scripts/ros_env
# A file stays with one process: what its tests share is made once.
PYTEST_ARGS ?= -n 2 --dist loadfile
STATISTICS_ARGS ?= -n 2
PYTEST := $(ENV) python -m pytest --durations=10
SEARCH_TIME ?= 3600

.PHONY: help setup demo live test statistics figures search lint wheel clean

help:
	@echo "make demo    two recorded presses: their numbers, and their page in demo/"
	@echo "make live    simulator, node, controller and monitor together, until Ctrl-C"
	@echo "make test    lint, then every test but statistics, on the same examples each time"
	@echo "make statistics  statistical claims at their full counts"
	@echo "make figures the tables of docs/accuracy.md, measured anew: hours (FIGURES_ARGS=--quick: minutes)"
	@echo "make search  property tests on new examples for SEARCH_TIME seconds (3600)"
	@echo "make lint    ruff and mypy"
	@echo "make wheel   wheels and a source archive in dist/, tried in a new environment"
	@echo "make setup   make or mend the environment (PYTHON=... chooses the interpreter)"
	@echo "make clean   remove the environment and everything built"

setup:
	@scripts/setup

demo: setup
	@echo "two recorded presses on simulated liver, replayed (true: G 450 and 700, Gn 9 and 8):"
	@$(ENV) fden replay examples/press.csv --config examples/probe.yaml
	@mkdir -p demo
	@$(ENV) fden report examples/press.csv --config examples/probe.yaml -o demo/report.html
	@echo "make live runs simulator, node, controller and monitor together, over DDS"

live:
	@$(ENV) fden live

lint:
	@$(ENV) ruff check
	@$(ENV) mypy

wheel: setup
	@$(ENV) scripts/wheels
	@$(PYTEST) -m wheels test/test_packaging.py

test:
	@echo "make test: set-up where it is missing (3 min), ruff and mypy (under 1 min), then every test but"
	@echo "statistics, in two processes, over DDS on this host alone: some 7 min on two idle cores"
	@$(MAKE) --no-print-directory lint
	@$(ENV) scripts/size
	@$(PYTEST) $(PYTEST_ARGS)

statistics:
	@echo "make statistics: statistical claims at their full counts, on all their seeds"
	@$(PYTEST) $(STATISTICS_ARGS) -m statistics

figures: setup
	@$(ENV) scripts/figures $(FIGURES_ARGS)

search: setup
	@end=$$(($$(date +%s) + $(SEARCH_TIME))); while [ $$(date +%s) -lt $$end ]; do \
		FDEN_SEARCH=4 $(ENV) python -m pytest -q -n 2 -m hypothesis || exit 1; done

clean:
	rm -rf .venv .venv-jazzy build install log demo dist *.egg-info
	rm -rf .hypothesis .mypy_cache .pytest_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
