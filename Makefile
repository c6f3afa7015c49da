# Two commands do everything on a fresh machine: `make demo` and `make test`.
# Each makes its own environment in .venv from the locked versions in requirements.lock.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
# Pytest workers; 0 runs everything in one process.
WORKERS ?= 2

.PHONY: demo test test-fast lint bench bench-compiled compiled generate matrix lock clean

demo: $(STAMP)
	$(BIN)/dbw demo

# The fast tests alone have to cover the safety code: the slow ones, which simulate for minutes, run
# untraced and so in a third of the time. Tests about the wall clock run alone and untraced: a
# loaded machine makes nodes late.
test: $(STAMP)
	$(BIN)/python -m pytest -n $(WORKERS) --dist worksteal -m "not slow and not wall_clock" \
		--cov --cov-report=
	$(BIN)/python -m pytest tests/gateway -m wall_clock --cov --cov-append --cov-report=
	$(BIN)/python -m coverage report --fail-under=100
	$(BIN)/python -m pytest -n $(WORKERS) --dist worksteal -m "slow and not wall_clock"
	$(BIN)/python -m pytest -m wall_clock
	$(BIN)/python -m tests.vcan

test-fast: $(STAMP)
	$(BIN)/python -m pytest -n $(WORKERS) --dist worksteal \
		-m "not slow and not wall_clock and not whole_car"

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/mypy

bench: $(STAMP)
	$(BIN)/python -m bench

bench-compiled: compiled
	PYTHONPATH=build/compiled $(BIN)/python -P -m bench speed

# The hot modules compiled with mypyc, for long simulations; needs a C compiler. To use them:
# PYTHONPATH=build/compiled .venv/bin/dbw demo
compiled: $(STAMP)
	$(BIN)/python compile_stack.py

generate: $(STAMP)
	$(BIN)/python -m dbc.generate
	$(BIN)/dbw docs --out docs/bus

# What each fault leads to, and what dbw why says of it: docs/fault-matrix.md, docs/why-faults.md.
matrix: $(STAMP)
	$(BIN)/python -m campaign.fault_docs

# Only for maintainers: renews the locked versions from pyproject.toml.
lock:
	uv pip compile --quiet --generate-hashes --no-emit-index-url --no-strip-markers --python-version 3.11 \
		--extra demo --extra campaign --extra logs --extra dashboard --extra foxglove --extra dev pyproject.toml --output-file requirements.lock

clean:
	rm -rf $(VENV) out build .pytest_cache .mypy_cache .ruff_cache .hypothesis .coverage

$(STAMP): requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
		|| { echo "Python 3.11 or newer is needed; set PYTHON=/path/to/python3.11"; exit 1; }
	@$(PYTHON) -m venv $(VENV) \
		|| { echo "no venv module: install it, on Debian with: apt install python3-venv"; exit 1; }
	@# The lock is complete, so nothing is resolved: pip 23 would take "coverage[toml]" for a
	@# package of its own, and refuse its newest release for want of a hash.
	$(BIN)/python -m pip install --quiet --disable-pip-version-check \
		--no-deps --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check \
		--no-deps --no-build-isolation -e .
	$(BIN)/python -m pip check --disable-pip-version-check
	@touch $@
