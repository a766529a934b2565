# The two commands: `make run` (the paper's experiment on the mock rig) and `make test`.
.DEFAULT_GOAL := help
.PHONY: help docs run test pytest test-slow test-realtime test-hardware test-board test-board-short fuzz strikes faults soak comedi lint lock clean

VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
# A file's tests share fixtures, so one process runs them all.
PARALLEL := -n auto --dist loadfile --no-loadscope-reorder

# Without compiled bytecode every process of a run or of a test compiles its sources again: seconds each.
unexport PYTHONDONTWRITEBYTECODE

help:
	@echo "make run    run protocol ramp-a on the mock rig, in real time"
	@echo "make test   run the tests, formatter, linter and type checker"
	@echo "make test-slow  run the tests that make test leaves out, because each takes some seconds"
	@echo "make test-realtime  run what needs a quiet machine: experiments in real time, and the page in Chromium"
	@echo "make fuzz   search for inputs that break a property, at random and for longer"
	@echo "make docs   build the documentation as a site with search, into build/site; each link is checked"
	@echo "make pytest  only the tests"
	@echo "make lint   only the formatter, linter and type checker"
	@echo "make comedi build and install the binding to Comedi cards"
	@echo "make test-hardware  drive a card and a camera of a real kernel, in a virtual machine"
	@echo "make test-board  drive an emulated Advantech board by its real driver, in a virtual machine"
	@echo "make test-board-short  part of these tests, a few minutes once QEMU is built"
	@echo "make strikes  two more faults in that virtual machine (five minutes)"
	@echo "make faults  every way a run can fail, at random moments; writes docs/validation/reliability.md (hours)"
	@echo "make soak    an hour in real time and a day in virtual time, watched for leaks (hours)"
	@echo "make lock   resolve the dependencies anew into requirements.lock and requirements-docs.lock"
	@echo "make clean  remove the environment and every cache"

$(STAMP): requirements.lock pyproject.toml scripts/environment.sh
	@sh scripts/environment.sh $(VENV)
	@touch $@

run: $(STAMP)
	@$(BIN)/rig run ramp-a --yes

# mypy uses one processor: the tests use the others meanwhile.
test: $(STAMP)
	@$(MAKE) --no-print-directory -j2 lint pytest

pytest: $(STAMP)
	$(BIN)/python -m pytest $(PARALLEL) -m "not slow and not realtime and not fuzz"

test-slow: $(STAMP)
	$(BIN)/python -m pytest $(PARALLEL) -m "slow and not realtime and not fuzz"

# Tests that run in real time would disturb each other, and so run one after the other. The host of a virtual machine may
# stall any of them for longer than a real bench allows: one that fails is repeated once, and listed under RERUN.
test-realtime: $(STAMP)
	$(BIN)/python -m pytest -m realtime --reruns 1 -rfEsR

# Each run draws new examples. A failure is printed as a decorator that repeats it, and repeated first by the next run.
fuzz: $(STAMP)
	$(BIN)/python -m pytest -n auto --dist worksteal --hypothesis-profile=fuzz -m "(hypothesis or fuzz) and not realtime"

lint: $(STAMP)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

# The pages link each other by relative paths; strict mode refuses one without a target.
docs: $(STAMP)
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-docs.lock
	@$(BIN)/python -m mkdocs build
	@echo "build/site/index.html"

comedi: $(STAMP)
	@sh scripts/comedi/install.sh $(VENV)

test-hardware: comedi
	$(BIN)/python -m pytest tests/rig/hardware/test_comedi_device.py
	@bash scripts/vm/test.sh $(VENV)

test-board: comedi
	@bash scripts/vm/board.sh $(VENV)

# Registers, inputs, digital lines and faults of the board, and a run on a hung bus.
test-board-short: comedi
	@bash scripts/vm/board.sh $(VENV) tests/board/test_board.py tests/board/test_digital_lines.py \
		tests/board/test_faults_in_a_run.py::test_a_run_whose_board_answers_all_ones_says_that_its_outputs_may_not_have_moved

strikes: comedi
	@bash scripts/vm/test.sh $(VENV) tests/hardware/strikes.py

faults: $(STAMP)
	$(BIN)/python -m scripts.faults --write docs/validation/reliability.md
	$(BIN)/python -m benchmarks.watchdog

soak: $(STAMP)
	$(BIN)/python -m scripts.soak

lock: $(STAMP)
	$(BIN)/python -m pip install -q uv
	$(BIN)/uv pip compile -q --universal --python-version 3.11 --extra rig --extra live --extra test --extra build \
		--generate-hashes --no-emit-index-url --no-header --upgrade pyproject.toml -o requirements.lock
	$(BIN)/uv pip compile -q --universal --python-version 3.11 --extra docs --constraints requirements.lock \
		--generate-hashes --no-emit-index-url --no-header --upgrade pyproject.toml -o requirements-docs.lock

clean:
	rm -rf $(VENV) build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
