# From a fresh clone to a result: a virtual environment in .venv, then the command.
#
#   PYTHON=python3.12    the Python of .venv (3.10 to 3.13); default python3
#   ROS=kilted           the ROS 2 in the virtual environment; default jazzy
#   ARGS="..."           more arguments for the command behind a target, e.g. ARGS="-k launcher"
#   NAME=servo           which experiment (experiments only); default all
#   BAG=out/run_1        which recording (replay only)
#   PIP_EXTRA_INDEX_URL=https://download.pytorch.org/whl/cpu    a torch without CUDA, 2 GB less

PYTHON ?= python3
ROS ?= jazzy
ARGS ?=

VENV_jazzy := .venv
VENV_kilted := .venv-kilted
VENV := $(or $(VENV_$(ROS)),$(error ROS=$(ROS) is unknown; known are jazzy and kilted))
BIN := $(VENV)/bin
# Compiling every module would take half of an installation's time; imports compile what they need.
PIP := $(BIN)/python -m pip install --disable-pip-version-check --no-compile
DATASET := out/collect/dataset.npz
MODEL := config/models/ur5_front.npz

# For setup.py.
export FVS_ROS_DISTRO := $(ROS)

# Without HOME and without this, rclpy does not start.
export ROS_LOG_DIR ?= $(CURDIR)/out/log

# The wheels in .venv are a whole ROS 2: a ROS that the shell has sourced must not mix with them.
unexport PYTHONPATH AMENT_PREFIX_PATH RMW_IMPLEMENTATION

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help demo dashboard test coverage experiments replay bench model docs lint format clean check-python log-dir

help: ## list the targets
	@echo "usage: make TARGET [PYTHON=python3.11] [ARGS=...]"
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "  make %-11s %s\n", $$1, $$2 }' Makefile

demo: $(VENV)/.installed-demo log-dir ## simulated UR5 follows four targets; result in out/demo
	@echo "== demo: about a minute; Ctrl-C stops it"
	@$(BIN)/fvs_launch config/demo.yaml $(ARGS)

dashboard: $(VENV)/.installed-dashboard log-dir ## the same arm, watched and driven from a page in the browser
	@echo "== the page's address follows in some seconds; Ctrl-C stops it"
	@$(BIN)/fvs_launch config/dashboard.yaml $(ARGS)

test: $(VENV)/.installed-all log-dir ## all tests
	@echo "== tests: four to seven minutes on two cores"
	@ROS_PYTHON_CHECK_FIELDS=1 ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST \
		$(BIN)/python -m pytest -n 2 $(ARGS)

coverage: $(VENV)/.installed-all log-dir ## lines that the tests run, of the ground and the nodes: at least 90 %
	@echo "== tests with coverage: about half as long again"
	@rm -rf out/coverage && mkdir -p out/coverage
	@ROS_PYTHON_CHECK_FIELDS=1 ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST \
		$(BIN)/python -m coverage run -m pytest -n 2 $(ARGS)
	@$(BIN)/python -m coverage combine -q && $(BIN)/python -m coverage report

experiments: $(VENV)/.installed-lab log-dir ## the paper's experiments, measured anew; page in out/experiments
	@echo "== experiments: some two hours on two cores; ARGS=--quick takes two or three"
	@ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST \
		$(BIN)/fvs_experiments $(or $(NAME),all) $(ARGS)

replay: $(VENV)/.installed-lab log-dir ## table and figure of a recording, BAG=out/run_1, into out/replay
	@$(BIN)/fvs_experiments replay $(or $(BAG),$(error name the recording: make replay BAG=out/run_1)) $(ARGS)

bench: $(VENV)/.installed-all log-dir ## measurements of bench/, as tables
	@echo "== benchmarks: some minutes; keep the machine idle"
	@$(BIN)/python -m bench $(ARGS)

model: $(VENV)/.installed-model log-dir ## record a data set and train the demo's model anew
	@echo "== record joint motion in simulation: some minutes"
	@$(BIN)/fvs_launch config/collect.yaml
	@echo "== train on it: some minutes"
	@mkdir -p $(dir $(MODEL))
	@$(BIN)/fvs_train $(DATASET) -o $(MODEL) $(ARGS)

