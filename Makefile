# make live   set up and touch a virtual skin in the browser
# make test   set up and run all tests
# make check  lint, types, import layers and all tests: what CI runs

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
SOURCES := src tests benchmarks examples docs firmware

.PHONY: live test check lint bench clean
.DEFAULT_GOAL := live

live: $(VENV)/.ready
	@exec $(BIN)/ohmskin live $(ARGS)

test: $(VENV)/.ready-dev
	$(BIN)/pytest $(ARGS)

check: lint test

lint: $(VENV)/.ready-dev
	$(BIN)/ruff check $(SOURCES)
	$(BIN)/ruff format --check $(SOURCES)
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: $(VENV)/.ready-dev
	$(BIN)/python -m benchmarks.loop $(ARGS)

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; v = sys.version_info; sys.exit(v < (3, 11) and f"ohmskin needs Python 3.11 or newer; {sys.executable} is {v.major}.{v.minor}. Try: make PYTHON=python3.11")'
	@echo "set-up: making a virtual environment in $(VENV)"
	@$(PYTHON) -m venv $(VENV)

$(VENV)/.ready: $(VENV)/bin/python pyproject.toml constraints.txt
	@echo "set-up: installing ohmskin and what it needs (a minute the first time)"
	@$(BIN)/python -m pip install -qq --disable-pip-version-check -c constraints.txt -e .
	@touch $@

$(VENV)/.ready-dev: $(VENV)/.ready
	@echo "set-up: installing what the tests need"
	@$(BIN)/python -m pip install -qq --disable-pip-version-check -c constraints.txt -e '.[dev]'
	@touch $@

clean:
	rm -rf $(VENV) firmware/build .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
