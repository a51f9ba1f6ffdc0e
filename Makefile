# Two commands are all it takes: `make demo` and `make test`; `make test-all` takes longer.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
OUT ?= demo-results
MINUTES ?= 10
TESTS ?= not slow
SEEDS ?= 1039 1040 1041 1042

.PHONY: demo test test-all lint bench fuzz torture mutants wheel oldest supply rates generated docs docs-output \
        screenshots strangers-path clean

$(VENV)/.run: pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit("ppmcal needs Python 3.11 or newer, this is " + sys.version.split()[0]) if sys.version_info < (3, 11) else None'
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@echo "Installing ppmcal into $(VENV) ..."
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -e .
	@touch $@

$(VENV)/.test: $(VENV)/.run
	@echo "Installing the test tools ..."
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[test]'
	@touch $@

$(VENV)/.docs: $(VENV)/.run
	@echo "Installing what builds the guides ..."
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[docs]'
	@touch $@

demo: $(VENV)/.run
	@$(BIN)/ppmcal demo --out $(OUT)

# worksteal: neighbours stay with one worker, and what a file's tests share is made once. Bytecode is
# kept, whatever the shell says: each worker, and each command that a test starts, would compile anew
test: $(VENV)/.test
	@PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest -n auto --dist worksteal -m "$(TESTS)"

# the same with the slow ones, in one run: what slow and quick tests of a file share is made once
test-all:
	@$(MAKE) test TESTS=

lint: $(VENV)/.test
	$(BIN)/ruff check ppmcal tests benchmarks docs
	$(BIN)/mypy
	$(BIN)/lint-imports

generated: $(VENV)/.run
	@for name in mechanism dataset scenario batch about; do $(BIN)/ppmcal schema $$name > ppmcal/io/schemas/$$name.json; done
	@cd docs && $(abspath $(BIN))/python -m generators.stub

docs: $(VENV)/.docs
	@$(BIN)/python docs/generate.py build/docs
	@$(BIN)/zensical build --clean --strict
	@$(BIN)/python docs/generators/links.py build/site
	@echo "The guides: build/site/index.html"

screenshots: $(VENV)/.run
	@$(BIN)/python docs/screenshots.py

docs-output: $(VENV)/.test
	@$(BIN)/python docs/refresh.py

strangers-path: $(VENV)/.run
	@$(BIN)/python docs/strangers_path.py

fuzz: $(VENV)/.test
	@PYTHONPATH=.:tests $(BIN)/python -m fuzz --minutes $(MINUTES)
	@PYTHONPATH=.:tests $(BIN)/python -m fuzz --minutes $(MINUTES) --commands
	@PYTHONPATH=.:tests $(BIN)/python -m fuzz --minutes $(MINUTES) --campaigns

bench: $(VENV)/.test
	$(BIN)/python -m pytest benchmarks --benchmark-only -o addopts= -s

torture: $(VENV)/.test
	@PYTHONPATH=benchmarks $(BIN)/python -m torture

rates: $(VENV)/.test
	PYTHONPATH=benchmarks $(BIN)/python -m rates --seeds $(SEEDS)

mutants: $(VENV)/.test
	@$(BIN)/python benchmarks/mutants.py $(MUTANTS)

wheel: $(VENV)/.run
	@$(BIN)/python benchmarks/supply.py wheel

oldest: $(VENV)/.run
	@$(BIN)/python benchmarks/supply.py oldest

supply: wheel oldest

clean:
	rm -rf $(VENV) $(OUT) build dist *.egg-info
