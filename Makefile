# Every target does its own set-up on a fresh machine: it creates .venv and installs into it.
# `make demo` installs no torch. PyPI's torch wheels include CUDA; for CPU wheels, use PyTorch's own
# index:
#   PIP_EXTRA_INDEX_URL=https://download.pytorch.org/whl/cpu make test
PYTHON ?= python3
VENV := .venv
BIN := $(CURDIR)/$(VENV)/bin
INSTALLED := build/installed
INSTALL := $(BIN)/python -m pip install --quiet --constraint constraints.txt
PACKAGING := setup.cfg pyproject.toml constraints.txt

# The same value as in cli/main.py, so that the tests tolerate a busy machine.
export GOMP_SPINCOUNT ?= 10000

.PHONY: demo test test-all test-processors lint fuzz docs figures screenshots clean

demo: $(VENV)/.installed
	$(BIN)/dgc-pose demo

# Two processes of one thread each: most tests use only one core.
PYTEST := OMP_NUM_THREADS=1 $(BIN)/python -m pytest --numprocesses 2 --dist loadfile

# The linters, and all tests except those marked as slow.
test: lint
	$(PYTEST) -m "not slow"

# Every test once.
test-all: test
	$(PYTEST) -m slow

# The network's tests once more, as on a processor without AVX-512.
test-processors: $(VENV)/.installed-dev
	env $$(cat tests/avx2.env) $(PYTEST) tests/network tests/runtime/test_engines.py \
		tests/runtime/test_processors.py tests/matching/test_features.py

# Types and layers are checked on the installed package: in the repository cli/, benchmarks/ and
# training/ lie beside dgc_pose/, where mypy would take every import between them for `Any`.
lint: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check --quiet .
	rm -rf build
	$(BIN)/python -m pip install --quiet --no-deps --no-build-isolation --target $(INSTALLED) .
	cd $(INSTALLED) && MYPYPATH=. $(BIN)/mypy --config-file $(CURDIR)/setup.cfg \
		--cache-dir $(CURDIR)/.mypy_cache -p dgc_pose
	cd $(INSTALLED) && PYTHONPATH=. $(BIN)/lint-imports --config $(CURDIR)/setup.cfg

# Damaged files for every reader, different ones in each round, for MINUTES minutes.
MINUTES ?= 10
fuzz: $(VENV)/.installed-dev
	end=$$(( $$(date +%s) + 60 * $(MINUTES) )); while [ $$(date +%s) -lt $$end ]; do \
		OMP_NUM_THREADS=1 $(BIN)/python -m pytest --hypothesis-profile fuzz tests/fuzz/test_readers.py \
			|| exit 1; \
	done

docs: $(VENV)/.installed-docs
	$(BIN)/mkdocs build --strict

# Updates the tool's output in the documentation; the tests fail if it is out of date.
figures: $(VENV)/.installed
	$(BIN)/python docs/figures.py

# The pages in headless Chromium; $CHROMIUM may name one.
screenshots: $(VENV)/.installed-dev
	$(BIN)/python docs/screenshots.py

clean:
	rm -rf $(VENV) build site dgc_pose.egg-info lightglue/build lightglue/*.egg-info

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
