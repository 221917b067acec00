# Every target does its own set-up on a fresh machine: it creates .venv and installs into it.
# The wheels of torch on PyPI carry CUDA; for a small CPU install, have pip look at PyTorch's own index:
#   PIP_EXTRA_INDEX_URL=https://download.pytorch.org/whl/cpu make demo
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALL := $(BIN)/python -m pip install --quiet --constraint constraints.txt
PACKAGING := setup.cfg pyproject.toml constraints.txt

# As the command sets it (cli/main.py), so that the tests bear a busy machine.
export GOMP_SPINCOUNT ?= 10000

.PHONY: demo test lint docs clean

demo: $(VENV)/.installed
	$(BIN)/dgc-pose demo

test: lint
	$(BIN)/python -m pytest

lint: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/mypy

docs: $(VENV)/.installed-docs
	$(BIN)/mkdocs build --strict

clean:
	rm -rf $(VENV) build site dgc_pose.egg-info

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: $(PACKAGING) | $(BIN)/python
	@echo "Installing into $(VENV) (a few minutes the first time)"
	$(INSTALL) --editable .
	touch $@

$(VENV)/.installed-dev: $(PACKAGING) | $(BIN)/python
	@echo "Installing into $(VENV) (a few minutes the first time)"
	$(INSTALL) --editable '.[dev]'
	touch $@ $(VENV)/.installed

$(VENV)/.installed-docs: $(PACKAGING) | $(BIN)/python
	@echo "Installing into $(VENV) (a few minutes the first time)"
	$(INSTALL) --editable '.[docs]'
	touch $@ $(VENV)/.installed
