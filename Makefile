# Each target does whatever set-up it needs; a second call sets nothing up again. What trains, and
# the tests, add PyTorch to it (make setup-train).
#   make reproduce                   all tables, figures and the report, as far as out of date
#   make reproduce-table3            one of them: table1 to table4, figure1 to figure7,
#                                    curves, studies, statistics, transfer, ...
#   make reproduce-table3 ZOO=path   with the author's 2018 weights too, in paper/with-zoo/
#   make reproduce-table3 BACKEND=reference   scored on Gymnasium and PyBullet instead of the engines
#   make page                        docs/page/index.html: the walker in the browser, and all results
#   make gallery                     looping pictures of each experiment's best agent
#   make transfer                    PPO on original and learned bodies (reproduce/train_ppo.py): the
#                                    curves that make reproduce-transfer draws; those there are kept.
#                                    Hours: make -j2 transfer for two at a time
#   make train-all                   train and publish every run of Table 3 that is missing
#   make verify-runs                 train the first generations of the published runs again
#   make test                        the test suite; make test-floors: on the oldest libraries that
#                                    pyproject.toml allows; make test-wheel: a wheel in an environment
#                                    without compiler (WHEEL_PYTHON=python3.13: of another Python)
#   make verify-engine               4,000 episodes in the engine and in Box2D or PyBullet, and 1.6
#                                    million steps of vector environments; make sanitize-engine:
#                                    its tests, 400 episodes and 8,000 steps in a build that
#                                    watches memory and undefined behaviour
#   make verify-resume              kill training runs a hundred times; make fuzz: 100,000 bad files
#   make types                       mypy on the modules that others import
#   make proto                       designrl/recording/schema_pb2.py from schema.proto
#   make bench                       speeds as ratios to a named baseline
VENV := .venv
BIN := $(VENV)/bin
SUPPORTED := import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))
# What .venv holds, else the first that runs: a pyenv shim is found and need not.
PYTHON ?= $(or $(wildcard $(BIN)/python),$(shell for p in python3.11 python3.12 python3.13 python3; do \
  $$p -c '$(SUPPORTED)' 2>/dev/null && { echo $$p; break; }; done),python3)
CXX ?= g++
READY := $(VENV)/.ready
TRAINING := $(VENV)/.ready-train
PIP := $(BIN)/python -m pip --disable-pip-version-check
# Where CFLAGS allow fused products (-march=native), Box2D and PyBullet would have other bits; and
# where CFLAGS are set, setuptools leaves out Python's own, -O3 among them.
EXACT := CFLAGS="-O3 -DNDEBUG $$CFLAGS -ffp-contract=off" CXXFLAGS="-O3 -DNDEBUG $$CXXFLAGS -ffp-contract=off"
ENGINE_SOURCES := setup.py $(shell find designrl/engine/native -type f)

export ZOO BACKEND
# box2d-py's build calls swig, which pip has put there; PyBullet's looks for NumPy.
export PATH := $(CURDIR)/$(BIN):$(PATH)

.PHONY: setup setup-train same-python test test-floors test-wheel bench lint types proto reproduce FORCE page \
  gallery train-all zoo verify-runs verify-zoo transfer verify-engine sanitize-engine verify-resume fuzz clean

setup: $(READY)

setup-train: $(TRAINING)

same-python:
	@test ! -x $(BIN)/python || test "$$($(PYTHON) -V 2>&1)" = "$$($(BIN)/python -V 2>&1)" || { \
	  echo "designrl: $(VENV) was made with $$($(BIN)/python -V) and PYTHON=$(PYTHON) is not that; remove it with make clean" >&2; exit 1; }

