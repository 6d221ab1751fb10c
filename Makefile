# make trial | test | test-all | check | bench | docs | reproduce | hidden | faults | healthy | fuzz | soak
# Each sets up .venv first; nothing else is needed than Python 3.11+ and make.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
export PIP_DISABLE_PIP_VERSION_CHECK = 1
# Bytecode is written whatever the environment says: the workers and the programs that tests start share it.
unexport PYTHONPATH PYTHONHOME VIRTUAL_ENV PYTHONDONTWRITEBYTECODE

.PHONY: trial test test-all check bench docs reproduce hidden faults healthy fuzz soak clean

trial: $(VENV)/.installed
	@mkdir -p out
	$(BIN)/bowden trial --peak 40 --overwrite --picture out/trial.png -o out/trial.mcap

# One thread of BLAS in each worker: threads of two workers on two processors wait for each other, at many times the cost.
PYTEST := OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist=loadfile --no-loadscope-reorder

test: $(VENV)/.installed-test
	$(PYTEST)

test-all: test
	$(PYTEST) -m "(slow or exhaustive or faults or hidden) and not socketcan"

check: $(VENV)/.installed-test
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(PYTEST)

docs: $(VENV)/.installed-test
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet

bench: $(VENV)/.installed-test
	$(BIN)/python -m benchmarks.performance

reproduce: $(VENV)/.installed-test
	$(BIN)/python -m benchmarks.reproduce
	$(BIN)/python -m benchmarks.family
	$(BIN)/python -m benchmarks.family --set-aside

hidden: $(VENV)/.installed-test
	$(BIN)/python -m tests.hidden.run --page
	$(BIN)/python -m tests.hidden.family_run --aside --first 7800 --every 4 --page

# Both go on where they were interrupted; without out/*.jsonl (make clean) they begin anew.
faults: $(VENV)/.installed-test
	@mkdir -p out
	$(BIN)/python -m tests.faults.run --kept out/faults.jsonl --page docs/faults.md
	$(BIN)/python -m tests.faults.run --kept out/faults.jsonl --cover --stealth --page docs/faults.md
	$(BIN)/python -m tests.faults.monitor_alone --csv docs/monitor.csv
	$(BIN)/python -m tests.faults.monitor_alone --drive bought --guards alone both --csv docs/monitor.csv --page docs/safety_monitor.md

healthy: $(VENV)/.installed-test
	@mkdir -p out
	$(BIN)/python -m benchmarks.supervision --healthy 500 --monitored 500 --kept out/healthy.jsonl --table docs/healthy.csv
	$(BIN)/python -m benchmarks.supervision --page

fuzz: $(VENV)/.installed-test
	$(BIN)/python -m tests.fuzz.run

soak: $(VENV)/.installed-test
	$(BIN)/python -m tests.fuzz.soak

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "Python 3.11 or newer is needed; say make PYTHON=python3.x"; exit 2; }
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: pyproject.toml constraints.txt | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet -c constraints.txt -e '.[all]'
	@touch $@

$(VENV)/.installed-test: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet -c constraints.txt -e '.[test]'
	@touch $@

clean:
	rm -rf $(VENV) out
