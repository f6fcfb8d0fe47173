# `make demo` and `make test` do everything on a machine with Python 3.11 and make; the rest is for people at work on it.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
DEMO_OUT := out/demo

.PHONY: demo test lint clean models

$(VENV)/.installed: pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "ur5-twin needs Python 3.11 or newer: make PYTHON=python3.11 ...")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev]'
	touch $@

demo: $(VENV)/.installed ## replay the log that ships, run a contact scenario, and say where to look
	$(BIN)/ur5-twin replay replay/demo --out $(DEMO_OUT) --rerun
	$(BIN)/ur5-twin run press_plate --out out/press_plate --rerun
	@echo
	@echo "Look at:  $(DEMO_OUT)/report.md  and  out/press_plate/report.md, each with figures/ beside it"
	@echo "Move it:  $(BIN)/rerun $(DEMO_OUT)/twin.rrd   or   $(BIN)/rerun out/press_plate/twin.rrd"
	@echo "More:     $(BIN)/ur5-twin run --list"
	@echo "The log in replay/demo was recorded by the twin itself. Real logs of a UR5: $(BIN)/ur5-twin fetch kufieta2014"

test: $(VENV)/.installed ## the whole test suite
	$(BIN)/python -m pytest -m "not slow"

lint: $(VENV)/.installed ## style and types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

models: $(VENV)/.installed ## write models/*.xml again from models/*.toml
	$(BIN)/python -m ur5_twin.arm.mjcf

clean: ## remove what the other targets made
	rm -rf $(VENV) out build dist *.egg-info .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
