# make run    the service with simulated devices, calibrating a machine as you watch
# make test   every check and test but the long ones; what CI runs
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
PYTHON ?= python3
export PYTHON
# Hundreds of processes are started by the tests: what one has compiled, the next one reads.
export PYTHONDONTWRITEBYTECODE :=
BIN := .venv/bin
# Some tests wait: three processes keep two cores busy. BLAS threads would fight over them.
JOBS ?= 3
SINGLE := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1

.PHONY: help
help: ## list the targets
	@sed -n 's/^\([a-z-]*\):[^#]*## \(.*\)/  make \1\t\2/p' Makefile | expand -t 24

.PHONY: setup
setup: .venv/developing ## make .venv with everything in it

INSTALL := $(BIN)/python -m pip install --progress-bar off \
  --upgrade-strategy only-if-needed -c constraints.txt

.venv/running: pyproject.toml constraints.txt
	@.ci/system-packages run
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "Python 3.11 or later is needed; set PYTHON=..." >&2; exit 1; }
	$(PYTHON) -m venv .venv
	$(INSTALL) -e .
	@touch $@

.venv/developing: .venv/running
	$(INSTALL) -e ".[dev,pg]"
	@touch $@

.PHONY: run
run: .venv/running ## service, page and simulated devices; calibrates on the fly at once
	$(BIN)/truepath serve --simulated --measure --data-dir var

.PHONY: check
check: setup ## format, lint, import contracts, types
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/lint-imports
	$(BIN)/pyright

.PHONY: setup-system
setup-system: ## Debian packages the tests call (apt-get, as root)
	@.ci/system-packages test

.PHONY: fast
fast: setup ## format, lint, types of files that have changed, unit tests
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	@changed=$$(git diff --name-only --diff-filter=d HEAD -- app drivers simulators | grep '\.py$$'); \
	  [ -z "$$changed" ] || $(BIN)/pyright $$changed
	$(SINGLE) $(BIN)/pytest -q -n $(JOBS) --dist worksteal -m "not long" tests/unit

.PHONY: test
test: setup-system check ## check, and the tests
	$(SINGLE) $(BIN)/pytest -q -n $(JOBS) --dist loadfile -m "not long" --durations=15

.PHONY: coverage
coverage: setup-system setup ## the same tests, counting lines and branches: a third slower
	rm -f .coverage .coverage.*
	$(SINGLE) $(BIN)/pytest -q -n $(JOBS) --dist loadfile -m "not long" \
	  --cov --cov-report= --cov-fail-under=90

.PHONY: mutants
mutants: setup-system setup ## how many of 60 small faults in the code the tests notice
	$(SINGLE) $(BIN)/python .ci/mutants.py --jobs $(JOBS)

.PHONY: test-long
test-long: setup ## the tests that need minutes; API and jobs on PostgreSQL
	@.ci/system-packages test-long
	$(SINGLE) $(BIN)/pytest -q -n $(JOBS) --dist loadfile -m long --timeout 900
	$(SINGLE) $(BIN)/pytest -q -n $(JOBS) --dist loadfile -m "database and not long" \
	  --database postgresql

.PHONY: reliability
reliability: setup ## runs every test of a fault; writes the table of docs/reliability.md
	@.ci/system-packages test
	$(SINGLE) $(BIN)/pytest -q -n $(JOBS) --dist loadfile -m fault_row --timeout 900 tests \
	  --measured docs/reliability-measured.json
	$(BIN)/python docs/write_reliability.py

.PHONY: bench
bench: setup ## the numbers that count, as ratios
	$(BIN)/python benchmarks/run.py

.PHONY: compensation-tables
compensation-tables: setup ## what compensation files leave, by simulated controllers; writes docs/compensation.md
	$(SINGLE) $(BIN)/python validation/run.py compensation_tables rotary_compensation

.PHONY: validation
validation: setup ## both papers reproduced and random machines; writes docs/validation.md
	$(SINGLE) $(BIN)/python validation/run.py

.PHONY: discovery-table
discovery-table: setup ## discovery on worlds that hide effects; writes docs/discovery.md
	$(SINGLE) $(BIN)/python validation/discovery_worlds.py --fresh --jobs $(JOBS)

.PHONY: wheelhouse
wheelhouse: setup ## a folder to install from without a network
	rm -rf wheelhouse
	$(BIN)/python -m pip wheel --quiet -c constraints.txt -w wheelhouse ".[pg]"
	@du -sh wheelhouse

.PHONY: clean
clean: ## remove everything that was made
	rm -rf .venv var build dist wheelhouse *.egg-info .coverage .coverage.* htmlcov \
	  .pytest_cache .ruff_cache .hypothesis .import_linter_cache .benchmarks
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
