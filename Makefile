# Everything a newcomer needs: `make demo`, `make test`. Only Python >= 3.11 and make are assumed.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

# The tests start a hundred processes; without this, each of them may compile all sources again.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo test check style types tests density bench docs docs-figures fuzz clean

# Two simulated drives; models of all kinds, learned from one, and the classical ones on the other.
demo: $(VENV)/.installed
	$(BIN)/probevo demo --out out/demo

# Mypy, which uses one core, runs beside the tests.
test: style
	$(MAKE) --jobs 2 types tests

check: style types

style: $(VENV)/.installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(VENV)/.installed
	$(BIN)/mypy

tests: $(VENV)/.installed
	$(BIN)/python -m pytest --numprocesses auto --dist loadfile --no-loadscope-reorder --durations 15

# How densely the code is packed; fails beyond the bounds.
density: $(VENV)/.installed
	$(BIN)/python tools/density.py src

bench: $(VENV)/.installed
	$(BIN)/python benchmarks/speed.py

# The documentation as a site, in out/site.
docs: $(VENV)/.installed
	$(BIN)/pip install --quiet --editable '.[docs]'
	$(BIN)/python -m sphinx -W --keep-going -c docs . out/site

# Most figures of README.md and docs/ once more; takes hours, and some need the real recordings.
docs-figures: $(VENV)/.installed
	$(BIN)/python benchmarks/recompute.py

# 10,000 damaged and hostile inputs, by class, each bounded in time and memory; minutes. Linux only.
fuzz: $(VENV)/.installed
	PYTHONPATH=src:tests:. $(BIN)/python -m fuzz --seed $${SEED:-0} --number $${NUMBER:-10000}

# Python makes bytecode of what it imports; pip would make it of all that is installed.
$(VENV)/.installed: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --no-compile --editable '.[dev]'
	touch $@

clean:
	rm -rf $(VENV) out htmlcov .coverage coverage.xml
	find src -name __pycache__ -prune -exec rm -rf {} +
