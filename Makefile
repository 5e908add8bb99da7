# minidual: `make all` runs the whole pipeline, `make test` the tests. Both set themselves up.

SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DEFAULT_GOAL := help

# What to run: smoke (minutes, wiring only), standard (acceptance) or gpu (full-size ACT on CUDA).
PROFILE ?= standard
# Name of the run's folder under runs/. Empty: the name that minidual gives it.
RUN ?=
# Further words for `minidual run`, for example ARGS="--set seed=7".
ARGS ?=
# Processes that run tests.
TEST_WORKERS ?= 2

BIN := .venv/bin
READY := .venv/.ready
CAMPAIGN := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 HF_HUB_OFFLINE=1 MUJOCO_GL=egl $(BIN)/python -m scripts.campaign

.PHONY: help all learn bench results campaign campaign-small docs plugins test test-slow lint format typecheck wheel setup egl clean

help: ## show this list
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## (.*)/  make \1\t\2/' | expand -t 20

all: $(READY) egl ## run every stage, PROFILE=standard by default, and say where the report is
	@$(BIN)/minidual run --profile $(PROFILE) $(if $(RUN),--run $(RUN)) $(ARGS)
	@echo "report: $${MINIDUAL_RUNS:-runs}/$(or $(RUN),$(basename $(notdir $(PROFILE))))/report/report.html"

learn: $(READY) egl ## train three seeds, and run each policy: half an hour more than `make all`
	@$(BIN)/minidual run --profile $(PROFILE) --until deploy --set train.seeds_n=3 --run $(or $(RUN),learn) $(ARGS)

test: $(READY) egl ## run the fast tests
	@OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 HF_HUB_OFFLINE=1 \
		$(BIN)/python -m pytest -n $(TEST_WORKERS) --dist worksteal $(ARGS)

test-slow: $(READY) egl ## run the tests marked slow
	@OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 HF_HUB_OFFLINE=1 $(BIN)/python -m pytest -m slow --timeout 1800 $(ARGS)

bench: $(READY) ## time control steps, planning, a new scene and a cold start
	@OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m scripts.bench $(ARGS)

results: $(READY) egl ## measure what is missing of docs/results*.md, and fill its tables: hours
	@OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 HF_HUB_OFFLINE=1 MUJOCO_GL=egl $(BIN)/python -m scripts.results $(ARGS)

campaign: $(READY) egl ## kill, tamper, break and interrupt: 15 minutes; docs/reliability.md
	@$(BIN)/minidual run --profile smoke
	@$(CAMPAIGN) --log runs/campaign.jsonl $(ARGS)

campaign-small: $(READY) egl ## the part of the campaign for every build, on a finished smoke run
	@$(CAMPAIGN) --small $(ARGS)

docs: $(READY) ## build the documentation site offline: build/site/index.html
	@$(BIN)/python -m scripts.site $(ARGS)

lint: $(READY) ## ruff, its formatter, and the direction of imports
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/lint-imports --no-cache

format: $(READY) ## let ruff mend what it can
	@$(BIN)/ruff check --fix .
	@$(BIN)/ruff format .

typecheck: $(READY) ## types of src and scripts, strict in gate, config and cli
	@$(BIN)/basedpyright

wheel: $(READY) ## build dist/minidual-*.whl
	@$(BIN)/python -m hatchling build -t wheel

plugins: $(READY) ## build the plug-ins for LeRobot and install them into .venv
	@$(BIN)/python -m uv pip install --quiet --python $(BIN)/python --no-deps --no-build-isolation \
		--reinstall $(sort $(wildcard plugins/lerobot_*))
	@echo "installed: $(notdir $(sort $(wildcard plugins/lerobot_*)))"

setup: $(READY) ## create .venv with the locked dependencies

$(READY): requirements.lock pyproject.toml scripts/setup.sh
	@scripts/setup.sh

egl: $(READY)
	@$(BIN)/python scripts/check_egl.py

clean: ## remove the environment, caches and builds; data/ and runs/ stay
	rm -rf .venv dist build .pytest_cache .ruff_cache .hypothesis .import_linter_cache
	find src tests scripts -name __pycache__ -type d -prune -exec rm -rf {} +
