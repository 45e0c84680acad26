# `make run` trains and judges the default model; `make test` checks everything with the quick tests, `make slow`
# runs those of ten seconds and more; `make reproduce` runs the paper's tables at their smallest budget, with a
# report; `make docs` builds the site into build/site; `make bench` measures; `make matrix` runs the
# quick tests on every Python here, with the newest and the oldest libraries.
# Each sets up .venv by itself.
PYTHON ?= python3
BIN := .venv/bin

.PHONY: run test slow reproduce docs bench matrix

run: .venv/installed
	$(BIN)/python -m ahnn.train

test: .venv/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright --pythonpath $(BIN)/python
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -m "not slow" -n 2 --dist loadfile

slow: .venv/installed
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -m slow -n 2 --dist loadfile

reproduce: .venv/installed
	$(BIN)/python -m ahnn.reproduce system=mass_spring budget=smoke
	$(BIN)/python -m ahnn.reproduce system=molniya budget=smoke
	$(BIN)/python -m ahnn.report runs/reproduce/mass_spring_smoke runs/reproduce/molniya_smoke output=runs/reproduce/report

docs: .venv/installed
	$(BIN)/pip install --quiet -c constraints.txt -e '.[dev,docs]'
	NO_MKDOCS_2_WARNING=1 DISABLE_MKDOCS_2_WARNING=true $(BIN)/mkdocs build

bench: .venv/installed
	$(BIN)/pip install --quiet -c constraints.txt -e '.[dev,bench]'
	OMP_NUM_THREADS=1 $(BIN)/python benchmarks/run.py

matrix: .venv/installed
	$(BIN)/pip install --quiet uv
	OMP_NUM_THREADS=1 $(BIN)/python tests/tools/matrix.py

.venv/installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet -c constraints.txt -e '.[dev]'
	touch $@