docs: $(VENV)/.installed-docs log-dir ## the API's pages, from the docstrings; out/docs/index.html
	@$(BIN)/pdoc --docformat numpy -o out/docs fvs_ros fvs_tools fvs_dashboard fvs_lab fvs_sim_node fvs_detector_node \
		fvs_estimator_node fvs_controller_node
	@echo "page: out/docs/index.html"

lint: $(VENV)/.installed-lint ## ruff and mypy, changing nothing
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy

format: $(VENV)/.installed-lint ## let ruff format and repair what it can
	@$(BIN)/ruff format .
	@$(BIN)/ruff check --fix .

clean: ## remove .venv, build products and caches; out/ stays
	rm -rf $(VENV) build install log *.egg-info .pytest_cache .ruff_cache .mypy_cache .hypothesis
	@find . -name .git -prune -o -name __pycache__ -type d -exec rm -rf {} +

log-dir:
	@mkdir -p "$$ROS_LOG_DIR"

# What is installed: one stamp per set of extras. A larger set stamps the smaller ones it holds.

$(VENV)/.installed-demo: EXTRAS := sim,record
$(VENV)/.installed-model: EXTRAS := sim,record,train
$(VENV)/.installed-lab: EXTRAS := sim,record,lab
$(VENV)/.installed-dashboard: EXTRAS := sim,record,dashboard
$(VENV)/.installed-lint: EXTRAS := test
$(VENV)/.installed-all: EXTRAS := all
$(VENV)/.installed-all: ALSO := demo dashboard model lab lint
$(VENV)/.installed-dashboard: ALSO := demo
$(VENV)/.installed-docs: EXTRAS := all,docs
$(VENV)/.installed-docs: ALSO := all demo dashboard model lab lint
$(VENV)/.installed-lab: ALSO := demo
$(VENV)/.installed-model: ALSO := demo
# Of installations; pip shows its own progress.
HINT_demo := half a minute and 250 MB
HINT_dashboard := a minute and 450 MB
HINT_model := minutes and up to 3 GB for torch
HINT_lab := a minute and 350 MB
HINT_docs := minutes and up to 3 GB for torch
HINT_lint := half a minute and 100 MB
HINT_all := minutes and up to 3 GB for torch

$(VENV)/.installed-%: setup.py $(VENV)/.made | check-python
	@echo "== install fvs_ros[$(EXTRAS)] into $(VENV): $(HINT_$*), once"
	@$(PIP) -e '.[$(EXTRAS)]'
	@touch $@ $(addprefix $(VENV)/.installed-,$(ALSO))

$(VENV)/.made:
	@$(call check-version,$(PYTHON))
	@echo "== make $(VENV) with $(PYTHON): some seconds"
	@rm -rf $(VENV)
	@"$(PYTHON)" -m venv $(VENV) || { rm -rf $(VENV); \
		echo "$(PYTHON) could not make a virtual environment;" \
			"on Debian and Ubuntu: sudo apt install python3-venv" >&2; exit 1; }
	@touch $@

define check-version
version=$$("$(1)" -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null) || { \
	echo "There is no Python called '$(1)'. Name one: make ... PYTHON=python3.11" >&2; exit 1; }; \
case $$version in 3.10|3.11|3.12|3.13) ;; *) \
	echo "'$(1)' is Python $$version, but fvs_ros needs 3.10 to 3.13." \
		"Name another one: make ... PYTHON=python3.11" >&2; exit 1;; esac
endef

# An existing .venv keeps its Python; say so when another one is asked for.
check-python: $(VENV)/.made
ifneq ($(filter command environment,$(origin PYTHON)),)
	@$(call check-version,$(PYTHON)); \
	held=$$($(BIN)/python -c 'import sys; print("%d.%d" % sys.version_info[:2])'); \
	[ "$$version" = "$$held" ] || { \
		echo "$(VENV) was made with Python $$held, '$(PYTHON)' is Python $$version:" \
			"run 'make clean' first." >&2; exit 1; }
endif
