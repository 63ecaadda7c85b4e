# make live       set up and touch a virtual skin in the browser
# make test       set up and run the everyday tests: all that a change can break, in some minutes on two cores
# make test-long  the tests that take long and are seldom broken
# make test-all   both
# make test-versions  the shortest tests with the lowest versions that pyproject.toml allows, and with the newest
# make docs       build the documentation site in docs/_build/html; warnings are errors
# make check      lint, types, import layers and all tests: what CI runs

# The tests start a hundred interpreters: bytecode is kept, whatever the shell says.
unexport PYTHONDONTWRITEBYTECODE

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
SOURCES := src tests benchmarks examples docs firmware tools hatch_build.py

WORKERS ?= 4 # for two cores: a third of the tests wait for a browser, a board or a device
PYTEST := $(BIN)/pytest --numprocesses $(WORKERS) --no-loadscope-reorder

DOTS := job=$$!; while kill -0 $$job 2>/dev/null; do printf .; sleep 2; done; echo; wait $$job

# uv takes a fifth of pip's time; pip takes its place where it fails. The index is the one that pip is told to use.
INDEX = $$($(BIN)/python -m pip config get global.index-url 2>/dev/null)
INSTALL = index=$${PIP_INDEX_URL:-$(INDEX)}; \
	$(BIN)/uv pip install -q --python $(BIN)/python $${index:+--default-index "$$index"} -c constraints.txt -e '$(1)' 2>/dev/null \
	|| $(BIN)/python -m pip install -qq --disable-pip-version-check --no-compile -c constraints.txt -e '$(1)'

.PHONY: live test test-long test-all test-versions check lint docs bench clean
.DEFAULT_GOAL := live

live: $(VENV)/.ready
	@echo "starting ohmskin"
	@exec $(BIN)/ohmskin live $(ARGS)

test: $(VENV)/.ready-dev
	$(PYTEST) -m "not long" $(ARGS)

test-long: $(VENV)/.ready-dev
	$(PYTEST) -m long $(ARGS)

test-all: $(VENV)/.ready-dev
	$(PYTEST) $(ARGS)

test-versions: $(VENV)/.ready-dev
	$(BIN)/python tools/versions.py $(ARGS)

check: lint test-all

lint: $(VENV)/.ready-dev
	$(BIN)/ruff check $(SOURCES)
	$(BIN)/ruff format --check $(SOURCES)
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python tools/imports.py src/ohmskin tests

docs: $(VENV)/.ready-docs
	$(BIN)/sphinx-build -W --keep-going -q -j auto docs docs/_build/html
	@echo "the site is in docs/_build/html/index.html"

bench: $(VENV)/.ready-dev
	$(BIN)/python -m benchmarks.loop $(ARGS)

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; v = sys.version_info; sys.exit(v < (3, 11) and f"ohmskin needs Python 3.11 or newer; {sys.executable} is {v.major}.{v.minor}. Try: make PYTHON=python3.11")'
	@echo "set-up: making a virtual environment in $(VENV)"
	@$(PYTHON) -m venv $(VENV) & $(DOTS)

$(VENV)/.ready: $(VENV)/bin/python pyproject.toml constraints.txt
	@echo "set-up: installing ohmskin and what it needs (once)"
	@{ $(BIN)/python -m pip install -qq --disable-pip-version-check -c constraints.txt uv 2>/dev/null; $(call INSTALL,.[plot]); } & $(DOTS)
	@touch $@

$(VENV)/.ready-dev: $(VENV)/.ready
	@echo "set-up: installing what the tests need"
	@$(call INSTALL,.[dev])
	@touch $@

$(VENV)/.ready-docs: $(VENV)/.ready
	@echo "set-up: installing what the documentation site needs"
	@$(call INSTALL,.[docs])
	@touch $@

# ROS 2's Python node, for tests/test_ros_node.py; wheels for Python 3.11 on Linux
.venv-ros/.ready: Makefile
	@$(PYTHON) -m venv .venv-ros
	@.venv-ros/bin/python -m pip install -qq --disable-pip-version-check ros-kilted-rclpy==9.1.2 \
		ros-kilted-rmw-fastrtps-cpp==9.3.3 ros-kilted-common-interfaces==5.5.1
	@touch $@

clean:
	rm -rf docs/_build docs/gallery docs/reference/api docs/reference/commands.md $(VENV) .venv-ros firmware/build .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
