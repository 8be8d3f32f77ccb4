# hilserver. `make help` lists what there is; `make run` and `make test` work on a fresh clone.

SHELL := /bin/sh
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
MAKEFLAGS += --no-print-directory

VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet
NPM_FOLDERS := $(patsubst %/package.json,%,$(wildcard tests/*/package.json)) page

# What the tests call, or a file that they need, and the Debian package it comes from.
TOOLS := cyclictest:rt-tests nft:nftables ip:iproute2 cc:gcc \
    systemd-analyze:systemd debootstrap:debootstrap systemd-nspawn:systemd-container \
    nsenter:util-linux promtool:prometheus mosquitto:mosquitto mosquitto_sub:mosquitto-clients \
    chromium:chromium g++:g++ idlc:cyclonedds-tools qemu-aarch64:qemu-user \
    aarch64-linux-gnu-gcc:gcc-aarch64-linux-gnu /usr/aarch64-linux-gnu/include/stdio.h:libc6-dev-arm64-cross \
    /usr/include/dds/dds.h:cyclonedds-dev /usr/include/fastdds/rtps/rtps_all.h:libfastrtps-dev
export PATH := $(PATH):/usr/sbin:/sbin

.PHONY: help
help: ## Show this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-13s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

.PHONY: run
run: $(VENV)/.run $(if $(BODY),$(VENV)/.physics) ## Install if needed and drive the demonstration (Ctrl-C ends it; ARGS="--duration 60"; BODY=1)
	@$(BIN)/python .ci/foreground.py $(BIN)/hilserver run --demo $(if $(BODY),-c examples/body/config.yaml) $(ARGS)

# Two runs. In the first, tests that compute and tests that wait share the cores, one process more
# than there are cores. The second keeps time: three files at once, which mostly wait. It begins
# with those that take longest, so that none is left alone at the end.
TIMED := tests/page tests/prometheus tests/soak tests/node_red tests/examples tests/control \
    tests/security/test_attack.py tests/io/recorder/test_process.py tests/commands/test_wiring.py tests/commands/test_demo.py \
    tests/systemd tests/scheduler tests/loopback/test_metrics.py
CORES := $(shell env -u OMP_NUM_THREADS nproc)
SHARED := --numprocesses $(shell expr $(CORES) + 1) --maxprocesses 8 --dist worksteal
APART := --numprocesses 3 --dist loadfile --no-loadscope-reorder
# A real-time test fails where other tests, or other guests of the host, hold the cores for seconds.
# What failed beside others has two more tries by itself; a defect fails in all of them.
ONCE_MORE := --- once more, one by one: what failed beside others
LAST_FAILED := $(BIN)/python -m pytest --last-failed --last-failed-no-failures none
# Threads of the linear algebra would wait for each other on cores that all processes share.
test test-long: export OPENBLAS_NUM_THREADS := 1
# An environment that forbids compiled modules makes every process of the tests compile them anew.
test test-long: export PYTHONDONTWRITEBYTECODE :=

.PHONY: test
test: test-tools ## Install what the tests need, run all tests but the long ones
ifeq ($(strip $(ARGS)),)
	@failed=; $(BIN)/python -m pytest $(SHARED) $(addprefix --ignore=,$(TIMED)) || failed=1; \
	    $(BIN)/python -m pytest $(APART) $(TIMED) || failed=1; \
	    if [ "$$failed" ]; then echo "$(ONCE_MORE)"; $(LAST_FAILED) || $(LAST_FAILED); fi
else
	@$(BIN)/python -m pytest $(ARGS)
endif

.PHONY: test-long
test-long: test-tools ## Run the soaks and full campaigns, and the properties with fresh seeds
ifeq ($(strip $(ARGS)),)
	@failed=; export HYPOTHESIS_PROFILE=fresh; \
	    $(BIN)/python -m pytest -m long --timeout 7200 || failed=1; \
	    $(BIN)/python -m pytest -m 'hypothesis and not long' || failed=1; [ -z "$$failed" ]
else
	@HYPOTHESIS_PROFILE=fresh $(BIN)/python -m pytest -m long --timeout 7200 $(ARGS)
endif

.PHONY: test-pythons
test-pythons: $(VENV)/.dev ## Start, drive and diagnose on each Python, with newest and lowest dependencies
	@$(BIN)/python .ci/pythons.py $(ARGS)

.PHONY: lint
lint: $(VENV)/.dev ## Check style, types, the layers of the house and its density
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy
	@$(BIN)/lint-imports
	@$(BIN)/python .ci/house.py --check

.PHONY: upgrade
upgrade: $(VENV)/.dev ## Install the newest versions of all packages; .ci/run writes them down if all passes
	@$(PIP) install --upgrade --upgrade-strategy eager --editable '.[dev]'
	@touch $(VENV)/.run $(VENV)/.dev

.PHONY: format
format: $(VENV)/.dev ## Bring all code into the project's form
	@$(BIN)/ruff check --fix .
	@$(BIN)/ruff format .

.PHONY: reference
reference: $(VENV)/.run ## Write the generated reference pages anew
	@$(BIN)/python -m reference
	@$(BIN)/python -m tests.control.table > docs/reference/control-matrix.md
	@$(BIN)/python -m reference.schemas findings > hilserver/diagnosis/schema/findings.schema.json
	@$(BIN)/python -m reference.schemas patch > hilserver/diagnosis/schema/model_patch.schema.json
	@$(BIN)/hilserver check --schema config.schema.json

.PHONY: pictures
pictures: test-tools ## Take the pictures of page and dashboard anew, on a quiet computer (a few minutes)
	@$(BIN)/python -m tests.page.pictures docs/how-to/page
	@$(BIN)/python -m tests.grafana.picture docs/how-to/dashboard.webp

.PHONY: wheel wheels
wheel: $(VENV)/.dev ## Build sdist and wheel with compiled code for this Python into dist/, and check them (two minutes)
	@rm -rf dist
	@$(BIN)/python deploy/wheels.py $(BIN)/python
	@$(BIN)/python -m twine check --strict dist/*

wheels: $(VENV)/.dev ## The same for each Python that we support and that is found
	@rm -rf dist
	@$(BIN)/python deploy/wheels.py
	@$(BIN)/python -m twine check --strict dist/*

.PHONY: image
image: $(VENV)/.dev ## Build an OCI image into dist/, without a registry (as root; needs debootstrap)
	@rm -rf build/lib* build/bdist.* build/plain
	@$(BIN)/python -m build --wheel --outdir build/plain . >/dev/null
	@$(BIN)/python deploy/container/image.py build/plain/*.whl --out dist/hilserver-oci.tar --work build/image

.PHONY: clean
clean: ## Remove everything that make has made
	@rm -rf $(VENV) build dist *.egg-info $(addsuffix /node_modules,$(NPM_FOLDERS))
	@rm -rf .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
	@find hilserver tests -name __pycache__ -type d -prune -exec rm -rf {} +

# --- installation: a stamp file says what is done, so that nothing is installed twice -------------

# The first Python that starts (a shim may not), is new enough and can make an environment.
$(BIN)/python:
	@for python in $(PYTHON) python3 python3.13 python3.12 python3.11; do \
	    if $$python -c 'import ensurepip, sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; \
	    then echo "making $(VENV) with $$($$python --version)"; exec $$python -m venv $(VENV); fi; \
	done; \
	echo "hilserver needs Python 3.11 or newer with venv: install the packages python3.11 and" \
	    "python3.11-venv, or name an interpreter with 'make PYTHON=/path/to/python'" >&2; exit 1

$(VENV)/.run: pyproject.toml constraints.txt | $(BIN)/python
	@echo "installing hilserver into $(VENV) (a minute or two)"
	@$(PIP) install --constraint constraints.txt --editable .
	@touch $@

$(VENV)/.physics: $(VENV)/.run
	@echo "installing the physics of the mechatronic model (a minute)"
	@$(PIP) install --constraint constraints.txt --editable '.[physics]'
	@touch $@

$(VENV)/.dev: pyproject.toml constraints.txt | $(BIN)/python
	@echo "installing hilserver and what its tests need into $(VENV) (a minute or two)"
	@$(PIP) install --constraint constraints.txt --editable '.[dev]'
	@touch $(VENV)/.run $@

.PHONY: test-tools
test-tools: $(VENV)/.dev $(VENV)/.debian build/ros/.installed $(addsuffix /node_modules/.installed,$(NPM_FOLDERS))

$(VENV)/.debian: Makefile | $(BIN)/python
	@missing=; \
	for tool in $(TOOLS); do \
	    { command -v $${tool%%:*} || test -e $${tool%%:*}; } >/dev/null || missing="$$missing $${tool#*:}"; \
	done; \
	command -v npm >/dev/null || missing="$$missing nodejs npm"; \
	case " $$missing " in *" gcc "*) missing="$$missing libc6-dev";; esac; \
	if [ -z "$$missing" ]; then touch $@; \
	elif [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	    echo "installing Debian packages:$$missing"; \
	    export DEBIAN_FRONTEND=noninteractive; \
	    apt-get update -qq && apt-get install -y -qq --no-install-recommends $$missing >/dev/null \
	        || exit 1; \
	    for service in prometheus mosquitto; do case "$$missing" in *$$service*) \
	        if [ -d /run/systemd/system ]; then systemctl disable --quiet --now $$service; fi;; \
	    esac; done; \
	    touch $@; \
	else \
	    echo "the tests that use them will fail without these Debian packages:$$missing;" \
	        "install them with 'sudo apt-get install$$missing'" >&2; \
	fi

# Nodes of a real ROS 2 for the tests, in an environment of their own: rclpy is there for Python 3.12.
ROS := ros-kilted-rclpy ros-geometry-msgs ros-nav-msgs ros-sensor-msgs ros-std-msgs ros-std-srvs ros-rcl-interfaces \
    ros-rmw-fastrtps-cpp

build/ros/.installed:
	@for python in python3.12 $$HOME/.pyenv/versions/3.12.*/bin/python3.12; do \
	    if $$python -c 'import ensurepip' 2>/dev/null; then \
	        echo "installing nodes of a real ROS 2 into build/ros (250 MB)"; \
	        $$python -m venv build/ros && build/ros/bin/python -m pip install --quiet --prefer-binary $(ROS) \
	            && touch $@; exit; \
	    fi; \
	done; \
	echo "the tests with nodes of a real ROS 2 are skipped: they need Python 3.12 with venv" >&2

%/node_modules/.installed: %/package.json | $(VENV)/.debian
	@command -v npm >/dev/null || { \
	    echo "the tests in $* need Node.js with npm: install the packages nodejs and npm" >&2; exit 1; }
	@echo "installing the npm packages of $*"
	@cd $* && npm install --no-audit --no-fund --no-package-lock --loglevel=error
	@touch $@

page/node_modules/.installed: page/package-lock.json | $(VENV)/.debian
	@echo "installing the npm packages of page"
	@cd page && npm ci --no-audit --no-fund --loglevel=error
	@touch $@