$(READY): requirements.lock pyproject.toml $(ENGINE_SOURCES) | same-python
	@why="$$($(PYTHON) -c '$(SUPPORTED)' 2>&1)" || { why="$$(echo "$$why" | head -n 1)"; \
	  echo "designrl: Python 3.11, 3.12 or 3.13 is needed and $${why:-$(PYTHON) is not it}; install one, or name it with make PYTHON=/path/to/python3.11" >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || { \
	  echo "designrl: $(PYTHON) cannot make virtual environments; install its venv package (Debian: $(notdir $(PYTHON))-venv)" >&2; exit 1; }
	@$(PYTHON) -c 'import os, sysconfig; os.stat(sysconfig.get_path("include") + "/Python.h")' 2>/dev/null || { \
	  echo "designrl: the headers of $(PYTHON) are needed to build box2d-py; install them (Debian: $(notdir $(PYTHON))-dev)" >&2; exit 1; }
	@command -v $(firstword $(CXX)) >/dev/null || { \
	  echo "designrl: a C++ compiler is needed to build box2d-py and $(firstword $(CXX)) was not found; install g++, or name one with make CXX=..." >&2; exit 1; }
	@test -x $(BIN)/python || { echo "designrl: making the virtual environment $(VENV)"; $(PYTHON) -m venv $(VENV); }
	@echo "designrl: installing the pinned dependencies (some minutes the first time; box2d-py is compiled, and after Python 3.11, for which the last wheel is, PyBullet: 5 minutes of processor time in all)"
	@grep -E '^(swig|setuptools|wheel|numpy)==' requirements.lock > $(VENV)/build-tools.lock
	@$(PIP) install --quiet -r $(VENV)/build-tools.lock
	@grep '^box2d-py==' requirements.lock > $(VENV)/box2d.lock
	@$(EXACT) $(PIP) install --quiet --no-build-isolation --no-cache-dir -r $(VENV)/box2d.lock  # not one built otherwise
	@$(EXACT) $(PIP) install --quiet --no-build-isolation -r requirements.lock
	@echo "designrl: building the package and its engine"
	@$(PIP) install --quiet --no-build-isolation --no-deps \
	  --config-settings editable_mode=compat --editable .
	@$(BIN)/python -c 'from designrl.engine import missing_reason as r; r() and print("designrl:", r(), "- training will use the slower reference environments")'
	@touch $@

$(TRAINING): requirements-train.lock $(READY)
	@echo "designrl: installing PyTorch, for training and the tests"
	@$(PIP) install --quiet -r requirements-train.lock
	@touch $@

test: $(TRAINING)
	$(BIN)/python -m pytest -n auto

FLOORS := build/floors
test-floors: $(READY)
	@test -x $(FLOORS)/bin/python || $(BIN)/python -m venv $(FLOORS)
	@$(FLOORS)/bin/python -m pip --disable-pip-version-check install --quiet -r requirements-floors.lock
	@echo "$(CURDIR)" > "$$($(FLOORS)/bin/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/designrl.pth"
	$(FLOORS)/bin/python -m pytest $(TESTS)

test-wheel: $(READY)
	@$(BIN)/python tests/wheel.py $(WHEEL_PYTHON)

bench: $(TRAINING)
	$(BIN)/python -m pytest tests/benchmarks --benchmark-only

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	@if command -v npx >/dev/null; then npx --yes --package typescript@5.9.3 tsc -p docs/page; \
	else echo "the types of docs/page/src are not checked: there is no npx"; fi

types: $(TRAINING)
	@$(PIP) install --quiet -c requirements-extras.lock mypy
	$(BIN)/mypy

proto: $(READY)
	@$(PIP) install --quiet --no-deps -c requirements-extras.lock grpcio-tools
	$(BIN)/python -m grpc_tools.protoc -I. --python_out=. designrl/recording/schema.proto

reproduce: $(READY)
	@$(BIN)/python -m reproduce.build

# Which items there are, the program knows (reproduce/build.py).
reproduce-%: $(READY) FORCE
	@$(BIN)/python -m reproduce.build $*

# The learned bodies stay, whatever becomes of the runs that they are of.
TRANSFER := paper/transfer
FLAT = --steps 4000000
HARDCORE = --steps 15000000 --hardcore
LEARNED = --design $(TRANSFER)/$(1)/body.safetensors
CURVE = $(BIN)/python -m reproduce.train_ppo --seed $* --out $@
transfer: $(foreach seed,0 1 2 3 4,$(foreach body,original learned, \
  $(foreach task,flat hardcore,$(TRANSFER)/$(task)/$(body)/seed$(seed).csv)))
$(TRANSFER)/flat/original/seed%.csv: | $(TRAINING)
	$(CURVE) $(FLAT)
$(TRANSFER)/flat/learned/seed%.csv: | $(TRAINING)
	$(CURVE) $(FLAT) $(call LEARNED,flat)
$(TRANSFER)/hardcore/original/seed%.csv: | $(TRAINING)
	$(CURVE) $(HARDCORE)
$(TRANSFER)/hardcore/learned/seed%.csv: | $(TRAINING)
	$(CURVE) $(HARDCORE) $(call LEARNED,hardcore)

page: $(READY)
	@$(BIN)/python -c 'import ziglang' 2>/dev/null || $(PIP) install --quiet -c requirements-extras.lock ziglang
	@$(BIN)/python -m reproduce.page

gallery: $(READY)
	@$(BIN)/python -m reproduce.gallery

# The published runs, one on each core; ONLY="biped ant" for those of some experiments.
train-all zoo: $(TRAINING)  # zoo: its old name
	@$(BIN)/python -m reproduce.train_all $(if $(ONLY),--only $(ONLY))

verify-runs verify-zoo: $(TRAINING)
	@$(BIN)/python -m reproduce.train_all --verify $(if $(ONLY),--only $(ONLY))

verify-engine: $(READY)
	@$(BIN)/python -m designrl.verify

# A second copy of the package, in build/. Python itself is not instrumented: the sanitiser has to be
# there before it, and what it never frees is not of interest.
SANITIZED := build/sanitized/lib
SANITIZED_EPISODES := 300
SANITIZE := -fsanitize=address,undefined -fno-sanitize-recover=undefined
WATCHED := ASAN_OPTIONS=detect_leaks=0:allocator_may_return_null=1 LD_PRELOAD="$$($(CXX) -print-file-name=libasan.so)" \
  PYTHONPATH=. $(CURDIR)/$(BIN)/python -m
sanitize-engine: $(TRAINING)
	@CXXFLAGS="$(SANITIZE)" $(BIN)/python setup.py -q build --build-base build/sanitized --build-lib $(SANITIZED)
	@nm -D $(SANITIZED)/designrl/engine/_native*.so | grep -q __asan_init
	@cd $(SANITIZED) && $(WATCHED) pytest -q -c /dev/null -p no:cacheprovider $(CURDIR)/tests/test_engine.py $(CURDIR)/tests/test_ant_engine.py $(CURDIR)/tests/test_vector_envs.py
	@cd $(SANITIZED) && $(WATCHED) designrl.verify --episodes $(SANITIZED_EPISODES) --steps 500

verify-resume: $(TRAINING)
	@$(BIN)/python tests/verify_resume.py

fuzz: $(TRAINING)
	@$(BIN)/python tests/fuzz.py

clean:
	rm -rf $(VENV) build *.egg-info .cache
